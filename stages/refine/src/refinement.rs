//! The recurrent refinement of one clip (`docs/spec/stage2.md` section B.7).

use std::time::Instant;

use rogs_field::{Correction, TimedField, raw_at};
use rogs_schemas::records::field::{Field, NamedArray, RAW_CHANNELS};
use rogs_schemas::records::refinement::{RESIDUAL_CHANNELS, Refinement, RefinementStep};
use rogs_schemas::units::iu_from_m;
use rogs_splat::{Contributions, Eligible, Gaussians, RasterConfig, Render, render_views_with_contributions};
use rogs_stage2::{FeatureMap, Refiner, TokenSet};
use rogs_worker::{Observer, Part, StageError, StageResult};

use crate::recurrence::{ClipInputs, Recurrence, state_name};
use crate::resume::resumed;
use crate::source_time::{SourceTime, source_times};
use crate::{LoadedRefiner, RefineParams};

/// Refines a field. `observer` hears the fraction done, what is being done, and of the n-th update how long it took, under
/// the name `update_N`: for the time that fewer updates would have taken.
///
/// # Errors
/// When the records do not belong together, or the earlier refinement does not fit.
pub fn refine(
    inputs: ClipInputs<'_>,
    network: &LoadedRefiner,
    params: &RefineParams,
    observer: &mut dyn Observer,
) -> StageResult<Refinement> {
    let (_, updates) = params.resolve()?;
    observer.progress(0.0, "features of the observed images");
    let times = source_times(inputs.clip, inputs.robot, inputs.field, &network.refiner)?;
    let mut recurrence = match inputs.resume {
        Some(earlier) => resumed(earlier, &inputs, network, params, &times, updates)?,
        None => beginning(inputs.field, network, &times)?,
    };
    let total = f64::from(updates - recurrence.update) * times.len() as f64;
    let mut done = 0.0;
    while recurrence.update < updates {
        let start = Instant::now();
        let before = recurrence.correction.clone();
        let stored = step(recurrence.update, &before);
        let corrected = TimedField::new(inputs.field)
            .and_then(|field| field.with_correction(&stored, params.scale_residual))
            .map_err(bad_field)?;
        for (time, state) in times.iter().zip(&mut recurrence.states) {
            let update = recurrence.update + 1;
            let name = format!("update {update} of {updates}, source frame {}", time.frame);
            let mut part = Part::new(observer, 0.02 + 0.97 * done / total, 0.97 / total).named(name);
            part.progress(0.0, "render");
            let scene = corrected.gaussians(time.slice.time).map_err(bad_field)?;
            let after = &mut recurrence.correction;
            update_source_time(&inputs, network, params, time, scene, &before, after, state, &mut part)?;
            done += 1.0;
        }
        recurrence.update += 1;
        if params.keep_intermediate && recurrence.update < updates {
            recurrence.steps.push(step(recurrence.update, &recurrence.correction));
        }
        observer.add_seconds(&format!("update_{}", recurrence.update), start.elapsed().as_secs_f64());
    }
    Ok(record(&inputs, network, params, &times, recurrence))
}

/// The state before the first update.
fn beginning(field: &Field, network: &LoadedRefiner, times: &[SourceTime<'_>]) -> StageResult<Recurrence> {
    let (height, width) = (field.height as usize, field.width as usize);
    let state = |time: &SourceTime<'_>| {
        network
            .refiner
            .initial_state(&time.maps, height, width)
            .map_err(internal)
    };
    Ok(Recurrence {
        update: 0,
        correction: Correction::zero(field.len()),
        states: times.iter().map(state).collect::<StageResult<_>>()?,
        steps: Vec::new(),
    })
}

/// One update of the Gaussians of one source time: renders the field of `before` (the scene), pools what the error
/// encoder says, and adds the updater's residuals to `after`. All source times read the same `before`, so their order is
/// irrelevant.
fn update_source_time(
    inputs: &ClipInputs<'_>,
    network: &LoadedRefiner,
    params: &RefineParams,
    time: &SourceTime<'_>,
    scene: Gaussians,
    before: &Correction,
    after: &mut Correction,
    state: &mut [f32],
    observer: &mut dyn Observer,
) -> StageResult<()> {
    let refiner = &network.refiner;
    let Feedback { set, corrected } = feedback(inputs.field, refiner, params, time, scene, before, observer)?;
    observer.progress(0.7, "updater");
    let residuals = refiner.update(&time.grid, set, state).map_err(internal)?;
    let rows = residuals.chunks_exact(RESIDUAL_CHANNELS);
    for (gaussian, residual) in corrected.into_iter().zip(rows) {
        if let Some(gaussian) = gaussian {
            after.add(gaussian as usize, residual, refiner.gates());
        }
    }
    Ok(())
}

/// What the renders of one source time say about its Gaussians.
pub(crate) struct Feedback {
    /// The tokens with enough contribution.
    pub(crate) set: TokenSet,
    /// For every 59 residual channels of the set: the Gaussian they correct. In a token of several Gaussians, those that
    /// no pixel sees are left alone (`None`).
    pub(crate) corrected: Vec<Option<u32>>,
}

/// Renders a source time, encodes the errors and pools them.
pub(crate) fn feedback(
    field: &Field,
    refiner: &Refiner,
    params: &RefineParams,
    time: &SourceTime<'_>,
    scene: Gaussians,
    before: &Correction,
    observer: &mut dyn Observer,
) -> StageResult<Feedback> {
    let area = time.grid.area();
    let ranges = time.grid.views().iter().map(|&view| view * area..(view + 1) * area);
    let owned = Eligible::Ranges(ranges.collect());
    let (renders, contributions) =
        render_views_with_contributions(&scene, &time.cameras, &RasterConfig::default(), &owned).map_err(internal)?;
    drop(scene);
    let as_plane = |render: Render| FeatureMap {
        height: render.height,
        width: render.width,
        channels: 3,
        data: render.rgb,
    };
    let renders: Vec<FeatureMap> = renders.into_iter().map(as_plane).collect();
    observer.progress(0.2, "error features");
    let errors = refiner
        .encoder()
        .forward(&renders, &time.observed, &time.maps)
        .map_err(internal)?;
    observer.progress(0.6, "pooling");
    let (set, mass) = token_set(
        field,
        params,
        refiner.config().features(),
        time,
        before,
        &contributions,
        errors,
    )?;
    let seen = |gaussian: usize| mass[row_of(&contributions, gaussian)] > params.epsilon;
    let members = set.tokens.iter().flat_map(|&token| time.grid.gaussians(token as usize));
    let corrected = members
        .map(|gaussian| seen(gaussian).then_some(gaussian as u32))
        .collect();
    Ok(Feedback { set, corrected })
}

/// The tokens with enough contribution, their attributes and pooled feedback; and the mass of every owned Gaussian.
fn token_set(
    field: &Field,
    params: &RefineParams,
    features: usize,
    time: &SourceTime<'_>,
    before: &Correction,
    contributions: &Contributions,
    errors: Vec<FeatureMap>,
) -> StageResult<(TokenSet, Vec<f32>)> {
    let mass = contributions.mass();
    let pooled = {
        let errors = errors.into_iter().map(|plane| plane.data).collect::<Vec<_>>().concat();
        contributions.pool(&errors, features).map_err(internal)?
    };
    let raw = raw_at(field, time.slice);
    let mut set = TokenSet::default();
    let per_token = time.grid.per_token();
    for token in 0..time.grid.len() {
        let rows = || {
            time.grid
                .gaussians(token)
                .map(|gaussian| row_of(contributions, gaussian))
        };
        let total: f32 = rows().map(|row| mass[row]).sum();
        if total <= params.epsilon || total.is_nan() {
            continue;
        }
        set.tokens.push(token as u32);
        let start = set.feedback.len();
        set.feedback.resize(start + features, 0.0);
        let feedback = &mut set.feedback[start..];
        for row in rows() {
            for (sum, value) in feedback.iter_mut().zip(&pooled[row * features..(row + 1) * features]) {
                *sum += value;
            }
        }
        feedback.iter_mut().for_each(|value| *value /= total);

        let start = set.attributes.len();
        set.attributes.resize(start + per_token * RESIDUAL_CHANNELS, 0.0);
        let attributes = set.attributes[start..].chunks_exact_mut(RESIDUAL_CHANNELS);
        for (member, (gaussian, out)) in time.grid.gaussians(token).zip(attributes).enumerate() {
            let centre = stage1_centre(field, time, gaussian);
            let raw = &raw[gaussian * RAW_CHANNELS..(gaussian + 1) * RAW_CHANNELS];
            before.attributes(gaussian, centre, raw, params.scale_residual, out);
            if member == 0 {
                let corrected = [out[0], out[1], out[2]];
                set.positions
                    .push(if params.recompute_knn { corrected } else { centre });
            }
        }
    }
    Ok((set, mass))
}

/// Row of a Gaussian of the rendered source time in its contributions. The rows are whole views, ascending.
fn row_of(contributions: &Contributions, gaussian: usize) -> usize {
    contributions.rows.partition_point(|&row| (row as usize) < gaussian)
}

/// Centre of a Gaussian at a source time before any correction, internal units.
fn stage1_centre(field: &Field, time: &SourceTime<'_>, gaussian: usize) -> [f32; 3] {
    let part = |axis: usize| field.position_m[3 * gaussian + axis] + time.slice.displacement_m[3 * gaussian + axis];
    [0, 1, 2].map(|axis| iu_from_m(part(axis)))
}

/// A correction as it is stored.
pub(crate) fn step(update: u32, correction: &Correction) -> RefinementStep {
    let (touched, values) = correction.to_touched();
    RefinementStep {
        update,
        touched,
        values,
    }
}

fn record(
    inputs: &ClipInputs<'_>,
    network: &LoadedRefiner,
    params: &RefineParams,
    times: &[SourceTime<'_>],
    recurrence: Recurrence,
) -> Refinement {
    let Recurrence {
        update,
        correction,
        states,
        mut steps,
    } = recurrence;
    steps.push(step(update, &correction));
    let width = network.refiner.config().state;
    let named = |(time, data): (&SourceTime<'_>, Vec<f32>)| NamedArray {
        name: state_name(time.frame),
        shape: vec![(data.len() / width) as u32, width as u32],
        data,
    };
    let resume_state = if params.keep_state {
        times.iter().zip(states).map(named).collect()
    } else {
        Vec::new()
    };
    Refinement {
        clip_id: inputs.clip.clip_id.clone(),
        field_key: inputs.field_key,
        gaussian_count: inputs.field.len() as u64,
        updates: update,
        preset: network.refiner.config().name.clone(),
        weights: network.info.clone(),
        scale_residual: params.scale_residual,
        steps,
        resume_state,
    }
}

/// An error about the field.
pub(crate) fn bad_field(error: rogs_field::Error) -> StageError {
    StageError::bad_input(error.to_string())
}

/// An error of a library that our own arrays should not have caused.
pub(crate) fn internal(error: impl std::fmt::Display) -> StageError {
    StageError::internal(error.to_string())
}
