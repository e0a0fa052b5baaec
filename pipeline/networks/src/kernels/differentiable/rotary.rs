//! The rotary embedding: x * cos + swap(x) * sin, where `swap` exchanges the two quarters of each half of a head.

use std::sync::Arc;

use burn::tensor::Tensor;
use rayon::prelude::*;

use super::{INPUTS, InputGradients, Operation, of_one};
use crate::stage1::positions::RotaryTable;

#[derive(Debug)]
struct Rotate(Arc<RotaryTable>);

/// Rotates queries or keys; the table repeats after its last position. `[B, heads, T, head size]`
pub(crate) fn rotate(input: Tensor<4>, table: Arc<RotaryTable>) -> Tensor<4> {
    let shape = input.dims();
    of_one(input, shape, Rotate(table))
}

impl Rotate {
    /// Runs `turn(out, values, cosine, sine)` on the quarters of all rows; `tokens` lie one after another.
    fn run(&self, values: &[f32], turn: impl Fn([f32; 2], [f32; 2], [f32; 2]) -> [f32; 2] + Sync) -> Vec<f32> {
        let Self(table) = self;
        let (size, period) = (table.head_size, table.len());
        let quarter = size / 4;
        let mut out = vec![0.0f32; values.len()];
        out.par_chunks_mut(period * size)
            .zip(values.par_chunks(period * size))
            .for_each(|(out, values)| {
                for (token, (out, row)) in out.chunks_exact_mut(size).zip(values.chunks_exact(size)).enumerate() {
                    let (cosine, sine) = (
                        &table.cosine[token * size..][..size],
                        &table.sine[token * size..][..size],
                    );
                    for half in [0, 2 * quarter] {
                        for k in half..half + quarter {
                            let other = k + quarter;
                            let turned = turn([row[k], row[other]], [cosine[k], cosine[other]], [sine[k], sine[other]]);
                            [out[k], out[other]] = turned;
                        }
                    }
                }
            });
        out
    }
}

impl Operation for Rotate {
    fn forward(&self, [input, ..]: [&[f32]; INPUTS]) -> Vec<f32> {
        self.run(input, |x, cosine, sine| {
            [x[0] * cosine[0] + x[1] * sine[0], x[1] * cosine[1] + x[0] * sine[1]]
        })
    }

    fn backward(&self, gradient: &[f32], _: [&[f32]; INPUTS], _: [bool; INPUTS]) -> InputGradients {
        let turned = self.run(gradient, |g, cosine, sine| {
            [g[0] * cosine[0] + g[1] * sine[1], g[1] * cosine[1] + g[0] * sine[0]]
        });
        [Some(turned), None, None]
    }
}
