//! The convolutional stem of small configurations: what a pixel's neighbourhood looks like, for tokens and for heads.
//!
//! The released network has a pretrained encoder behind its 14-pixel patches. A small network that starts from nothing
//! learns to read patches late, and its heads never see an edge; a few convolutions on colours and ray directions give
//! both a start. In between, a frame may be compared with other cameras ([`sweep`]). `full` has no stem.

use burn::tensor::Tensor;

use super::config::Stage1Config;
use super::encoder::normalised;
use super::geometry::ray_maps;
use super::network::SourceFrames;
use super::sweep;
use crate::ops::{self, Conv, Linear};
use crate::parameters::Scope;
use crate::{Error, Result};

/// Side of the cells that a level of the stem sees as one pixel.
pub const CELL: usize = 2;
/// Channels of an image.
pub(super) const COLOURS: usize = 3;
/// Colours, and the six channels of the ray map.
pub const INPUTS: usize = COLOURS + 6;
/// Levels whose features reach the tokens.
pub const TOKEN_LEVELS: [usize; 2] = [2, 3];

/// Features of the stem at a half, a quarter, an eighth and a sixteenth of the image size. `4 x [S, c, h, w]`
pub type Pyramid = [Tensor<4>; 4];

/// What a stem says about the frames of a clip.
#[derive(Debug, Clone)]
pub struct Local {
    /// Its features.
    pub levels: Pyramid,
    /// What the sweep finds; `None` without one, or where no frame has company.
    pub sweep: Option<sweep::Found>,
}

impl Local {
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
    pub fn features(&self, frames: &SourceFrames) -> Result<Local> {
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
        Ok(Local {
            levels: [first, second, third, fourth],
            sweep,
        })
    }

    /// What the sweep finds; `None` without one, or where no frame has company.
    ///
    /// # Errors
    /// As [`Self::features`].
    pub fn sweep(&self, frames: &SourceFrames) -> Result<Option<sweep::Found>> {
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

/// Two rectified convolutions. `[S, c', h, w] -> [S, c, h, w]`
pub(super) fn two_layers(scope: &Scope<'_>, map: Tensor<4>, outputs: usize) -> Result<Tensor<4>> {
    let inputs = map.dims()[1];
    let first = Conv::load(&scope.child("conv1"), [outputs, inputs], 3, 1)?.forward(map);
    let second = Conv::load(&scope.child("conv2"), [outputs; 2], 3, 1)?.forward(ops::relu(first));
    Ok(ops::relu(second))
}

/// The pixels of every cell as channels; a last row or column without a partner is doubled.
/// `[S, c, h, w] -> [S, c * CELL^2, h / CELL, w / CELL]`, sizes rounded up
pub(super) fn cells(map: Tensor<4>) -> Tensor<4> {
    let mut map = map;
    for axis in [2, 3] {
        let size = map.dims()[axis];
        if !size.is_multiple_of(CELL) {
            map = Tensor::cat(vec![map.clone(), map.narrow(axis, size - 1, 1)], axis);
        }
    }
    let [frames, channels, height, width] = map.dims();
    let (rows, columns) = (height / CELL, width / CELL);
    map.reshape([frames, channels, rows, CELL, columns, CELL])
        .permute([0, 1, 3, 5, 2, 4])
        .reshape([frames, channels * CELL * CELL, rows, columns])
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;
    use crate::parameters::{from_host, to_host};

    #[test]
    fn an_odd_side_is_made_even() {
        let map = cells(from_host(vec![1.0, 2.0, 3.0], [1, 1, 1, 3], &Device::flex()));
        assert_eq!(map.dims(), [1, 4, 1, 2]);
        assert_eq!(to_host(map).unwrap(), [1.0, 3.0, 2.0, 3.0, 1.0, 3.0, 2.0, 3.0]);
    }

    #[test]
    fn a_cell_keeps_its_pixels_in_reading_order() {
        let values = (0..2 * 2 * 4).map(|value| value as f32).collect();
        let map = cells(from_host(values, [1, 2, 2, 4], &Device::flex()));
        assert_eq!(map.dims(), [1, 8, 1, 2]);
        let expected = [0, 2, 1, 3, 4, 6, 5, 7, 8, 10, 9, 11, 12, 14, 13, 15];
        assert_eq!(to_host(map).unwrap(), expected.map(|value| value as f32));
    }
}
