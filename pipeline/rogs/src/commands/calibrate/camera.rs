//! One camera after the other.

use rogs_agreement::audit::{Filmed, Footage, Mount};
use rogs_calibration::rig::upside_down;
use rogs_calibration::{Error as Unsolved, Picture, Prior, Refined, Settings, Take, overlay, refine, search};
use rogs_geometry::Pinhole;
use rogs_orchestrator::Error;
use rogs_schemas::ids::unknown;
use rogs_schemas::records::clip::{CameraRole, Clip};

use super::Args;
use super::clips::{Clips, Robot};

/// A camera, and what came out.
pub(super) struct Calibrated {
    pub(super) name: String,
    /// The lens as given.
    pub(super) lens: Pinhole,
    /// The pose as given.
    pub(super) given: Mount,
    /// What the correction is of: the pose as given, or the one that a search found.
    pub(super) start: Mount,
    /// Overlay of the pose that a search found, and of the best other one.
    pub(super) searched: Option<(f64, Option<f64>)>,
    /// The result; or why there is none.
    pub(super) refined: Result<Refined, Unsolved>,
}

/// Calibrates the cameras that are asked for.
pub(super) fn calibrate_all(clips: &Clips, robot: &Robot, args: &Args) -> anyhow::Result<Vec<Calibrated>> {
    let first = &clips.clips[0];
    let names: Vec<&str> = first
        .cameras
        .iter()
        .filter(|camera| camera.role == CameraRole::Source)
        .map(|camera| camera.id.as_str())
        .collect();
    if let Some(told) = unknown(args.camera.iter().map(String::as_str), &names) {
        let error = Error::usage(format!("the clip has no camera {told}"));
        return Err(error.with_hint(format!("it has {}", names.join(", "))).into());
    }
    let wanted = names
        .into_iter()
        .filter(|name| args.camera.is_empty() || args.camera.iter().any(|wanted| wanted == name));
    wanted.map(|name| calibrate(clips, robot, args, name)).collect()
}

fn calibrate(clips: &Clips, robot: &Robot, args: &Args, name: &str) -> anyhow::Result<Calibrated> {
    let (lens, given) = given(&clips.clips[0], robot, name)?;
    let mut camera = Calibrated {
        name: name.to_owned(),
        lens,
        start: given.clone(),
        given,
        searched: None,
        refined: Err(Unsolved::TooFewFrames { frames: 0 }),
    };
    if (args.new || args.search) && matches!(camera.start, Mount::Fixed(_)) {
        let footages = camera.footages(clips, robot);
        match search(&takes(&footages)) {
            Ok(found) => {
                camera.searched = Some((found.overlay, found.other));
                camera.start = Mount::Fixed(found.base_from_camera);
            }
            Err(why) => {
                camera.refined = Err(why);
                return Ok(camera);
            }
        }
    }
    let on_hand = matches!(camera.start, Mount::Hand { .. });
    let pose = if on_hand { Prior::HAND_EYE } else { Prior::POSE };
    let settings = Settings {
        prior: Prior {
            focal: match (args.focal, args.new && on_hand) {
                (true, _) => Some(if args.new { 0.15 } else { 0.05 }),
                // The lens is that of the model, before rectification.
                (false, true) => Some(0.05),
                (false, false) => None,
            },
            principal: args.principal_point.then_some(0.03),
            lag_frames: args.lag.then_some(2.0).or(pose.lag_frames),
            ..pose
        },
        frames: args.frames as usize,
    };
    let refined = |camera: &Calibrated| refine(&takes(&camera.footages(clips, robot)), &settings);
    camera.refined = refined(&camera);
    if args.new
        && let Mount::Hand { link, link_from_camera } = camera.start
        && !camera.refined.as_ref().is_ok_and(is_sure)
    {
        let start = Mount::Hand {
            link,
            link_from_camera: upside_down(&link_from_camera),
        };
        let mut other = Calibrated {
            start,
            refined: Err(Unsolved::TooFewFrames { frames: 0 }),
            name: camera.name.clone(),
            given: camera.given.clone(),
            ..camera
        };
        other.refined = refined(&other);
        if fits_better(&other.refined, &camera.refined) {
            return Ok(other);
        }
    }
    Ok(camera)
}

/// Whether a camera on the hand need not be sought elsewhere.
fn is_sure(refined: &Refined) -> bool {
    refined.after.overlay > 0.3 || refined.after.epipolar_px.is_some_and(|px| px < 0.7)
}

/// Whether one result of a camera on the hand is better than another one: by the path where one fits it by far better,
/// else by the gripper.
fn fits_better(new: &Result<Refined, Unsolved>, old: &Result<Refined, Unsolved>) -> bool {
    let (Ok(new), Ok(old)) = (new, old) else {
        return new.is_ok();
    };
    match (new.after.epipolar_px, old.after.epipolar_px) {
        (Some(new), Some(old)) if new < 0.6 * old => true,
        (Some(new), Some(old)) if old < 0.6 * new => false,
        _ => new.after.overlay > old.after.overlay,
    }
}

/// Lens and pose of a camera as the clip has them.
fn given(clip: &Clip, robot: &Robot, name: &str) -> anyhow::Result<(Pinhole, Mount)> {
    let Some(camera) = clip.cameras.iter().find(|camera| camera.id == name) else {
        return Err(Error::usage(format!("the clip has no camera `{name}`")).into());
    };
    let mount = Mount::of_clip(&camera.mount, robot.meshes.model())?;
    Ok((Pinhole::of_clip(clip, camera), mount))
}

fn takes<'a>(footages: &'a [Footage<'a>]) -> Vec<Take<'a>> {
    footages.iter().map(|footage| Take { footage, camera: 0 }).collect()
}

impl Calibrated {
    /// The clips with this camera alone, as it stands at the start. Clips without its images are left out.
    fn footages<'a>(&'a self, clips: &'a Clips, robot: &'a Robot) -> Vec<Footage<'a>> {
        let of_clip = |clip: &'a Clip| {
            let camera = clip.cameras.iter().find(|camera| camera.id == self.name)?;
            let images = camera.recorded.as_deref()?;
            let bytes = 3 * clip.width as usize * clip.height as usize;
            Some(Footage {
                model: robot.meshes.model(),
                scene: robot.meshes.scene(),
                spec: &robot.spec,
                joint_names: &clip.robot.joint_names,
                positions: &clip.robot.positions,
                gripper: &clip.robot.gripper,
                cameras: vec![Filmed {
                    name: &self.name,
                    lens: self.lens,
                    mount: self.start.clone(),
                    images: images.chunks_exact(bytes).collect(),
                }],
            })
        };
        clips.clips.iter().filter_map(of_clip).collect()
    }

    /// Outlines before and after at three moments of the first clip.
    pub(super) fn picture(&self, clips: &Clips, robot: &Robot, refined: &Refined) -> anyhow::Result<Picture> {
        let footages = self.footages(clips, robot);
        let takes = takes(&footages);
        let Some(take) = takes.first() else {
            return Err(Error::usage(format!("camera `{}` has no images", self.name)).into());
        };
        let last = take.footage.frames().saturating_sub(1);
        let mut frames = vec![last / 8, last / 2, last - last / 8];
        frames.dedup();
        Ok(overlay(take, &refined.correction, &frames)?)
    }
}
