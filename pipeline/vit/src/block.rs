//! The pre-norm transformer block: plain in image encoders, with norms of queries and keys elsewhere.

use burn::tensor::Tensor;

use crate::Result;
use rogs_kernels::Precision;
use rogs_tensors::ops::{LayerNorm, Linear, Rotary, SelfAttention};
use rogs_tensors::parameters::Scope;

/// How queries and keys are normalised, head by head.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum HeadNorm {
    /// By a layer norm with the block's epsilon.
    Layer,
    /// By their root mean square, with an epsilon of its own.
    RootMeanSquare(f64),
}

/// What distinguishes the blocks of the networks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockKind {
    /// Epsilon of the layer norms.
    pub epsilon: f64,
    /// How queries and keys are normalised per head.
    pub qk_norm: Option<HeadNorm>,
    /// Whether linear layers and layer norms add a bias.
    pub bias: bool,
    /// Whether residual branches are scaled per channel.
    pub layer_scale: bool,
    /// Numbers of the matrix products.
    pub precision: Precision,
}

impl BlockKind {
    /// Blocks of the image encoder DINOv2.
    pub const ENCODER: Self = Self {
        epsilon: 1e-6,
        qk_norm: None,
        bias: true,
        layer_scale: true,
        precision: Precision::F32,
    };
    /// Frame and global blocks of the aggregator of Stage 1.
    pub const AGGREGATOR: Self = Self {
        epsilon: 1e-5,
        qk_norm: Some(HeadNorm::Layer),
        bias: true,
        layer_scale: true,
        precision: Precision::F32,
    };
    /// Blocks of the latent adapter of Stage 1.
    pub const ADAPTER: Self = Self {
        epsilon: 1e-5,
        qk_norm: None,
        bias: true,
        layer_scale: false,
        precision: Precision::F32,
    };
    /// Blocks of 4DGT (`docs/spec/baseline-4dgt.md` section 4).
    pub const FOUR_DGT: Self = Self {
        epsilon: 1e-5,
        qk_norm: Some(HeadNorm::RootMeanSquare(1e-6)),
        bias: false,
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
        let head_norm = |name: &str, norm: HeadNorm| {
            let (scope, size) = (attention.child(name), width / heads);
            match norm {
                HeadNorm::Layer => LayerNorm::load(&scope, size, kind.epsilon),
                HeadNorm::RootMeanSquare(epsilon) => LayerNorm::root_mean_square(&scope, size, epsilon),
            }
        };
        let qk_norms = match kind.qk_norm {
            Some(norm) => Some([head_norm("q_norm", norm)?, head_norm("k_norm", norm)?]),
            None => None,
        };
        let norm = |name: &str| match kind.bias {
            true => LayerNorm::load(&scope.child(name), width, kind.epsilon),
            false => LayerNorm::scaling(&scope.child(name), width, kind.epsilon),
        };
        let scale = |name: &str| scope.get(name, [width]);
        let scales = if kind.layer_scale {
            Some([scale("ls1.gamma")?, scale("ls2.gamma")?])
        } else {
            None
        };
        let linear = |scope: &Scope<'_>, outputs: usize, inputs: usize| -> Result<Linear> {
            let layer = match kind.bias {
                true => Linear::load(scope, outputs, inputs)?,
                false => Linear::load_unbiased(scope, outputs, inputs)?,
            };
            Ok(layer.with_precision(kind.precision))
        };
        let mlp = scope.child("mlp");
        Ok(Self {
            norm1: norm("norm1")?,
            norm2: norm("norm2")?,
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
