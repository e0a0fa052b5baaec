//! The convolutional stem of small configurations: what a pixel's neighbourhood looks like, for tokens and for heads.
//!
//! The released network has a pretrained encoder behind its 14-pixel patches. A small network that starts from nothing
//! learns to read patches late, and its heads never see an edge; a few convolutions on colours and ray directions give
//! both a start. In between, a frame may be compared with other cameras ([`sweep`]). `full` has no stem.

use burn::tensor::Tensor;

use super::config::Stage1Config;
use super::frames::{SourceFrames, normalised};
use super::geometry::ray_maps;
use super::pyramid::{Pyramid, cells, two_layers};
use super::sweep;
use crate::{Error, Result};
use rogs_tensors::ops::{self, Linear};
use rogs_tensors::parameters::Scope;

/// Channels of an image.
pub(super) const COLOURS: usize = 3;
/// Colours, and the six channels of the ray map.
pub const INPUTS: usize = COLOURS + 6;
/// Levels whose features reach the tokens.
pub const TOKEN_LEVELS: [usize; 2] = [2, 3];

/// What a stem says about the frames of a clip.
#[derive(Debug, Clone)]
pub struct StemFeatures {
    /// Its features.
    pub levels: Pyramid,
    /// What the sweep finds; `None` without one, or where no frame has company.
    pub sweep: Option<sweep::SweptDepth>,
}

impl StemFeatures {
    /// The same for some frames.
    #[must_use]
    pub fn frames_at(&self, start: usize, count: usize) -> Self {
        let narrow = |map: Tensor<4>| map.narrow(0, start, count);
        Self {
            levels: self.levels.clone().map(narrow),
            sweep: self.sweep.as_ref().map(|found| found.frames_at(start, count)),
        }
    }
}

/// The stem over a scope of parameters (`stem`).
pub struct Stem<'a> {
    scope: Scope<'a>,
    config: &'a Stage1Config,
}

impl<'a> Stem<'a> {
    /// The stem of a scope.
    #[must_use]
    pub fn new(scope: Scope<'a>, config: &'a Stage1Config) -> Self {
        Self { scope, config }
    }

    /// What it says about the frames' images.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape, or the frames do not fit together.
    pub fn features(&self, frames: &SourceFrames) -> Result<StemFeatures> {
        let sweep = self.sweep(frames)?;
        let SourceFrames { images, cameras, .. } = frames;
        let [_, _, height, width] = images.dims();
        let rays = ray_maps(cameras, [height, width], self.scope.device());
        let first = self.level(0, Tensor::cat(vec![normalised(images.clone()), rays], 1))?;
        let second = self.level(1, first.clone())?;
        let second = match &sweep {
            Some(found) => self.sweeping().join(second, found)?,
            None => second,
        };
        let third = self.level(2, second.clone())?;
        let fourth = self.level(3, third.clone())?;
        Ok(StemFeatures {
            levels: [first, second, third, fourth],
            sweep,
        })
    }

    /// What the sweep finds; `None` without one, or where no frame has company.
    ///
    /// # Errors
    /// As [`Self::features`].
    pub fn sweep(&self, frames: &SourceFrames) -> Result<Option<sweep::SweptDepth>> {
        let (images, poses) = (frames.images.dims()[0], frames.cameras.len());
        if poses != images {
            return Err(Error::BadInput(format!("{images} images come with {poses} cameras")));
        }
        self.sweeping().find(frames)
    }

    fn sweeping(&self) -> sweep::Sweeping<'a> {
        sweep::Sweeping::new(self.scope.child("sweep"), self.config)
    }

    /// Two convolutions on the cells of a map. `[S, c', h, w] -> [S, c, h / 2, w / 2]`, sizes rounded up
    fn level(&self, level: usize, map: Tensor<4>) -> Result<Tensor<4>> {
        let scope = self.scope.child(format_args!("levels.{level}"));
        two_layers(&scope, cells(map), self.config.stem_channels[level])
    }

    /// What the features add to the patch tokens of a grid. `4 x [S, c, h, w] -> [S, N, C]`
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn tokens(&self, features: &Pyramid, grid: [usize; 2]) -> Result<Tensor<3>> {
        let maps = TOKEN_LEVELS.map(|level| ops::resize(features[level].clone(), grid));
        let joined = Tensor::cat(maps.to_vec(), 1);
        let [frames, channels, rows, columns] = joined.dims();
        let rows = joined.reshape([frames, channels, rows * columns]).swap_dims(1, 2);
        Ok(Linear::load(&self.scope.child("tokens"), self.config.width, channels)?.forward(rows))
    }
}
