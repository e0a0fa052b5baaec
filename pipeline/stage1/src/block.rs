//! The pre-norm transformer block of the encoder (plain) and of the aggregator (QK norm and rotary).

use burn::tensor::Tensor;

use crate::Result;
use rogs_kernels::Precision;
use rogs_tensors::ops::{LayerNorm, Linear, Rotary, SelfAttention};
use rogs_tensors::parameters::Scope;

/// What distinguishes the blocks of the three parts of the network.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockKind {
    /// Epsilon of the layer norms.
    pub epsilon: f64,
    /// Whether queries and keys are normalised per head.
    pub qk_norm: bool,
    /// Whether residual branches are scaled per channel.
    pub layer_scale: bool,
    /// Numbers of the matrix products.
    pub precision: Precision,
}

impl BlockKind {
    /// Blocks of the image encoder.
    pub const ENCODER: Self = Self {
        epsilon: 1e-6,
        qk_norm: false,
        layer_scale: true,
        precision: Precision::F32,
    };
    /// Frame and global blocks of the aggregator.
    pub const AGGREGATOR: Self = Self {
        epsilon: 1e-5,
        qk_norm: true,
        layer_scale: true,
        precision: Precision::F32,
    };
    /// Blocks of the latent adapter.
    pub const ADAPTER: Self = Self {
        epsilon: 1e-5,
        qk_norm: false,
        layer_scale: false,
        precision: Precision::F32,
    };
}

/// The weights of one block.
#[derive(Debug, Clone)]
pub struct Block {
    norm1: LayerNorm,
    norm2: LayerNorm,
    attention: SelfAttention,
    projection: Linear,
    scales: Option<[Tensor<1>; 2]>,
    widen: Linear,
    narrow: Linear,
}

impl BlockKind {
    /// The same blocks with matrix products of other numbers.
    #[must_use]
    pub const fn with(self, precision: Precision) -> Self {
        Self { precision, ..self }
    }
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
        let linear = |scope: &Scope<'_>, outputs: usize, inputs: usize| -> Result<Linear> {
            Ok(Linear::load(scope, outputs, inputs)?.with_precision(kind.precision))
        };
        let mlp = scope.child("mlp");
        Ok(Self {
            norm1: LayerNorm::load(&scope.child("norm1"), width, kind.epsilon)?,
            norm2: LayerNorm::load(&scope.child("norm2"), width, kind.epsilon)?,
            attention: SelfAttention::new(linear(&attention.child("qkv"), 3 * width, width)?, qk_norms, heads),
            projection: linear(&attention.child("proj"), width, width)?,
            scales,
            widen: linear(&mlp.child("fc1"), 4 * width, width)?,
            narrow: linear(&mlp.child("fc2"), width, 4 * width)?,
        })
    }

    /// Runs the block; attention is within each batch entry. `[B, T, C] -> [B, T, C]`
    #[must_use]
    pub fn forward(&self, input: Tensor<3>, rotary: Option<&Rotary>) -> Tensor<3> {
        let middle = self.attend(input, rotary);
        let wide = self.widen.forward_gelu(self.norm2.forward(middle.clone()));
        self.narrow.forward_onto(wide, middle, self.scale(1))
    }

    /// The first half: x + ls1 * attention(norm1(x)). `[B, T, C] -> [B, T, C]`
    #[must_use]
    pub fn attend(&self, input: Tensor<3>, rotary: Option<&Rotary>) -> Tensor<3> {
        let mixed = self.attention.forward(self.norm1.forward(input.clone()), rotary);
        self.projection.forward_onto(mixed, input, self.scale(0))
    }

    /// Normalised and rotated queries and keys, and values. `[B, T, C] -> 3 x [B, heads, T, head size]`
    #[must_use]
    pub fn queries_keys_values(&self, input: Tensor<3>, rotary: Option<&Rotary>) -> [Tensor<4>; 3] {
        self.attention.queries_keys_values(self.norm1.forward(input), rotary)
    }

    /// The scale of the channels of a residual branch.
    fn scale(&self, branch: usize) -> Option<&Tensor<1>> {
        self.scales.as_ref().map(|scales| &scales[branch])
    }
}
