//! The recurrent updater: attributes, state and pooled feedback to a new state and a residual
//! (`docs/spec/stage2.md` sections A.5 and B.6).

use burn::tensor::activation::{sigmoid, softmax};
use burn::tensor::{Device, Int, Tensor, TensorData};

use super::RefinerConfig;
use crate::{Error, Result};
use rogs_tensors::ops::{self, LayerNorm, Linear, gelu};
use rogs_tensors::parameters::{Parameters, Scope, to_host};

/// Tokens that are processed at a time where tokens do not see each other; bounds memory, does not change results.
const TOKENS_AT_A_TIME: usize = 4096;

/// Neighbour indices of a token set on a device.
#[derive(Debug, Clone)]
pub struct Neighbours {
    indices: Tensor<1, Int>,
    count: usize,
}

impl Neighbours {
    /// From the result of [`super::nearest_neighbours`]: `count` indices per token.
    #[must_use]
    pub fn new(indices: &[u32], count: usize, device: &Device) -> Self {
        let values: Vec<i32> = indices.iter().map(|&index| index as i32).collect();
        let length = values.len();
        Self {
            indices: Tensor::from_data(TensorData::new(values, [length]), device),
            count,
        }
    }
}

/// One neighbour-attention block: `x += attention(norm x)`, `x += mlp(norm x)`. A token attends to its neighbours and
/// itself; positions choose the neighbours and do nothing else.
#[derive(Debug, Clone)]
pub struct NeighbourBlock {
    norm1: LayerNorm,
    qkv: Tensor<2>,
    projection: Linear,
    norm2: LayerNorm,
    expand: Linear,
    contract: Linear,
}

impl NeighbourBlock {
    /// Reads the block of a scope (`encoder.update_module.1.blocks.0`).
    ///
    /// # Errors
    /// When a parameter is missing or has another shape.
    pub fn load(scope: &Scope<'_>, width: usize, attention: usize) -> Result<Self> {
        let mlp = scope.child("mlp");
        Ok(Self {
            norm1: LayerNorm::load(&scope.child("norm1"), width, 1e-5)?,
            qkv: scope.get("attn.qkv.weight", [3 * attention, width])?,
            projection: Linear::load(&scope.child("attn.proj"), width, attention)?,
            norm2: LayerNorm::load(&scope.child("norm2"), width, 1e-5)?,
            expand: Linear::load(&mlp.child("fc1"), 4 * width, width)?,
            contract: Linear::load(&mlp.child("fc2"), width, 4 * width)?,
        })
    }

    /// The block on one token set. `[n, S]`
    #[must_use]
    pub fn forward(&self, tokens: Tensor<2>, neighbours: &Neighbours) -> Tensor<2> {
        let attended = tokens.clone() + self.attention_of(self.norm1.forward(tokens), neighbours);
        by_rows(attended, |rows, _| {
            let hidden = gelu(self.expand.forward(self.norm2.forward(rows.clone())));
            rows + self.contract.forward(hidden)
        })
    }

    /// The attention alone, without normalisation and residual. `[n, S]`
    #[must_use]
    pub fn attention_of(&self, tokens: Tensor<2>, neighbours: &Neighbours) -> Tensor<2> {
        let width = self.qkv.dims()[0] / 3;
        let count = neighbours.count;
        let weight = self.qkv.clone().transpose();
        let qkv = by_rows(tokens, |rows, _| ops::product(rows, weight.clone()));
        let [total, _] = qkv.dims();
        let key_value = qkv.clone().slice([0..total, width..3 * width]);
        by_rows(qkv, |rows, first| {
            let [n, _] = rows.dims();
            let indices = neighbours.indices.clone().narrow(0, first * count, n * count);
            let near = key_value.clone().select(0, indices).reshape([n, count, 2 * width]);
            let query = rows.slice([0..n, 0..width]).reshape([n, 1, width]);
            let key = near.clone().slice([0..n, 0..count, 0..width]);
            let value = near.slice([0..n, 0..count, width..2 * width]);
            let logits = (query * key).sum_dim(2) / (width as f64).sqrt();
            let mixed = (softmax(logits, 1) * value).sum_dim(1).reshape([n, width]);
            self.projection.forward(mixed)
        })
    }
}

/// What one update gives a token set.
#[derive(Debug, Clone)]
pub struct UpdaterOutput {
    /// New hidden state. `[n, S]`
    pub state: Tensor<2>,
    /// Ungated residual. `[n, 59 * block^2]`
    pub residual: Tensor<2>,
}

/// The trained part of the refiner.
#[derive(Debug, Clone)]
pub struct Updater {
    observation: Linear,
    input: Linear,
    blocks: Vec<NeighbourBlock>,
    head: [Linear; 4],
    gate_logit: Tensor<1>,
}

impl Updater {
    /// Reads the trained parameters of a configuration. The tensors are those of the store, so that gradients reach it.
    ///
    /// # Errors
    /// When a parameter is missing or has another shape.
    pub fn load(parameters: &Parameters, config: &RefinerConfig) -> Result<Self> {
        let (state, scope) = (config.state, parameters.scope("encoder"));
        let blocks = scope.child("update_module.1.blocks");
        let head = scope.child("update_head");
        let layer = |index: usize, outputs: usize| Linear::load(&head.child(index), outputs, state);
        Ok(Self {
            observation: Linear::load(&scope.child("update_obs_proj"), state, config.features())?,
            input: Linear::load(&scope.child("update_module.0.linear"), state, config.inputs())?,
            blocks: (0..config.blocks)
                .map(|index| NeighbourBlock::load(&blocks.child(index), state, config.attention))
                .collect::<Result<_>>()?,
            head: [
                layer(0, state)?,
                layer(2, state)?,
                layer(4, state)?,
                layer(6, config.residuals())?,
            ],
            gate_logit: scope.get("update_gate.logit", [5])?,
        })
    }

    /// Hidden state before the first update, from observation features. `[n, F] -> [n, S]`
    #[must_use]
    pub fn initial_state(&self, features: Tensor<2>) -> Tensor<2> {
        by_rows(features, |rows, _| self.observation.forward(rows))
    }

    /// The five residual gates in the order position, scale, rotation, opacity, harmonics. `[5]`
    #[must_use]
    pub fn gates(&self) -> Tensor<1> {
        sigmoid(self.gate_logit.clone())
    }

    /// The gates on the host.
    ///
    /// # Errors
    /// When the device cannot hand them over.
    pub fn gates_on_host(&self) -> Result<[f32; 5]> {
        let gates = to_host(self.gates())?;
        gates
            .try_into()
            .map_err(|_| Error::BadConfiguration("the refiner has five gates".into()))
    }

    /// One update of one token set. `attributes` `[n, 59 * block^2]`, `state` `[n, S]`, `feedback` `[n, F]`
    #[must_use]
    pub fn forward(
        &self,
        attributes: Tensor<2>,
        state: Tensor<2>,
        feedback: Tensor<2>,
        neighbours: &Neighbours,
    ) -> UpdaterOutput {
        let mut tokens = self.embed(attributes, state.clone(), feedback);
        for block in &self.blocks {
            tokens = block.forward(tokens, neighbours);
        }
        let state = tokens + state;
        let residual = by_rows(state.clone(), |rows, _| {
            let [first, second, third, last] = &self.head;
            let hidden = [first, second, third]
                .iter()
                .fold(rows, |rows, layer| gelu(layer.forward(rows)));
            last.forward(hidden)
        });
        UpdaterOutput { state, residual }
    }

    /// The input layer alone.
    #[must_use]
    pub fn embed(&self, attributes: Tensor<2>, state: Tensor<2>, feedback: Tensor<2>) -> Tensor<2> {
        by_rows(attributes, |rows, first| {
            let range = first..first + rows.dims()[0];
            let part = |tensor: &Tensor<2>| {
                let [_, width] = tensor.dims();
                tensor.clone().slice([range.clone(), 0..width])
            };
            self.input
                .forward(Tensor::cat(vec![rows, part(&state), part(&feedback)], 1))
        })
    }

    /// The blocks.
    #[must_use]
    pub fn blocks(&self) -> &[NeighbourBlock] {
        &self.blocks
    }
}

/// Applies a function of rows (and the index of the first) piece by piece.
fn by_rows(input: Tensor<2>, function: impl Fn(Tensor<2>, usize) -> Tensor<2>) -> Tensor<2> {
    let [total, width] = input.dims();
    if total <= TOKENS_AT_A_TIME {
        return function(input, 0);
    }
    let piece = |first: usize| {
        let last = (first + TOKENS_AT_A_TIME).min(total);
        function(input.clone().slice([first..last, 0..width]), first)
    };
    Tensor::cat((0..total).step_by(TOKENS_AT_A_TIME).map(piece).collect(), 0)
}
