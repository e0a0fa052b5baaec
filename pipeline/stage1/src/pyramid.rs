//! Levels of a pyramid of feature maps, each half as large as the one before.

use burn::tensor::Tensor;
use rogs_tensors::ops::{self, Conv};
use rogs_tensors::parameters::Scope;

use super::config::CELL;
use crate::Result;

/// Features at a half, a quarter, an eighth and a sixteenth of the image size. `4 x [S, c, h, w]`
pub type Pyramid = [Tensor<4>; 4];

/// Two rectified convolutions. `[S, c', h, w] -> [S, c, h, w]`
pub(crate) fn two_layers(scope: &Scope<'_>, map: Tensor<4>, outputs: usize) -> Result<Tensor<4>> {
    let inputs = map.dims()[1];
    let first = Conv::load(&scope.child("conv1"), [outputs, inputs], 3, 1)?.forward(map);
    let second = Conv::load(&scope.child("conv2"), [outputs; 2], 3, 1)?.forward_of_relu(first);
    Ok(ops::relu(second))
}

/// The pixels of every cell as channels; a last row or column without a partner is doubled.
/// `[S, c, h, w] -> [S, c * CELL^2, h / CELL, w / CELL]`, sizes rounded up
pub(crate) fn cells(map: Tensor<4>) -> Tensor<4> {
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
    use rogs_tensors::parameters::{from_host, to_host};

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
