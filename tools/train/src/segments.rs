//! Gradient checkpointing of the aggregator: its backward pass in segments, of which only one keeps its intermediate results.
//!
//! A pass without gradients keeps the tokens that enter each pair, and the taps. The caller differentiates what follows down
//! to the taps; then each pair, from the last to the first, runs again and is differentiated down to its input. Weights of a
//! large checkpoint are read from its file for one pair at a time.

use burn::tensor::Tensor;
use rogs_stage1::{SourceFrames, Stage1};
use rogs_tensors::optimiser::{Gradients, collect};

use crate::error::{Error, Result};

/// What a pass without gradients keeps.
pub(crate) struct Segments {
    /// Inputs of all pairs. `[S, T, C]` each
    inputs: Vec<Tensor<3>>,
    /// Outputs of the tapped pairs. `[S, T, 2C]` each
    pub(crate) taps: [Tensor<3>; 4],
}

impl Segments {
    /// Runs the aggregator of a network without gradients on patch tokens `[S, N, C]`.
    pub(crate) fn run(plain: &Stage1, frames: &SourceFrames, tokens: Tensor<3>) -> Result<Self> {
        let [count, _, height, width] = frames.images.dims();
        let mut tokens = plain.embed(frames, tokens)?;
        let aggregator = plain.aggregator();
        let layout = aggregator.layout(count, plain.config.grid(height, width)?, &frames.attention)?;
        let (mut inputs, mut taps) = (Vec::new(), Vec::new());
        for pair in 0..=plain.config.taps[3] {
            inputs.push(tokens.clone());
            let [frame, global] = aggregator.pair(pair, tokens, &layout)?;
            if plain.config.taps.contains(&pair) {
                taps.push(Tensor::cat(vec![frame, global.clone()], 2));
            }
            tokens = global;
        }
        let short = |_| rogs_tensors::Error::BadConfiguration("fewer than four taps".into());
        let taps = taps.try_into().map_err(short).map_err(Error::from)?;
        Ok(Self { inputs, taps })
    }

    /// Takes gradients of the taps back through all pairs of the same network with gradients: adds those of its parameters
    /// and returns that of what enters the first pair, a plain tensor. `[S, T, C]`
    pub(crate) fn back(
        self,
        network: &Stage1,
        frames: &SourceFrames,
        of_taps: &[Option<Tensor<3>>; 4],
        gradients: &mut Gradients,
    ) -> Result<Option<Tensor<3>>> {
        let [count, _, height, width] = frames.images.dims();
        let tapped = |pair: usize| network.config.taps.iter().position(|&tap| tap == pair);
        let aggregator = network.aggregator();
        let layout = aggregator.layout(count, network.config.grid(height, width)?, &frames.attention)?;
        let mut of_output: Option<Tensor<3>> = None;
        for (pair, input) in self.inputs.into_iter().enumerate().rev() {
            let input = input.autodiff().require_grad();
            let [frame, global] = aggregator.pair(pair, input.clone(), &layout)?;
            let mut parts = Vec::new();
            if let Some(gradient) = tapped(pair).and_then(|tap| of_taps[tap].clone()) {
                parts.push((Tensor::cat(vec![frame, global.clone()], 2) * gradient.autodiff()).sum());
            }
            if let Some(gradient) = of_output.take() {
                parts.push((global * gradient.autodiff()).sum());
            }
            let Some(product) = parts.into_iter().reduce(|a, b| a + b) else {
                continue;
            };
            let mut graph = product.backward();
            collect(&network.parameters, &mut graph, gradients)?;
            of_output = input.grad_remove(&mut graph);
        }
        Ok(of_output)
    }
}
