//! Held-out clips before and after refinement.

use rogs_field::TimedField;
use rogs_geometry::{Pose, PosedCamera, Recon};
use rogs_schemas::records::clip::{Clip, Target, time_of_frame};
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::units::LengthUnit;
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_splat::{RasterCamera, RasterConfig, render};

use super::lifted::LiftedClip;
use crate::error::Result;
use crate::picture::{Canvas, Picture};
use crate::plan::SOURCE_CAMERAS;

/// A view of the field after some updates, RGB in 0..1. `[A, 3]`
pub(super) fn view(
    lifted: &LiftedClip,
    refinement: &Refinement,
    updates: u32,
    frame: FrameIndex,
    camera: CameraIndex,
) -> Result<Vec<f32>> {
    let LiftedClip { records, field, .. } = lifted;
    let timed = TimedField::new(field)?;
    let timed = match refinement.steps.iter().find(|step| step.update == updates) {
        Some(step) => timed.with_correction(step, refinement.scale_residual)?,
        None => timed,
    };
    let frames = records.clip.frame_count();
    let scene = timed.gaussians(time_of_frame(frame, frames))?;
    let recon_from_base = Pose::from_rigid(&records.robot.recon_from_base)?;
    let posed = PosedCamera::of_clip(&records.clip, &records.robot, camera, frame)?;
    let posed: PosedCamera<Recon> = posed.in_frame(&recon_from_base);
    let camera = RasterCamera::new(&posed, LengthUnit::Internal);
    Ok(render(&scene, &camera, &RasterConfig::default())?.rgb)
}

/// What a camera saw, RGB in 0..1; empty where it saw nothing. `[A, 3]`
pub(super) fn seen(clip: &Clip, frame: FrameIndex, camera: CameraIndex) -> Vec<f32> {
    let image = clip.target(camera, frame).map_or(&[][..], Target::rgb);
    image.iter().map(|&value| f32::from(value) / 255.0).collect()
}

/// Rows: seen, Stage 1, refined; columns: the source cameras.
pub(super) fn picture(
    lifted: &LiftedClip,
    refinement: &Refinement,
    updates: u32,
    frame: FrameIndex,
) -> Result<Picture> {
    let clip = &lifted.records.clip;
    let mut picture = Canvas::new([clip.height as usize, clip.width as usize], [3, SOURCE_CAMERAS]);
    for camera in CameraIndex::first(SOURCE_CAMERAS) {
        let images = [
            seen(clip, frame, camera),
            view(lifted, refinement, 0, frame, camera)?,
            view(lifted, refinement, updates, frame, camera)?,
        ];
        for (row, image) in images.iter().enumerate() {
            picture.paint([row, camera.at()], |pixel, channel| image[3 * pixel + channel]);
        }
    }
    Ok(picture.finish())
}
