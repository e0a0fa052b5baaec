//! What the refinement knows of each source time: its views, cameras, observed images and their features.

use rogs_geometry::{Base, Pose, PosedCamera, Recon};
use rogs_schemas::records::clip::{Clip, time_of_frame};
use rogs_schemas::records::field::{Field, TimeSlice};
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::units::LengthUnit;
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_splat::RasterCamera;
use rogs_stage2::{FeatureMap, FeatureMaps, Refiner, TokenGrid};
use rogs_worker::{StageError, StageResult};

/// One source time of a clip.
pub(crate) struct SourceTime<'a> {
    /// Clip frame.
    pub(crate) frame: FrameIndex,
    /// The field at this time.
    pub(crate) slice: &'a TimeSlice,
    /// Tokens of the Gaussians that this time owns.
    pub(crate) grid: TokenGrid,
    /// Source cameras in the reconstruction frame, in the order of the grid's views.
    pub(crate) cameras: Vec<RasterCamera>,
    /// Observed images.
    pub(crate) observed: Vec<FeatureMap>,
    /// Their feature maps.
    pub(crate) maps: Vec<FeatureMaps>,
}

/// All source times of a field, ascending; the features of the observed images are computed here, once per clip.
///
/// # Errors
/// When the records do not belong together.
pub(crate) fn source_times<'a>(
    clip: &Clip,
    robot: &RobotMaps,
    field: &'a Field,
    refiner: &Refiner,
) -> StageResult<Vec<SourceTime<'a>>> {
    check(clip, robot, field)?;
    let mut frames: Vec<FrameIndex> = field.views.iter().map(|view| view.frame).collect();
    frames.sort_unstable();
    frames.dedup();
    frames
        .into_iter()
        .map(|frame| source_time(clip, robot, field, refiner, frame))
        .collect()
}

fn source_time<'a>(
    clip: &Clip,
    robot: &RobotMaps,
    field: &'a Field,
    refiner: &Refiner,
    frame: FrameIndex,
) -> StageResult<SourceTime<'a>> {
    let (height, width) = (field.height as usize, field.width as usize);
    let time = time_of_frame(frame, clip.frame_count());
    let slice = field.slice_at(time).ok_or_else(|| {
        StageError::bad_input(format!("the field has no values at its own source frame {frame}"))
            .with_hint("run the lift stage again with the source frames among its times")
    })?;
    let views: Vec<usize> = (0..field.views.len())
        .filter(|&view| field.views[view].frame == frame)
        .collect();
    let mut cameras = Vec::with_capacity(views.len());
    let mut observed = Vec::with_capacity(views.len());
    for &view in &views {
        let index = field.views[view].camera;
        let Some(image) = clip.observation(field.views[view]) else {
            return Err(StageError::bad_input(format!(
                "source camera `{}` has no images in the clip",
                clip.cameras[index.at()].id
            )));
        };
        let data = image.rgb().iter().map(|&value| f32::from(value) / 255.0).collect();
        observed.push(FeatureMap {
            height,
            width,
            channels: 3,
            data,
        });
        cameras.push(raster_camera(clip, robot, field, index, frame)?);
    }
    let maps = observed.iter().map(|image| refiner.encoder().feature_maps(image));
    let maps = maps
        .collect::<Result<_, _>>()
        .map_err(|error| StageError::bad_input(error.to_string()))?;
    let grid = TokenGrid::new(views, height, width, refiner.config()).map_err(|error| {
        StageError::bad_params(error.to_string()).with_hint("choose another preset, or other image sides at ingest")
    })?;
    Ok(SourceTime {
        frame,
        slice,
        grid,
        cameras,
        observed,
        maps,
    })
}

/// Refuses records of different clips and sizes.
fn check(clip: &Clip, robot: &RobotMaps, field: &Field) -> StageResult<()> {
    let checked = field.check_beside(clip, robot);
    checked.map_err(|problem| StageError::bad_input(problem).with_hint("all inputs of a job must come from one clip"))
}

/// A camera of the clip at a frame as the field is rendered from it.
pub(crate) fn raster_camera(
    clip: &Clip,
    robot: &RobotMaps,
    field: &Field,
    camera: CameraIndex,
    frame: FrameIndex,
) -> StageResult<RasterCamera> {
    let camera = PosedCamera::of_clip(clip, robot, camera, frame).map_err(bad_pose)?;
    let in_recon = camera.in_frame(&recon_from_base(field)?);
    Ok(RasterCamera::new(&in_recon, LengthUnit::Internal))
}

/// The base in the reconstruction frame of a field, metres.
pub(crate) fn recon_from_base(field: &Field) -> StageResult<Pose<Recon, Base>> {
    Pose::from_rigid(&field.recon_from_base).map_err(bad_pose)
}

pub(crate) fn bad_pose(error: rogs_geometry::Error) -> StageError {
    StageError::bad_input(error.to_string())
}
