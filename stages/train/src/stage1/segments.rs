//! Gradient checkpointing: the backward pass of a clip in segments, of which only one keeps its intermediate results.
//!
//! A pass without gradients keeps the tokens that enter each pair of the aggregator. Then heads and losses are
//! differentiated down to the taps, each pair, from the last to the first, down to its input, and at last encoder and
//! embedding. Every pair runs twice; weights of a large checkpoint are read from its file for one pair at a time.

use burn::tensor::Tensor;
use rogs_networks::optimiser::{Gradients, collect};
use rogs_networks::stage1::Stage1;
use rogs_random::Pcg64;

use super::forward::{Heads, decode, source_frames};
use super::objective::{Losses, Objective, objective};
use crate::error::{Error, Result};
use crate::sample::Sample;

/// Objective and gradients of a clip; `network` has leaves that record gradients.
pub(super) fn differentiate(
    network: &Stage1,
    clip: &Sample,
    (conditioned, heads): (bool, Heads),
    losses: Losses<'_>,
    random: &mut Pcg64,
) -> Result<(Objective, Gradients)> {
    let tapped = |pair: usize| network.config.taps.iter().position(|&tap| tap == pair);
    let (inputs, taps) = without_gradients(network, clip)?;
    let frames = source_frames(clip, network.parameters.device());

    let mut gradients = Gradients::new();
    let leaves = taps.map(|tap| tap.autodiff().require_grad());
    let encoded = network.encoded(leaves.clone(), network.local(&frames)?, clip.size)?;
    let lifted = decode(network, clip, &encoded, conditioned, heads)?;
    let objective = objective(clip, &lifted, losses, random)?;
    drop((lifted, encoded));
    let mut graph = objective.loss.backward();
    collect(&network.parameters, &mut graph, &mut gradients)?;
    let of_taps = leaves.map(|leaf| leaf.grad_remove(&mut graph));
    drop(graph);

    let aggregator = network.aggregator();
    let grid = network.config.grid(clip.size[0], clip.size[1])?;
    let layout = aggregator.layout(clip.views.len(), grid, &frames.attention)?;
    let mut of_output: Option<Tensor<3>> = None;
    for (pair, input) in inputs.into_iter().enumerate().rev() {
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
        collect(&network.parameters, &mut graph, &mut gradients)?;
        of_output = input.grad_remove(&mut graph);
    }
    if let Some(gradient) = of_output {
        let local = network.local(&frames)?;
        let patches = network.patch_tokens(&frames, local.as_ref())?;
        let tokens = network.embed(&frames, patches)?;
        // Nothing here records gradients when only low-rank updates are trained.
        if tokens.is_tracked() {
            let mut graph = (tokens * gradient.autodiff()).sum().backward();
            collect(&network.parameters, &mut graph, &mut gradients)?;
        }
    }
    Ok((objective, gradients))
}

/// Inputs of all pairs and outputs of the tapped ones, as plain tensors.
fn without_gradients(network: &Stage1, clip: &Sample) -> Result<(Vec<Tensor<3>>, [Tensor<3>; 4])> {
    let plain = Stage1::new(network.config.clone(), network.parameters.without_gradients())?;
    let frames = source_frames(clip, plain.parameters.device());
    let local = plain.local(&frames)?;
    let mut tokens = plain.embed(&frames, plain.patch_tokens(&frames, local.as_ref())?)?;
    let aggregator = plain.aggregator();
    let grid = plain.config.grid(clip.size[0], clip.size[1])?;
    let layout = aggregator.layout(clip.views.len(), grid, &frames.attention)?;
    let (mut inputs, mut taps) = (Vec::new(), Vec::new());
    for pair in 0..=plain.config.taps[3] {
        inputs.push(tokens.clone());
        let [frame, global] = aggregator.pair(pair, tokens, &layout)?;
        if plain.config.taps.contains(&pair) {
            taps.push(Tensor::cat(vec![frame, global.clone()], 2));
        }
        tokens = global;
    }
    let short = |_| rogs_networks::Error::BadConfiguration("fewer than four taps".into());
    Ok((inputs, taps.try_into().map_err(short).map_err(Error::from)?))
}
