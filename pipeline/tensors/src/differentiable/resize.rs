//! Bilinear resampling that keeps the corner pixel centres in place.

use std::sync::Arc;

use burn::tensor::Tensor;
use rayon::prelude::*;

use super::node::{HostOperation, node};
use rogs_kernels::Axis;

#[derive(Debug)]
struct Resize {
    rows: Axis,
    columns: Axis,
}

/// Resamples maps. `[B, c, h, w] -> [B, c, height, width]`
pub fn resize(input: Tensor<4>, [height, width]: [usize; 2]) -> Tensor<4> {
    let [batch, channels, rows, columns] = input.dims();
    let operation = Resize {
        rows: Axis::new(rows, height),
        columns: Axis::new(columns, width),
    };
    let shape = [batch, channels, height, width];
    node([input.into_dispatch()], shape, Arc::new(operation))
}

impl HostOperation<1> for Resize {
    // Columns first: between rows, whole rows are mixed.
    fn forward(&self, [input]: [&[f32]; 1]) -> Vec<f32> {
        let (rows, columns) = (&self.rows, &self.columns);
        let (height, width) = (rows.taps.len(), columns.taps.len());
        let area = rows.inputs * columns.inputs;
        let mut out = vec![0.0f32; input.len() / area * height * width];
        out.par_chunks_mut(height * width)
            .zip(input.par_chunks(area))
            .for_each(|(out, plane)| {
                let mut wide = vec![0.0f32; rows.inputs * width];
                for (wide, row) in wide.chunks_exact_mut(width).zip(plane.chunks_exact(columns.inputs)) {
                    for (wide, &(first, share)) in wide.iter_mut().zip(&columns.taps) {
                        *wide = row[first] + share * (row[columns.second(first)] - row[first]);
                    }
                }
                for (out, &(first, share)) in out.chunks_exact_mut(width).zip(&rows.taps) {
                    let upper = &wide[first * width..][..width];
                    let lower = &wide[rows.second(first) * width..][..width];
                    for (out, (upper, lower)) in out.iter_mut().zip(upper.iter().zip(lower)) {
                        *out = upper + share * (lower - upper);
                    }
                }
            });
        out
    }

    fn backward(&self, gradient: &[f32], [input]: [&[f32]; 1], _: [bool; 1]) -> [Option<Vec<f32>>; 1] {
        let (rows, columns) = (&self.rows, &self.columns);
        let (height, width) = (rows.taps.len(), columns.taps.len());
        let area = rows.inputs * columns.inputs;
        let mut out = vec![0.0f32; input.len()];
        out.par_chunks_mut(area)
            .zip(gradient.par_chunks(height * width))
            .for_each(|(out, gradient)| {
                let mut wide = vec![0.0f32; rows.inputs * width];
                for (gradient, &(first, share)) in gradient.chunks_exact(width).zip(&rows.taps) {
                    for (row, weight) in [(first, 1.0 - share), (rows.second(first), share)] {
                        let wide = &mut wide[row * width..][..width];
                        wide.iter_mut()
                            .zip(gradient)
                            .for_each(|(sum, value)| *sum += weight * value);
                    }
                }
                for (out, wide) in out.chunks_exact_mut(columns.inputs).zip(wide.chunks_exact(width)) {
                    for (&value, &(first, share)) in wide.iter().zip(&columns.taps) {
                        out[first] += (1.0 - share) * value;
                        out[columns.second(first)] += share * value;
                    }
                }
            });
        [Some(out)]
    }
}
