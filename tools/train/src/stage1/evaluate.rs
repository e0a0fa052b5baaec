//! Scores of the network on held-out clips, and a picture of what it makes of the first of them.

use std::collections::BTreeMap;

use rogs_field::gates::MOTION_GATE_IU;
use rogs_schemas::units::m_from_iu;
use rogs_splat::RasterConfig;
use rogs_stage1::Stage1;
use rogs_synth::World;
use rogs_tensors::parameters::to_host;
use rogs_tensors::render::render_views;

use super::forward::{Heads, attributes, decode, gaussians, source_frames};
use super::matching::relative_errors;
use crate::config::{DataSettings, Stage1Training};
use crate::error::Result;
use crate::picture::{Canvas, Picture, peak_signal};
use crate::plan::ClipPlan;
use crate::recorded::Recordings;
use crate::run::Evaluation;
use crate::sample::{Query, Sample};

/// Pixels with less accumulated opacity have no depth.
const LEAST_ALPHA: f32 = 0.5;

/// What a camera sees of the field at a query time.
struct View {
    /// RGB. `[A, 3]`
    rgb: Vec<f32>,
    /// Accumulated opacity. `[A]`
    alpha: Vec<f32>,
    /// Expected depth, internal units. `[A]`
    depth: Vec<f32>,
}

/// What is known of one clip.
struct Scored {
    scores: BTreeMap<&'static str, f64>,
    /// All views at its last query time.
    views: Vec<View>,
    /// Depth of the head, internal units. `[S, A]`
    head_depth: Vec<f32>,
}

/// Scores held-out clips; the picture shows the first one.
///
/// # Errors
/// When a clip cannot be made or rendered.
pub(super) fn evaluate(network: &Stage1, settings: &Stage1Training) -> Result<Evaluation> {
    // Without gradients it is faster, and runs on the kernels that lifting uses.
    let network = Stage1::new(network.config.clone(), network.parameters.without_gradients())?;
    let mut evaluation = Evaluation::default();
    let mut counts: BTreeMap<String, f64> = BTreeMap::new();
    held_out(settings, &mut |kind, sample| {
        let Scored {
            scores,
            views,
            head_depth,
        } = score(&network, sample)?;
        for (name, value) in scores {
            let name = format!("{kind}{name}");
            *counts.entry(name.clone()).or_insert(0.0) += 1.0;
            *evaluation.scores.entry(name).or_insert(0.0) += value;
        }
        if evaluation.picture.is_none() {
            let last = sample.queries.last();
            evaluation.picture = last.map(|query| grid(sample, query, &views, &head_depth));
        }
        Ok(())
    })?;
    for (name, sum) in &mut evaluation.scores {
        *sum /= counts.get(name).copied().unwrap_or(1.0);
    }
    Ok(evaluation)
}

/// Goes through the clips that are scored, each with what stands before the names of its scores: plain robot cells of the
/// settings' size; `wide_`, where there are wide worlds; the size, as `154x280_`, where there are more; `recorded_` and
/// `frames_`. The latter are fewer.
fn held_out(settings: &Stage1Training, visit: &mut dyn FnMut(&str, &Sample) -> Result<()>) -> Result<()> {
    let data = &settings.data;
    let plain = DataSettings {
        world: None,
        props: None,
        robots: Vec::new(),
        ..data.clone()
    };
    let all = settings.evaluation_clips;
    let some = all.div_ceil(2);
    let mut procedural = |kind: &str, data: &DataSettings, count: u64| -> Result<()> {
        for index in 0..count {
            let plan = ClipPlan::evaluation(data.held_out_seed + index, data);
            visit(kind, &plan.or_another(|plan| plan.sample(data, true))?)?;
        }
        Ok(())
    };
    procedural("", &plain, all)?;
    if let Some(world) = &data.world {
        let wide = DataSettings {
            world: Some(World {
                share: 1.0,
                ..world.clone()
            }),
            ..data.clone()
        };
        procedural("wide_", &wide, some)?;
    }
    for more in &data.more_sizes {
        let [height, width] = more.size;
        let sized = DataSettings {
            size: more.size,
            ..plain.clone()
        };
        procedural(&format!("{height}x{width}_"), &sized, some.div_ceil(2))?;
    }
    for (kind, sample) in Recordings::open(data)?.held_out(data, some)? {
        visit(&format!("{kind}_"), &sample)?;
    }
    Ok(())
}

/// Scores of one clip.
///
/// | score | |
/// |---|---|
/// | `head_abs_rel` | mean of abs(D - D*) / D* of the depth head at source pixels that are not robot |
/// | `head_robot_abs_rel` | the same at pixels of the robot |
/// | `sweep_abs_rel` | the same of the expected depth of the stem's sweep, where there is one, all cells |
/// | `source_abs_rel`, `novel_abs_rel` | the same of rendered depth at source cameras and at right eyes |
/// | `source_psnr`, `novel_psnr` | at query times, dB |
/// | `robot_epe_mm` | mean distance of predicted and true displacement at robot pixels |
/// | `robot_epe_unconditioned_mm` | the same with all conditioning maps zero |
/// | `robot_epe_unanchored_mm` | the same without mesh anchors |
/// | `object_epe_mm` | the same at pixels of objects |
/// | `moving_object_epe_mm` | the same at pixels of objects that move |
/// | `moving_object_mm` | how far these move: the error of no motion at all |
fn score(network: &Stage1, sample: &Sample) -> Result<Scored> {
    let encoded = network.encode(&source_frames(sample, network.parameters.device()))?;
    let lifted = decode(network, sample, &encoded, true, Heads::All)?.on_cpu()?;
    let bare = decode(network, sample, &encoded, false, Heads::All)?;
    let free = decode(network, &sample.without_anchors(), &encoded, true, Heads::All)?;
    let mut means = Means::default();
    let depth = to_host(lifted.depth.clone())?;
    for pixel in 0..depth.len() {
        if sample.valid[pixel] > 0.0 {
            let error = (depth[pixel] - sample.depth_iu[pixel]).abs();
            let robot = sample.robot[pixel] > 0.0;
            let name = if robot { "head_robot_abs_rel" } else { "head_abs_rel" };
            means.add(name, f64::from(error / sample.depth_iu[pixel]));
        }
    }
    if let Some(found) = &lifted.sweep {
        for error in relative_errors(sample, found)? {
            means.add("sweep_abs_rel", error);
        }
    }
    let area = sample.size[0] * sample.size[1];
    let mut last = Vec::new();
    for (index, query) in sample.queries.iter().enumerate() {
        let moved = to_host(lifted.queries[index].displacement.clone())?;
        distances(sample, query, &moved, |pixel, distance| {
            if sample.robot[pixel] > 0.0 {
                means.add("robot_epe_mm", distance);
                return;
            }
            means.add("object_epe_mm", distance);
            let moves_iu = query.moved_iu(pixel, area);
            if moves_iu > MOTION_GATE_IU {
                means.add("moving_object_epe_mm", distance);
                means.add("moving_object_mm", millimetres(moves_iu));
            }
        });
        for (name, other) in [
            ("robot_epe_unconditioned_mm", &bare),
            ("robot_epe_unanchored_mm", &free),
        ] {
            let moved = to_host(other.queries[index].displacement.clone())?;
            distances(sample, query, &moved, |pixel, distance| {
                if sample.robot[pixel] > 0.0 {
                    means.add(name, distance);
                }
            });
        }
        let outputs = &lifted.queries[index];
        let field = gaussians(
            lifted.position.clone() + outputs.displacement.clone(),
            attributes(outputs.raw.clone(), sample),
            None,
        );
        let cameras: Vec<_> = query.targets.iter().map(|target| target.camera).collect();
        let rendered = render_views(&field, &cameras, None, &RasterConfig::default())?;
        let (rgb, alpha, depth) = (
            to_host(rendered.rgb)?,
            to_host(rendered.alpha)?,
            to_host(rendered.depth)?,
        );
        let split = alpha.chunks_exact(area).zip(depth.chunks_exact(area));
        let views = rgb.chunks_exact(3 * area).zip(split).map(|(rgb, (alpha, depth))| View {
            rgb: rgb.to_vec(),
            alpha: alpha.to_vec(),
            depth: depth.to_vec(),
        });
        last = views.collect();
        for (view, target) in last.iter().zip(&query.targets) {
            let (psnr, abs_rel) = if target.right {
                ("novel_psnr", "novel_abs_rel")
            } else {
                ("source_psnr", "source_abs_rel")
            };
            means.add(psnr, peak_signal(&view.rgb, &target.rgb));
            for pixel in 0..area {
                if target.valid[pixel] > 0.0 && view.alpha[pixel] > LEAST_ALPHA {
                    let error = (view.depth[pixel] - target.depth_iu[pixel]).abs();
                    means.add(abs_rel, f64::from(error / target.depth_iu[pixel]));
                }
            }
        }
    }
    Ok(Scored {
        scores: means.values(),
        views: last,
        head_depth: depth,
    })
}

fn millimetres(length_iu: f32) -> f64 {
    f64::from(m_from_iu(length_iu)) * 1000.0
}

/// Distances of displacements at pixels of robot and objects, millimetres.
fn distances(sample: &Sample, query: &Query, moved: &[f32], mut add: impl FnMut(usize, f64)) {
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
        add(pixel, millimetres(square.sqrt()));
    }
}

/// The picture of a clip. Rows at a query time: seen, rendered, reference depth, rendered depth; columns: the cameras. Below,
/// as many source images as fit: seen, reference depth, depth of the head.
fn grid(sample: &Sample, query: &Query, views: &[View], head_depth: &[f32]) -> Picture {
    let size = sample.size;
    let area = size[0] * size[1];
    let mut picture = Canvas::new(size, [7, views.len()]);
    for (column, (view, target)) in views.iter().zip(&query.targets).enumerate() {
        picture.paint([0, column], |pixel, channel| target.rgb[3 * pixel + channel]);
        picture.paint([1, column], |pixel, channel| view.rgb[3 * pixel + channel]);
        picture.paint([2, column], |pixel, _| shade(target.depth_iu[pixel]));
        picture.paint([3, column], |pixel, _| shade(view.depth[pixel]));
    }
    let sources = sample.views.len();
    let shown = views.len().min(sources);
    for column in 0..shown {
        // Spread over the cameras and times.
        let source = column * sources / shown.max(1);
        picture.paint([4, column], |pixel, channel| {
            sample.images[(3 * source + channel) * area + pixel]
        });
        picture.paint([5, column], |pixel, _| shade(sample.depth_iu[source * area + pixel]));
        picture.paint([6, column], |pixel, _| shade(head_depth[source * area + pixel]));
    }
    picture.finish()
}

/// Brightness of a depth, internal units: near is bright, 10 and what has no depth are black.
fn shade(depth: f32) -> f32 {
    if depth > 0.0 {
        1.0 - (depth / 10.0).min(1.0)
    } else {
        0.0
    }
}

/// Means by name.
#[derive(Default)]
struct Means {
    sum_and_count: BTreeMap<&'static str, (f64, f64)>,
}

impl Means {
    fn add(&mut self, name: &'static str, value: f64) {
        let (sum, count) = self.sum_and_count.entry(name).or_default();
        *sum += value;
        *count += 1.0;
    }

    fn values(self) -> BTreeMap<&'static str, f64> {
        let mean = |(name, (sum, count))| (name, sum / count);
        self.sum_and_count.into_iter().map(mean).collect()
    }
}
