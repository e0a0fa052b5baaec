//! The pre-norm transformer block of the encoder (plain) and of the aggregator (QK norm and rotary).

use burn::tensor::Tensor;

use super::positions::Rotary;
use crate::Result;
use crate::ops::{self, LayerNorm, Linear};
use crate::parameters::Scope;

/// What distinguishes the blocks of the three parts of the network.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockKind {
    /// Epsilon of the layer norms.
    pub epsilon: f64,
    /// Whether queries and keys are normalised per head.
    pub qk_norm: bool,
    /// Whether residual branches are scaled per channel.
    pub layer_scale: bool,
}

impl BlockKind {
    /// Blocks of the image encoder.
    pub const ENCODER: Self = Self {
        epsilon: 1e-6,
        qk_norm: false,
        layer_scale: true,
    };
    /// Frame and global blocks of the aggregator.
    pub const AGGREGATOR: Self = Self {
        epsilon: 1e-5,
        qk_norm: true,
        layer_scale: true,
    };
    /// Blocks of the latent adapter.
    pub const ADAPTER: Self = Self {
        epsilon: 1e-5,
        qk_norm: false,
        layer_scale: false,
    };
}

/// The weights of one block.
#[derive(Debug, Clone)]
pub struct Block {
    norm1: LayerNorm,
    norm2: LayerNorm,
    qkv: Linear,
    projection: Linear,
    qk_norms: Option<[LayerNorm; 2]>,
    scales: Option<[Tensor<1>; 2]>,
    widen: Linear,
    narrow: Linear,
    heads: usize,
}

impl Block {
    /// Reads the block of a scope.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn load(scope: &Scope<'_>, kind: BlockKind, width: usize, heads: usize) -> Result<Self> {
        let attention = scope.child("attn");
        let head_norm = |name: &str| LayerNorm::load(&attention.child(name), width / heads, kind.epsilon);
        let qk_norms = if kind.qk_norm {
            Some([head_norm("q_norm")?, head_norm("k_norm")?])
        } else {
            None
        };
        let scale = |name: &str| scope.get(name, [width]);
        let scales = if kind.layer_scale {
            Some([scale("ls1.gamma")?, scale("ls2.gamma")?])
        } else {
            None
        };
        let mlp = scope.child("mlp");
        Ok(Self {
            norm1: LayerNorm::load(&scope.child("norm1"), width, kind.epsilon)?,
            norm2: LayerNorm::load(&scope.child("norm2"), width, kind.epsilon)?,
            qkv: Linear::load(&attention.child("qkv"), 3 * width, width)?,
            projection: Linear::load(&attention.child("proj"), width, width)?,
            qk_norms,
            scales,
            widen: Linear::load(&mlp.child("fc1"), 4 * width, width)?,
            narrow: Linear::load(&mlp.child("fc2"), width, 4 * width)?,
            heads,
        })
    }

    /// Runs the block; attention is within each batch entry. `[B, T, C] -> [B, T, C]`
    #[must_use]
    pub fn forward(&self, input: Tensor<3>, rotary: Option<&Rotary>) -> Tensor<3> {
        let middle = self.attend(input, rotary);
        let branch = self
            .narrow
            .forward(ops::gelu(self.widen.forward(self.norm2.forward(middle.clone()))));
        middle + self.scaled(branch, 1)
    }

    /// The first half: x + ls1 * attention(norm1(x)). `[B, T, C] -> [B, T, C]`
    #[must_use]
    pub fn attend(&self, input: Tensor<3>, rotary: Option<&Rotary>) -> Tensor<3> {
        let [query, key, value] = self.queries_keys_values(input.clone(), rotary);
        let [batch, heads, tokens, size] = query.dims();
        let mixed = ops::attention(query, key, value)
            .swap_dims(1, 2)
            .reshape([batch, tokens, heads * size]);
        input + self.scaled(self.projection.forward(mixed), 0)
    }

    /// Normalised and rotated queries and keys, and values. `[B, T, C] -> 3 x [B, heads, T, head size]`
    #[must_use]
    pub fn queries_keys_values(&self, input: Tensor<3>, rotary: Option<&Rotary>) -> [Tensor<4>; 3] {
        let [batch, tokens, width] = input.dims();
        let packed = self.qkv.forward(self.norm1.forward(input));
        let packed = packed.reshape([batch, tokens, 3, self.heads, width / self.heads]);
        let part = |index: usize| packed.clone().narrow(2, index, 1).squeeze_dim::<4>(2).swap_dims(1, 2);
        let [mut query, mut key, value] = [part(0), part(1), part(2)];
        if let Some([query_norm, key_norm]) = &self.qk_norms {
            query = query_norm.forward(query);
            key = key_norm.forward(key);
        }
        if let Some(rotary) = rotary {
            query = rotary.apply(query);
            key = rotary.apply(key);
        }
        [query, key, value]
    }

    fn scaled(&self, branch: Tensor<3>, index: usize) -> Tensor<3> {
        match &self.scales {
            Some(scales) => branch * scales[index].clone().unsqueeze(),
            None => branch,
        }
    }
}
