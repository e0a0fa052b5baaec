//! What is known of one camera before its optimisation: images, poses, masks, depth in metres, tracks
//! (`docs/spec/baseline-som.md` sections 1 and 2).

use rogs_geometry::{Base, Camera, Pinhole, Pose, PosedCamera};
use rogs_optimise::depth_maps::{aligned_depth, median_filter};
use rogs_optimise::masks::{Side, sides};
use rogs_optimise::statistics::lower_median;
use rogs_schemas::records::clip::{Clip, SourceView};
use rogs_schemas::records::robot::{NO_LINK, RobotMaps};
use rogs_schemas::units::LengthUnit;
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_splat::RasterCamera;
use rogs_worker::{StageError, StageResult};

use crate::params::LiftSomParams;
use crate::sidecars::Sidecars;

/// Side of the median filter of depth, pixels.
const MEDIAN_SIDE: usize = 11;
/// Smallest side of an image: the windows of the structural similarity and of the median filter.
const LEAST_SIDE: u32 = 11;

/// Fewest frames: smoothness is taken of three.
const LEAST_FRAMES: usize = 3;

/// One frame of a camera.
pub(crate) struct ObservedFrame {
    /// Where the camera stands, metres.
    pub(crate) base_from_camera: Pose<Base, Camera>,
    /// The same for the rasteriser, metres.
    pub(crate) raster: RasterCamera,
    /// 0 to 1. `[H, W, 3]`
    pub(crate) image: Vec<f32>,
    /// The same with a white band.
    pub(crate) target: Vec<f32>,
    /// `[H, W]`
    pub(crate) sides: Vec<Side>,
    /// 1 in the foreground, 0 elsewhere. `[H, W]`
    pub(crate) mask: Vec<f32>,
    /// Aligned and filtered, metres. `[H, W]`
    pub(crate) depth_m: Vec<f32>,
}

impl ObservedFrame {
    /// An image whose band is white. `[H, W, 3]`
    pub(crate) fn painted(&self, rgb: &[f32]) -> Vec<f32> {
        painted(rgb, &self.sides)
    }
}

fn painted(rgb: &[f32], sides: &[Side]) -> Vec<f32> {
    let pixel = |(pixel, side): (&[f32], &Side)| match side {
        Side::Band => [1.0; 3],
        Side::Foreground | Side::Background => [pixel[0], pixel[1], pixel[2]],
    };
    rgb.chunks_exact(3).zip(sides).flat_map(pixel).collect()
}

/// One camera.
pub(crate) struct Observed {
    pub(crate) id: String,
    pub(crate) height: usize,
    pub(crate) width: usize,
    /// Image points of places as the published code takes them: nothing is added to integer pixel centres.
    pub(crate) lens: Pinhole,
    pub(crate) frames: Vec<ObservedFrame>,
    /// `[T]` of `[N, T, 4]`
    pub(crate) tracks: Vec<Vec<f32>>,
    /// What brings the metric depth of the sidecar to metres.
    pub(crate) factor: f64,
}

impl Observed {
    /// Puts together what a camera saw and what others estimated from it.
    ///
    /// # Errors
    /// When an image, a mask, a pose or stereo depth is missing, or the robot is in no frame; with the camera's name.
    pub(crate) fn new(
        clip: &Clip,
        robot: &RobotMaps,
        camera: CameraIndex,
        sidecars: Sidecars,
        params: &LiftSomParams,
    ) -> StageResult<Self> {
        let id = clip.cameras[camera.at()].id.clone();
        let (height, width) = (clip.height as usize, clip.width as usize);
        if clip.height < LEAST_SIDE || clip.width < LEAST_SIDE {
            return Err(StageError::bad_input(format!(
                "images of {width}x{height} pixels are too small: expected at least {LEAST_SIDE}x{LEAST_SIDE}"
            )));
        }
        if clip.frame_count() < LEAST_FRAMES {
            return Err(StageError::bad_input(format!(
                "a clip of {} frames is too short for Shape of Motion: expected at least {LEAST_FRAMES}",
                clip.frame_count()
            )));
        }
        let factor = stereo_factor(clip, camera, &sidecars.metric_m)?;
        let mut lens = None;
        let mut frames = Vec::with_capacity(clip.frame_count());
        for frame in FrameIndex::first(clip.frame_count()) {
            let image = clip.observation(SourceView { camera, frame }).ok_or_else(|| {
                StageError::bad_input(format!("there is no image of camera `{id}` at clip frame {frame}"))
                    .with_hint("Shape of Motion takes all frames of a clip")
            })?;
            let posed = PosedCamera::of_clip(clip, robot, camera, frame)
                .map_err(|error| StageError::bad_input(error.to_string()))?;
            let map = robot.maps.iter().find(|map| map.camera == camera && map.frame == frame);
            let map = map.ok_or_else(|| {
                StageError::bad_input(format!("there is no robot map of camera `{id}` at clip frame {frame}"))
            })?;
            let inside: Vec<bool> = map.link.iter().map(|&link| link != NO_LINK).collect();
            let (erode, dilate) = (params.erode_px as usize, params.dilate_px as usize);
            let sides = sides(&inside, height, width, erode, dilate).map_err(crate::internal)?;
            let metric: Vec<f32> = sidecars.metric_m[frame.at()]
                .iter()
                .map(|&depth| (f64::from(depth) * factor) as f32)
                .collect();
            let aligned = aligned_depth(&sidecars.relative[frame.at()], &metric).map_err(crate::internal)?;
            let image: Vec<f32> = image.rgb().iter().map(|&value| f32::from(value) / 255.0).collect();
            frames.push(ObservedFrame {
                target: painted(&image, &sides),
                raster: RasterCamera::new(&posed, LengthUnit::Metre),
                base_from_camera: posed.world_from_camera,
                image,
                mask: sides
                    .iter()
                    .map(|&side| if side == Side::Foreground { 1.0 } else { 0.0 })
                    .collect(),
                sides,
                depth_m: median_filter(&aligned, height, width, MEDIAN_SIDE).map_err(crate::internal)?,
            });
            lens = Some(posed.lens);
        }
        let lens = lens.ok_or_else(|| StageError::bad_input("the clip has no frames"))?;
        if frames.iter().all(|frame| !frame.sides.contains(&Side::Foreground)) {
            return Err(StageError::bad_input(format!(
                "the foreground mask of camera `{id}` is empty: at no frame is a pixel more than {} pixels inside the robot",
                params.erode_px
            ))
            .with_hint("Shape of Motion has no field of a camera that does not see the robot; the clip counts as failed"));
        }
        Ok(Self {
            id,
            height,
            width,
            lens,
            frames,
            tracks: sidecars.tracks,
            factor,
        })
    }

    /// Number of frames.
    pub(crate) fn len(&self) -> usize {
        self.frames.len()
    }
}

/// Median over the source times of stereo depth over metric depth, where stereo depth is in its range.
fn stereo_factor(clip: &Clip, camera: CameraIndex, metric_m: &[Vec<f32>]) -> StageResult<f64> {
    let camera = &clip.cameras[camera.at()];
    let missing = |what: &str| {
        StageError::bad_input(format!(
            "Shape of Motion needs stereo depth of camera `{}`: {what}",
            camera.id
        ))
        .with_hint(
            "it takes one factor per camera from the depth at the source frames: `[references]` in the manifest makes some \
             from cameras with a right eye (docs/references.md)",
        )
    };
    let depth = camera.depth.as_ref().ok_or_else(|| missing("the clip has none"))?;
    let area = (clip.height * clip.width) as usize;
    let [near, far] = depth.range_m;
    let mut ratios = Vec::new();
    for frame in &clip.source_frames {
        let stored = depth.depth_m.get(frame.at() * area..(frame.at() + 1) * area);
        let stored = stored.ok_or_else(|| missing("its maps are too few"))?;
        let pairs = stored.iter().zip(&metric_m[frame.at()]);
        let valid = pairs.filter(|(stereo, metric)| **stereo > near && **stereo < far && **metric > 0.0);
        ratios.extend(valid.map(|(&stereo, &metric)| f64::from(stereo) / f64::from(metric)));
    }
    lower_median(&ratios).ok_or_else(|| missing("no pixel of its source frames has a valid depth"))
}
