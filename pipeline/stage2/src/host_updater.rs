//! The updater without gradients on the CPU: the formulas of [`super::Updater`] on slices, whole layers a piece of rows at
//! a time, so that no array of the hidden width of all tokens is ever held.

use rayon::prelude::*;

use super::RefinerConfig;
use super::resnet::checked;
use crate::{Error, Result};
use rogs_kernels::pointwise::add_assign;
use rogs_kernels::{LayerNorm, Linear, ROWS_PER_PIECE, neighbour_attention};
use rogs_tensors::parameters::Parameters;

/// One neighbour-attention block.
#[derive(Debug, Clone)]
struct Block {
    norm1: LayerNorm,
    qkv: Linear,
    projection: Linear,
    norm2: LayerNorm,
    expand: Linear,
    contract: Linear,
    attention: usize,
    width: usize,
}

/// The parts of the updater that an update runs.
#[derive(Debug, Clone)]
pub(crate) struct HostUpdater {
    input: Linear,
    blocks: Vec<Block>,
    head: [Linear; 4],
    state: usize,
    /// Widths of attributes, state, feedback.
    parts: [usize; 3],
}

impl HostUpdater {
    /// Reads the parameters of a configuration.
    ///
    /// # Errors
    /// When one is missing or has another shape.
    pub(crate) fn load(parameters: &Parameters, config: &RefinerConfig) -> Result<Self> {
        let s = config.state;
        let get = |name: &str, shape: &[usize]| checked(parameters, &format!("encoder.{name}"), shape);
        let linear = |name: &str, outputs: usize, inputs: usize| -> Result<Linear> {
            let bias = get(&format!("{name}.bias"), &[outputs])?;
            Ok(Linear::new(
                &get(&format!("{name}.weight"), &[outputs, inputs])?,
                Some(bias),
                inputs,
                outputs,
            ))
        };
        let norm = |name: &str| -> Result<LayerNorm> {
            Ok(LayerNorm {
                weight: get(&format!("{name}.weight"), &[s])?,
                bias: get(&format!("{name}.bias"), &[s])?,
            })
        };
        let block = |index: usize| -> Result<Block> {
            let name = format!("update_module.1.blocks.{index}");
            let packed = 3 * config.attention;
            let qkv = get(&format!("{name}.attn.qkv.weight"), &[packed, s])?;
            Ok(Block {
                norm1: norm(&format!("{name}.norm1"))?,
                qkv: Linear::new(&qkv, None, s, packed),
                projection: linear(&format!("{name}.attn.proj"), s, config.attention)?,
                norm2: norm(&format!("{name}.norm2"))?,
                expand: linear(&format!("{name}.mlp.fc1"), 4 * s, s)?,
                contract: linear(&format!("{name}.mlp.fc2"), s, 4 * s)?,
                attention: config.attention,
                width: s,
            })
        };
        Ok(Self {
            input: linear("update_module.0.linear", s, config.inputs())?,
            blocks: (0..config.blocks).map(block).collect::<Result<_>>()?,
            head: [
                linear("update_head.0", s, s)?,
                linear("update_head.2", s, s)?,
                linear("update_head.4", s, s)?,
                linear("update_head.6", config.residuals(), s)?,
            ],
            state: s,
            parts: [config.residuals(), s, config.features()],
        })
    }

    /// One update of one token set: the new state replaces `state`, the residuals are returned. `attributes
    /// [n, 59 * block^2]`, `state [n, S]`, `feedback [n, F]`, `neighbours [n, count]`
    ///
    /// # Errors
    /// When the arrays do not fit each other.
    pub(crate) fn run(
        &self,
        attributes: &[f32],
        state: &mut [f32],
        feedback: &[f32],
        (neighbours, count): (&[u32], usize),
    ) -> Result<Vec<f32>> {
        let (s, [a, _, f]) = (self.state, self.parts);
        let n = state.len() / s;
        let fits = state.len() == n * s
            && attributes.len() == n * a
            && feedback.len() == n * f
            && neighbours.len() == n * count
            && neighbours.iter().all(|&index| (index as usize) < n);
        if !fits {
            return Err(Error::BadInput(format!(
                "the arrays of {n} tokens do not fit the updater"
            )));
        }
        let mut tokens = vec![0.0; n * s];
        tokens
            .par_chunks_mut(ROWS_PER_PIECE * s)
            .zip(state.par_chunks(ROWS_PER_PIECE * s))
            .enumerate()
            .for_each_init(Vec::new, |joined, (piece, (tokens, state))| {
                joined.clear();
                for (row, state) in state.chunks_exact(s).enumerate() {
                    let row = piece * ROWS_PER_PIECE + row;
                    joined.extend_from_slice(&attributes[row * a..][..a]);
                    joined.extend_from_slice(state);
                    joined.extend_from_slice(&feedback[row * f..][..f]);
                }
                self.input.apply(joined, tokens);
            });
        for block in &self.blocks {
            block.run(&mut tokens, neighbours, count);
        }
        let mut residuals = vec![0.0; n * a];
        residuals
            .par_chunks_mut(ROWS_PER_PIECE * a)
            .zip(tokens.par_chunks(ROWS_PER_PIECE * s))
            .zip(state.par_chunks_mut(ROWS_PER_PIECE * s))
            .for_each_init(
                || (Vec::new(), Vec::new()),
                |(from, to), ((residuals, tokens), state)| {
                    add_assign(state, tokens);
                    from.clear();
                    from.extend_from_slice(state);
                    let [first, second, third, last] = &self.head;
                    for layer in [first, second, third] {
                        to.resize(from.len(), 0.0);
                        layer.apply_gelu(from, to);
                        std::mem::swap(from, to);
                    }
                    last.apply(from, residuals);
                },
            );
        Ok(residuals)
    }
}

impl Block {
    fn run(&self, tokens: &mut [f32], neighbours: &[u32], count: usize) {
        let (s, p) = (self.width, self.attention);
        let mut qkv = vec![0.0; tokens.len() / s * 3 * p];
        qkv.par_chunks_mut(ROWS_PER_PIECE * 3 * p)
            .zip(tokens.par_chunks(ROWS_PER_PIECE * s))
            .for_each_init(Vec::new, |normalised, (qkv, tokens)| {
                normalised.clear();
                normalised.extend_from_slice(tokens);
                self.norm1.apply(normalised);
                self.qkv.apply(normalised, qkv);
            });
        let mixed = neighbour_attention(&qkv, p, neighbours, count);
        tokens
            .par_chunks_mut(ROWS_PER_PIECE * s)
            .zip(mixed.par_chunks(ROWS_PER_PIECE * p))
            .for_each_init(
                || (Vec::new(), Vec::new()),
                |(narrow, wide), (tokens, mixed)| {
                    narrow.resize(tokens.len(), 0.0);
                    self.projection.apply(mixed, narrow);
                    add_assign(tokens, narrow);
                    narrow.copy_from_slice(tokens);
                    self.norm2.apply(narrow);
                    wide.resize(4 * tokens.len(), 0.0);
                    self.expand.apply_gelu(narrow, wide);
                    self.contract.apply(wide, narrow);
                    add_assign(tokens, narrow);
                },
            );
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;
    use crate::updater::Neighbours;
    use crate::weights::uniform;
    use crate::{Updater, nearest_neighbours, parameter_shapes, seeded_parameters};
    use rogs_tensors::parameters::{from_host, to_host};

    /// Seeded parameters with a head that is not zero and norms that are not the identity.
    fn parameters(config: &RefinerConfig) -> Parameters {
        let mut parameters = seeded_parameters(config, 5, &Device::flex()).unwrap();
        for (name, shape) in parameter_shapes(config) {
            if name.contains("update_head.6") || name.contains(".norm") {
                let values = uniform(&name, shape.iter().product(), 5, 0.5);
                parameters.insert(&name, &shape, values).unwrap();
            }
        }
        parameters
    }

    #[test]
    fn slices_and_tensors_give_the_same_update() {
        for (name, n) in [("ci", 700), ("cpu", 300), ("ci", 3)] {
            let config = RefinerConfig::preset(name).unwrap();
            let parameters = parameters(&config);
            let (s, a, f) = (config.state, config.residuals(), config.features());
            let values = |name: &str, width: usize| uniform(name, n * width, 9, 1.0);
            let (attributes, mut state, feedback) = (values("a", a), values("s", s), values("f", f));
            let points: Vec<[f32; 3]> = values("p", 3).chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
            let count = config.neighbours.min(n);
            let near = nearest_neighbours(&points, count);
            let device = Device::flex();
            let expected = Updater::load(&parameters, &config).unwrap().forward(
                from_host(attributes.clone(), [n, a], &device),
                from_host(state.clone(), [n, s], &device),
                from_host(feedback.clone(), [n, f], &device),
                &Neighbours::new(&near, count, &device),
            );
            let host = HostUpdater::load(&parameters, &config).unwrap();
            let residual = host.run(&attributes, &mut state, &feedback, (&near, count)).unwrap();
            let pairs = [(state.clone(), expected.state), (residual, expected.residual)];
            for (found, expected) in pairs {
                let expected = to_host(expected).unwrap();
                assert_eq!(found.len(), expected.len());
                assert!(expected.iter().any(|value| value.abs() > 0.1), "something to compare");
                for (a, b) in found.iter().zip(&expected) {
                    assert!((a - b).abs() <= 2e-5 * (1.0 + b.abs()), "{name}: {a} {b}");
                }
            }
            assert!(
                host.run(&attributes[1..], &mut state, &feedback, (&near, count))
                    .is_err()
            );
        }
    }
}
