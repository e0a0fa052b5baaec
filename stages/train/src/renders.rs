//! Losses of rendered views and of composited motion.
//!
//! Their gradient in the pixels is known in closed form; the rasteriser's backward pass turns it into one in the
//! Gaussians, and the sum of the Gaussians' tensors times that constant has the same gradient in the parameters.

use std::collections::BTreeMap;

use burn::tensor::Tensor;
use rogs_networks::parameters::{from_host, to_host};
use rogs_schemas::units::m_from_iu;
use rogs_splat::backward::{Gradients, RenderGradient, backward_into, render_with_tape};
use rogs_splat::{Colour, Gaussians, RasterConfig, Render};

use crate::config::LossWeights;
use crate::error::Result;
use crate::forward::{Lifted, attributes};
use crate::sample::{Query, Sample, Target};

/// Keeps a mean over nothing finite.
const EPSILON: f64 = 1e-6;

/// The rendered terms of a clip.
pub struct Rendered {
    /// Weight and value before it, by key.
    pub terms: BTreeMap<&'static str, (f64, f64)>,
    /// Its gradient is that of the weighted sum. `[1]`
    pub surrogate: Tensor<1>,
}

/// Rows of Gaussians on the host with the gradient that gathers for them.
struct Rows {
    tensor: Tensor<2>,
    values: Vec<f32>,
    gradient: Vec<f32>,
    channels: usize,
}

impl Rows {
    /// `[S, c, H, W]` as `[S A, c]`.
    fn new(map: Tensor<4>) -> Result<Self> {
        let [views, channels, height, width] = map.dims();
        let tensor = map.permute([0, 2, 3, 1]).reshape([views * height * width, channels]);
        let values = to_host(tensor.clone())?;
        Ok(Self {
            gradient: vec![0.0; values.len()],
            tensor,
            values,
            channels,
        })
    }

    fn row(&self, index: usize) -> &[f32] {
        &self.values[index * self.channels..(index + 1) * self.channels]
    }

    fn gradient_row(&mut self, index: usize) -> &mut [f32] {
        &mut self.gradient[index * self.channels..(index + 1) * self.channels]
    }

    /// Sum of the rows times their gradient.
    fn surrogate(self) -> Tensor<1> {
        let constant = from_host(self.gradient, self.tensor.dims(), &self.tensor.device());
        (self.tensor * constant).sum()
    }
}

/// Terms of a clip, each a mean over its queries.
///
/// # Errors
/// When the rasteriser or the device fails.
pub fn terms(sample: &Sample, lifted: &Lifted, weights: &LossWeights, tracks: &[i32]) -> Result<Rendered> {
    let mut pass = Pass {
        sample,
        weights,
        config: RasterConfig::default(),
        position: Rows::new(lifted.position.clone())?,
        base: Rows::new(attributes(lifted.base_raw.clone(), sample))?,
        terms: BTreeMap::new(),
    };
    let mut surrogate = Tensor::zeros([1], &lifted.depth.device());
    let share = 1.0 / sample.queries.len().max(1) as f64;
    for (query, outputs) in sample.queries.iter().zip(&lifted.queries) {
        let mut displacement = Rows::new(outputs.displacement.clone())?;
        if weights.renders_views() {
            let mut timed = Rows::new(attributes(outputs.raw.clone(), sample))?;
            pass.views(query, &mut displacement, &mut timed, share)?;
            surrogate = surrogate + timed.surrogate();
        }
        if weights.renders_motion() {
            pass.motion(query, &mut displacement, tracks, share)?;
        }
        surrogate = surrogate + displacement.surrogate();
    }
    surrogate = surrogate + pass.position.surrogate() + pass.base.surrogate();
    Ok(Rendered {
        terms: pass.terms,
        surrogate,
    })
}

struct Pass<'a> {
    sample: &'a Sample,
    weights: &'a LossWeights,
    config: RasterConfig,
    position: Rows,
    base: Rows,
    terms: BTreeMap<&'static str, (f64, f64)>,
}

impl Pass<'_> {
    fn add(&mut self, key: &'static str, weight: f64, value: f64) {
        let entry = self.terms.entry(key).or_insert((weight, 0.0));
        entry.1 += value;
    }

    /// Colour, depth and coverage of the field at a query time, seen by all cameras.
    fn views(&mut self, query: &Query, displacement: &mut Rows, timed: &mut Rows, share: f64) -> Result<()> {
        let all: Vec<usize> = (0..displacement.values.len() / 3).collect();
        let mut scene = scene(&all, &self.position, timed);
        for (mean, moved) in scene.means.iter_mut().zip(&displacement.values) {
            *mean += moved;
        }
        let mut gradients = Gradients::zeros(&scene);
        let count = |right: bool| {
            query
                .targets
                .iter()
                .filter(|target| target.right == right)
                .count()
                .max(1) as f64
        };
        let (sources, rights, cameras) = (count(false), count(true), query.targets.len().max(1) as f64);
        for target in &query.targets {
            let side = share / if target.right { rights } else { sources };
            let (render, tape) = render_with_tape(&scene, &target.camera, &self.config)?;
            let rgb = self.colour(&render, target, share / cameras);
            let depth = self.metric(&render, target, side);
            let alpha = self.coverage(&render, target, side);
            let gradient = RenderGradient {
                rgb: &rgb,
                alpha: &alpha,
                depth_expected: &depth,
                ..RenderGradient::default()
            };
            backward_into(&scene, &self.config, &tape, &gradient, &mut gradients)?;
        }
        for index in all {
            for axis in 0..3 {
                let slope = gradients.means[3 * index + axis];
                self.position.gradient[3 * index + axis] += slope;
                displacement.gradient[3 * index + axis] += slope;
            }
            add_attributes(timed.gradient_row(index), &gradients, index);
        }
        Ok(())
    }

    fn colour(&mut self, render: &Render, target: &Target, share: f64) -> Vec<f32> {
        let weight = self.weights.movies_mse;
        if weight == 0.0 {
            return Vec::new();
        }
        let each = share / render.rgb.len() as f64;
        let mut value = 0.0;
        let gradient = render.rgb.iter().zip(&target.rgb).map(|(rendered, seen)| {
            let error = f64::from(rendered - seen);
            value += each * error * error;
            (weight * each * 2.0 * error) as f32
        });
        let gradient = gradient.collect();
        self.add("movies_mse", weight, value);
        gradient
    }

    /// Depth error in millimetres where there is a reference and something was hit.
    fn metric(&mut self, render: &Render, target: &Target, share: f64) -> Vec<f32> {
        let (key, weight) = if target.right {
            ("metric_right", self.weights.metric_right)
        } else {
            ("metric_final", self.weights.metric_final)
        };
        if weight == 0.0 {
            return Vec::new();
        }
        let hit: Vec<bool> = (render.alpha.iter().zip(&target.valid))
            .map(|(&alpha, &valid)| alpha > 0.0 && valid > 0.0)
            .collect();
        let each = share / (hit.iter().filter(|&&hit| hit).count() as f64 + EPSILON);
        let millimetres = f64::from(m_from_iu(1.0)) * 1000.0;
        let mut value = 0.0;
        let gradient = (0..hit.len()).map(|pixel| {
            if !hit[pixel] {
                return 0.0;
            }
            let error = f64::from(render.depth_expected[pixel] - target.depth_iu[pixel]);
            value += each * millimetres * error.abs();
            (weight * each * millimetres * sign(error)) as f32
        });
        let gradient = gradient.collect();
        self.add(key, weight, value);
        gradient
    }

    fn coverage(&mut self, render: &Render, target: &Target, share: f64) -> Vec<f32> {
        let (key, weight) = if target.right {
            ("coverage_right", self.weights.coverage_right)
        } else {
            ("coverage", self.weights.coverage)
        };
        if weight == 0.0 {
            return Vec::new();
        }
        let each = share / (target.valid.iter().map(|&valid| f64::from(valid)).sum::<f64>() + EPSILON);
        let mut value = 0.0;
        let gradient = render.alpha.iter().zip(&target.valid).map(|(&alpha, &valid)| {
            value += each * f64::from(valid * (1.0 - alpha));
            (-weight * each * f64::from(valid)) as f32
        });
        let gradient = gradient.collect();
        self.add(key, weight, value);
        gradient
    }

    /// Displacement composited at the source times: the Gaussians of one source time, seen by its cameras.
    fn motion(&mut self, query: &Query, displacement: &mut Rows, tracks: &[i32], share: f64) -> Result<()> {
        let area = self.sample.size[0] * self.sample.size[1];
        let robot_pixels = self.sample.support.iter().filter(|&&robot| robot > 0.0).count() as f64;
        let track_each = share / (3.0 * tracks.len() as f64 + EPSILON);
        let robot_each = share / (3.0 * robot_pixels + EPSILON);
        let mut tracked = vec![false; displacement.values.len() / 3];
        tracks.iter().for_each(|&pixel| tracked[pixel as usize] = true);
        let mut times: Vec<f32> = self.sample.views.iter().map(|&(_, time)| time).collect();
        times.sort_unstable_by(f32::total_cmp);
        times.dedup();
        let [mut track_value, mut robot_value] = [0.0; 2];
        for time in times {
            let views: Vec<usize> = (0..self.sample.views.len())
                .filter(|&view| self.sample.views[view].1 == time)
                .collect();
            let chosen: Vec<usize> = views.iter().flat_map(|view| view * area..(view + 1) * area).collect();
            let mut scene = scene(&chosen, &self.position, &self.base);
            scene.extra_channels = 3;
            scene.extra = chosen
                .iter()
                .flat_map(|&index| displacement.row(index).to_vec())
                .collect();
            let mut gradients = Gradients::zeros(&scene);
            for &view in &views {
                let (render, tape) = render_with_tape(&scene, &self.sample.raster_cameras[view], &self.config)?;
                let mut gradient = vec![0.0f32; 3 * area];
                for pixel in 0..area {
                    let global = view * area + pixel;
                    let robot = self.sample.support[global] > 0.0;
                    if render.alpha[pixel] <= 0.0 || !(tracked[global] || robot) {
                        continue;
                    }
                    for axis in 0..3 {
                        let reference = query.displacement_iu[(3 * view + axis) * area + pixel];
                        let error = f64::from(render.extra[3 * pixel + axis] - reference);
                        let mut slope = 0.0;
                        if tracked[global] {
                            track_value += track_each * error.abs();
                            slope += self.weights.track_final * track_each * sign(error);
                        }
                        if robot {
                            robot_value += robot_each * error.abs();
                            slope += self.weights.fk_final * robot_each * sign(error);
                        }
                        gradient[3 * pixel + axis] = slope as f32;
                    }
                }
                let gradient = RenderGradient {
                    extra: &gradient,
                    ..RenderGradient::default()
                };
                backward_into(&scene, &self.config, &tape, &gradient, &mut gradients)?;
            }
            for (row, &index) in chosen.iter().enumerate() {
                for axis in 0..3 {
                    self.position.gradient[3 * index + axis] += gradients.means[3 * row + axis];
                    displacement.gradient[3 * index + axis] += gradients.extra[3 * row + axis];
                }
                add_attributes(self.base.gradient_row(index), &gradients, row);
            }
        }
        self.add("track_final", self.weights.track_final, track_value);
        self.add("fk_final", self.weights.fk_final, robot_value);
        Ok(())
    }
}

/// Slope of |x|; 0 at 0, where most static pixels are.
fn sign(value: f64) -> f64 {
    if value == 0.0 { 0.0 } else { value.signum() }
}

/// The chosen Gaussians at their own positions.
fn scene(chosen: &[usize], position: &Rows, attributes: &Rows) -> Gaussians {
    let gather = |first: usize, count: usize| -> Vec<f32> {
        chosen
            .iter()
            .flat_map(|&index| attributes.row(index)[first..first + count].iter().copied())
            .collect()
    };
    Gaussians {
        means: chosen
            .iter()
            .flat_map(|&index| position.row(index).iter().copied())
            .collect(),
        colour: Colour::Rgb(gather(0, 3)),
        scales: gather(3, 3),
        quats: gather(6, 4),
        opacities: gather(10, 1),
        extra: Vec::new(),
        extra_channels: 0,
    }
}

/// Adds the gradient of Gaussian `from` to a row of attributes.
fn add_attributes(row: &mut [f32], gradients: &Gradients, from: usize) {
    for axis in 0..3 {
        row[axis] += gradients.colour[3 * from + axis];
        row[3 + axis] += gradients.scales[3 * from + axis];
    }
    for part in 0..4 {
        row[6 + part] += gradients.quats[4 * from + part];
    }
    row[10] += gradients.opacities[from];
}
