//! Objective and gradients of a clip with gradient checkpointing.

use rogs_random::Pcg64;
use rogs_stage1::Stage1;
use rogs_tensors::optimiser::{Gradients, collect};

use super::forward::{Heads, decode, source_frames};
use super::objective::objective;
use super::terms::{Losses, Objective};
use crate::error::Result;
use crate::sample::Sample;
use crate::segments::Segments;

/// Objective and gradients of a clip; `network` has leaves that record gradients. Heads and losses are differentiated first,
/// then the aggregator pair by pair, at last encoder and embedding.
pub(super) fn differentiate(
    network: &Stage1,
    clip: &Sample,
    (conditioned, heads): (bool, Heads),
    losses: Losses<'_>,
    random: &mut Pcg64,
) -> Result<(Objective, Gradients)> {
    let plain = Stage1::new(network.config.clone(), network.parameters.without_gradients())?;
    let plain_frames = source_frames(clip, plain.parameters.device());
    let tokens = plain.patch_tokens(&plain_frames, plain.local(&plain_frames)?.as_ref())?;
    let segments = Segments::run(&plain, &plain_frames, tokens)?;
    let frames = source_frames(clip, network.parameters.device());

    let mut gradients = Gradients::new();
    let leaves = segments.taps.clone().map(|tap| tap.autodiff().require_grad());
    let encoded = network.encoded(leaves.clone(), network.local(&frames)?, clip.size)?;
    let lifted = decode(network, clip, &encoded, conditioned, heads)?;
    let objective = objective(clip, &lifted, losses, random)?;
    drop((lifted, encoded));
    let mut graph = objective.loss.backward();
    collect(&network.parameters, &mut graph, &mut gradients)?;
    let of_taps = leaves.map(|leaf| leaf.grad_remove(&mut graph));
    drop(graph);

    if let Some(gradient) = segments.back(network, &frames, &of_taps, &mut gradients)? {
        let patches = network.patch_tokens(&frames, network.local(&frames)?.as_ref())?;
        let tokens = network.embed(&frames, patches)?;
        // Nothing here records gradients when only low-rank updates are trained.
        if tokens.is_tracked() {
            let mut graph = (tokens * gradient.autodiff()).sum().backward();
            collect(&network.parameters, &mut graph, &mut gradients)?;
        }
    }
    Ok((objective, gradients))
}
