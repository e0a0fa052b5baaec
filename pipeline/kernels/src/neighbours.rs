//! Attention of tokens to a few neighbours each.

use rayon::prelude::*;

use crate::lanes::dot;
use crate::layers::ROWS_PER_PIECE;
use crate::pointwise::exp;
use crate::vectorised;

/// softmax over the neighbours of a token of `q . k / sqrt(width)`, times their values. `qkv [n, 3 * width]` ordered
/// query, key, value; `indices [n, count]`; result `[n, width]`.
pub fn neighbour_attention(qkv: &[f32], width: usize, indices: &[u32], count: usize) -> Vec<f32> {
    let tokens = qkv.len() / (3 * width);
    let scale = 1.0 / (width as f32).sqrt();
    let mut out = vec![0.0; tokens * width];
    out.par_chunks_mut(ROWS_PER_PIECE * width)
        .enumerate()
        .for_each_init(Vec::new, |logits, (piece, out)| {
            logits.resize(count, 0.0);
            vectorised(
                #[inline(always)]
                || {
                    for (row, out) in out.chunks_exact_mut(width).enumerate() {
                        let token = piece * ROWS_PER_PIECE + row;
                        let near = &indices[token * count..][..count];
                        let part = |index: u32, part: usize| &qkv[(index as usize * 3 + part) * width..][..width];
                        let query = part(token as u32, 0);
                        for (logit, &index) in logits.iter_mut().zip(near) {
                            *logit = dot(query, part(index, 1)) * scale;
                        }
                        let largest = logits.iter().fold(f32::NEG_INFINITY, |a, &b| a.max(b));
                        logits.iter_mut().for_each(|logit| *logit = exp(*logit - largest));
                        let inverse = 1.0 / logits.iter().sum::<f32>();
                        for (logit, &index) in logits.iter().zip(near) {
                            let weight = logit * inverse;
                            for (out, value) in out.iter_mut().zip(part(index, 2)) {
                                *out += weight * value;
                            }
                        }
                    }
                },
            );
        });
    out
}
