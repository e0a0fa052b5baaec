//! What the fit sees of each source time: cameras and observed images.

use rogs_geometry::{Base, Pose, PosedCamera, Recon};
use rogs_schemas::records::clip::{Clip, SourceView, time_of_frame};
use rogs_schemas::records::field::Field;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::units::LengthUnit;
use rogs_splat::RasterCamera;
use rogs_worker::{StageError, StageResult};

/// One source time of a clip.
pub(crate) struct SourceTime {
    /// Place of its slice in the field.
    pub(crate) slice: usize,
    /// Source cameras in the reconstruction frame, internal units.
    pub(crate) cameras: Vec<RasterCamera>,
    /// Observed images, 0 to 1. `[cameras]` of `[H, W, 3]`
    pub(crate) images: Vec<Vec<f32>>,
    /// Reference depth, 0 where it is unknown or out of range, metres. `[cameras]` of `[H, W]`
    pub(crate) depths_m: Vec<Option<Vec<f32>>>,
}

/// All source times of a field, ascending.
///
/// # Errors
/// When the records do not belong together, or a source view has no image or no stored values.
pub(crate) fn source_times(clip: &Clip, robot: &RobotMaps, field: &Field) -> StageResult<Vec<SourceTime>> {
    check(clip, robot, field)?;
    let recon_from_base: Pose<Recon, Base> =
        Pose::from_rigid(&field.recon_from_base).map_err(|error| StageError::bad_input(error.to_string()))?;
    let mut frames: Vec<_> = field.views.iter().map(|view| view.frame).collect();
    frames.sort_unstable();
    frames.dedup();
    let one = |frame| {
        let time = time_of_frame(frame, clip.frame_count());
        let slice = field
            .slices
            .iter()
            .position(|slice| slice.time == time)
            .ok_or_else(|| {
                StageError::bad_input(format!("the field has no values at its own source frame {frame}"))
                    .with_hint("run the lift stage again with the source frames among its times")
            })?;
        let (mut cameras, mut images, mut depths_m) = (Vec::new(), Vec::new(), Vec::new());
        for view in field.views.iter().filter(|view| view.frame == frame) {
            let Some(image) = clip.observation(*view) else {
                return Err(StageError::bad_input(format!(
                    "source camera `{}` has no images in the clip",
                    clip.cameras[view.camera.at()].id
                )));
            };
            images.push(image.rgb().iter().map(|&value| f32::from(value) / 255.0).collect());
            depths_m.push(reference_depth(clip, *view));
            let camera = PosedCamera::of_clip(clip, robot, view.camera, frame)
                .map_err(|error| StageError::bad_input(error.to_string()))?;
            cameras.push(RasterCamera::new(
                &camera.in_frame(&recon_from_base),
                LengthUnit::Internal,
            ));
        }
        Ok(SourceTime {
            slice,
            cameras,
            images,
            depths_m,
        })
    };
    frames.into_iter().map(one).collect()
}

/// The reference depth of a source view, where there is any.
fn reference_depth(clip: &Clip, view: SourceView) -> Option<Vec<f32>> {
    let reference = clip.cameras.get(view.camera.at())?.depth.as_ref()?;
    let area = clip.height as usize * clip.width as usize;
    let [near, far] = reference.range_m;
    let depth = reference
        .depth_m
        .get(view.frame.at() * area..(view.frame.at() + 1) * area)?;
    Some(
        depth
            .iter()
            .map(|&z| if z > near && z < far { z } else { 0.0 })
            .collect(),
    )
}

/// Refuses records of different clips and sizes.
fn check(clip: &Clip, robot: &RobotMaps, field: &Field) -> StageResult<()> {
    let checked = field.check_beside(clip, robot);
    checked.map_err(|problem| StageError::bad_input(problem).with_hint("all inputs of a job must come from one clip"))
}
