//! How well the observations agree with each other through a field (`docs/spec/scoring.md` section 14).

use rogs_schemas::records::clip::SourceView;
use rogs_schemas::records::scores::CrossViewScore;
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_splat::{RasterConfig, Render};
use rogs_worker::StageResult;

use crate::metrics::PSNR_CEILING_DB;
use crate::render::{FieldSource, Predictions, Scene, splat_error};

/// The others show a pixel where their accumulated opacity reaches this.
const SHOWN: f32 = 0.5;
/// Where they show a smaller share of the image, nothing is compared.
const LEAST_SHOWN: f64 = 0.05;

impl Scene<'_> {
    /// The observation of every source camera at a frame against the field without the Gaussians of its own pixels. Empty
    /// for fields whose Gaussians are no pixels, for fields of one camera, and where there are no observations.
    pub(crate) fn cross_views(&self, frame: FrameIndex) -> StageResult<Vec<CrossViewScore>> {
        let Predictions::Field(source @ FieldSource::Own { field, .. }) = &self.predictions else {
            return Ok(Vec::new());
        };
        let gaussians = self.gaussians(source, frame)?;
        let owners: Vec<CameraIndex> = (0..gaussians.len()).map(|n| field.source_camera(n)).collect();
        let mut scores = Vec::new();
        for camera in self.clip.source_cameras() {
            let Some(observed) = self.clip.observation(SourceView { camera, frame }) else {
                continue;
            };
            let others: Vec<bool> = owners.iter().map(|owner| *owner != camera).collect();
            if others.iter().all(|other| *other) || !others.contains(&true) {
                continue;
            }
            let view = self.camera(source, camera, frame)?;
            let render =
                rogs_splat::render(&gaussians.kept(&others), &view, &RasterConfig::default()).map_err(splat_error)?;
            let (psnr, shown) = compare(&render, observed.rgb());
            scores.push(CrossViewScore {
                camera: self.clip.cameras[camera.at()].id.clone(),
                frame,
                psnr,
                shown,
            });
        }
        Ok(scores)
    }
}

/// PSNR of the colours over accumulated opacity, over the pixels that are shown, and their share. `observed [H, W, 3]`
fn compare(render: &Render, observed: &[u8]) -> (Option<f64>, f64) {
    let pixels = render.rgb.chunks_exact(3).zip(observed.chunks_exact(3));
    let (mut squares, mut shown) = (0.0, 0u64);
    for ((own, observed), &alpha) in pixels.zip(&render.alpha) {
        if !(alpha >= SHOWN && own.iter().all(|value| value.is_finite())) {
            continue;
        }
        shown += 1;
        for (own, observed) in own.iter().zip(observed) {
            let off = f64::from((own / alpha).clamp(0.0, 1.0)) - f64::from(*observed) / 255.0;
            squares += off * off;
        }
    }
    let share = shown as f64 / render.alpha.len().max(1) as f64;
    let mean = squares / (3 * shown.max(1)) as f64;
    let psnr = (share >= LEAST_SHOWN).then(|| (-10.0 * libm::log10(mean)).min(PSNR_CEILING_DB));
    (psnr, share)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn render(alpha: Vec<f32>, rgb: Vec<f32>) -> Render {
        Render {
            width: alpha.len(),
            height: 1,
            extra_channels: 0,
            depth_accumulated: vec![0.0; alpha.len()],
            depth_expected: vec![0.0; alpha.len()],
            extra_accumulated: Vec::new(),
            extra: Vec::new(),
            counts: rogs_splat::Counts::default(),
            rgb,
            alpha,
        }
    }

    #[test]
    fn only_what_the_others_show_is_compared() {
        // Two pixels of four: one as it is, one off by 0.1 in every channel; the others are not shown.
        let drawn = render(
            vec![1.0, 0.8, 0.4, 0.0],
            vec![0.4, 0.4, 0.4, 0.4, 0.4, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        );
        let observed = [[102u8; 3], [102; 3], [255; 3], [255; 3]].concat();
        let (psnr, shown) = compare(&drawn, &observed);
        assert_eq!(shown, 0.5);
        assert!(
            (psnr.unwrap() - -10.0 * f64::log10(0.5 * 0.01)).abs() < 1e-4,
            "{psnr:?}"
        );
        let (psnr, _) = compare(&render(vec![1.0; 4], vec![1.0; 12]), &[255; 12]);
        assert_eq!(psnr, Some(PSNR_CEILING_DB));
    }

    #[test]
    fn a_field_of_which_nothing_is_seen_has_no_number() {
        let (psnr, shown) = compare(&render(vec![0.0; 100], vec![0.0; 300]), &[9; 300]);
        assert_eq!((psnr, shown), (None, 0.0));
    }
}
