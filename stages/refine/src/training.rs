//! Gradients of the Stage-2 objective with respect to the trained parameters (`stage2-network.md` section B.8).
//!
//! Corrections and feedback renders are constants from one update to the next; only the hidden state carries gradients
//! through time. So the objective after update `r` depends on the parameters through the residuals of that update
//! alone, given its inputs: the rasteriser's backward pass turns the objective's gradient in the renders into one in the
//! corrections, and the sum of residuals times that constant gradient is a surrogate whose gradient in the parameters is
//! that of the objective.

use std::collections::BTreeMap;

use burn::tensor::{Int, Tensor, TensorData};
use rogs_networks::parameters::{Parameters, from_host, to_host};
use rogs_networks::stage2::objective::{ObjectiveWeights, RenderedView, UpdateOutcome, ViewSide, update_objective};
use rogs_networks::stage2::updater::Neighbours;
use rogs_networks::stage2::weights::is_trained;
use rogs_networks::stage2::{Correction, GateGroup, Refiner, nearest_neighbours};
use rogs_schemas::records::field::{Field, RAW_CHANNELS, TimeSlice};
use rogs_schemas::records::refinement::{RESIDUAL_CHANNELS, ScaleResidual};
use rogs_schemas::units::m_from_iu;
use rogs_splat::backward::{Gradients, RenderGradient, backward_into, render_with_tape};
use rogs_splat::{Colour, Gaussians, RasterConfig, TimedField};
use rogs_worker::StageResult;

use crate::refinement::{Feedback, bad_field, feedback, internal, step};
use crate::source_time::{SourceTime, source_times};
use crate::{ClipInputs, RefineParams};

/// AdamW over the trained parameters of a store (`stage2-network.md` section B.8). Rates are fields, so that a schedule
/// sets them before each step.
#[derive(Debug, Clone)]
pub struct AdamW {
    /// Learning rate of the updater.
    pub learning_rate: f32,
    /// Learning rate of the residual gates.
    pub gate_learning_rate: f32,
    /// Decoupled weight decay of matrices; gates, biases and normalisations have none.
    pub weight_decay: f32,
    /// Largest norm of the gradient of all parameters together.
    pub clip: f32,
    steps: i32,
    moments: BTreeMap<String, [Vec<f32>; 2]>,
}

impl Default for AdamW {
    /// The paper's rates and decay, ReSplat's clip.
    fn default() -> Self {
        Self {
            learning_rate: 1e-4,
            gate_learning_rate: 1.521e-4,
            weight_decay: 0.01,
            clip: 0.5,
            steps: 0,
            moments: BTreeMap::new(),
        }
    }
}

impl AdamW {
    /// Makes the trained parameters of a store require gradients. Call it before the network is loaded from them.
    pub fn track(parameters: &mut Parameters) {
        for (name, parameter) in parameters.memory_mut() {
            if is_trained(name) {
                parameter.values = parameter.values.clone().require_grad();
            }
        }
    }

    /// Differentiates a surrogate and moves the parameters.
    ///
    /// # Errors
    /// When the device fails.
    pub fn step(&mut self, parameters: &mut Parameters, surrogate: &Tensor<1>) -> StageResult<()> {
        const BETAS: [f32; 2] = [0.9, 0.999];
        let gradients = surrogate.backward();
        let mut found = Vec::new();
        for (name, parameter) in parameters.memory().iter().filter(|(name, _)| is_trained(name)) {
            if let Some(gradient) = parameter.values.grad(&gradients) {
                found.push((
                    name.clone(),
                    parameter.shape.clone(),
                    to_host(gradient).map_err(internal)?,
                ));
            }
        }
        let square = |values: &[f32]| {
            values
                .iter()
                .map(|&value| f64::from(value) * f64::from(value))
                .sum::<f64>()
        };
        let norm = found
            .iter()
            .map(|(_, _, gradient)| square(gradient))
            .sum::<f64>()
            .sqrt() as f32;
        let share = if norm > self.clip { self.clip / norm } else { 1.0 };
        self.steps += 1;
        let unbias = BETAS.map(|beta| 1.0 - beta.powi(self.steps));
        for (name, shape, gradient) in found {
            let gate = name == "encoder.update_gate.logit";
            let rate = if gate {
                self.gate_learning_rate
            } else {
                self.learning_rate
            };
            let decay = if shape.len() > 1 { self.weight_decay } else { 0.0 };
            let mut values = parameters.host(&name).map_err(internal)?;
            let moments = self.moments.entry(name.clone());
            let [first, second] = moments.or_insert_with(|| [vec![0.0; gradient.len()], vec![0.0; gradient.len()]]);
            for (index, gradient) in gradient.iter().map(|value| value * share).enumerate() {
                first[index] = BETAS[0] * first[index] + (1.0 - BETAS[0]) * gradient;
                second[index] = BETAS[1] * second[index] + (1.0 - BETAS[1]) * gradient * gradient;
                let direction = first[index] / unbias[0] / ((second[index] / unbias[1]).sqrt() + 1e-8);
                values[index] -= rate * (direction + decay * values[index]);
            }
            parameters.insert(&name, &shape, values).map_err(internal)?;
        }
        Ok(())
    }
}

/// What one training step on one clip gives.
pub struct TrainingStep {
    /// The objective over all updates.
    pub objective: f64,
    /// Mean absolute colour difference at the source views after each update.
    pub rendering: Vec<f64>,
    /// Its gradient with respect to the parameters is that of the objective; its value means nothing. `[1]`
    pub surrogate: Tensor<1>,
}

/// Runs some updates on a clip and differentiates the rendering and coverage terms at the source views.
///
/// `refiner` must be loaded from parameters on an autodiff device whose trained tensors require gradients. Depth, robot
/// and motion terms need references that not every clip has; they are terms of the objective and not of this function.
///
/// # Errors
/// When the records do not belong together, or the device fails.
pub fn training_step(
    inputs: ClipInputs<'_>,
    refiner: &Refiner,
    params: &RefineParams,
    weights: &ObjectiveWeights,
) -> StageResult<TrainingStep> {
    let (_, updates) = params.resolve()?;
    let times = source_times(inputs.clip, inputs.robot, inputs.field, refiner)?;
    let (device, field) = (refiner.device(), inputs.field);
    let mut states = Vec::with_capacity(times.len());
    for time in &times {
        let features = time.maps.iter().flat_map(|maps| {
            rogs_networks::stage2::observation::gather_features(
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
    let mut correction = Correction::zero(field.len());
    let mut result = TrainingStep {
        objective: 0.0,
        rendering: Vec::new(),
        surrogate: Tensor::zeros([1], device),
    };
    for update in 0..updates {
        let before = correction.clone();
        let mut residuals = Vec::with_capacity(times.len());
        let mut shortening = vec![1.0; field.len()];
        for (time, state) in times.iter().zip(&mut states) {
            let scene = scene_at(field, &before, params.scale_residual, time.slice.time)?;
            let feedback = feedback(field, refiner, params, time, scene, &before, &mut |_, _| {})?;
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
        let weight = weights.discount.powi((updates - 1 - update) as i32);
        let (objective, rendering, gradient) =
            correction_gradient(field, refiner, &times, &correction, params, weights, &shortening)?;
        result.objective += weight * objective;
        result.rendering.push(rendering);
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

/// The corrected field at a stored time with harmonics of full degree, whatever the correction.
fn scene_at(field: &Field, correction: &Correction, mode: ScaleResidual, time: f64) -> StageResult<Gaussians> {
    let stored = step(0, correction);
    let timed = TimedField::new(field)
        .and_then(|field| field.with_correction(&stored, mode))
        .map_err(bad_field)?;
    let mut scene = timed.gaussians(time).map_err(bad_field)?;
    let values = scene.colour.values();
    let known = scene.colour.values_per_gaussian();
    let mut coefficients = vec![0.0; 48 * scene.len()];
    for (full, values) in coefficients.chunks_exact_mut(48).zip(values.chunks_exact(known)) {
        full[..known].copy_from_slice(values);
        if matches!(scene.colour, Colour::Rgb(_)) {
            full[..3]
                .iter_mut()
                .for_each(|value| *value = rogs_splat::sh::coefficient_from_colour(*value));
        }
    }
    scene.colour = Colour::Sh {
        degree: 3,
        coefficients,
    };
    Ok(scene)
}

/// The objective at the source views, its rendering term, and its gradient in the corrections before the bound, position
/// in internal units. `[N, 59]`
fn correction_gradient(
    field: &Field,
    refiner: &Refiner,
    times: &[SourceTime<'_>],
    correction: &Correction,
    params: &RefineParams,
    weights: &ObjectiveWeights,
    shortening: &[f32],
) -> StageResult<(f64, f64, Vec<f32>)> {
    let (device, raster) = (refiner.device(), RasterConfig::default());
    let mut scenes = Vec::with_capacity(times.len());
    let (mut tapes, mut views) = (Vec::new(), Vec::new());
    for (index, time) in times.iter().enumerate() {
        let scene = scene_at(field, correction, params.scale_residual, time.slice.time)?;
        for (camera, observed) in time.cameras.iter().zip(&time.observed) {
            let (render, tape) = render_with_tape(&scene, camera, &raster).map_err(internal)?;
            let pixels = render.alpha.len();
            let depth_m = render.depth_expected.iter().map(|&depth| m_from_iu(depth)).collect();
            views.push(RenderedView {
                side: ViewSide::Source,
                rgb: from_host(render.rgb, [pixels, 3], device).require_grad(),
                observed_rgb: from_host(observed.data.clone(), [pixels, 3], device),
                depth_m: from_host(depth_m, [pixels], device),
                observed_depth_m: Tensor::ones([pixels], device),
                // Every source pixel should be covered; without a depth reference its term is constant.
                depth_valid: Tensor::ones([pixels], device),
                alpha: from_host(render.alpha, [pixels], device).require_grad(),
            });
            tapes.push((index, tape));
        }
        scenes.push(scene);
    }
    let outcome = UpdateOutcome {
        views,
        robot: None,
        motion: None,
    };
    let terms = update_objective(&outcome, &ObjectiveWeights { depth: 0.0, ..*weights }, None);
    let number = |tensor: Tensor<1>| to_host(tensor).map(|values| f64::from(values[0])).map_err(internal);
    let (objective, rendering) = (number(terms.total.clone())?, number(terms.rendering)?);
    let gradients = terms.total.backward();
    let mut into: Vec<Gradients> = scenes.iter().map(Gradients::zeros).collect();
    for (view, (index, tape)) in outcome.views.iter().zip(&tapes) {
        let rgb = view
            .rgb
            .grad(&gradients)
            .map(to_host)
            .transpose()
            .map_err(internal)?
            .unwrap_or_default();
        let alpha = view
            .alpha
            .grad(&gradients)
            .map(to_host)
            .transpose()
            .map_err(internal)?
            .unwrap_or_default();
        let gradient = RenderGradient {
            rgb: &rgb,
            alpha: &alpha,
            ..RenderGradient::default()
        };
        backward_into(&scenes[*index], &raster, tape, &gradient, &mut into[*index]).map_err(internal)?;
    }
    let mut total = vec![0.0; field.len() * RESIDUAL_CHANNELS];
    for ((time, scene), gradients) in times.iter().zip(&scenes).zip(&into) {
        add_chained(
            field,
            time.slice,
            scene,
            correction,
            params.scale_residual,
            gradients,
            &mut total,
        );
    }
    for ((n, row), &factor) in total.chunks_exact_mut(RESIDUAL_CHANNELS).enumerate().zip(shortening) {
        if factor < 1.0 {
            bound_gradient(&mut row[..3], &correction.row(n)[..3], factor);
        }
    }
    Ok((objective, rendering, total))
}

/// Gradient through the bound: the radial part vanishes, the rest shrinks with the vector.
fn bound_gradient(gradient: &mut [f32], bounded: &[f32], factor: f32) {
    let square: f32 = bounded.iter().map(|value| value * value).sum();
    let along: f32 = gradient.iter().zip(bounded).map(|(g, b)| g * b).sum::<f32>() / square;
    for (gradient, bounded) in gradient.iter_mut().zip(bounded) {
        *gradient = factor * (*gradient - along * bounded);
    }
}

/// Adds the gradient in the corrections that follows from one in the Gaussians at one time.
fn add_chained(
    field: &Field,
    slice: &TimeSlice,
    scene: &Gaussians,
    correction: &Correction,
    mode: ScaleResidual,
    gradients: &Gradients,
    total: &mut [f32],
) {
    let raw = slice.raw(&field.base_raw);
    for (n, row) in total.chunks_exact_mut(RESIDUAL_CHANNELS).enumerate() {
        let (raw, shift) = (&raw[n * RAW_CHANNELS..(n + 1) * RAW_CHANNELS], correction.row(n));
        for axis in 0..3 {
            row[axis] += gradients.means[3 * n + axis];
            let scale = scene.scales[3 * n + axis];
            let slope = match mode {
                _ if scale >= field.scale_cap_iu[n] => 0.0,
                ScaleResidual::PreActivation if scale >= rogs_splat::field::MAX_SCALE_IU => 0.0,
                ScaleResidual::PreActivation => {
                    rogs_splat::field::SCALE_STEP_IU * rogs_splat::field::logistic(raw[3 + axis] + shift[3 + axis])
                }
                ScaleResidual::Linear if scale <= rogs_splat::field::MIN_LINEAR_SCALE_IU => 0.0,
                ScaleResidual::Linear => 1.0,
            };
            row[3 + axis] += slope * gradients.scales[3 * n + axis];
        }
        for part in 0..4 {
            row[6 + part] += gradients.quats[4 * n + part];
        }
        let opacity = scene.opacities[n];
        row[10] += opacity * (1.0 - opacity) * gradients.opacities[n];
        for coefficient in 0..16 {
            for colour in 0..3 {
                row[11 + 16 * colour + coefficient] += gradients.colour[48 * n + 3 * coefficient + colour];
            }
        }
    }
}
