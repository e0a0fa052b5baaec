//! Attention without masks.

use burn::tensor::ops::AttentionModuleOptions;
use burn::tensor::{Tensor, module};
use rogs_kernels::PackedAttention;

use super::linear::Linear;
use super::norm::{HostNorm, LayerNorm};
use super::rotary::Rotary;
use crate::device::is_cpu;
use crate::parameters::from_host;
use crate::{differentiable, host};

/// Scores that a GPU holds at a time; many refuse buffers of more than 128 MiB.
const SCORES: usize = 24 << 20;

/// softmax(q k^T / sqrt(head size)) v; on a GPU, whose framework holds all scores at once, for as many queries at a time as
/// fit. `[B, heads, T, head size]` each
#[must_use]
pub fn attention(query: Tensor<4>, key: Tensor<4>, value: Tensor<4>) -> Tensor<4> {
    if differentiable::usable(&query) {
        return differentiable::attention(query, key, value);
    }
    let plain = |query| {
        let options = AttentionModuleOptions::default();
        module::attention(query, key.clone(), value.clone(), None, None, options)
    };
    let [batch, heads, tokens, _] = query.dims();
    let rows = (SCORES / (batch * heads * key.dims()[2]).max(1)).max(1);
    if is_cpu(&query.device()) || rows >= tokens {
        return plain(query);
    }
    let piece = |first: usize| plain(query.clone().narrow(2, first, rows.min(tokens - first)));
    Tensor::cat((0..tokens).step_by(rows).map(piece).collect(), 2)
}

/// Self-attention of token lists: queries, keys and values from one projection, with norms per head where there are any.
#[derive(Debug, Clone)]
pub struct SelfAttention {
    qkv: Linear,
    norms: Option<[LayerNorm; 2]>,
    heads: usize,
}

impl SelfAttention {
    /// Attention of a projection `C -> 3C` (queries, keys, values, each head by head), and the norms of queries and keys.
    #[must_use]
    pub fn new(qkv: Linear, norms: Option<[LayerNorm; 2]>, heads: usize) -> Self {
        Self { qkv, norms, heads }
    }

    /// What tokens take from each other, heads side by side. `[B, T, C] -> [B, T, C]`
    #[must_use]
    pub fn forward(&self, input: Tensor<3>, rotary: Option<&Rotary>) -> Tensor<3> {
        let shape = input.dims();
        if self.qkv.has_kernel(&input) {
            return self.by_kernel(&input, rotary);
        }
        let [query, key, value] = self.queries_keys_values(input, rotary);
        attention(query, key, value).swap_dims(1, 2).reshape(shape)
    }

    /// Normalised and rotated queries and keys, and values. `[B, T, C] -> 3 x [B, heads, T, head size]`
    #[must_use]
    pub fn queries_keys_values(&self, input: Tensor<3>, rotary: Option<&Rotary>) -> [Tensor<4>; 3] {
        let [batch, tokens, width] = input.dims();
        let packed = self.qkv.forward(input);
        let packed = packed.reshape([batch, tokens, 3, self.heads, width / self.heads]);
        let part = |index: usize| packed.clone().narrow(2, index, 1).squeeze_dim::<4>(2).swap_dims(1, 2);
        let [mut query, mut key, value] = [part(0), part(1), part(2)];
        if let Some([query_norm, key_norm]) = &self.norms {
            query = query_norm.forward(query);
            key = key_norm.forward(key);
        }
        if let Some(rotary) = rotary {
            query = rotary.apply(query);
            key = rotary.apply(key);
        }
        [query, key, value]
    }

    /// Norms, rotary embedding and biases inside the attention kernel.
    fn by_kernel(&self, input: &Tensor<3>, rotary: Option<&Rotary>) -> Tensor<3> {
        let [_, tokens, width] = input.dims();
        let packed = self.qkv.by_kernel(input, |_, _, _| {});
        let norms = self.norms.as_ref().map(|norms| norms.each_ref().map(LayerNorm::host));
        let (bias, table) = (self.qkv.host_bias(), rotary.map(Rotary::table));
        let mixed = host::with_values(&packed, |packed| {
            PackedAttention {
                packed,
                bias: &bias,
                tokens,
                heads: self.heads,
                size: width / self.heads,
                norms: norms.as_ref().map(|norms| norms.each_ref().map(HostNorm::borrow)),
                rotary: table.map(|table| [table.cosine.as_slice(), table.sine.as_slice()]),
                precision: self.qkv.precision(),
            }
            .run()
        });
        from_host(mixed, input.dims(), &input.device())
    }
}
