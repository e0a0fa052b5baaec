//! A clip through the network, camera by camera.

use rogs_4dgt::rays::RayCamera;
use rogs_4dgt::{Recentring, Stream};
use rogs_geometry::{Base, Camera, Pose, PosedCamera};
use rogs_schemas::records::clip::{Clip, SourceView};
use rogs_schemas::records::polynomial::{PolynomialField, Polynomials};
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_worker::{Observer, Part, StageError, StageResult};

use crate::images::{resized, resized_lens};
use crate::model::{Model, stage_error};
use crate::params::{InputFrames, Lift4dgtParams};

/// Lifts one clip. `observer` hears of the phases `preprocess` and `network` of each camera.
///
/// # Errors
/// When the clip has no source camera, an image or pose is missing, or the cameras of a stream have no mean frame; with the
/// camera's name.
pub fn lift_clip(
    model: &Model,
    params: &Lift4dgtParams,
    clip: &Clip,
    robot: &RobotMaps,
    observer: &mut dyn Observer,
) -> StageResult<PolynomialField> {
    if robot.clip_id != clip.clip_id {
        return Err(StageError::bad_input(format!(
            "the robot maps are those of clip `{}`, not of `{}`",
            robot.clip_id, clip.clip_id
        )));
    }
    let frames: Vec<FrameIndex> = match params.frames {
        InputFrames::All => (0..clip.frame_count() as u32).map(FrameIndex).collect(),
        InputFrames::Source => clip.source_frames.clone(),
    };
    let cameras = clip.source_cameras();
    if cameras.is_empty() || frames.is_empty() {
        return Err(StageError::bad_input("the clip has no source views"));
    }
    let (mut gaussians, mut views) = (Polynomials::default(), Vec::new());
    for (done, &camera) in cameras.iter().enumerate() {
        let share = 1.0 / cameras.len() as f64;
        let mut observer = Part::new(observer, done as f64 * share, share);
        let observer: &mut dyn Observer = &mut observer;
        let (stream, recentring, start_s) =
            observer.phase("preprocess", 0.0, || stream(params, clip, robot, camera, &frames))?;
        let lifted = observer.phase("network", 0.05, || model.network.lift(&stream));
        let mut field = lifted.map_err(|error| {
            let error = stage_error(error);
            StageError {
                message: format!("camera `{}`: {}", clip.cameras[camera.at()].id, error.message),
                ..error
            }
        })?;
        recentring.undo(&mut field);
        field.time_s.iter_mut().for_each(|time| *time += start_s);
        gaussians.append(field);
        views.extend(frames.iter().map(|&frame| SourceView { camera, frame }));
    }
    Ok(PolynomialField {
        clip_id: clip.clip_id.clone(),
        height: params.height,
        width: params.width,
        views,
        weights: model.weights.clone(),
        gaussians,
    })
}

/// What the network sees of a camera, the way back from its mean frame, and when its first frame is, seconds.
fn stream(
    params: &Lift4dgtParams,
    clip: &Clip,
    robot: &RobotMaps,
    camera: CameraIndex,
    frames: &[FrameIndex],
) -> StageResult<(Stream, Recentring, f32)> {
    let id = &clip.cameras[camera.at()].id;
    let size = [params.height, params.width];
    let [own, wanted] = [[clip.height, clip.width], size].map(|size| size.map(|side| side as usize));
    let (mut images, mut poses, mut lenses) = (Vec::new(), Vec::<Pose<Base, Camera>>::new(), Vec::new());
    for &frame in frames {
        let image = clip.observation(SourceView { camera, frame }).ok_or_else(|| {
            StageError::bad_input(format!("there is no image of camera `{id}` at clip frame {frame}")).with_hint(
                "`lift = { frames = \"source\" }` under [[baselines]] takes the frames at the source times alone",
            )
        })?;
        images.extend(resized(image.rgb(), own, wanted));
        let posed = PosedCamera::of_clip(clip, robot, camera, frame)
            .map_err(|error| StageError::bad_input(error.to_string()))?;
        poses.push(posed.world_from_camera);
        lenses.push(resized_lens(&posed.lens, size));
    }
    let recentring = Recentring::of(&poses).ok_or_else(|| {
        StageError::bad_input(format!(
            "the poses of camera `{id}` have no mean frame: it looks along its own vertical axis, seen from the robot's base"
        ))
    })?;
    let cameras = poses.iter().zip(lenses).map(|(pose, lens)| RayCamera {
        lens,
        mean_from_camera: recentring.apply(pose),
    });
    let seconds = |frame: FrameIndex| f64::from(frame.0) / clip.fps;
    let start = seconds(frames[0]);
    let stream = Stream {
        images,
        times_s: frames.iter().map(|&frame| (seconds(frame) - start) as f32).collect(),
        cameras: cameras.collect(),
    };
    Ok((stream, recentring, start as f32))
}
