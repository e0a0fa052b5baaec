//! From predictions of a clip to its numbers. Nothing here knows where the predictions come from: the stage's own
//! renders and those of outside methods are measured by the same code.

use rogs_schemas::records::clip::{CameraRole, Clip, ClipCamera, Target};
use rogs_schemas::records::robot::{RobotMap, RobotMaps};
use rogs_schemas::records::scores::{ImageScore, RobotDepthScore, TrackScore};
use rogs_schemas::{CameraIndex, FrameIndex};
use serde::{Deserialize, Serialize};

use crate::metrics::{
    DisplacementMap, MetricError, Pixels, RgbView, SsimVariant, TrackSample, depth_scores, depth_support, far_support,
    median_scale, psnr, robot_core, robot_depth_error, ssim, track_error_m,
};

/// Threshold of the robot's core.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RobotCore {
    /// Largest difference of reference and mesh depth, metres. The paper fixes one but does not publish it.
    pub tau_m: f64,
}

impl Default for RobotCore {
    fn default() -> Self {
        Self { tau_m: 0.03 }
    }
}

/// A predicted image, as far as the method has it.
#[derive(Debug, Clone, Copy, Default)]
pub struct PredictedImage<'a> {
    /// Colours in [0, 1]. `[H, W, 3]`
    pub rgb: Option<&'a [f32]>,
    /// Expected camera-z depth, metres, 0 where undefined. `[H, W]`
    pub depth_m: Option<&'a [f32]>,
}

/// What one predicted image gave.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredImage {
    /// Its scores; LPIPS is left to the caller.
    pub score: ImageScore,
    /// There is reference depth, but none of it in range.
    pub empty_support: bool,
    /// Predicted over reference depth, the median of the pixels that have both; `None` without any.
    pub depth_ratio: Option<f64>,
    /// Sum of absolute depth errors in metres and pixels of the robot's core; `None` for evaluation cameras and where
    /// reference depth, mesh or prediction is missing.
    pub core: Option<(f64, u64)>,
}

/// Measures the prediction of camera `camera` (an index into the clip's) at clip frame `frame`.
///
/// # Errors
/// When a buffer does not have the clip's image size.
pub fn measure_image(
    clip: &Clip,
    robot: &RobotMaps,
    camera: CameraIndex,
    frame: FrameIndex,
    prediction: &PredictedImage<'_>,
    variant: SsimVariant,
    core: RobotCore,
) -> Result<MeasuredImage, MetricError> {
    let (height, width) = (clip.height as usize, clip.width as usize);
    let view = &clip.cameras[camera.at()];
    let mut score = ImageScore {
        camera: view.id.clone(),
        source_view: view.role == CameraRole::Source,
        frame,
        psnr: None,
        ssim: None,
        lpips: None,
        absrel: None,
        rmse_m: None,
        delta1: None,
        absrel_scaled: None,
        far_absrel: None,
        support_n: 0,
    };
    if let (Some(predicted), Some(reference)) = (prediction.rgb, reference_rgb(clip, camera, frame)) {
        let predicted = RgbView::new(height, width, Pixels::Unit(predicted))?;
        let reference = RgbView::new(height, width, Pixels::Bytes(reference))?;
        score.psnr = Some(psnr(&predicted, &reference)?);
        score.ssim = Some(ssim(&predicted, &reference, variant)?);
    }
    let mut measured = MeasuredImage {
        score,
        empty_support: false,
        depth_ratio: None,
        core: None,
    };
    if let (Some(predicted), Some((reference, range_m))) = (prediction.depth_m, reference_depth(view, clip, frame)) {
        if predicted.len() != height * width {
            return Err(MetricError::BufferSize {
                height,
                width,
                expected: height * width,
                found: predicted.len(),
            });
        }
        measure_depth(&mut measured, predicted, reference, range_m);
        if view.role == CameraRole::Source
            && let Some(map) = robot_map(robot, camera, frame)
        {
            let support = depth_support(reference, range_m);
            let inside = robot_core(height, width, &map.link, &map.depth_m, reference, &support, core.tau_m);
            measured.core = Some(robot_depth_error(predicted, reference, &inside));
        }
    }
    Ok(measured)
}

fn measure_depth(measured: &mut MeasuredImage, predicted: &[f32], reference: &[f32], range_m: [f32; 2]) {
    let support = depth_support(reference, range_m);
    let Some(plain) = depth_scores(predicted, reference, &support, 1.0) else {
        measured.empty_support = true;
        return;
    };
    let score = &mut measured.score;
    score.absrel = Some(plain.absrel);
    score.rmse_m = Some(plain.rmse_m);
    score.delta1 = Some(plain.delta1);
    score.support_n = plain.count;
    let scale = median_scale(predicted, reference, &support);
    let has_both = |(predicted, supported): (&f32, &bool)| *supported && predicted.is_finite() && *predicted > 0.0;
    measured.depth_ratio = predicted.iter().zip(&support).any(has_both).then_some(1.0 / scale);
    score.absrel_scaled = depth_scores(predicted, reference, &support, scale).map(|scores| scores.absrel);
    let far = far_support(reference, &support);
    score.far_absrel = depth_scores(predicted, reference, &far, 1.0).map(|scores| scores.absrel);
}

/// Pools the cores of the source cameras at one time.
#[must_use]
pub fn pool_robot_depth<'a>(frame: FrameIndex, images: impl IntoIterator<Item = &'a MeasuredImage>) -> RobotDepthScore {
    let (mut sum, mut count) = (0.0, 0);
    for (error, pixels) in images.into_iter().filter_map(|image| image.core) {
        sum += error;
        count += pixels;
    }
    RobotDepthScore {
        frame,
        robot_depth_mm: (count > 0).then(|| 1000.0 * sum / count as f64),
        core_n: count,
    }
}

/// Valid robot tracks of a camera between the tracks' anchor time and `frame`: the anchor pixel is visible and lies on
/// the robot's mesh support at the anchor time, and the positions are finite at both times.
#[must_use]
pub fn robot_tracks(clip: &Clip, robot: &RobotMaps, camera: CameraIndex, frame: FrameIndex) -> Vec<TrackSample> {
    let Some(tracks) = &clip.tracks else { return Vec::new() };
    let Some(map) = robot_map(robot, camera, tracks.anchor_frame) else {
        return Vec::new();
    };
    let frames = clip.frame_count();
    let position = |track: usize, frame: FrameIndex| {
        let at = (track * frames + frame.at()) * 3;
        let point = tracks.position_m.get(at..at + 3)?;
        point
            .iter()
            .all(|value| value.is_finite())
            .then(|| [point[0], point[1], point[2]])
    };
    let sample = |track: usize| {
        let pixel = [tracks.pixel[track * 2], tracks.pixel[track * 2 + 1]];
        let at = pixel_index(pixel, clip.height, clip.width)?;
        let visible = tracks.visible.get(track * frames + tracks.anchor_frame.at()) == Some(&1);
        if !visible || map.support[at] == 0 {
            return None;
        }
        let anchor_m = position(track, tracks.anchor_frame)?;
        Some(TrackSample {
            pixel,
            anchor_m,
            query_m: position(track, frame)?,
        })
    };
    (0..tracks.camera.len())
        .filter(|&track| tracks.camera[track] == camera)
        .filter_map(sample)
        .collect()
}

/// The pixel nearest to a point with integer pixel centres; `None` outside of the image.
fn pixel_index(pixel: [f32; 2], height: u32, width: u32) -> Option<usize> {
    let column = (f64::from(pixel[0]) + 0.5).floor();
    let row = (f64::from(pixel[1]) + 0.5).floor();
    let inside = column >= 0.0 && row >= 0.0 && column < f64::from(width) && row < f64::from(height);
    inside.then(|| row as usize * width as usize + column as usize)
}

/// End-point error of rendered displacements from the anchor to `frame`, pooled over `(map, tracks)` of the cameras.
#[must_use]
pub fn measure_displacement(
    anchor: FrameIndex,
    frame: FrameIndex,
    views: &[(DisplacementMap<'_>, Vec<TrackSample>)],
) -> TrackScore {
    let (mut sum, mut count) = (0.0, 0u64);
    for (map, tracks) in views {
        for track in tracks {
            sum += track_error_m(map, track);
            count += 1;
        }
    }
    TrackScore {
        anchor,
        frame,
        epe_mm: (count > 0).then(|| 1000.0 * sum / count as f64),
        n_tracks: count,
    }
}

/// The reference image of a camera at a frame.
#[must_use]
pub fn reference_rgb(clip: &Clip, camera: CameraIndex, frame: FrameIndex) -> Option<&[u8]> {
    clip.target(camera, frame).map(Target::rgb)
}

/// Reference depth of a camera at a frame and its scored range, metres.
pub(crate) fn reference_depth<'a>(
    camera: &'a ClipCamera,
    clip: &Clip,
    frame: FrameIndex,
) -> Option<(&'a [f32], [f32; 2])> {
    let depth = camera.depth.as_ref()?;
    let size = clip.height as usize * clip.width as usize;
    let start = frame.at() * size;
    Some((depth.depth_m.get(start..start + size)?, depth.range_m))
}

/// The robot's map in a source camera at a frame.
fn robot_map(robot: &RobotMaps, camera: CameraIndex, frame: FrameIndex) -> Option<&RobotMap> {
    robot.maps.iter().find(|map| map.camera == camera && map.frame == frame)
}
