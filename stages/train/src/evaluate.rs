//! Scores of the network on held-out clips, and a picture of what it makes of the first of them.

use std::collections::BTreeMap;

use burn::tensor::Device;
use rogs_networks::parameters::{Parameters, to_host};
use rogs_networks::stage1::Stage1;
use rogs_schemas::units::m_from_iu;
use rogs_splat::{Colour, Gaussians, RasterConfig, Render, render_views};
use serde::{Deserialize, Serialize};

use crate::config::Stage1Training;
use crate::error::Result;
use crate::forward::{Lifted, attributes, lift};
use crate::run::{Evaluation, Picture};
use crate::sample::{ClipPlan, Query, Sample, Target};

/// Pixels with less accumulated opacity have no depth.
const LEAST_ALPHA: f32 = 0.5;

/// Means over held-out clips.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// Clips.
    pub clips: u64,
    /// Mean |D - D*| / D* of the depth head at source pixels that are not robot.
    pub head_abs_rel: f64,
    /// The same of rendered depth at source cameras.
    pub source_abs_rel: f64,
    /// The same at right eyes.
    pub novel_abs_rel: f64,
    /// PSNR at source cameras at query times, dB.
    pub source_psnr: f64,
    /// PSNR at right eyes, dB.
    pub novel_psnr: f64,
    /// Mean distance of predicted and true displacement at robot pixels, millimetres.
    pub robot_epe_mm: f64,
    /// The same with all conditioning maps zero.
    pub robot_epe_unconditioned_mm: f64,
    /// Mean distance at pixels of objects, millimetres.
    pub object_epe_mm: f64,
}

/// The same network without gradients: faster, and by the kernels that lifting uses.
///
/// # Errors
/// When a parameter cannot be read.
pub fn without_gradients(network: &Stage1) -> Result<Stage1> {
    let mut parameters = Parameters::new(&Device::flex());
    for name in network.parameters.names() {
        let shape = network
            .parameters
            .shape(&name)
            .map(<[usize]>::to_vec)
            .unwrap_or_default();
        parameters.insert(&name, &shape, network.parameters.host(&name)?)?;
    }
    Ok(Stage1::new(network.config.clone(), parameters)?)
}

/// Scores held-out clips; the picture shows the first one.
///
/// # Errors
/// When a clip cannot be made or rendered.
pub fn evaluate(network: &Stage1, settings: &Stage1Training) -> Result<Evaluation> {
    let network = without_gradients(network)?;
    let (mut sum, mut picture) = (Scores::default(), None);
    for index in 0..settings.evaluation_clips {
        let plan = ClipPlan::evaluation(settings.data.held_out_seed + index, &settings.data);
        let sample = plan.sample(&settings.data, true)?;
        let (scores, views) = score(&network, &sample)?;
        sum.add(&scores);
        if picture.is_none() {
            picture = Some(grid(&sample, &views));
        }
    }
    let scores = if settings.evaluation_clips > 0 {
        sum.mean().by_name()
    } else {
        BTreeMap::new()
    };
    Ok(Evaluation { scores, picture })
}

/// Scores of one clip and the renders of its last query.
fn score(network: &Stage1, sample: &Sample) -> Result<(Scores, Vec<Render>)> {
    let lifted = lift(network, sample, true)?;
    let bare = lift(network, sample, false)?;
    let depth = to_host(lifted.depth.clone())?;
    let mut head = Mean::default();
    for pixel in 0..depth.len() {
        if sample.valid[pixel] > 0.0 && sample.robot[pixel] == 0.0 {
            head.add(f64::from(
                (depth[pixel] - sample.depth_iu[pixel]).abs() / sample.depth_iu[pixel],
            ));
        }
    }
    let [mut robot, mut unconditioned, mut objects] = [Mean::default(); 3];
    let mut rel = [Mean::default(); 2];
    let mut psnr = [Mean::default(); 2];
    let mut last = Vec::new();
    for (index, query) in sample.queries.iter().enumerate() {
        for (outputs, robot_mean, object_mean) in [
            (&lifted, &mut robot, Some(&mut objects)),
            (&bare, &mut unconditioned, None),
        ] {
            let moved = to_host(outputs.queries[index].displacement.clone())?;
            distances(sample, query, &moved, robot_mean, object_mean);
        }
        let scene = scene(sample, &lifted, index)?;
        let cameras: Vec<_> = query.targets.iter().map(|target| target.camera).collect();
        let renders = render_views(&scene, &cameras, &RasterConfig::default())?;
        for (render, target) in renders.iter().zip(&query.targets) {
            let side = usize::from(target.right);
            psnr[side].add(peak_signal(render, target));
            for pixel in 0..target.valid.len() {
                if target.valid[pixel] > 0.0 && render.alpha[pixel] > LEAST_ALPHA {
                    let error = (render.depth_expected[pixel] - target.depth_iu[pixel]).abs();
                    rel[side].add(f64::from(error / target.depth_iu[pixel]));
                }
            }
        }
        last = renders;
    }
    let scores = Scores {
        clips: 1,
        head_abs_rel: head.value(),
        source_abs_rel: rel[0].value(),
        novel_abs_rel: rel[1].value(),
        source_psnr: psnr[0].value(),
        novel_psnr: psnr[1].value(),
        robot_epe_mm: robot.value(),
        robot_epe_unconditioned_mm: unconditioned.value(),
        object_epe_mm: objects.value(),
    };
    Ok((scores, last))
}

/// Adds distances of displacements at robot and object pixels, millimetres.
fn distances(sample: &Sample, query: &Query, moved: &[f32], robot: &mut Mean, mut objects: Option<&mut Mean>) {
    let area = sample.size[0] * sample.size[1];
    for pixel in 0..sample.robot.len() {
        if sample.trackable[pixel] == 0.0 {
            continue;
        }
        let (view, local) = (pixel / area, pixel % area);
        let square: f32 = (0..3)
            .map(|axis| {
                let index = (3 * view + axis) * area + local;
                (moved[index] - query.displacement_iu[index]).powi(2)
            })
            .sum();
        let distance = f64::from(m_from_iu(square.sqrt())) * 1000.0;
        if sample.robot[pixel] > 0.0 {
            robot.add(distance);
        } else if let Some(objects) = objects.as_mut() {
            objects.add(distance);
        }
    }
}

/// The field at a query time.
fn scene(sample: &Sample, lifted: &Lifted, query: usize) -> Result<Gaussians> {
    let query = &lifted.queries[query];
    let rows = |map: burn::tensor::Tensor<4>, first: usize, count: usize| {
        let [views, _, height, width] = map.dims();
        let map = map.narrow(1, first, count).permute([0, 2, 3, 1]);
        to_host(map.reshape([views * height * width, count]))
    };
    let attributes = attributes(query.raw.clone(), sample);
    Ok(Gaussians {
        means: rows(lifted.position.clone() + query.displacement.clone(), 0, 3)?,
        colour: Colour::Rgb(rows(attributes.clone(), 0, 3)?),
        scales: rows(attributes.clone(), 3, 3)?,
        quats: rows(attributes.clone(), 6, 4)?,
        opacities: rows(attributes, 10, 1)?,
        extra: Vec::new(),
        extra_channels: 0,
    })
}

fn peak_signal(render: &Render, target: &Target) -> f64 {
    let square = render
        .rgb
        .iter()
        .zip(&target.rgb)
        .map(|(a, b)| f64::from(a.clamp(0.0, 1.0) - b).powi(2));
    let mean = square.sum::<f64>() / target.rgb.len() as f64;
    -10.0 * libm::log10(mean.max(1e-10))
}

/// Rows: seen, rendered, reference depth, rendered depth; columns: the cameras.
fn grid(sample: &Sample, renders: &[Render]) -> Picture {
    let [height, width] = sample.size;
    let Some(query) = sample.queries.last() else {
        return Picture {
            width: 0,
            height: 0,
            rgb: Vec::new(),
        };
    };
    let columns = renders.len();
    let mut rgb = vec![0u8; 4 * height * columns * width * 3];
    let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    // Near is bright; 1 iu and 10 iu are the ends.
    let shade = |depth: f32| {
        if depth > 0.0 {
            byte(1.0 - (depth / 10.0).min(1.0))
        } else {
            0
        }
    };
    for (column, (render, target)) in renders.iter().zip(&query.targets).enumerate() {
        for pixel in 0..height * width {
            let (y, x) = (pixel / width, pixel % width);
            for channel in 0..3 {
                let values = [
                    byte(target.rgb[3 * pixel + channel]),
                    byte(render.rgb[3 * pixel + channel]),
                    shade(target.depth_iu[pixel]),
                    shade(render.depth_expected[pixel]),
                ];
                for (row, value) in values.into_iter().enumerate() {
                    rgb[((row * height + y) * columns * width + column * width + x) * 3 + channel] = value;
                }
            }
        }
    }
    Picture {
        width: (columns * width) as u32,
        height: (4 * height) as u32,
        rgb,
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    sum: f64,
    count: f64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1.0;
    }

    fn value(&self) -> f64 {
        self.sum / self.count.max(1.0)
    }
}

impl Scores {
    /// The numbers by name.
    fn by_name(&self) -> BTreeMap<String, f64> {
        let value = serde_json::to_value(self).unwrap_or_default();
        let numbers = value.as_object().into_iter().flatten();
        numbers
            .filter_map(|(key, value)| Some((key.clone(), value.as_f64()?)))
            .collect()
    }

    fn numbers(&mut self) -> [&mut f64; 8] {
        [
            &mut self.head_abs_rel,
            &mut self.source_abs_rel,
            &mut self.novel_abs_rel,
            &mut self.source_psnr,
            &mut self.novel_psnr,
            &mut self.robot_epe_mm,
            &mut self.robot_epe_unconditioned_mm,
            &mut self.object_epe_mm,
        ]
    }

    fn add(&mut self, other: &Self) {
        let mut other = *other;
        self.clips += other.clips;
        for (sum, value) in self.numbers().into_iter().zip(other.numbers()) {
            *sum += *value;
        }
    }

    fn mean(mut self) -> Self {
        let clips = self.clips.max(1) as f64;
        self.numbers().into_iter().for_each(|number| *number /= clips);
        self
    }
}
