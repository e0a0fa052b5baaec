//! The Gaussians of a fit at a time, the gradients of its parameters, and the field that they make
//! (`docs/spec/fit.md` sections 3 and 6).

use std::borrow::Cow;

use rayon::prelude::*;
use rogs_field::attributes::{self, COLOUR, OPACITY, ROTATION, SCALE};
use rogs_optimise::bases::{BASE_NUMBERS, BaseMotion, Moved, move_gaussians, move_gradient, shares};
use rogs_schemas::records::field::{Field, GATE_ATTRIBUTES, RAW_CHANNELS, TimeSlice};
use rogs_schemas::units::{UNITS_PER_METRE, iu_from_m, m_from_iu};
use rogs_splat::{Colour, Gaussians, Gradients};
use rogs_worker::{StageError, StageResult};

use crate::start::{Group, Start};

/// Gaussians of one piece of work.
const PIECE: usize = 4096;

/// The rigid motion that moves nothing.
const IDENTITY: BaseMotion = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0];

/// What is optimised: differences from the start, all 0 at first.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Parameters {
    /// Centres, metres. `[N, 3]`
    pub(crate) position_m: Vec<f32>,
    /// Natural logarithms of scales. `[N, 3]`
    pub(crate) scale: Vec<f32>,
    /// Quaternions. `[N, 4]`
    pub(crate) rotation: Vec<f32>,
    /// Raw opacities. `[N]`
    pub(crate) opacity: Vec<f32>,
    /// Raw colours. `[N, 3]`
    pub(crate) colour: Vec<f32>,
    /// Logits of the mixture of rigid motions. `[moving, K]`
    pub(crate) mixture: Vec<f32>,
    /// Rigid motions at the source times; between these they are interpolated. `[sources, K, 9]`
    pub(crate) motion: Vec<f32>,
}

impl Parameters {
    /// Zeros for a start.
    pub(crate) fn zeros(start: &Start, sources: usize) -> Self {
        let n = start.len();
        Self {
            position_m: vec![0.0; 3 * n],
            scale: vec![0.0; 3 * n],
            rotation: vec![0.0; 4 * n],
            opacity: vec![0.0; n],
            colour: vec![0.0; 3 * n],
            mixture: vec![0.0; start.logits.len()],
            motion: vec![0.0; sources * start.bases * BASE_NUMBERS],
        }
    }
}

/// A start with its parameters.
pub(crate) struct Scene<'a> {
    pub(crate) start: &'a Start,
    /// Slices of the source times, ascending.
    pub(crate) sources: &'a [usize],
}

/// Gaussians at a time with what their gradients need.
pub(crate) struct Posed {
    /// Internal units, reconstruction frame.
    pub(crate) gaussians: Gaussians,
    slice: usize,
    bases: Vec<BaseMotion>,
    shares: Vec<f32>,
    unmoved: Moved,
    moved: Moved,
}

impl Scene<'_> {
    /// Shares of the source times in a slice: between two of them by their distance in time, beyond them the nearest's.
    fn hats(&self, slice: usize) -> Vec<(usize, f32)> {
        let time = |slice: usize| self.start.slices[slice].time;
        let after = self.sources.iter().position(|&source| source >= slice);
        match after {
            None => vec![(self.sources.len() - 1, 1.0)],
            Some(0) => vec![(0, 1.0)],
            Some(next) if self.sources[next] == slice => vec![(next, 1.0)],
            Some(next) => {
                let (from, to) = (time(self.sources[next - 1]), time(self.sources[next]));
                let share = ((time(slice) - from) / (to - from)) as f32;
                vec![(next - 1, 1.0 - share), (next, share)]
            }
        }
    }

    /// The rigid motions at a slice.
    fn bases(&self, parameters: &Parameters, slice: usize) -> Vec<BaseMotion> {
        let mut bases = vec![IDENTITY; self.start.bases];
        let row = bases.len() * BASE_NUMBERS;
        for (source, share) in self.hats(slice) {
            let from = &parameters.motion[source * row..(source + 1) * row];
            for (to, from) in bases.iter_mut().flatten().zip(from) {
                *to += share * from;
            }
        }
        bases
    }

    fn shares(&self, parameters: &Parameters) -> Vec<f32> {
        let logits: Vec<f32> = self
            .start
            .logits
            .iter()
            .zip(&parameters.mixture)
            .map(|(a, b)| a + b)
            .collect();
        shares(&logits, self.start.bases)
    }

    /// Centres and rotations of the moving Gaussians at a slice, before the rigid motions. `raws`: the attributes there.
    fn unmoved(&self, parameters: &Parameters, slice: usize, raws: &[f32]) -> Moved {
        let displacement_m = &self.start.slices[slice].displacement_m;
        let mut unmoved = Moved::default();
        for &index in &self.start.moving {
            let index = index as usize;
            for axis in 3 * index..3 * index + 3 {
                let own = self.start.position_m[axis] + parameters.position_m[axis];
                unmoved.means.push(iu_from_m(own + displacement_m[axis]));
            }
            for (k, channel) in ROTATION.enumerate() {
                unmoved
                    .quats
                    .push(raws[RAW_CHANNELS * index + channel] + parameters.rotation[4 * index + k]);
            }
        }
        unmoved
    }

    /// The Gaussians at a stored time.
    pub(crate) fn pose(&self, parameters: &Parameters, slice: usize) -> StageResult<Posed> {
        let start = self.start;
        let n = start.len();
        let bases = self.bases(parameters, slice);
        let shares = self.shares(parameters);
        let raws = raw_at(start, slice);
        let unmoved = self.unmoved(parameters, slice, &raws);
        let moved = move_gaussians(&bases, &shares, &unmoved.means, &unmoved.quats).map_err(internal)?;
        let fixed = &start.slices[slice];
        let mut out = Gaussians {
            means: vec![0.0; 3 * n],
            quats: vec![0.0; 4 * n],
            scales: vec![0.0; 3 * n],
            opacities: vec![0.0; n],
            colour: Colour::Rgb(Vec::new()),
            extra: Vec::new(),
            extra_channels: 0,
        };
        let mut rgb = vec![0.0; 3 * n];
        (out.means.par_chunks_mut(3 * PIECE))
            .zip(out.quats.par_chunks_mut(4 * PIECE))
            .zip(out.scales.par_chunks_mut(3 * PIECE))
            .zip(out.opacities.par_chunks_mut(PIECE))
            .zip(rgb.par_chunks_mut(3 * PIECE))
            .enumerate()
            .for_each(|(piece, ((((means, quats), scales), opacities), rgb))| {
                for local in 0..opacities.len() {
                    let index = piece * PIECE + local;
                    let raw = &raws[RAW_CHANNELS * index..][..RAW_CHANNELS];
                    let (mean, quat) = (&mut means[3 * local..][..3], &mut quats[4 * local..][..4]);
                    if let Group::Moving(place) = start.groups[index] {
                        let place = place as usize;
                        mean.copy_from_slice(&moved.means[3 * place..3 * place + 3]);
                        quat.copy_from_slice(&moved.quats[4 * place..4 * place + 4]);
                    } else {
                        for axis in 0..3 {
                            let at = 3 * index + axis;
                            let own = start.position_m[at] + parameters.position_m[at];
                            mean[axis] = iu_from_m(own + fixed.displacement_m[at]);
                        }
                        for (k, channel) in ROTATION.enumerate() {
                            quat[k] = raw[channel] + parameters.rotation[4 * index + k];
                        }
                    }
                    for (k, channel) in SCALE.enumerate() {
                        let own = attributes::scale_iu(raw[channel]) * libm::expf(parameters.scale[3 * index + k]);
                        scales[3 * local + k] = own.min(limit(start, index));
                    }
                    opacities[local] = attributes::opacity(raw[OPACITY] + parameters.opacity[index]);
                    for (k, channel) in COLOUR.enumerate() {
                        rgb[3 * local + k] = attributes::colour(raw[channel] + parameters.colour[3 * index + k]);
                    }
                }
            });
        out.colour = Colour::Rgb(rgb);
        Ok(Posed {
            gaussians: out,
            slice,
            bases,
            shares,
            unmoved,
            moved,
        })
    }

    /// Gradients of the parameters, given those of the Gaussians at a time.
    pub(crate) fn gradient(&self, posed: &Posed, of: &Gradients) -> StageResult<Parameters> {
        let start = self.start;
        let mut out = Parameters::zeros(start, self.sources.len());
        let gaussians = &posed.gaussians;
        let rgb = gaussians.colour.values();
        (out.position_m.par_chunks_mut(3 * PIECE))
            .zip(out.rotation.par_chunks_mut(4 * PIECE))
            .zip(out.scale.par_chunks_mut(3 * PIECE))
            .zip(out.opacity.par_chunks_mut(PIECE))
            .zip(out.colour.par_chunks_mut(3 * PIECE))
            .enumerate()
            .for_each(|(piece, ((((position, rotation), scale), opacity), colour))| {
                for local in 0..opacity.len() {
                    let index = piece * PIECE + local;
                    if !matches!(start.groups[index], Group::Moving(_)) {
                        // Centres of the robot's Gaussians lie on its mesh.
                        let fitted = if start.groups[index] == Group::Robot {
                            0..0
                        } else {
                            0..3
                        };
                        for k in fitted {
                            position[3 * local + k] = UNITS_PER_METRE as f32 * of.means[3 * index + k];
                        }
                        rotation[4 * local..4 * local + 4].copy_from_slice(&of.quats[4 * index..4 * index + 4]);
                    }
                    for k in 0..3 {
                        let at = 3 * index + k;
                        let own = gaussians.scales[at];
                        // At its cap a scale has no gradient.
                        scale[3 * local + k] = if own < limit(start, index) {
                            own * of.scales[at]
                        } else {
                            0.0
                        };
                        colour[3 * local + k] = 2.0 * rgb[at] * (1.0 - rgb[at]) * of.colour[at];
                    }
                    let own = gaussians.opacities[index];
                    opacity[local] = 2.0 * own * (1.0 - own) * of.opacities[index];
                }
            });
        if !start.moving.is_empty() {
            self.motion_gradient(posed, of, &mut out)?;
        }
        Ok(out)
    }

    fn motion_gradient(&self, posed: &Posed, of: &Gradients, out: &mut Parameters) -> StageResult<()> {
        let (mut means, mut quats) = (Vec::new(), Vec::new());
        for &index in &self.start.moving {
            let index = index as usize;
            means.extend_from_slice(&of.means[3 * index..3 * index + 3]);
            quats.extend_from_slice(&of.quats[4 * index..4 * index + 4]);
        }
        let Posed {
            bases,
            shares,
            unmoved,
            moved,
            ..
        } = posed;
        let gradient =
            move_gradient(bases, shares, &unmoved.means, &unmoved.quats, moved, &means, &quats).map_err(internal)?;
        for (place, &index) in self.start.moving.iter().enumerate() {
            let index = index as usize;
            for k in 0..3 {
                out.position_m[3 * index + k] = UNITS_PER_METRE as f32 * gradient.means[3 * place + k];
            }
            out.rotation[4 * index..4 * index + 4].copy_from_slice(&gradient.quats[4 * place..4 * place + 4]);
        }
        out.mixture = gradient.logits;
        let row = bases.len() * BASE_NUMBERS;
        for (source, share) in self.hats(posed.slice) {
            let to = &mut out.motion[source * row..(source + 1) * row];
            for (to, &from) in to.iter_mut().zip(gradient.bases.iter().flatten()) {
                *to = (f64::from(share) * from) as f32;
            }
        }
        Ok(())
    }

    /// The field of these parameters. Its clip, views and supports are those of the field that the fit started from.
    pub(crate) fn into_field(self, parameters: &Parameters, from: &Field) -> StageResult<Field> {
        let start = self.start;
        let shares = self.shares(parameters);
        let position_m: Vec<f32> = start
            .position_m
            .iter()
            .zip(&parameters.position_m)
            .map(|(a, b)| a + b)
            .collect();
        let mut base_raw = start.raw.clone();
        for (index, raw) in base_raw.chunks_exact_mut(RAW_CHANNELS).enumerate() {
            changed(raw, index, parameters);
        }
        let slices = (0..start.slices.len())
            .map(|slice| self.slice(parameters, &shares, &position_m, slice))
            .collect::<StageResult<_>>()?;
        Ok(Field {
            clip_id: from.clip_id.clone(),
            frame_count: from.frame_count,
            height: from.height,
            width: from.width,
            views: from.views.clone(),
            recon_from_base: from.recon_from_base,
            weights: from.weights.clone(),
            position_m,
            base_raw,
            support: from.support.clone(),
            link: from.link.clone(),
            scale_cap_iu: from.scale_cap_iu.clone(),
            slices,
            // The network answers other times for the field as it lifted it, not for this one.
            query_state: Vec::new(),
        })
    }

    /// One time of the field that is written.
    fn slice(
        &self,
        parameters: &Parameters,
        shares: &[f32],
        position_m: &[f32],
        slice: usize,
    ) -> StageResult<TimeSlice> {
        let start = self.start;
        let fixed = &start.slices[slice];
        let raws = raw_at(start, slice);
        let unmoved = self.unmoved(parameters, slice, &raws);
        let bases = self.bases(parameters, slice);
        let moved = move_gaussians(&bases, shares, &unmoved.means, &unmoved.quats).map_err(internal)?;
        let mut out = TimeSlice {
            time: fixed.time,
            displacement_m: fixed.displacement_m.clone(),
            gate: fixed.gate.clone(),
            moving_raw: Vec::new(),
        };
        for index in 0..start.len() {
            let place = match start.groups[index] {
                Group::Moving(place) => Some(place as usize),
                _ => None,
            };
            if place.is_some() {
                // The rotation at this time is one of its own.
                out.gate[index] |= GATE_ATTRIBUTES;
            }
            if out.gate[index] == 0 {
                continue;
            }
            let mut raw = [0.0; RAW_CHANNELS];
            raw.copy_from_slice(&raws[RAW_CHANNELS * index..][..RAW_CHANNELS]);
            changed(&mut raw, index, parameters);
            if let Some(place) = place {
                raw[ROTATION].copy_from_slice(&moved.quats[4 * place..4 * place + 4]);
                for axis in 0..3 {
                    let at = 3 * index + axis;
                    out.displacement_m[at] = m_from_iu(moved.means[3 * place + axis]) - position_m[at];
                }
            }
            out.moving_raw.extend_from_slice(&raw);
        }
        Ok(out)
    }
}

/// Raw attributes of every Gaussian at a slice, before the parameters. `[N, RAW_CHANNELS]`
fn raw_at(start: &Start, slice: usize) -> Cow<'_, [f32]> {
    let fixed = &start.slices[slice];
    if fixed.moving_raw.is_empty() {
        return Cow::Borrowed(&start.raw);
    }
    let mut raws = start.raw.clone();
    let mut robot = fixed.moving_raw.chunks_exact(RAW_CHANNELS);
    for (raw, &gate) in raws.chunks_exact_mut(RAW_CHANNELS).zip(&fixed.gate) {
        rogs_field::gates::choose_next(gate, &mut robot, raw);
    }
    Cow::Owned(raws)
}

/// Largest scale of a Gaussian, internal units.
fn limit(start: &Start, index: usize) -> f32 {
    attributes::scale_limit_iu(start.scale_cap_iu[index])
}

/// Raw attributes with the parameters.
fn changed(raw: &mut [f32], index: usize, parameters: &Parameters) {
    for (k, channel) in SCALE.enumerate() {
        raw[channel] = attributes::rescaled(raw[channel], libm::exp(parameters.scale[3 * index + k].into()));
    }
    for (k, channel) in ROTATION.enumerate() {
        raw[channel] += parameters.rotation[4 * index + k];
    }
    raw[OPACITY] += parameters.opacity[index];
    for (k, channel) in COLOUR.enumerate() {
        raw[channel] += parameters.colour[3 * index + k];
    }
}

pub(crate) fn internal(error: impl std::fmt::Display) -> StageError {
    StageError::internal(error.to_string())
}

#[cfg(test)]
mod tests {
    use rogs_field::TimedField;
    use rogs_schemas::records::clip::SourceView;
    use rogs_schemas::records::field::WeightsInfo;
    use rogs_schemas::{CameraIndex, FrameIndex, RigidPose};

    use super::*;
    use crate::start::FixedSlice;

    const SOURCES: [usize; 2] = [0, 2];

    fn number(k: usize) -> f32 {
        (k * 7919 % 97) as f32 / 97.0 - 0.5
    }

    /// Two Gaussians of the robot, two that stand, two that move; three times, the middle one between two source times.
    fn start() -> Start {
        let n = 6;
        let slice = |time: f64, open: bool| FixedSlice {
            time,
            displacement_m: (0..3 * n)
                .map(|k| if (6..12).contains(&k) { 0.0 } else { 0.1 * number(k + 5) })
                .collect(),
            gate: if open { vec![1, 3, 0, 0, 2, 0] } else { vec![0; n] },
            moving_raw: (0..if open { 3 * RAW_CHANNELS } else { 0 })
                .map(|k| 2.0 + number(k + 3))
                .collect(),
        };
        Start {
            groups: vec![
                Group::Robot,
                Group::Robot,
                Group::Static,
                Group::Static,
                Group::Moving(0),
                Group::Moving(1),
            ],
            moving: vec![4, 5],
            own_slice: vec![0, 2, 0, 2, 0, 2],
            position_m: (0..3 * n).map(|k| number(k + 11)).collect(),
            raw: (0..RAW_CHANNELS * n).map(|k| 1.5 + number(k + 17)).collect(),
            scale_cap_iu: vec![f32::INFINITY, 1e-6, f32::INFINITY, 0.2, 0.2, 0.2],
            slices: vec![slice(0.0, false), slice(0.25, true), slice(1.0, true)],
            bases: 2,
            logits: vec![1.0, 0.0, 0.2, 0.6],
        }
    }

    fn parameters(start: &Start) -> Parameters {
        let mut out = Parameters::zeros(start, SOURCES.len());
        let mut seed = 0;
        for group in all(&mut out) {
            for value in group.iter_mut() {
                seed += 1;
                *value = 0.2 * number(seed);
            }
        }
        out
    }

    fn all(parameters: &mut Parameters) -> [&mut Vec<f32>; 7] {
        let Parameters {
            position_m,
            scale,
            rotation,
            opacity,
            colour,
            mixture,
            motion,
        } = parameters;
        [position_m, scale, rotation, opacity, colour, mixture, motion]
    }

    /// A loss that weighs everything that comes out.
    fn weighed(gaussians: &Gaussians) -> (f64, Gradients) {
        let mut gradients = Gradients::zeros(gaussians);
        let mut sum = 0.0;
        let arrays: [(&[f32], &mut Vec<f32>, f32); 5] = [
            (&gaussians.means, &mut gradients.means, 1.0),
            (&gaussians.quats, &mut gradients.quats, 1.0),
            (&gaussians.scales, &mut gradients.scales, 500.0),
            (&gaussians.opacities, &mut gradients.opacities, 1.0),
            (gaussians.colour.values(), &mut gradients.colour, 1.0),
        ];
        for (seed, (values, weights, size)) in arrays.into_iter().enumerate() {
            for (k, (value, weight)) in values.iter().zip(weights).enumerate() {
                *weight = size * number(31 * k + 7 * seed + 3);
                sum += f64::from(*value) * f64::from(*weight);
            }
        }
        (sum, gradients)
    }

    #[test]
    fn gradients_are_those_of_central_differences() {
        let start = start();
        let scene = Scene {
            start: &start,
            sources: &SOURCES,
        };
        let here = parameters(&start);
        for slice in 0..3 {
            let posed = scene.pose(&here, slice).unwrap();
            let mut found = scene.gradient(&posed, &weighed(&posed.gaussians).1).unwrap();
            let found: Vec<Vec<f32>> = all(&mut found).map(|group| group.clone()).into();
            for (group, found) in found.iter().enumerate() {
                for (k, &found) in found.iter().enumerate() {
                    if group == 0 && k < 6 {
                        assert_eq!(found, 0.0, "centres of the robot stay");
                        continue;
                    }
                    let at = |step: f32| {
                        let mut moved = here.clone();
                        all(&mut moved)[group][k] += step;
                        weighed(&scene.pose(&moved, slice).unwrap().gaussians).0
                    };
                    let expected = (at(4e-3) - at(-4e-3)) / 8e-3;
                    let difference = (f64::from(found) - expected).abs();
                    assert!(
                        difference < 2e-3 * (1.0 + expected.abs()),
                        "{slice} {group} {k}: {found} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_field_is_what_was_rendered() {
        let start = start();
        let here = parameters(&start);
        let view = |frame: u32| SourceView {
            camera: CameraIndex(0),
            frame: FrameIndex(frame),
        };
        let from = Field {
            clip_id: "clip".parse().unwrap(),
            frame_count: 5,
            height: 1,
            width: 3,
            views: vec![view(0), view(4)],
            recon_from_base: RigidPose::IDENTITY,
            weights: WeightsInfo {
                trained: false,
                configuration: String::new(),
                description: String::new(),
                hash: String::new(),
            },
            position_m: Vec::new(),
            base_raw: Vec::new(),
            support: vec![1, 1, 0, 0, 0, 0],
            link: vec![0, 0, 255, 255, 255, 255],
            scale_cap_iu: start.scale_cap_iu.clone(),
            slices: Vec::new(),
            query_state: Vec::new(),
        };
        let scene = Scene {
            start: &start,
            sources: &SOURCES,
        };
        let field = Scene { ..scene }.into_field(&here, &from).unwrap();
        field.check().unwrap();
        for (slice, fixed) in start.slices.iter().enumerate() {
            let posed = scene.pose(&here, slice).unwrap().gaussians;
            let stored = TimedField::new(&field).unwrap().gaussians(fixed.time).unwrap();
            let close = |a: &[f32], b: &[f32], tolerance: f32| {
                assert_eq!(a.len(), b.len());
                for (k, (a, b)) in a.iter().zip(b).enumerate() {
                    assert!((a - b).abs() < tolerance * (1.0 + a.abs()), "{slice} {k}: {a} {b}");
                }
            };
            close(&posed.means, &stored.means, 1e-5);
            close(&posed.quats, &stored.quats, 1e-5);
            close(&posed.scales, &stored.scales, 1e-6);
            close(&posed.opacities, &stored.opacities, 1e-6);
            close(posed.colour.values(), stored.colour.values(), 1e-6);
            assert_eq!(
                field.slices[slice].displacement_m[..6],
                fixed.displacement_m[..6],
                "the robot's stay"
            );
            assert!(
                field.slices[slice].displacement_m[6..12].iter().all(|&v| v == 0.0),
                "the background stays"
            );
        }
    }
}
