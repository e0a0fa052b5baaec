//! Products and means whose order of summation does not depend on the width of a processor's vectors, as that of the
//! framework's products with one column and of its sums along the last dimension does.

use burn::tensor::Tensor;
use rogs_kernels::{Matrix, PackedWeight, Precision};

use crate::host;
use crate::parameters::from_host;

/// A B. `[rows, inner]`, `[inner, columns] -> [rows, columns]`
#[must_use]
pub fn product(left: Tensor<2>, right: Tensor<2>) -> Tensor<2> {
    if !host::usable(&left) || !host::usable(&right) {
        return left.matmul(right);
    }
    let ([rows, _], [_, columns]) = (left.dims(), right.dims());
    let values = host::with_values(&right, |right| {
        let packed = PackedWeight::of(Matrix::new(right, columns).transposed(), Precision::F32);
        host::with_values(&left, |left| packed.apply(left, |_, _, _| {}))
    });
    from_host(values, [rows, columns], &left.device())
}

/// The mean of every row, summed from the first value to the last in double precision. `[rows, columns] -> [rows, 1]`
#[must_use]
pub fn row_means(input: Tensor<2>) -> Tensor<2> {
    let [rows, columns] = input.dims();
    if columns == 0 || !host::usable(&input) {
        return input.mean_dim(1);
    }
    let mean = |row: &[f32]| (row.iter().map(|&value| f64::from(value)).sum::<f64>() / columns as f64) as f32;
    let means = host::with_values(&input, |values| values.chunks_exact(columns).map(mean).collect());
    from_host(means, [rows, 1], &input.device())
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;
    use crate::parameters::to_host;

    fn noise<const D: usize>(shape: [usize; D], seed: usize) -> (Tensor<D>, Vec<f32>) {
        let value = |k: usize| ((k * 7919 + seed * 104_729) % 1009) as f32 / 504.5 - 1.0;
        let values: Vec<f32> = (0..shape.iter().product()).map(value).collect();
        (from_host(values.clone(), shape, &Device::flex()), values)
    }

    #[test]
    fn products_and_means_are_those_of_doubles() {
        for [rows, inner, columns] in [[3, 5, 1], [1, 700, 40], [17, 33, 9]] {
            let ((left, a), (right, b)) = (noise([rows, inner], 1), noise([inner, columns], 2));
            let found = to_host(product(left.clone(), right)).unwrap();
            for (place, &found) in found.iter().enumerate() {
                let terms = (0..inner)
                    .map(|k| f64::from(a[place / columns * inner + k]) * f64::from(b[k * columns + place % columns]));
                assert!((f64::from(found) - terms.sum::<f64>()).abs() < 1e-4);
            }
            for (row, &found) in to_host(row_means(left)).unwrap().iter().enumerate() {
                let sum: f64 = a[row * inner..][..inner].iter().map(|&value| f64::from(value)).sum();
                assert!((f64::from(found) - sum / inner as f64).abs() < 1e-7);
            }
        }
    }
}
