//! The pre-norm transformer block of the encoder (plain) and of the aggregator (QK norm and rotary).

use burn::tensor::Tensor;

use super::positions::Rotary;
use crate::Result;
use crate::kernels::{self, PackedAttention};
use crate::ops::{self, HostNorm, LayerNorm, Linear};
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
        if self.has_kernels(&middle) {
            return self.widen_and_narrow(middle);
        }
        let branch = self
            .narrow
            .forward(ops::gelu(self.widen.forward(self.norm2.forward(middle.clone()))));
        middle + self.scaled(branch, 1)
    }

    /// The first half: x + ls1 * attention(norm1(x)). `[B, T, C] -> [B, T, C]`
    #[must_use]
    pub fn attend(&self, input: Tensor<3>, rotary: Option<&Rotary>) -> Tensor<3> {
        if self.has_kernels(&input) {
            return self.attend_packed(input, rotary);
        }
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

    fn has_kernels(&self, input: &Tensor<3>) -> bool {
        kernels::usable(input) && kernels::usable(&self.qkv.weight) && kernels::usable(&self.widen.weight)
    }

    /// [`Self::attend`] without gradients on the CPU: norms, rotary embedding and biases inside the attention kernel.
    fn attend_packed(&self, input: Tensor<3>, rotary: Option<&Rotary>) -> Tensor<3> {
        let [batch, tokens, width] = input.dims();
        let packed = ops::linear(self.norm1.forward(input.clone()), self.qkv.weight.clone(), None);
        let (heads, size) = (self.heads, width / self.heads);
        let norms = self
            .qk_norms
            .as_ref()
            .map(|norms| norms.each_ref().map(LayerNorm::host));
        let table = rotary.map(|rotary| rotary.table().clone());
        let bias = self.qkv.bias.as_ref().map_or_else(|| vec![0.0; 3 * width], ops::values);
        let mixed: Tensor<3> = kernels::read(
            packed,
            self.projection.weight.clone(),
            [batch, tokens, width],
            move |packed, _| {
                PackedAttention {
                    packed,
                    bias: &bias,
                    tokens,
                    heads,
                    size,
                    norms: norms.as_ref().map(|norms| norms.each_ref().map(HostNorm::borrow)),
                    rotary: table
                        .as_ref()
                        .map(|table| [table.cosine.as_slice(), table.sine.as_slice()]),
                }
                .run()
            },
        );
        let branch = ops::linear(mixed, self.projection.weight.clone(), None);
        self.add_branch(branch, &self.projection, 0, input)
    }

    /// The second half of the block without gradients on the CPU.
    fn widen_and_narrow(&self, input: Tensor<3>) -> Tensor<3> {
        let wide = ops::linear(self.norm2.forward(input.clone()), self.widen.weight.clone(), None);
        let (shape, bias) = (wide.dims(), self.widen.bias.as_ref().map(ops::values));
        let wide: Tensor<3> = kernels::update(wide, self.narrow.weight.clone(), shape, move |mut values, _| {
            kernels::bias_gelu(&mut values, bias.as_deref().unwrap_or(&vec![0.0; shape[2]]));
            values
        });
        let branch = ops::linear(wide, self.narrow.weight.clone(), None);
        self.add_branch(branch, &self.narrow, 1, input)
    }

    /// residual + scale * (branch + bias of the layer that made it).
    fn add_branch(&self, branch: Tensor<3>, layer: &Linear, index: usize, residual: Tensor<3>) -> Tensor<3> {
        let (shape, bias) = (branch.dims(), layer.bias.as_ref().map(ops::values));
        let scale = self
            .scales
            .as_ref()
            .map(|scales| ops::values(&scales[index]))
            .unwrap_or_default();
        kernels::update(branch, residual, shape, move |mut values, residual| {
            kernels::bias_scale_add(
                &mut values,
                bias.as_deref().unwrap_or(&vec![0.0; shape[2]]),
                &scale,
                residual,
            );
            values
        })
    }

    fn scaled(&self, branch: Tensor<3>, index: usize) -> Tensor<3> {
        match &self.scales {
            Some(scales) => branch * scales[index].clone().unsqueeze(),
            None => branch,
        }
    }
}
