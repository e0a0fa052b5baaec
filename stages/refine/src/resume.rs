//! Continuing from an earlier refinement.

use rogs_field::Correction;
use rogs_schemas::records::refinement::Refinement;
use rogs_worker::{StageError, StageResult};

use crate::recurrence::{ClipInputs, Recurrence, state_name};
use crate::source_time::SourceTime;
use crate::{LoadedRefiner, RefineParams};

/// The recurrent state that an earlier refinement ended with.
///
/// # Errors
/// When it belongs to another field, network or parameters, was run further than asked, or kept no hidden state.
pub(crate) fn resumed(
    earlier: &Refinement,
    inputs: &ClipInputs<'_>,
    network: &LoadedRefiner,
    params: &RefineParams,
    times: &[SourceTime<'_>],
    updates: u32,
) -> StageResult<Recurrence> {
    let wrong = |what: String| {
        StageError::bad_input(format!("cannot resume from the earlier refinement: {what}"))
            .with_hint("leave out the input `resume` to start from the field")
    };
    let config = network.refiner.config();
    let count = inputs.field.len();
    if (&earlier.clip_id, earlier.field_key) != (&inputs.clip.clip_id, inputs.field_key)
        || earlier.gaussian_count != count as u64
    {
        return Err(wrong("it corrects another field".into()));
    }
    if earlier.preset != config.name || earlier.weights != network.info {
        return Err(wrong(format!(
            "it was made by the network `{}` ({})",
            earlier.preset, earlier.weights.description
        )));
    }
    if earlier.scale_residual != params.scale_residual {
        return Err(wrong(
            "its scale residuals have another meaning (`scale_residual`)".into(),
        ));
    }
    let Some((last, before)) = earlier.steps.split_last() else {
        return Err(wrong("it holds no correction".into()));
    };
    if last.update != earlier.updates || last.update > updates {
        return Err(wrong(format!(
            "it ends after update {}, and {updates} are asked for",
            last.update
        )));
    }
    let correction = (last.touched.len() == count).then(|| Correction::from_touched(&last.touched, &last.values));
    let correction = correction
        .flatten()
        .ok_or_else(|| wrong("its arrays contradict each other".into()))?;

    let state = |time: &SourceTime<'_>| {
        let name = state_name(time.frame);
        let array = earlier
            .resume_state
            .iter()
            .find(|array| array.name == name)
            .ok_or_else(|| {
                wrong("it did not keep its hidden state".into()).with_hint("make it with the parameter `keep_state`")
            })?;
        if array.data.len() != time.grid.len() * config.state {
            return Err(wrong(format!("the hidden state `{name}` has another size")));
        }
        Ok(array.data.clone())
    };
    let states = times.iter().map(state).collect::<StageResult<_>>()?;

    let mut steps = Vec::new();
    if params.keep_intermediate {
        let kept: Vec<u32> = earlier.steps.iter().map(|step| step.update).collect();
        if !kept.iter().copied().eq(1..=last.update) && last.update > 0 {
            return Err(wrong("it did not keep the corrections of all its updates".into()));
        }
        steps.extend_from_slice(before);
        if last.update > 0 && last.update < updates {
            steps.push(last.clone());
        }
    }
    Ok(Recurrence {
        update: last.update,
        correction,
        states,
        steps,
    })
}
