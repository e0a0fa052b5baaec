//! FK conditioning maps kappa, stored sparse and lossless (`docs/spec/stage1.md` section 11).

use super::check::{Check, area, ascending_frames, binary, count, ensure, product};
use super::clip::SourceView;
use crate::ids::ClipId;
use crate::index::FrameIndex;

/// Channels of a dense conditioning map: support, mesh depth (m), FK displacement x, y, z (iu), availability, prior.
pub const KAPPA_CHANNELS: usize = 7;

/// Places of the planes of a dense conditioning map.
pub mod plane {
    /// 1 at valid robot support.
    pub const SUPPORT: usize = 0;
    /// Mesh depth, metres.
    pub const DEPTH: usize = 1;
    /// The first of the three planes of the FK displacement, internal units.
    pub const DISPLACEMENT: usize = 2;
    /// 1 where joint states and mesh exist.
    pub const AVAILABLE: usize = 5;
    /// Gripper-neighbourhood prior.
    pub const PRIOR: usize = 6;
}

/// Written by `conditioning`: everything from which kappa(t) of each source view and query time follows exactly.
#[derive(Debug, Clone, PartialEq)]
pub struct Conditioning {
    /// The clip this belongs to.
    pub clip_id: ClipId,
    /// Map height, pixels.
    pub height: u32,
    /// Map width, pixels.
    pub width: u32,
    /// Source views in token order. `[S]`
    pub views: Vec<SourceView>,
    /// Clip frames for which displacements are stored, ascending (see `Clip::field_frames`). `[Q]`
    pub query_frames: Vec<FrameIndex>,
    /// Per source view. `[S]`
    pub view_maps: Vec<ViewConditioning>,
}

/// The conditioning of one source view.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewConditioning {
    /// Row-major pixel indices of valid robot support, ascending. `[M]`
    pub pixels: Vec<u32>,
    /// Link id of each supported pixel. `[M]`
    pub link: Vec<u8>,
    /// Mesh depth (camera z) at each supported pixel, metres. `[M]`
    pub depth_m: Vec<f32>,
    /// FK displacement from the view's time to each query frame, reconstruction frame, INTERNAL units. `[Q, M, 3]`
    pub displacement_iu: Vec<f32>,
    /// 1 where joint states and mesh exist for the source and the query time. `[Q]`
    pub available: Vec<u8>,
    /// Gripper-neighbourhood prior of this view.
    pub prior: GripperPrior,
}

/// The gripper-neighbourhood prior: a Gaussian around the projected tool centre. Kept as its parameters, because the
/// dense map follows from them exactly.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct GripperPrior {
    /// Tool centre in pixels, `(u, v)`, pixel centres at + 0.5.
    pub centre_px: [f64; 2],
    /// Camera-z depth of the tool centre, metres; the prior is 0 everywhere when it is <= 0.01.
    pub depth_m: f64,
    /// Focal lengths in pixels.
    pub focal_px: [f64; 2],
    /// Standard deviation, metres in the image plane at the tool's depth.
    pub sigma_m: f64,
}

impl GripperPrior {
    /// The prior at pixel `(column, row)`, in 0..=1.
    #[must_use]
    pub fn at(&self, column: u32, row: u32) -> f32 {
        if self.depth_m <= 0.01 {
            return 0.0;
        }
        let dx = (f64::from(column) + 0.5 - self.centre_px[0]) * self.depth_m / self.focal_px[0];
        let dy = (f64::from(row) + 0.5 - self.centre_px[1]) * self.depth_m / self.focal_px[1];
        libm::exp(-0.5 * (dx * dx + dy * dy) / (self.sigma_m * self.sigma_m)) as f32
    }
}

impl Conditioning {
    /// The dense map of view `view` at stored query index `query`, planar. `[KAPPA_CHANNELS, H, W]`
    #[must_use]
    pub fn dense(&self, view: usize, query: usize) -> Vec<f32> {
        let area = (self.height * self.width) as usize;
        let maps = &self.view_maps[view];
        let mut dense = vec![0.0f32; KAPPA_CHANNELS * area];
        let count = maps.pixels.len();
        let displacement = &maps.displacement_iu[query * count * 3..(query + 1) * count * 3];
        for (index, &pixel) in maps.pixels.iter().enumerate() {
            let pixel = pixel as usize;
            dense[plane::SUPPORT * area + pixel] = 1.0;
            dense[plane::DEPTH * area + pixel] = maps.depth_m[index];
            for axis in 0..3 {
                dense[(plane::DISPLACEMENT + axis) * area + pixel] = displacement[index * 3 + axis];
            }
        }
        dense[plane::AVAILABLE * area..][..area].fill(f32::from(maps.available[query]));
        for row in 0..self.height {
            for column in 0..self.width {
                dense[plane::PRIOR * area + (row * self.width + column) as usize] = maps.prior.at(column, row);
            }
        }
        dense
    }
}

impl Conditioning {
    /// The arrays agree with the counts, and every number is possible.
    ///
    /// # Errors
    /// What contradicts what, in words.
    pub fn check(&self) -> Check {
        let area = area(self.height, self.width)?;
        let queries = self.query_frames.len();
        ascending_frames("query frames", &self.query_frames, usize::MAX)?;
        count("view maps", self.view_maps.len(), self.views.len())?;
        for (number, view) in self.view_maps.iter().enumerate() {
            let here = |what: String| format!("view {number}: {what}");
            let ViewConditioning {
                pixels,
                link,
                depth_m,
                displacement_iu,
                available,
                prior: _,
            } = view;
            let support = pixels.len();
            let inside = pixels.is_sorted_by(|a, b| a < b) && pixels.last().is_none_or(|&last| (last as usize) < area);
            ensure(inside, || here(format!("pixels do not ascend below {area}")))?;
            count("link ids", link.len(), support).map_err(here)?;
            count("mesh depth", depth_m.len(), support).map_err(here)?;
            count(
                "displacements",
                displacement_iu.len(),
                product("displacements", &[queries, support, 3])?,
            )
            .map_err(here)?;
            count("availability", available.len(), queries).map_err(here)?;
            binary("availability", available).map_err(here)?;
            let finite = |values: &[f32]| values.iter().all(|value| value.is_finite());
            ensure(finite(depth_m) && finite(displacement_iu), || {
                here("a depth or displacement is not finite".into())
            })?;
        }
        Ok(())
    }
}
