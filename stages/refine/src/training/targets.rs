//! What the renders of a clip are compared with: images and stereo depth of source and right cameras, robot positions from
//! forward kinematics, tracks, and the motion that Stage 1 renders.

use glam::{DVec3, Vec3};
use rogs_geometry::{Base, Link, Pose, Recon};
use rogs_schemas::records::clip::{CameraRole, Clip, time_of_frame};
use rogs_schemas::records::field::{Field, TimeSlice};
use rogs_schemas::records::robot::{NO_LINK, RobotMaps};
use rogs_schemas::units::{UNITS_PER_METRE, iu_from_m};
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_splat::{RasterCamera, RasterConfig, render};
use rogs_stage2::objective::ViewSide;
use rogs_worker::{StageError, StageResult};

use super::TrainingOptions;
use super::chain::scene_at;
use crate::refinement::internal;
use crate::source_time::{bad_pose, raster_camera, recon_from_base};
use crate::{ClipInputs, RefineParams};
use rogs_field::Correction;

/// A view that is rendered and compared.
pub(super) struct TargetView {
    pub(super) side: ViewSide,
    pub(super) camera: RasterCamera,
    /// `[P, 3]`
    pub(super) rgb: Vec<f32>,
    /// Metres; 1 where it is not valid. `[P]`
    pub(super) depth_m: Vec<f32>,
    /// `[P]`
    pub(super) depth_valid: Vec<f32>,
    /// `[P]`
    pub(super) covered: Vec<f32>,
}

/// Mesh-anchored Gaussians at one time.
pub(super) struct RobotTarget {
    /// `[M]`
    pub(super) gaussians: Vec<u32>,
    /// Where their links take their anchors, reconstruction frame, metres. `[M, 3]`
    pub(super) reference_m: Vec<f32>,
}

/// One query time.
pub(super) struct TargetTime<'a> {
    pub(super) slice: &'a TimeSlice,
    pub(super) views: Vec<TargetView>,
    pub(super) robot: RobotTarget,
}

/// Displacements from the anchor time to every query time, rendered by one camera at the anchor time.
pub(super) struct MotionTarget<'a> {
    /// The field at the anchor time.
    pub(super) anchor: &'a TimeSlice,
    pub(super) camera: RasterCamera,
    /// Displacements of all Gaussians to every query time, internal units. `[N, 3 * times]`
    pub(super) displacement_iu: Vec<f32>,
    /// Channels of a rendered pixel: `3 * times`.
    pub(super) channels: usize,
    /// First channel in the rendered map of each sample: `pixel * channels + 3 * time`. `[K]`
    pub(super) samples: Vec<usize>,
    /// Displacement of the track, reconstruction frame, internal units. `[K, 3]`
    pub(super) reference_iu: Vec<f32>,
    /// Displacement that the uncorrected field renders. `[K, 3]`
    pub(super) stage1_iu: Vec<f32>,
}

/// All references of a clip.
pub(super) struct Targets<'a> {
    pub(super) times: Vec<TargetTime<'a>>,
    pub(super) motion: Vec<MotionTarget<'a>>,
}

impl<'a> Targets<'a> {
    /// Gathers them.
    ///
    /// # Errors
    /// When the field lacks one of the query times or the records contradict each other.
    pub(super) fn new(
        inputs: &ClipInputs<'a>,
        params: &RefineParams,
        options: &TrainingOptions<'_>,
    ) -> StageResult<Self> {
        let ClipInputs { clip, robot, field, .. } = *inputs;
        let frames = if options.frames.is_empty() {
            &clip.source_frames
        } else {
            options.frames
        };
        let mut times = Vec::with_capacity(frames.len());
        for &frame in frames {
            times.push(TargetTime {
                slice: slice_at(clip, field, frame)?,
                views: views(clip, robot, field, frame, options.right_views)?,
                robot: robot_target(robot, field, frame)?,
            });
        }
        if times.iter().all(|time| time.views.is_empty()) {
            return Err(StageError::bad_input(
                "no camera of the clip has images at the query times",
            ));
        }
        let motion = motion(inputs, params, frames)?;
        Ok(Self { times, motion })
    }
}

fn slice_at<'a>(clip: &Clip, field: &'a Field, frame: FrameIndex) -> StageResult<&'a TimeSlice> {
    let time = time_of_frame(frame, clip.frame_count());
    field.slice_at(time).ok_or_else(|| {
        StageError::bad_input(format!("the field has no values at frame {frame}"))
            .with_hint("lift the clip with that frame among its query frames")
    })
}

fn views(
    clip: &Clip,
    robot: &RobotMaps,
    field: &Field,
    frame: FrameIndex,
    right: bool,
) -> StageResult<Vec<TargetView>> {
    let pixels = (field.height * field.width) as usize;
    let mut views = Vec::new();
    for (index, camera) in CameraIndex::first(clip.cameras.len()).zip(&clip.cameras) {
        let side = match camera.role {
            CameraRole::Source => ViewSide::Source,
            CameraRole::Evaluation if right && camera.partner.is_some() => ViewSide::PairedRight,
            CameraRole::Evaluation => continue,
        };
        let of_frame = frame.at() * pixels..(frame.at() + 1) * pixels;
        let Some(target) = clip.target(index, frame) else {
            continue;
        };
        let depth = camera.depth.as_ref();
        let range = depth.map_or([0.0, f32::INFINITY], |depth| depth.range_m);
        let stored = depth.and_then(|depth| depth.depth_m.get(of_frame));
        let is_valid = |depth: f32| depth > range[0] && depth < range[1];
        let valid: Vec<bool> = match stored {
            Some(depths) => depths.iter().map(|&depth| is_valid(depth)).collect(),
            None => vec![false; pixels],
        };
        let depth_m = match stored {
            Some(depths) => depths
                .iter()
                .zip(&valid)
                .map(|(&depth, &valid)| if valid { depth } else { 1.0 })
                .collect(),
            None => vec![1.0; pixels],
        };
        let depth_valid: Vec<f32> = valid.iter().map(|&valid| f32::from(u8::from(valid))).collect();
        views.push(TargetView {
            side,
            camera: raster_camera(clip, robot, field, index, frame)?,
            rgb: target.rgb().iter().map(|&value| f32::from(value) / 255.0).collect(),
            covered: if stored.is_some() {
                depth_valid.clone()
            } else {
                vec![1.0; pixels]
            },
            depth_m,
            depth_valid,
        });
    }
    Ok(views)
}

/// `T_l(t) T_l(s)^-1 p` of every mesh-anchored Gaussian, `s` being its own source time.
fn robot_target(robot: &RobotMaps, field: &Field, frame: FrameIndex) -> StageResult<RobotTarget> {
    let (links, area) = (robot.link_names.len(), (field.height * field.width) as usize);
    let recon_from_base = recon_from_base(field)?;
    let base_from_recon = recon_from_base.inverse();
    let pose = |frame: FrameIndex, link: usize| -> StageResult<Pose<Base, Link>> {
        let stored = robot.base_from_link.get(frame.at() * links + link).ok_or_else(|| {
            StageError::bad_input(format!("the robot maps have no pose of link {link} at frame {frame}"))
        })?;
        Pose::from_rigid(stored).map_err(bad_pose)
    };
    let (mut gaussians, mut reference_m) = (Vec::new(), Vec::new());
    for (view, source) in field.views.iter().enumerate() {
        let mut motions: Vec<Option<Pose<Recon, Recon>>> = vec![None; links];
        for index in view * area..(view + 1) * area {
            let link = field.link[index];
            if field.support[index] == 0 || link == NO_LINK || usize::from(link) >= links {
                continue;
            }
            let link = usize::from(link);
            let motion = match motions[link] {
                Some(motion) => motion,
                None => {
                    let moved = pose(frame, link)? * pose(source.frame, link)?.inverse();
                    *motions[link].insert(recon_from_base * moved * base_from_recon)
                }
            };
            let point = Vec3::from_slice(&field.position_m[3 * index..]).as_dvec3();
            gaussians.push(index as u32);
            reference_m.extend(motion.point(point).as_vec3().to_array());
        }
    }
    Ok(RobotTarget { gaussians, reference_m })
}

/// The tracks of every source camera, and what Stage 1 renders there.
fn motion<'a>(
    inputs: &ClipInputs<'a>,
    params: &RefineParams,
    frames: &[FrameIndex],
) -> StageResult<Vec<MotionTarget<'a>>> {
    let ClipInputs { clip, robot, field, .. } = *inputs;
    let Some(tracks) = &clip.tracks else {
        return Ok(Vec::new());
    };
    let (height, width) = (field.height as usize, field.width as usize);
    let anchor = slice_at(clip, field, tracks.anchor_frame)?;
    let channels = 3 * frames.len();
    let mut displacement_iu = vec![0.0; field.len() * channels];
    for (time, &frame) in frames.iter().enumerate() {
        let slice = slice_at(clip, field, frame)?;
        for (row, (to, from)) in displacement_iu.chunks_exact_mut(channels).zip(
            slice
                .displacement_m
                .chunks_exact(3)
                .zip(anchor.displacement_m.chunks_exact(3)),
        ) {
            for axis in 0..3 {
                row[3 * time + axis] = iu_from_m(to[axis] - from[axis]);
            }
        }
    }
    let position = |track: usize, frame: FrameIndex| -> Option<DVec3> {
        let start = (track * clip.frame_count() + frame.at()) * 3;
        let point = Vec3::from_slice(tracks.position_m.get(start..start + 3)?).as_dvec3();
        point.is_finite().then_some(point)
    };
    let recon_from_base = recon_from_base(field)?;
    let mut targets = Vec::new();
    for camera in clip.source_cameras() {
        let (mut samples, mut reference_iu) = (Vec::new(), Vec::new());
        for track in (0..tracks.camera.len()).filter(|&track| tracks.camera[track] == camera) {
            let visible = tracks
                .visible
                .get(track * clip.frame_count() + tracks.anchor_frame.at())
                == Some(&1);
            let [x, y] = [0, 1].map(|axis| (tracks.pixel[2 * track + axis] + 0.5).floor());
            let inside = x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32;
            let Some(from) = position(track, tracks.anchor_frame).filter(|_| visible && inside) else {
                continue;
            };
            for (time, &frame) in frames
                .iter()
                .enumerate()
                .filter(|&(_, &frame)| frame != tracks.anchor_frame)
            {
                let Some(to) = position(track, frame) else { continue };
                samples.push((y as usize * width + x as usize) * channels + 3 * time);
                let moved_iu = recon_from_base.direction(to - from) * UNITS_PER_METRE;
                reference_iu.extend(moved_iu.as_vec3().to_array());
            }
        }
        if samples.is_empty() {
            continue;
        }
        let view = raster_camera(clip, robot, field, camera, tracks.anchor_frame)?;
        let mut scene = scene_at(
            field,
            &Correction::zero(field.len()),
            params.scale_residual,
            anchor.time,
        )?;
        scene.extra.clone_from(&displacement_iu);
        scene.extra_channels = channels;
        let rendered = render(&scene, &view, &RasterConfig::default()).map_err(internal)?.extra;
        let stage1_iu = samples
            .iter()
            .flat_map(|&sample| &rendered[sample..sample + 3])
            .copied()
            .collect();
        targets.push(MotionTarget {
            anchor,
            camera: view,
            displacement_iu: displacement_iu.clone(),
            channels,
            samples,
            reference_iu,
            stage1_iu,
        });
    }
    Ok(targets)
}
