//! Pixels of source views whose motion tracks tell.

use glam::DVec3;
use rogs_geometry::{Base, Pose, PosedCamera, Recon};
use rogs_schemas::records::clip::{Clip, SourceView, Tracks};
use rogs_schemas::units::UNITS_PER_METRE;
use rogs_schemas::{CameraIndex, FrameIndex};

use crate::error::Result;

/// The pixels of a clip's source views that tracks go through.
pub(super) struct Tracked {
    pub(super) pixels: Vec<KnownPixel>,
}

/// A pixel with a track.
pub(super) struct KnownPixel {
    /// Index of the source view.
    pub(super) view: usize,
    pub(super) pixel: usize,
    /// Displacement to each frame, reconstruction frame, internal units; not finite where unknown. `[F]`
    displacement_iu: Vec<[f32; 3]>,
}

impl KnownPixel {
    /// Where the point has gone at a frame, where that is known.
    pub(super) fn moved(&self, frame: FrameIndex) -> Option<[f32; 3]> {
        let moved = *self.displacement_iu.get(frame.at())?;
        moved.iter().all(|value| value.is_finite()).then_some(moved)
    }
}

impl Tracked {
    /// The pixels in which cameras see points of their tracks at source times. A pixel counts at all query times of the clip
    /// or at none.
    pub(super) fn of(
        clip: &Clip,
        tracks: &Tracks,
        views: &[SourceView],
        recon_from_base: &Pose<Recon, Base>,
        posed: &dyn Fn(CameraIndex, FrameIndex) -> Result<PosedCamera<Recon>>,
    ) -> Result<Self> {
        let frames = clip.frame_count();
        let [height, width] = [clip.height, clip.width].map(|side| side as usize);
        let mut pixels = Vec::new();
        for (index, view) in views.iter().enumerate() {
            let camera = posed(view.camera, view.frame)?;
            let camera_from_recon = camera.world_from_camera.inverse();
            for (track, &its) in tracks.camera.iter().enumerate() {
                let seen = tracks.visible.get(track * frames + view.frame.at());
                if its != view.camera || seen.is_none_or(|&seen| seen == 0) {
                    continue;
                }
                let positions = &tracks.position_m[3 * frames * track..][..3 * frames];
                let at = |frame: usize| {
                    let place = [0, 1, 2].map(|axis: usize| f64::from(positions[3 * frame + axis]));
                    recon_from_base.point(DVec3::from_array(place))
                };
                let here = at(view.frame.at());
                let Some((place, _)) = camera.lens.project(camera_from_recon.point(here)) else {
                    continue;
                };
                let inside = (0.0..width as f64).contains(&place.x) && (0.0..height as f64).contains(&place.y);
                if !here.is_finite() || !inside {
                    continue;
                }
                let moved = |frame| ((at(frame) - here) * UNITS_PER_METRE).as_vec3().to_array();
                let known = KnownPixel {
                    view: index,
                    pixel: place.y as usize * width + place.x as usize,
                    displacement_iu: (0..frames).map(moved).collect(),
                };
                if clip.query_frames.iter().all(|&frame| known.moved(frame).is_some()) {
                    pixels.push(known);
                }
            }
        }
        Ok(Self { pixels })
    }
}
