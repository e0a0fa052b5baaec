//! The loss of a batch and its gradient (`docs/spec/baseline-som.md` section 6).

use glam::DVec3;
use rayon::prelude::*;
use rogs_optimise::losses::Loss;
use rogs_optimise::losses::image::photometric;
use rogs_optimise::losses::robust::{disparity_l1, gradient_l1, track_2d, trimmed_l1};
use rogs_optimise::losses::smoothness::{bases_smoothness, ray_acceleration, scale_variance, track_smoothness};
use rogs_optimise::masks::Side;
use rogs_optimise::tracks::{Sight, clamped_sample};
use rogs_optimise::{Moved, bases};
use rogs_splat::{
    Colour, Gaussians, Gradients, RasterConfig, Render, RenderGradient, Tape, backward_with_screen, render_with_tape,
};
use rogs_worker::StageResult;

use crate::internal;
use crate::motion::{self, At};
use crate::observed::{Observed, ObservedFrame};
use crate::scene::{Cloud, Scene, add, logistic};
use crate::tracks_alone::Image;

/// Weights of the terms.
const TRACK: f64 = 2.0;
const DEPTH: f64 = 0.5;
const MAPPED_DEPTH: f64 = 0.1;
const DEPTH_STEPS: f64 = 1.0;
const BASES: f64 = 0.1;
const CENTRES: f64 = 2.0;
const SCALES: f64 = 0.01;
const ALONG_RAY: f64 = 1.0;
/// Shares of errors that are kept.
const KEPT: f64 = 0.98;
const STEPS_KEPT: f64 = 0.95;
/// Added to depths before they become disparities.
const DEPTH_EPSILON: f32 = 1e-5;

/// One sample of a batch: a frame, and the frames to which its tracks are followed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Sample {
    pub(crate) frame: usize,
    pub(crate) targets: Vec<usize>,
}

impl Sample {
    /// The three frames around it that smoothness is taken of.
    fn neighbours(&self, frames: usize) -> [usize; 3] {
        let middle = self.frame.clamp(1, frames - 2);
        [middle - 1, middle, middle + 1]
    }
}

/// What a batch says.
pub(crate) struct Said {
    pub(crate) value: f64,
    pub(crate) gradient: Scene,
    /// Lengths of the gradients with respect to centres in the image, in units of half the image, added up over the samples.
    /// `[N]`
    pub(crate) screen: Vec<f32>,
    /// Samples in which each Gaussian was seen. `[N]`
    pub(crate) seen: Vec<f32>,
    /// Images of the samples, their band white. `[samples]` of `[H, W, 3]`
    pub(crate) images: Vec<Vec<f32>>,
}

/// How a scene is rendered: over white, in metres.
pub(crate) fn raster() -> RasterConfig {
    RasterConfig {
        near: 0.01,
        far: 1e10,
        background: [1.0; 3],
        min_opacity: 0.0,
        ..RasterConfig::default()
    }
}

/// Loss and gradient of a batch.
///
/// # Errors
/// When the scene cannot be rendered.
pub(crate) fn loss(observed: &Observed, scene: &Scene, batch: &[Sample]) -> StageResult<Said> {
    let batch = Batch::new(observed, scene, batch)?;
    let views: Vec<(Gaussians, Render, Tape)> = (batch.samples.par_iter())
        .map(|sample| {
            let gaussians = batch.gaussians(sample);
            let camera = &observed.frames[sample.frame].raster;
            let (render, tape) = render_with_tape(&gaussians, camera, &raster()).map_err(internal)?;
            Ok((gaussians, render, tape))
        })
        .collect::<StageResult<_>>()?;
    let renders: Vec<&Render> = views.iter().map(|(_, render, _)| render).collect();
    let (value, terms) = batch.image_terms(&renders)?;
    let gradients: Vec<(Gradients, Vec<u32>)> = (views.par_iter().zip(&terms))
        .map(|((gaussians, _, tape), term)| {
            let gradient = RenderGradient {
                rgb: &term.rgb,
                alpha: &term.alpha,
                depth_expected: &term.depth,
                extra_accumulated: &term.extra,
                ..RenderGradient::default()
            };
            let gradient = backward_with_screen(gaussians, &raster(), tape, &gradient).map_err(internal)?;
            Ok((gradient, tape.visible()))
        })
        .collect::<StageResult<_>>()?;
    let mut said = batch.collect(value, &gradients)?;
    let frames = batch.frames_of();
    said.images = frames
        .zip(&renders)
        .map(|(frame, render)| frame.painted(&render.rgb))
        .collect();
    Ok(said)
}

/// A batch with the foreground at all frames that it needs.
struct Batch<'a> {
    observed: &'a Observed,
    scene: &'a Scene,
    samples: &'a [Sample],
    shares: Vec<f32>,
    /// Frames that are needed, ascending.
    frames: Vec<usize>,
    /// The foreground at those.
    moved: Vec<Moved>,
    /// Activated attributes, foreground then background.
    scales: Vec<f32>,
    opacities: Vec<f32>,
    colours: Vec<f32>,
}

/// Gradient with respect to the render of a sample.
#[derive(Default)]
struct Term {
    rgb: Vec<f32>,
    alpha: Vec<f32>,
    depth: Vec<f32>,
    extra: Vec<f32>,
}

impl<'a> Batch<'a> {
    fn new(observed: &'a Observed, scene: &'a Scene, samples: &'a [Sample]) -> StageResult<Self> {
        let shares = bases::shares(&scene.coefficients, scene.bases.len());
        let mut frames: Vec<usize> = (samples.iter())
            .flat_map(|own| {
                let around = own.neighbours(observed.len());
                std::iter::once(own.frame)
                    .chain(own.targets.iter().copied())
                    .chain(around)
            })
            .collect();
        frames.sort_unstable();
        frames.dedup();
        let moved = motion::moved(scene, &shares, &frames)?;
        let (fg, bg) = (&scene.foreground, &scene.background);
        let both = |of: fn(&Cloud) -> &Vec<f32>, activate: fn(f32) -> f32| -> Vec<f32> {
            of(fg).iter().chain(of(bg)).map(|&value| activate(value)).collect()
        };
        Ok(Self {
            observed,
            scene,
            samples,
            shares,
            frames,
            moved,
            scales: both(|cloud| &cloud.scales, libm::expf),
            opacities: both(|cloud| &cloud.opacities, logistic),
            colours: both(|cloud| &cloud.colours, logistic),
        })
    }

    /// Place of a frame among those that are needed.
    fn place(&self, frame: usize) -> usize {
        self.frames.partition_point(|&known| known < frame)
    }

    /// The foreground at a frame.
    fn at(&self, frame: usize) -> &Moved {
        &self.moved[self.place(frame)]
    }

    /// Centres of all Gaussians at a frame. `[N, 3]`
    fn means(&self, frame: usize) -> impl Iterator<Item = f32> {
        let background = &self.scene.background.means;
        self.at(frame).means.iter().chain(background).copied()
    }

    /// What the rasteriser draws for a sample: further channels are the foreground's indicator and, for every target frame,
    /// the centre there in the frame of the camera there.
    fn gaussians(&self, sample: &Sample) -> Gaussians {
        let (fg, count) = (self.scene.foreground.len(), self.scene.len());
        let channels = 1 + 3 * sample.targets.len();
        let mut extra = vec![0.0; count * channels];
        extra.chunks_exact_mut(channels).take(fg).for_each(|row| row[0] = 1.0);
        for (number, &target) in sample.targets.iter().enumerate() {
            let camera_from_base = self.observed.frames[target].base_from_camera.inverse();
            let means: Vec<f32> = self.means(target).collect();
            for (row, mean) in extra.chunks_exact_mut(channels).zip(means.chunks_exact(3)) {
                let point = camera_from_base.point(vector(mean));
                row[1 + 3 * number..4 + 3 * number].copy_from_slice(&point.as_vec3().to_array());
            }
        }
        let own = self.at(sample.frame);
        Gaussians {
            means: self.means(sample.frame).collect(),
            quats: own.quats.iter().chain(&self.scene.background.quats).copied().collect(),
            scales: self.scales.clone(),
            opacities: self.opacities.clone(),
            colour: Colour::Rgb(self.colours.clone()),
            extra,
            extra_channels: channels,
        }
    }

    /// The terms of the renders, and the gradient with respect to each of them.
    fn image_terms(&self, renders: &[&Render]) -> StageResult<(f64, Vec<Term>)> {
        let (height, width) = (self.observed.height, self.observed.width);
        let area = height * width;
        let each = 1.0 / renders.len().max(1) as f64;
        let photos = (renders.par_iter().zip(self.samples))
            .map(|(render, sample)| {
                let frame = &self.observed.frames[sample.frame];
                let mut own =
                    photometric(&frame.painted(&render.rgb), &frame.target, height, width).map_err(internal)?;
                for (pixel, side) in frame.sides.iter().enumerate() {
                    let keep = if *side == Side::Band { 0.0 } else { each as f32 };
                    own.gradient[3 * pixel..3 * pixel + 3]
                        .iter_mut()
                        .for_each(|value| *value *= keep);
                }
                Ok(own)
            })
            .collect::<StageResult<Vec<Loss>>>()?;
        let mut value = photos.iter().map(|own| each * own.value).sum::<f64>();
        let mut terms: Vec<Term> = (renders.iter().zip(photos))
            .map(|(render, own)| Term {
                rgb: own.gradient,
                alpha: Vec::new(),
                depth: Vec::new(),
                extra: vec![0.0; render.extra_accumulated.len()],
            })
            .collect();
        value += self.opacity_terms(renders, &mut terms)?;
        value += self.depth_terms(renders, &mut terms)?;
        value += self.track_terms(renders, &mut terms)?;
        debug_assert!(
            terms
                .iter()
                .all(|term| term.alpha.len() == area && term.depth.len() == area)
        );
        Ok((value, terms))
    }

    /// Everything is opaque, and the foreground lies where the mask does.
    fn opacity_terms(&self, renders: &[&Render], terms: &mut [Term]) -> StageResult<f64> {
        let area = self.observed.height * self.observed.width;
        let each = 1.0 / (area * renders.len().max(1)) as f64;
        let mut value = 0.0;
        for (render, term) in renders.iter().zip(terms.iter_mut()) {
            let off = |alpha: &f32| f64::from(*alpha) - 1.0;
            value += each * render.alpha.iter().map(|alpha| off(alpha) * off(alpha)).sum::<f64>();
            term.alpha = render
                .alpha
                .iter()
                .map(|alpha| (2.0 * each * off(alpha)) as f32)
                .collect();
        }
        let shown: Vec<f32> = (renders.iter())
            .flat_map(|render| render.extra_accumulated.iter().step_by(render.extra_channels).copied())
            .collect();
        let masks: Vec<f32> = self.frames_of().flat_map(|frame| frame.mask.iter().copied()).collect();
        let own = trimmed_l1(&shown, &masks, KEPT).map_err(internal)?;
        for ((render, term), gradient) in renders.iter().zip(terms).zip(own.gradient.chunks_exact(area)) {
            for (to, from) in term.extra.iter_mut().step_by(render.extra_channels).zip(gradient) {
                *to += from;
            }
        }
        Ok(value + own.value)
    }

    /// Rendered depth against that of the sidecars, and its steps from pixel to pixel.
    fn depth_terms(&self, renders: &[&Render], terms: &mut [Term]) -> StageResult<f64> {
        let (height, width) = (self.observed.height, self.observed.width);
        let depths: Vec<f32> = renders
            .iter()
            .flat_map(|render| render.depth_expected.iter().copied())
            .collect();
        let targets: Vec<f32> = self
            .frames_of()
            .flat_map(|frame| frame.depth_m.iter().copied())
            .collect();
        let valid: Vec<bool> = self
            .frames_of()
            .flat_map(|frame| frame.sides.iter().map(|&side| side != Side::Band))
            .collect();
        let weights: Vec<f32> = valid.iter().map(|&valid| f32::from(u8::from(valid))).collect();
        let mut own = Loss {
            value: 0.0,
            gradient: vec![0.0; depths.len()],
        };
        own.add(
            DEPTH,
            &disparity_l1(&depths, &targets, &weights, KEPT).map_err(internal)?,
        );
        let disparity = |depth: &f32| 1.0 / (depth + DEPTH_EPSILON);
        let shown: Vec<f32> = depths.iter().map(disparity).collect();
        let wanted: Vec<f32> = targets.iter().map(disparity).collect();
        let mut steps = gradient_l1(&shown, &wanted, &valid, height, width, STEPS_KEPT).map_err(internal)?;
        for (gradient, disparity) in steps.gradient.iter_mut().zip(&shown) {
            *gradient *= -disparity * disparity;
        }
        own.add(DEPTH_STEPS, &steps);
        for (term, gradient) in terms.iter_mut().zip(own.gradient.chunks_exact(height * width)) {
            term.depth = gradient.to_vec();
        }
        Ok(own.value)
    }

    /// Where the points of the tracks come to lie at the target frames, and how deep.
    fn track_terms(&self, renders: &[&Render], terms: &mut [Term]) -> StageResult<f64> {
        let observed = self.observed;
        let (height, width) = (observed.height, observed.width);
        let mut points = Vec::new();
        let (mut places, mut tracks, mut visible, mut sure) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let (mut depths, mut wanted, mut weights) = (Vec::new(), Vec::new(), Vec::new());
        for (number, (render, sample)) in renders.iter().zip(self.samples).enumerate() {
            for track in observed.tracks[sample.frame].chunks_exact(4 * observed.len()) {
                let own = &track[4 * sample.frame..];
                let pixel = own[1] as usize * width + own[0] as usize;
                for (target_number, &target) in sample.targets.iter().enumerate() {
                    let [x, y, hidden, wrong] = [0, 1, 2, 3].map(|k| track[4 * target + k]);
                    let at = pixel * render.extra_channels + 1 + 3 * target_number;
                    let shown = &render.extra_accumulated[at..at + 3];
                    let image = Image::of(observed, DVec3::new(shown[0].into(), shown[1].into(), shown[2].into()));
                    let sight = Sight::from_logits(hidden, wrong);
                    let depth = clamped_sample(&observed.frames[target].depth_m, height, width, 1, [x, y])[0];
                    places.extend(image.place.as_vec2().to_array());
                    tracks.extend([x, y]);
                    visible.push(sight.visible);
                    sure.push(sight.confidence);
                    depths.push(shown[2]);
                    wanted.push(depth);
                    weights.push(if sight.visible { sight.confidence } else { 0.0 });
                    points.push((number, at, image));
                }
            }
        }
        let longer = height.max(width) as f64;
        let on_image = track_2d(&places, &tracks, &visible, &sure, longer, KEPT).map_err(internal)?;
        let in_depth = disparity_l1(&depths, &wanted, &weights, 1.0).map_err(internal)?;
        for (index, (number, at, image)) in points.iter().enumerate() {
            let place = [on_image.gradient[2 * index], on_image.gradient[2 * index + 1]];
            let mut gradient = image.gradient(place) * TRACK;
            gradient.z += MAPPED_DEPTH * f64::from(in_depth.gradient[index]);
            for axis in 0..3 {
                terms[*number].extra[at + axis] += gradient[axis] as f32;
            }
        }
        Ok(TRACK * on_image.value + MAPPED_DEPTH * in_depth.value)
    }

    /// The observed frame of every sample.
    fn frames_of(&self) -> impl Iterator<Item = &ObservedFrame> {
        self.samples.iter().map(|sample| &self.observed.frames[sample.frame])
    }

    /// From gradients of the renders to those of the parameters, with the terms that need no render.
    fn collect(&self, value: f64, gradients: &[(Gradients, Vec<u32>)]) -> StageResult<Said> {
        let (fg, count) = (self.scene.foreground.len(), self.scene.len());
        let mut said = Said {
            value,
            gradient: self.scene.zeros(),
            screen: vec![0.0; count],
            seen: vec![0.0; count],
            images: Vec::new(),
        };
        let mut at: Vec<At> = (self.frames.iter())
            .map(|&frame| At {
                frame,
                means: vec![0.0; 3 * fg],
                quats: vec![0.0; 4 * fg],
            })
            .collect();
        let (mut scales, mut opacities, mut colours) = (
            vec![0.0; self.scales.len()],
            vec![0.0; self.opacities.len()],
            vec![0.0; self.colours.len()],
        );
        for (sample, (own, visible)) in self.samples.iter().zip(gradients) {
            let background = &mut said.gradient.background;
            let here = &mut at[self.place(sample.frame)];
            let (front, behind) = own.means.split_at(3 * fg);
            add(&mut here.means, 1.0, front);
            add(&mut background.means, 1.0, behind);
            let (front, behind) = own.quats.split_at(4 * fg);
            add(&mut here.quats, 1.0, front);
            add(&mut background.quats, 1.0, behind);
            add(&mut scales, 1.0, &own.scales);
            add(&mut opacities, 1.0, &own.opacities);
            add(&mut colours, 1.0, &own.colour);
            let channels = 1 + 3 * sample.targets.len();
            for (number, &target) in sample.targets.iter().enumerate() {
                let base_from_camera = self.observed.frames[target].base_from_camera;
                let place = self.place(target);
                for (row, extra) in own.extra.chunks_exact(channels).enumerate() {
                    let gradient = base_from_camera.rotation * vector(&extra[1 + 3 * number..4 + 3 * number]);
                    let to = match row.checked_sub(fg) {
                        None => &mut at[place].means[3 * row..3 * row + 3],
                        Some(row) => &mut background.means[3 * row..3 * row + 3],
                    };
                    add(to, 1.0, &gradient.as_vec3().to_array());
                }
            }
            let half =
                [self.observed.width, self.observed.height].map(|side| 0.5 * side as f32 * self.samples.len() as f32);
            for &index in visible {
                let index = index as usize;
                let [x, y] = [0, 1].map(|axis| own.screen[2 * index + axis] * half[axis]);
                said.screen[index] += (x * x + y * y).sqrt();
                said.seen[index] += 1.0;
            }
        }
        self.activations(&mut said.gradient, &scales, &opacities, &colours);
        said.value += self.smoothness(&mut at, &mut said.gradient)?;
        motion::add_gradient(self.scene, &self.shares, &self.moved, &at, &mut said.gradient)?;
        Ok(said)
    }

    /// Gradients of raw parameters from those of activated ones.
    fn activations(&self, gradient: &mut Scene, scales: &[f32], opacities: &[f32], colours: &[f32]) {
        let fg = self.scene.foreground.len();
        let of_scale = |(value, gradient): (&f32, &f32)| value * gradient;
        let of_share = |(value, gradient): (&f32, &f32)| value * (1.0 - value) * gradient;
        let scales: Vec<f32> = self.scales.iter().zip(scales).map(of_scale).collect();
        let opacities: Vec<f32> = self.opacities.iter().zip(opacities).map(of_share).collect();
        let colours: Vec<f32> = self.colours.iter().zip(colours).map(of_share).collect();
        let (front, behind) = (&mut gradient.foreground, &mut gradient.background);
        for (front, behind, values, width) in [
            (&mut front.scales, &mut behind.scales, &scales, 3),
            (&mut front.opacities, &mut behind.opacities, &opacities, 1),
            (&mut front.colours, &mut behind.colours, &colours, 3),
        ] {
            front.copy_from_slice(&values[..width * fg]);
            behind.copy_from_slice(&values[width * fg..]);
        }
    }

    /// Terms of motion and shape.
    fn smoothness(&self, at: &mut [At], gradient: &mut Scene) -> StageResult<f64> {
        let fg = self.scene.foreground.len();
        let batch = self.samples.len();
        // [G, 3 frames, B, 3]
        let around: Vec<[usize; 3]> = (self.samples.iter())
            .map(|sample| sample.neighbours(self.observed.len()).map(|frame| self.place(frame)))
            .collect();
        let mut means = Vec::with_capacity(9 * fg * batch);
        for row in 0..fg {
            for step in 0..3 {
                for places in &around {
                    means.extend_from_slice(&self.moved[places[step]].means[3 * row..3 * row + 3]);
                }
            }
        }
        let centres: Vec<DVec3> = self
            .frames_of()
            .map(|frame| frame.base_from_camera.translation)
            .collect();
        let mut own = Loss {
            value: 0.0,
            gradient: vec![0.0; means.len()],
        };
        own.add(CENTRES, &track_smoothness(&means, batch).map_err(internal)?);
        own.add(ALONG_RAY, &ray_acceleration(&means, &centres).map_err(internal)?);
        for (index, from) in own.gradient.chunks_exact(3).enumerate() {
            let (row, step, sample) = (index / (3 * batch), index / batch % 3, index % batch);
            add(&mut at[around[sample][step]].means[3 * row..3 * row + 3], 1.0, from);
        }
        let mut value = own.value;
        let (rotations, translations) = bases_smoothness(&self.scene.bases).map_err(internal)?;
        value += BASES * rotations.value;
        add(&mut gradient.bases.rotations, BASES, &rotations.gradient);
        add(&mut gradient.bases.translations, BASES, &translations);
        for (cloud, gradient) in [
            (&self.scene.foreground, &mut gradient.foreground),
            (&self.scene.background, &mut gradient.background),
        ] {
            let own = scale_variance(&cloud.scales).map_err(internal)?;
            value += SCALES * own.value;
            add(&mut gradient.scales, SCALES, &own.gradient);
        }
        Ok(value)
    }
}

fn vector(values: &[f32]) -> DVec3 {
    DVec3::new(values[0].into(), values[1].into(), values[2].into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::initial;
    use crate::params::LiftSomParams;
    use crate::sidecars;
    use crate::support;
    use crate::tracks_alone::{self, Targets};

    fn observed(params: &LiftSomParams) -> Observed {
        let (clip, robot) = support::clip();
        let folder = tempfile::tempdir().unwrap();
        support::sidecars(folder.path());
        let size = [support::HEIGHT, support::WIDTH];
        let own = sidecars::read(folder.path(), "clip", "ext1", support::FRAMES, size).unwrap();
        Observed::new(&clip, &robot, rogs_schemas::CameraIndex(0), own, params).unwrap()
    }

    /// Compares the gradient along its own direction, array by array, with central differences of the value: of five sizes of
    /// steps one must agree. What is less opaque than 1/255 is not drawn, so a step may lead across a jump.
    fn check(scene: &Scene, steps: [f32; 13], tolerance: f64, value: impl Fn(&Scene) -> (f64, Scene)) {
        let (_, gradient) = value(scene);
        for (index, step) in steps.into_iter().enumerate().filter(|(_, step)| *step > 0.0) {
            let own = gradient.arrays()[index];
            let length = own.iter().map(|g| f64::from(*g) * f64::from(*g)).sum::<f64>().sqrt();
            assert!(length > 0.0, "array {index} has no gradient");
            let along = |step: f32| {
                let at = |step: f32| {
                    let mut moved = scene.clone();
                    for (to, from) in moved.arrays_mut()[index].iter_mut().zip(own) {
                        *to += step * from / length as f32;
                    }
                    value(&moved).0
                };
                (at(step) - at(-step)) / (2.0 * f64::from(step))
            };
            let found = [1.0, 0.3, 0.1, 0.03, 0.01].map(|share| along(share * step));
            println!("array {index}: {found:.5?}, the gradient says {length:.5}");
            let agrees = |found: &f64| (found - length).abs() < tolerance * length;
            assert!(found.iter().any(agrees), "array {index}: {found:?} {length}");
        }
    }

    #[test]
    fn gradients_are_those_of_central_differences() {
        let params = LiftSomParams {
            erode_px: 1,
            dilate_px: 2,
            smallest_cluster: 10,
            clusters: 2,
            ..LiftSomParams::default()
        };
        let observed = observed(&params);
        let (mut scene, followed) = initial::scene(&observed, &params, 0).unwrap();
        // The plate moves as a whole: it has one base. A second one gives the mixture something to choose.
        assert_eq!(scene.bases.len(), 1);
        scene.coefficients = scene.coefficients.iter().flat_map(|&own| [own, 0.5]).collect();
        scene.bases.rotations = [scene.bases.rotations.clone(), scene.bases.rotations].concat();
        let other: Vec<f32> = scene.bases.translations.iter().map(|value| value + 0.1).collect();
        scene.bases.translations.extend(other);
        // Something to be wrong about: the exact start has errors of zero, where an absolute value has no gradient.
        for (array, size) in [(0, 0.02), (2, 0.3), (6, 0.02), (8, 0.3), (11, 0.03), (12, 0.02)] {
            for (k, value) in scene.arrays_mut()[array].iter_mut().enumerate() {
                *value += size * libm::sinf(1.7 * k as f32);
            }
        }
        let targets = Targets::new(&followed, &observed);
        let mut steps = [0.0; 13];
        [steps[0], steps[5], steps[11], steps[12]] = [1e-3, 1e-2, 1e-3, 1e-3];
        check(&scene, steps, 0.05, |scene| {
            tracks_alone::loss(scene, &targets, 0.05).unwrap()
        });
        let batch = [
            Sample {
                frame: 0,
                targets: vec![1, 3, 4, 5],
            },
            Sample {
                frame: 3,
                targets: vec![0, 2, 3, 5],
            },
        ];
        // Logits and turns do little, so they take larger steps.
        let mut steps = [3e-3; 13];
        [steps[1], steps[5], steps[7]] = [3e-2; 3];
        check(&scene, steps, 0.1, |scene| {
            let said = loss(&observed, scene, &batch).unwrap();
            (said.value, said.gradient)
        });
    }
}
