//! Losses of the released network that train its heads (`docs/spec/stage1.md` section 14.1).

use burn::tensor::Tensor;

use crate::{Error, Result};

/// Scales of the gradient term of the depth loss.
const GRADIENT_SCALES: usize = 4;
/// Keeps a mean over an empty mask finite.
const MASK_EPSILON: f64 = 1e-6;
/// Weight of the pairwise term of the motion loss.
const PAIR_WEIGHT: f64 = 10.0;

/// Depth loss of one clip: masked mean squared error plus the gradient term at four scales. Internal units.
/// `[S, H, W]` each, the mask 0 or 1
///
/// # Errors
/// When the shapes differ.
pub fn depth(predicted: Tensor<3>, target: Tensor<3>, mask: Tensor<3>) -> Result<Tensor<1>> {
    let [square, gradient] = depth_terms(predicted, target, mask)?;
    Ok(square + gradient)
}

/// The two terms of [`depth`]: squared error, gradient.
///
/// # Errors
/// When the shapes differ.
pub fn depth_terms(predicted: Tensor<3>, target: Tensor<3>, mask: Tensor<3>) -> Result<[Tensor<1>; 2]> {
    if predicted.dims() != target.dims() || predicted.dims() != mask.dims() {
        return Err(Error::BadInput(
            "depth, reference depth and mask have different shapes".into(),
        ));
    }
    let error = (predicted - target) * mask.clone();
    let square = (error.clone() * error.clone()).sum() / (mask.clone().sum() + MASK_EPSILON);
    let (mut total, mut error, mut mask) = (None, error, mask);
    for scale in 0..GRADIENT_SCALES {
        if scale > 0 {
            (error, mask) = (every_second(error), every_second(mask));
        }
        let term =
            (differences(&error, &mask, 2) + differences(&error, &mask, 1)) / (mask.clone().sum() + MASK_EPSILON);
        total = Some(match total {
            Some(sum) => sum + term,
            None => term,
        });
    }
    let gradient = total.map_or_else(|| square.clone() * 0.0, |sum| sum / GRADIENT_SCALES as f64);
    Ok([square, gradient])
}

/// Sum of absolute differences of neighbours along an axis, where both are in the mask.
fn differences(error: &Tensor<3>, mask: &Tensor<3>, axis: usize) -> Tensor<1> {
    let count = error.dims()[axis];
    if count < 2 {
        return (error.clone() * 0.0).sum();
    }
    let pair = |map: &Tensor<3>| {
        (
            map.clone().narrow(axis, 1, count - 1),
            map.clone().narrow(axis, 0, count - 1),
        )
    };
    let ((right, left), (right_mask, left_mask)) = (pair(error), pair(mask));
    ((right - left).abs() * right_mask * left_mask).sum()
}

/// Every second row and column.
fn every_second(map: Tensor<3>) -> Tensor<3> {
    let [frames, height, width] = map.dims();
    let (rows, columns) = (height.div_ceil(2), width.div_ceil(2));
    let device = map.device();
    let picks = |count: usize| Tensor::<1, burn::tensor::Int>::arange_step(0..2 * count as i64, 2, &device);
    map.select(1, picks(rows))
        .select(2, picks(columns))
        .reshape([frames, rows, columns])
}

/// Motion loss of the valid (query, track) displacements: mean absolute error plus 10 x the mean absolute difference of
/// all pairwise products. `[M, 3]` each; pass at most 1000 rows to the pairwise term by giving a chosen subset.
///
/// # Errors
/// When the shapes differ.
pub fn motion(predicted: Tensor<2>, target: Tensor<2>, pairs: [Tensor<2>; 2]) -> Result<Tensor<1>> {
    let [pair_predicted, pair_target] = pairs;
    if predicted.dims() != target.dims() || pair_predicted.dims() != pair_target.dims() {
        return Err(Error::BadInput(
            "displacements and their references have different shapes".into(),
        ));
    }
    let products = |rows: Tensor<2>| rows.clone().matmul(rows.transpose());
    let pairwise = (products(pair_predicted) - products(pair_target)).abs().mean();
    Ok((predicted - target).abs().mean() + pairwise * PAIR_WEIGHT)
}
