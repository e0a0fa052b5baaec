//! The camera-wise baseline: every camera lifted by itself, as the released monocular network does it, with one scale per
//! camera from stereo depth; the fields are merged by calibration (paper, appendix on baselines).
//!
//! A camera's poses are taken relative to its first source frame and divided by its scale, the mean distance of the valid
//! back-projected stereo points of its source frames from that first camera. So the network sees the scene of unit size
//! that it was released for. Its field then is multiplied by that scale and carried to the reconstruction frame.

use rogs_field::attributes::rescaled;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::field::{RAW_CHANNELS, TimeSlice};
use rogs_schemas::units::UNITS_PER_METRE;
use rogs_worker::{StageError, StageResult};

use crate::lifting::{Base, MotionHeads, lift_base, quaternion_product};
use crate::source::{Source, View};
use crate::{LiftParams, Model, Phases, Work, lift_slices, stage_error};

/// From the frame and unit of one camera's lifting to the reconstruction frame in internal units.
#[derive(Debug, Clone, Copy)]
struct Similarity {
    /// Rotation of recon_from_first, row-major.
    rotation: [f64; 9],
    /// The same as a quaternion (w, x, y, z).
    quaternion: [f32; 4],
    /// Position of the first camera in the reconstruction frame, metres.
    translation_m: [f64; 3],
    /// Internal units per unit of the lifting.
    factor: f64,
}

/// Lifts every camera by itself; base field and slices of all of them in the order of the views.
pub(crate) fn lift(
    run: &mut Phases<'_>,
    model: &Model,
    params: &LiftParams,
    source: &Source<'_>,
) -> StageResult<(Base, Vec<TimeSlice>)> {
    let mut cameras: Vec<u32> = source.views.iter().map(|view| view.view.camera).collect();
    cameras.dedup();
    let mut merged: Option<(Base, Vec<TimeSlice>)> = None;
    for (done, &camera) in cameras.iter().enumerate() {
        let share = cameras.len() as f64;
        let mut scaled = |name: &str, fraction: f64, work: Work<'_>| {
            (run.phase)(name, (done as f64 + fraction) / share, work);
        };
        let mut run = Phases { phase: &mut scaled };
        let (alone, similarity) = alone(source, camera)?;
        let network = &model.network;
        let (frames, images) = alone.frames(params, network.parameters.device());
        let encoded = run.phase("encode", 0.0, || network.encode(&frames))?;
        let mut base = run.phase("base heads", 0.3, || {
            lift_base(network, &encoded, &images, &alone, params)
        })?;
        let heads = MotionHeads::load(network, alone.views.len()).map_err(stage_error)?;
        let mut slices = lift_slices(&mut run, &heads, &encoded, &base, &alone, params)?;
        similarity.apply_to_base(&mut base);
        slices.iter_mut().for_each(|slice| similarity.apply_to_slice(slice));
        match &mut merged {
            None => merged = Some((base, slices)),
            Some((all, all_slices)) => {
                all.append(base);
                for (all, slice) in all_slices.iter_mut().zip(slices) {
                    all.displacement_m.extend(slice.displacement_m);
                    all.gate.extend(slice.gate);
                    all.moving_raw.extend(slice.moving_raw);
                }
            }
        }
    }
    merged.ok_or_else(|| StageError::bad_input("the clip has no source views"))
}

/// The views of one camera, relative to the first of them and of unit size, and the way back.
fn alone<'a>(source: &Source<'a>, camera: u32) -> StageResult<(Source<'a>, Similarity)> {
    let mut views: Vec<View<'a>> = source
        .views
        .iter()
        .filter(|view| view.view.camera == camera)
        .cloned()
        .collect();
    let first = views[0].camera;
    for view in &mut views {
        view.camera = view.camera.seen_from(&first.pose());
    }
    let scale_iu = stereo_scale_iu(source.clip, &views)?;
    for view in &mut views {
        view.camera.translation_iu = view.camera.translation_iu.map(|value| value / scale_iu);
    }
    let similarity = Similarity {
        rotation: first.rotation,
        quaternion: quaternion_of(&first.rotation),
        translation_m: first.translation_iu.map(|value| value / UNITS_PER_METRE),
        factor: scale_iu,
    };
    let mut base = source.base.seen_from(&first.pose());
    base.translation_iu = base.translation_iu.map(|value| value / scale_iu);
    Ok((Source { views, base, ..*source }, similarity))
}

/// Mean distance from the origin of the stereo points of some views of one camera, internal units.
fn stereo_scale_iu(clip: &Clip, views: &[View<'_>]) -> StageResult<f64> {
    let camera = &clip.cameras[views[0].view.camera as usize];
    let missing = |what: &str| {
        StageError::bad_input(format!(
            "camera-wise lifting needs stereo depth of camera `{}`: {what}",
            camera.id
        ))
        .with_hint(
            "it takes one scale per camera from the depth at the source frames; lift jointly where there is none",
        )
    };
    let depth = camera.depth.as_ref().ok_or_else(|| missing("the clip has none"))?;
    let (width, area) = (clip.width as usize, (clip.height * clip.width) as usize);
    let (mut sum, mut count) = (0.0, 0usize);
    for view in views {
        let start = view.view.frame as usize * area;
        let stored = depth
            .depth_m
            .get(start..start + area)
            .ok_or_else(|| missing("its maps are too few"))?;
        let (r, t) = (&view.camera.rotation, &view.camera.translation_iu);
        for (pixel, &depth_m) in stored.iter().enumerate() {
            if !(depth_m > depth.range_m[0] && depth_m < depth.range_m[1]) {
                continue;
            }
            let z = f64::from(depth_m) * UNITS_PER_METRE;
            let local = [
                ((pixel % width) as f64 + 0.5 - view.intrinsics.cx) / view.intrinsics.fx * z,
                ((pixel / width) as f64 + 0.5 - view.intrinsics.cy) / view.intrinsics.fy * z,
                z,
            ];
            let square: f64 = (0..3)
                .map(|row| (t[row] + (0..3).map(|k| r[3 * row + k] * local[k]).sum::<f64>()).powi(2))
                .sum();
            sum += square.sqrt();
            count += 1;
        }
    }
    if count == 0 {
        return Err(missing("no pixel of its source frames has a valid depth"));
    }
    Ok(sum / count as f64)
}

impl Similarity {
    fn apply_to_base(&self, base: &mut Base) {
        for point in base.position_m.chunks_exact_mut(3) {
            let turned = self.turned(point);
            for (value, (turned, shift)) in point.iter_mut().zip(turned.into_iter().zip(self.translation_m)) {
                *value = (turned + shift) as f32;
            }
        }
        self.apply_to_raw(&mut base.raw);
    }

    fn apply_to_slice(&self, slice: &mut TimeSlice) {
        for displacement in slice.displacement_m.chunks_exact_mut(3) {
            let turned = self.turned(displacement);
            displacement
                .iter_mut()
                .zip(turned)
                .for_each(|(value, turned)| *value = turned as f32);
        }
        self.apply_to_raw(&mut slice.moving_raw);
    }

    /// Scaled and turned.
    fn turned(&self, vector: &[f32]) -> [f64; 3] {
        std::array::from_fn(|row| {
            let sum: f64 = (0..3).map(|k| self.rotation[3 * row + k] * f64::from(vector[k])).sum();
            self.factor * sum
        })
    }

    /// Raw attributes whose activated scales are larger by the factor, and whose rotations are turned.
    fn apply_to_raw(&self, raw: &mut [f32]) {
        for raw in raw.chunks_exact_mut(RAW_CHANNELS) {
            for scale in &mut raw[3..6] {
                *scale = rescaled(*scale, self.factor);
            }
            let turned = quaternion_product(self.quaternion, [raw[6], raw[7], raw[8], raw[9]]);
            raw[6..10].copy_from_slice(&turned);
        }
    }
}

/// Unit quaternion (w, x, y, z) of a rotation matrix.
fn quaternion_of(rotation: &[f64; 9]) -> [f32; 4] {
    let r = rotation;
    let matrix = glam::DMat3::from_cols_array(&[r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]]);
    let q = glam::DQuat::from_mat3(&matrix);
    [q.w as f32, q.x as f32, q.y as f32, q.z as f32]
}
