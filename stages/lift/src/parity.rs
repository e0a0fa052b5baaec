//! Render parity of camera-wise fields: a camera must see the same of its field in its own frame and unit, where the network
//! made it, as in the world, where it is joined with the others (paper, appendix on coverage: an audit that excludes
//! nothing).

use rogs_field::TimedField;
use rogs_geometry::{Pose, PosedCamera, Recon};
use rogs_schemas::records::field::{Field, TimeSlice};
use rogs_schemas::units::{LengthUnit, UNITS_PER_METRE};
use rogs_splat::{RasterCamera, RasterConfig};
use rogs_worker::{StageError, StageResult};

use crate::lifting::Base;
use crate::source::{Source, View};

/// Renders of less parity are told, dB of PSNR. In a field of random weights at 28x42 pixels up to an eighth of the values
/// changed, some by 0.12, which leaves 43.1 dB, while all others agreed to 1e-5. Probably rounding decides which of two
/// Gaussians at the same depth is in front; that was not proved.
const EXPECTED_DB: f64 = 40.0;

/// What a camera sees from one of its views: colours in 0 to 1. `[H, W, 3]`
pub(crate) fn seen(source: &Source<'_>, base: &Base, slice: &TimeSlice, view: &View<'_>) -> StageResult<Vec<f32>> {
    let field = Field {
        clip_id: source.clip.clip_id.clone(),
        frame_count: source.clip.frame_count() as u32,
        height: source.clip.height,
        width: source.clip.width,
        views: source.views.iter().map(|view| view.view).collect(),
        recon_from_base: source.robot.recon_from_base,
        weights: rogs_schemas::records::field::WeightsInfo {
            trained: false,
            configuration: String::new(),
            description: String::new(),
            hash: String::new(),
        },
        position_m: base.position_m.clone(),
        base_raw: base.raw.clone(),
        support: base.support.clone(),
        link: base.link.clone(),
        scale_cap_iu: base.scale_cap_iu.clone(),
        slices: vec![slice.clone()],
        query_state: Vec::new(),
    };
    let failed = |error: &dyn std::fmt::Display| StageError::internal(format!("render parity: {error}"));
    let timed = TimedField::new(&field).map_err(|error| failed(&error))?;
    let gaussians = timed.gaussians(slice.time).map_err(|error| failed(&error))?;
    let pose = &view.camera.world_from_camera_iu;
    let pose: Pose<Recon, _> = Pose::new(pose.rotation, pose.translation / UNITS_PER_METRE);
    let camera = RasterCamera::new(&PosedCamera::new(view.lens, pose), LengthUnit::Internal);
    let render = rogs_splat::render(&gaussians, &camera, &RasterConfig::default()).map_err(|error| failed(&error))?;
    Ok(render.rgb)
}

/// What a person should know where a camera sees its field in the world otherwise than in its own frame.
pub(crate) fn warning(camera: &str, own: &[f32], world: &[f32]) -> Option<String> {
    let parity = parity_db(own, world);
    // NaN is no parity.
    let differs = parity.is_nan() || parity < EXPECTED_DB;
    differs.then(|| {
        format!(
            "camera `{camera}` sees its field in the world otherwise than in its own frame and unit: {parity:.1} dB of PSNR \
             between the renders, expected are {EXPECTED_DB} or more"
        )
    })
}

/// How far two renders are the same, dB of PSNR; infinite where they are equal.
fn parity_db(own: &[f32], world: &[f32]) -> f64 {
    let square = |(a, b): (&f32, &f32)| (f64::from(*a) - f64::from(*b)).powi(2);
    let error = own.iter().zip(world).map(square).sum::<f64>() / own.len().max(1) as f64;
    -10.0 * libm::log10(error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn renders_that_differ_are_told() {
        let own = vec![0.5f32; 300];
        let shifted = |by: f32| own.iter().map(|value| value + by).collect::<Vec<f32>>();
        assert_eq!(parity_db(&own, &own), f64::INFINITY);
        assert!((parity_db(&own, &shifted(0.1)) - 20.0).abs() < 1e-3);
        assert!(warning("ext1", &own, &shifted(0.003)).is_none());
        let told = warning("ext1", &own, &shifted(0.1)).unwrap();
        assert!(told.contains("`ext1`") && told.contains("20.0 dB"), "{told}");
        assert!(warning("ext1", &own, &shifted(f32::NAN)).is_some());
    }
}
