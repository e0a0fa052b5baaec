//! The pre-norm transformer block of the encoder (plain) and of the aggregator (QK norm and rotary).

use burn::tensor::Tensor;

use crate::Result;
use rogs_kernels::{PackedAttention, Precision};
use rogs_tensors::device;
use rogs_tensors::host;
use rogs_tensors::ops::{self, HostNorm, LayerNorm, Linear, Rotary};
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
    qkv: Linear,
    projection: Linear,
    qk_norms: Option<[LayerNorm; 2]>,
    scales: Option<[Tensor<1>; 2]>,
    widen: Linear,
    narrow: Linear,
    heads: usize,
    precision: Precision,
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
            precision: kind.precision,
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
        let mixed = attention(query, key, value)
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
        host::usable(input) && host::usable(&self.qkv.weight) && host::usable(&self.widen.weight)
    }

    /// [`Self::attend`] without gradients on the CPU: norms, rotary embedding and biases inside the attention kernel.
    fn attend_packed(&self, input: Tensor<3>, rotary: Option<&Rotary>) -> Tensor<3> {
        let [batch, tokens, width] = input.dims();
        let normed = self.norm1.forward(input.clone());
        let packed = self.product(normed, &self.qkv, |_, _, _| {});
        let (heads, size, precision) = (self.heads, width / self.heads, self.precision);
        let norms = self
            .qk_norms
            .as_ref()
            .map(|norms| norms.each_ref().map(LayerNorm::host));
        let table = rotary.map(|rotary| rotary.table().clone());
        let bias = bias_of(&self.qkv);
        let mixed: Tensor<3> = host::read(
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
                    precision,
                }
                .run()
            },
        );
        self.add_branch(mixed, &self.projection, 0, input)
    }

    /// The second half of the block without gradients on the CPU.
    fn widen_and_narrow(&self, input: Tensor<3>) -> Tensor<3> {
        let bias = bias_of(&self.widen);
        let wide = self.product(
            self.norm2.forward(input.clone()),
            &self.widen,
            #[inline(always)]
            move |_, column, values| {
                for (value, bias) in values.iter_mut().zip(&bias[column..]) {
                    *value = rogs_kernels::gelu(*value + bias);
                }
            },
        );
        self.add_branch(wide, &self.narrow, 1, input)
    }

    /// x W^T without the bias; `finish` as in [`rogs_kernels::PackedWeight::apply`].
    fn product(
        &self,
        input: Tensor<3>,
        layer: &Linear,
        finish: impl Fn(usize, usize, &mut [f32]) + Send + Sync + 'static,
    ) -> Tensor<3> {
        let [batch, tokens, _] = input.dims();
        let packed = host::pack(&layer.weight, self.precision);
        let shape = [batch, tokens, packed.outputs()];
        host::read(input, layer.weight.clone(), shape, move |input, _| {
            packed.apply(
                input,
                #[inline(always)]
                |row, column, values| finish(row, column, values),
            )
        })
    }

    /// residual + scale * (x W^T + bias).
    fn add_branch(&self, input: Tensor<3>, layer: &Linear, index: usize, residual: Tensor<3>) -> Tensor<3> {
        let (shape, bias) = (residual.dims(), bias_of(layer));
        let scale = self
            .scales
            .as_ref()
            .map_or_else(|| vec![1.0; shape[2]], |scales| ops::values(&scales[index]));
        let packed = host::pack(&layer.weight, self.precision);
        host::read(input, residual, shape, move |input, residual| {
            packed.apply(
                input,
                #[inline(always)]
                |row, column, values| {
                    let residual = &residual[row * shape[2] + column..];
                    let terms = bias[column..].iter().zip(&scale[column..]).zip(residual);
                    for (value, ((bias, scale), residual)) in values.iter_mut().zip(terms) {
                        *value = scale.mul_add(*value + bias, *residual);
                    }
                },
            )
        })
    }

    fn scaled(&self, branch: Tensor<3>, index: usize) -> Tensor<3> {
        match &self.scales {
            Some(scales) => branch * scales[index].clone().unsqueeze(),
            None => branch,
        }
    }
}

/// Scores that a graphics processor holds at a time; many refuse buffers of more than 128 MiB.
const SCORES: usize = 24 << 20;

/// Attention; on a graphics processor, whose framework holds all scores at once, for as many queries at a time as fit.
fn attention(query: Tensor<4>, key: Tensor<4>, value: Tensor<4>) -> Tensor<4> {
    let [batch, heads, tokens, _] = query.dims();
    let rows = (SCORES / (batch * heads * key.dims()[2]).max(1)).max(1);
    if device::is_cpu(&query.device()) || rows >= tokens {
        return ops::attention(query, key, value);
    }
    let piece = |first: usize| {
        let queries = query.clone().narrow(2, first, rows.min(tokens - first));
        ops::attention(queries, key.clone(), value.clone())
    };
    Tensor::cat((0..tokens).step_by(rows).map(piece).collect(), 2)
}

/// The bias of a layer on the host, zeros where it has none.
fn bias_of(layer: &Linear) -> Vec<f32> {
    let zeros = || vec![0.0; layer.weight.dims()[0]];
    layer.bias.as_ref().map_or_else(zeros, ops::values)
}
