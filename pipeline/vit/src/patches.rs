//! The projection of patches.

use burn::tensor::Tensor;
use rogs_kernels::Precision;
use rogs_tensors::ops;

/// A convolution whose stride is its kernel size, as one matrix product. `[S, c, H, W] -> [S, N, C]`
#[must_use]
pub fn patch_projection(images: Tensor<4>, weight: Tensor<4>, bias: Tensor<1>) -> Tensor<3> {
    let [frames, channels, height, width] = images.dims();
    let [outputs, _, patch, _] = weight.dims();
    let (rows, columns) = (height / patch, width / patch);
    let cells = images
        .reshape([frames, channels, rows, patch, columns, patch])
        .permute([0, 2, 4, 1, 3, 5]);
    let cells = cells.reshape([frames, rows * columns, channels * patch * patch]);
    ops::linear(
        cells,
        weight.reshape([outputs, channels * patch * patch]),
        Some(bias),
        Precision::F32,
    )
}
