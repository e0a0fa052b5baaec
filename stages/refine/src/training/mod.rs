//! Gradients of the Stage-2 objective with respect to the trained parameters (`docs/spec/stage2.md` section B.8).
//!
//! Corrections and feedback renders are constants from one update to the next; only the hidden state carries gradients
//! through time. So the objective after update `r` depends on the parameters through the residuals of that update
//! alone, given its inputs: the rasteriser's backward pass turns the objective's gradient in the renders into one in the
//! corrections, and the sum of residuals times that constant gradient is a surrogate whose gradient in the parameters is
//! that of the objective.
//!
//! A trainer loads parameters on an autodiff device, calls [`AdamW::track`], [`Refiner::load`], [`training_step`] and
//! [`AdamW::step`], clip after clip. Every term of the objective is taken from what the clip has: a clip without stereo
//! depth, robot, tracks or right eyes simply has fewer terms, and those are zero.

mod chain;
mod optimiser;
mod outcome;
mod targets;

use burn::tensor::{Int, Tensor, TensorData};
use rogs_field::{Correction, GateGroup};
use rogs_schemas::FrameIndex;
use rogs_schemas::records::refinement::RESIDUAL_CHANNELS;
use rogs_stage2::objective::{ObjectiveTerms, ObjectiveWeights, Perceptual};
use rogs_stage2::updater::Neighbours;
use rogs_stage2::{Refiner, nearest_neighbours};
use rogs_tensors::parameters::{from_host, to_host};
use rogs_worker::{StageResult, Unobserved};

pub use optimiser::AdamW;

use crate::refinement::{Feedback, feedback, internal};
use crate::source_time::source_times;
use crate::{ClipInputs, RefineParams};
use chain::scene_at;
use outcome::correction_gradient;
use targets::Targets;

/// What a training step is judged by.
#[derive(Clone, Copy, Default)]
pub struct TrainingOptions<'a> {
    /// Weights of the terms.
    pub weights: ObjectiveWeights,
    /// Query times as clip frames; the field must have them stored. Empty for the source frames.
    pub frames: &'a [FrameIndex],
    /// Whether the paired-right cameras of the clip are targets too.
    pub right_views: bool,
    /// Perceptual distance of a render from its observation, for example LPIPS; without it that term is zero.
    pub perceptual: Option<Perceptual<'a>>,
}

/// The terms of the objective after one update, as numbers.
pub type TermValues = ObjectiveTerms<f64>;

/// What one training step on one clip gives.
pub struct TrainingStep {
    /// The objective over all updates.
    pub objective: f64,
    /// Its terms after each update.
    pub terms: Vec<TermValues>,
    /// Its gradient with respect to the parameters is that of the objective; its value means nothing. `[1]`
    pub surrogate: Tensor<1>,
}

/// Runs the updates of `params` on a clip and differentiates the objective after each of them.
///
/// `refiner` must be loaded from parameters on an autodiff device whose trained tensors require gradients
/// ([`AdamW::track`]).
///
/// # Errors
/// When the records do not belong together, the field lacks a query time, or the device fails.
pub fn training_step(
    inputs: ClipInputs<'_>,
    refiner: &Refiner,
    params: &RefineParams,
    options: &TrainingOptions<'_>,
) -> StageResult<TrainingStep> {
    let (_, updates) = params.resolve()?;
    let times = source_times(inputs.clip, inputs.robot, inputs.field, refiner)?;
    let (device, field) = (refiner.device(), inputs.field);
    let mut states = Vec::with_capacity(times.len());
    for time in &times {
        let features = time.maps.iter().flat_map(|maps| {
            rogs_stage2::observation::gather_features(
                maps,
                field.height as usize,
                field.width as usize,
                refiner.config().token_block,
            )
        });
        let features = from_host(
            features.collect(),
            [time.grid.len(), refiner.config().features()],
            device,
        );
        states.push(refiner.updater().initial_state(features));
    }
    let targets = Targets::new(&inputs, params, options)?;
    let mut correction = Correction::zero(field.len());
    let mut result = TrainingStep {
        objective: 0.0,
        terms: Vec::new(),
        surrogate: Tensor::zeros([1], device),
    };
    for update in 0..updates {
        let before = correction.clone();
        let mut residuals = Vec::with_capacity(times.len());
        let mut shortening = vec![1.0; field.len()];
        for (time, state) in times.iter().zip(&mut states) {
            let scene = scene_at(field, &before, params.scale_residual, time.slice.time)?;
            let feedback = feedback(field, refiner, params, time, scene, &before, &mut Unobserved)?;
            let (residual, new_state) = updated(refiner, &feedback, state.clone())?;
            *state = new_state;
            let values = to_host(residual.clone()).map_err(internal)?;
            for (gaussian, row) in feedback.corrected.iter().zip(values.chunks_exact(RESIDUAL_CHANNELS)) {
                if let Some(gaussian) = gaussian {
                    shortening[*gaussian as usize] = correction.add(*gaussian as usize, row, refiner.gates());
                }
            }
            residuals.push((residual, feedback.corrected));
        }
        let weight = options.weights.discount.powi((updates - 1 - update) as i32);
        let (terms, gradient) =
            correction_gradient(field, &targets, &correction, params, options, device, &shortening)?;
        result.objective += weight * terms.total;
        result.terms.push(terms);
        for (residual, corrected) in residuals {
            let constant = gathered(&gradient, &corrected, weight as f32);
            let constant = from_host(constant, residual.dims(), device);
            let term = (residual * gate_row(refiner) * constant).sum();
            result.surrogate = result.surrogate + term;
        }
    }
    Ok(result)
}

/// One call of the updater, differentiable: residual of the set, and the state with the set's rows replaced.
fn updated(refiner: &Refiner, feedback: &Feedback, state: Tensor<2>) -> StageResult<(Tensor<2>, Tensor<2>)> {
    let (device, config, set) = (refiner.device(), refiner.config(), &feedback.set);
    let n = set.tokens.len();
    if n == 0 {
        return Ok((Tensor::zeros([0, config.residuals()], device), state));
    }
    let count = config.neighbours.min(n);
    let neighbours = Neighbours::new(&nearest_neighbours(&set.positions, count), count, device);
    let tokens: Vec<i32> = set.tokens.iter().map(|&token| token as i32).collect();
    let tokens: Tensor<1, Int> = Tensor::from_data(TensorData::new(tokens, [n]), device);
    let rows = state.clone().select(0, tokens.clone());
    let attributes = from_host(set.attributes.clone(), [n, config.residuals()], device);
    let pooled = from_host(set.feedback.clone(), [n, config.features()], device);
    let output = refiner.updater().forward(attributes, rows.clone(), pooled, &neighbours);
    let state = state.select_assign(0, tokens, output.state - rows, burn::tensor::IndexingUpdateOp::Add);
    Ok((output.residual, state))
}

/// The gates laid out over the residual channels of a token. `[1, 59 * block^2]`
fn gate_row(refiner: &Refiner) -> Tensor<2> {
    let group = |channel: usize| {
        GateGroup::ALL
            .iter()
            .position(|group| group.channels().contains(&channel))
            .unwrap_or(0) as i32
    };
    let channels = refiner.config().residuals();
    let groups: Vec<i32> = (0..channels)
        .map(|channel| group(channel % RESIDUAL_CHANNELS))
        .collect();
    let groups: Tensor<1, Int> = Tensor::from_data(TensorData::new(groups, [channels]), refiner.device());
    refiner.updater().gates().select(0, groups).unsqueeze()
}

/// The gradient of the Gaussians that the rows of a residual correct; zero for those left alone.
fn gathered(gradient: &[f32], corrected: &[Option<u32>], weight: f32) -> Vec<f32> {
    let mut out = vec![0.0; corrected.len() * RESIDUAL_CHANNELS];
    for (row, gaussian) in out.chunks_exact_mut(RESIDUAL_CHANNELS).zip(corrected) {
        if let Some(gaussian) = gaussian {
            let source = &gradient[*gaussian as usize * RESIDUAL_CHANNELS..][..RESIDUAL_CHANNELS];
            row.iter_mut()
                .zip(source)
                .for_each(|(out, value)| *out = weight * value);
        }
    }
    out
}
