//! The camera-wise baseline: every camera lifted by itself, as the released monocular network does it, with one scale per
//! camera from stereo depth; the fields are merged by calibration (paper, appendix on baselines).
//!
//! A camera's poses are taken relative to its first source frame and divided by its scale, the mean distance of the valid
//! back-projected stereo points of its source frames from that first camera. So the network sees the scene of unit size
//! that it was released for. Its field then is multiplied by that scale, the largest scale of a Gaussian with it, and carried
//! to the reconstruction frame, where the camera must see the same as before ([`crate::parity`]). The depth
//! is the clip's, which the references that the pipeline made complete; the field's label says what made it.

use glam::{DQuat, DVec3};
use rogs_field::attributes::{MAX_SCALE_IU, rescaled};
use rogs_geometry::{Camera, Pose, Recon, Similarity, pixel_centre, quaternion_product, wxyz_f32};
use rogs_schemas::CameraIndex;
use rogs_schemas::records::clip::{Clip, time_of_frame};
use rogs_schemas::records::field::{RAW_CHANNELS, TimeSlice};
use rogs_schemas::units::UNITS_PER_METRE;
use rogs_worker::{Part, StageError, StageResult};

use crate::lifting::{Base, MotionHeads, lift_base};
use crate::source::{Source, View};
use crate::{Lifting, parity, stage_error};

/// From the lifting of one camera, in the frame of its first view and in its own unit, to the reconstruction frame.
#[derive(Debug, Clone, Copy)]
struct Transport {
    /// Translation in metres; the scale is internal units per unit of the lifting.
    recon_from_first: Similarity<Recon, Camera>,
    /// Its rotation (w, x, y, z).
    quaternion: [f32; 4],
}

/// The fields of all cameras, in the order of the views.
pub(crate) struct Merged {
    pub(crate) base: Base,
    pub(crate) slices: Vec<TimeSlice>,
    /// The scale of every camera and what it was taken from, in words.
    pub(crate) scales: String,
}

/// Lifts every camera by itself.
pub(crate) fn lift(all: &mut Lifting<'_>, source: &Source<'_>) -> StageResult<Merged> {
    let mut cameras: Vec<CameraIndex> = source.views.iter().map(|view| view.view.camera).collect();
    cameras.dedup();
    let mut merged: Option<(Base, Vec<TimeSlice>)> = None;
    let mut scales = Vec::with_capacity(cameras.len());
    for (done, &camera) in cameras.iter().enumerate() {
        let share = 1.0 / cameras.len() as f64;
        let (model, params) = (all.model, all.params);
        let mut lifting = Lifting {
            model,
            params,
            observer: &mut Part::new(all.observer, done as f64 * share, share),
        };
        let (alone, transport) = alone(source, camera)?;
        scales.push(label(source.clip, camera, &transport));
        let network = &model.network;
        let (frames, images) = alone.frames(params, network.parameters.device());
        let encoded = lifting.phase("encode", 0.0, || network.encode(&frames))?;
        let mut base = lifting.phase("base heads", 0.3, || {
            lift_base(network, &encoded, &images, &alone, params)
        })?;
        let heads = MotionHeads::load(network, alone.views.len()).map_err(stage_error)?;
        let mut slices = lifting.slices(&alone, &heads, &encoded, &base)?;
        // Where the clip asks for the time of the first view, as all do that are scored, renders are compared.
        let first = time_of_frame(alone.views[0].view.frame, source.clip.frame_count());
        let audited = slices.iter().position(|slice| slice.time == first);
        let own = audited.map(|at| parity::seen(&alone, &base, &slices[at], &alone.views[0]));
        let own = own.transpose()?;
        transport.apply_to_base(&mut base);
        slices.iter_mut().for_each(|slice| transport.apply_to_slice(slice));
        if let (Some(at), Some(own)) = (audited, own) {
            let in_world = alone.placed_as(source);
            let world = parity::seen(&in_world, &base, &slices[at], &in_world.views[0])?;
            if let Some(warning) = parity::warning(&source.clip.cameras[camera.at()].id, &own, &world) {
                lifting.observer.warn(warning);
            }
        }
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
    let (base, slices) = merged.ok_or_else(|| StageError::bad_input("the clip has no source views"))?;
    let scales = format!("unit of each camera: {}", scales.join(", "));
    Ok(Merged { base, slices, scales })
}

/// `wrist 0.41 m (classical stereo)`
fn label(clip: &Clip, camera: CameraIndex, transport: &Transport) -> String {
    let camera = &clip.cameras[camera.at()];
    let origin = camera.depth.as_ref().map(|depth| depth.origin).unwrap_or_default();
    let unit_m = transport.recon_from_first.scale / UNITS_PER_METRE;
    format!("{} {unit_m:.4} m ({})", camera.id, origin.label())
}

/// The views of one camera, relative to the first of them and of unit size, and the way back.
fn alone<'a>(source: &Source<'a>, camera: CameraIndex) -> StageResult<(Source<'a>, Transport)> {
    let mut views: Vec<View<'a>> = source
        .views
        .iter()
        .filter(|view| view.view.camera == camera)
        .cloned()
        .collect();
    // What the network takes for the reconstruction frame is here the frame of the first view.
    let recon_from_first_iu = views[0].camera.world_from_camera_iu;
    for view in &mut views {
        let pose = &mut view.camera.world_from_camera_iu;
        *pose = pose.seen_from(&recon_from_first_iu).relabelled();
    }
    let scale_iu = stereo_scale_iu(source.clip, &views)?;
    for view in &mut views {
        view.camera.world_from_camera_iu.translation /= scale_iu;
    }
    let rotation = recon_from_first_iu.rotation;
    let transport = Transport {
        recon_from_first: Similarity {
            rigid: Pose::new(rotation, recon_from_first_iu.translation / UNITS_PER_METRE),
            scale: scale_iu,
        },
        quaternion: wxyz_f32(DQuat::from_mat3(&rotation)),
    };
    let mut base = source.recon_from_base_iu.seen_from(&recon_from_first_iu).relabelled();
    base.translation /= scale_iu;
    let alone = Source {
        views,
        recon_from_base_iu: base,
        ..*source
    };
    Ok((alone, transport))
}

/// Mean distance from the origin of the stereo points of some views of one camera, internal units.
fn stereo_scale_iu(clip: &Clip, views: &[View<'_>]) -> StageResult<f64> {
    let camera = &clip.cameras[views[0].view.camera.at()];
    let missing = |what: &str| {
        StageError::bad_input(format!(
            "camera-wise lifting needs stereo depth of camera `{}`: {what}",
            camera.id
        ))
        .with_hint(
            "it takes one scale per camera from the depth at the source frames: `[references]` in the manifest makes some \
             from cameras with a right eye (docs/references.md); lift jointly where there is none",
        )
    };
    let depth = camera.depth.as_ref().ok_or_else(|| missing("the clip has none"))?;
    let (width, area) = (clip.width as usize, (clip.height * clip.width) as usize);
    let (mut sum, mut count) = (0.0, 0usize);
    for view in views {
        let start = view.view.frame.at() * area;
        let stored = depth
            .depth_m
            .get(start..start + area)
            .ok_or_else(|| missing("its maps are too few"))?;
        for (pixel, &depth_m) in stored.iter().enumerate() {
            if !(depth_m > depth.range_m[0] && depth_m < depth.range_m[1]) {
                continue;
            }
            let depth_iu = f64::from(depth_m) * UNITS_PER_METRE;
            let centre = pixel_centre((pixel % width) as u32, (pixel / width) as u32);
            let point_iu = view.lens.unproject(centre, depth_iu);
            sum += view.camera.world_from_camera_iu.point(point_iu).length();
            count += 1;
        }
    }
    if count == 0 {
        return Err(missing("no pixel of its source frames has a valid depth"));
    }
    Ok(sum / count as f64)
}

impl Transport {
    fn apply_to_base(&self, base: &mut Base) {
        for point in base.position_m.chunks_exact_mut(3) {
            let carried = self.recon_from_first.point(vector(point));
            point.copy_from_slice(&carried.as_vec3().to_array());
        }
        self.apply_to_raw(&mut base.raw);
        // The largest scale is one of the camera's own unit.
        base.scale_cap_iu
            .fill((f64::from(MAX_SCALE_IU) * self.recon_from_first.scale) as f32);
    }

    fn apply_to_slice(&self, slice: &mut TimeSlice) {
        for displacement in slice.displacement_m.chunks_exact_mut(3) {
            let carried = self.recon_from_first.vector(vector(displacement));
            displacement.copy_from_slice(&carried.as_vec3().to_array());
        }
        self.apply_to_raw(&mut slice.moving_raw);
    }

    /// Raw attributes whose activated scales are larger by the factor, and whose rotations are turned.
    fn apply_to_raw(&self, raw: &mut [f32]) {
        for raw in raw.chunks_exact_mut(RAW_CHANNELS) {
            for scale in &mut raw[3..6] {
                *scale = rescaled(*scale, self.recon_from_first.scale);
            }
            let turned = quaternion_product(self.quaternion, [raw[6], raw[7], raw[8], raw[9]]);
            raw[6..10].copy_from_slice(&turned);
        }
    }
}

fn vector(values: &[f32]) -> DVec3 {
    glam::Vec3::from_slice(values).as_dvec3()
}
