//! What the fields of a run cost: from the ledger's phases to the times of the tables.

use std::collections::BTreeMap;
use std::path::Path;

use rogs_orchestrator::plan::{InputSource, Plan};
use rogs_orchestrator::stage::StageId;
use rogs_schemas::ledger::Attempt;
use rogs_schemas::records::scores::ScoreSheet;
use rogs_score::timing::ClipTiming;

/// Name of the file in an outside method's folder of a clip that says what its own steps cost.
const TIMING_FILE: &str = "timing.json";
/// Longest such file that is read, bytes.
const MAX_TIMING_BYTES: u64 = 1 << 16;

/// What a method's field on a clip cost: the nodes upstream of its scores, without loading weights.
pub(crate) fn timing(
    plan: &Plan,
    clip: usize,
    score: usize,
    sheet: &ScoreSheet,
    costs: &BTreeMap<usize, &Attempt>,
) -> ClipTiming {
    let phase = |node: usize, name: &str| costs.get(&node).and_then(|attempt| attempt.seconds.get(name).copied());
    let without_loading =
        |node: usize| Some(phase(node, "total")? - phase(node, "load").unwrap_or(0.0)).map(|seconds| seconds.max(0.0));
    let node = &plan.nodes[score];
    let given = node.inputs.iter().find_map(|input| match input.from {
        InputSource::Prediction(index) => plan.predictions.get(index as usize),
        _ => None,
    });
    let mut timing = given
        .map(|root| given_timing(&root.join(&plan.clips[clip].id).join(TIMING_FILE)))
        .unwrap_or_default();
    timing.method.clone_from(&sheet.method);
    timing.setting.clone_from(&sheet.setting);
    timing.clip_id = sheet.clip_id.to_string();
    timing.render_query_s = timing.render_query_s.or(phase(score, "render_query"));
    timing.render_displacement_s = timing.render_displacement_s.or(phase(score, "render_displacement"));
    timing.transform_merge_s = timing.transform_merge_s.or(phase(score, "transform_merge"));
    if given.is_some() {
        return timing;
    }
    timing.device = "cpu".to_owned();
    let threads = |node: usize| {
        costs
            .get(&node)
            .map(|attempt| attempt.threads)
            .filter(|&count| count > 0)
    };
    timing.threads = threads(score);
    let mut peak = costs.get(&score).map(|attempt| attempt.peak_rss_bytes);
    let (mut refined, mut fitted) = (false, None);
    for upstream in plan.upstream(score) {
        match plan.nodes[upstream].stage {
            StageId::Lift | StageId::Lift4dgt | StageId::LiftSom => timing.lift_s = without_loading(upstream),
            StageId::Fit => fitted = Some(without_loading(upstream)),
            StageId::Refine => {
                refined = true;
                let scored = node.params.get("update").and_then(serde_json::Value::as_u64);
                let made = plan.nodes[upstream]
                    .params
                    .get("updates")
                    .and_then(serde_json::Value::as_u64);
                let seconds = costs.get(&upstream).map(|attempt| &attempt.seconds);
                timing.refine_s = seconds.and_then(|seconds| refinement_seconds(seconds, scored, made));
            }
            _ => continue,
        }
        timing.threads = timing.threads.max(threads(upstream));
        // The stage was loaded for this clip: the process had not done one with these weights before.
        timing.warmup |= phase(upstream, "load").is_some();
        peak = peak.max(costs.get(&upstream).map(|attempt| attempt.peak_rss_bytes));
    }
    if let Some(seconds) = fitted {
        let before = if refined { timing.refine_s } else { Some(0.0) };
        timing.refine_s = seconds.zip(before).map(|(fit, refinement)| fit + refinement);
    }
    timing.peak_rss_bytes = peak;
    timing
}

/// Time of a refinement without loading, from its phases; of a field after fewer updates than were made (`scored`) that of
/// the later ones less. Not known for ledgers older than the times by update unless all `made` are scored, and nothing
/// where nothing was refined.
fn refinement_seconds(seconds: &BTreeMap<String, f64>, scored: Option<u64>, made: Option<u64>) -> Option<f64> {
    let all = seconds.get("total")? - seconds.get("load").unwrap_or(&0.0);
    let update = |phase: (&String, &f64)| Some((phase.0.strip_prefix("update_")?.parse::<u64>().ok()?, *phase.1));
    let Some(scored) = scored else {
        return Some(all.max(0.0));
    };
    let updates: Vec<(u64, f64)> = seconds.iter().filter_map(update).collect();
    let known = scored > 0 && (made == Some(scored) || updates.iter().any(|(number, _)| *number == scored));
    let later: f64 = updates
        .iter()
        .filter(|(number, _)| *number > scored)
        .map(|(_, s)| s)
        .sum();
    known.then(|| (all - later).max(0.0))
}

/// What an outside method says its own steps cost; nothing when nothing of it is understood.
fn given_timing(path: &Path) -> ClipTiming {
    let short = std::fs::metadata(path).is_ok_and(|metadata| metadata.len() <= MAX_TIMING_BYTES);
    let text = if short {
        rogs_files::read(path).unwrap_or_default()
    } else {
        Vec::new()
    };
    serde_json::from_slice(&text).unwrap_or_default()
}

/// A method whose every clip was the first of its process keeps them all: a slower figure says more than none.
pub(crate) fn keep_some_timings(timings: &mut [ClipTiming]) {
    let name = |timing: &ClipTiming| (timing.method.clone(), timing.setting.clone());
    let warm: std::collections::BTreeSet<_> = timings.iter().filter(|t| !t.warmup).map(name).collect();
    for timing in timings.iter_mut().filter(|timing| !warm.contains(&name(timing))) {
        timing.warmup = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fewer_updates_cost_the_run_without_the_later_ones() {
        let phases = |phases: &[(&str, f64)]| -> BTreeMap<String, f64> {
            phases
                .iter()
                .map(|&(name, seconds)| (name.to_owned(), seconds))
                .collect()
        };
        let own = phases(&[
            ("total", 20.0),
            ("load", 3.0),
            ("refine", 16.0),
            ("update_1", 5.0),
            ("update_2", 4.0),
            ("update_10", 6.0),
        ]);
        let of = |scored| refinement_seconds(&own, scored, Some(10));
        assert_eq!(
            [of(None), of(Some(10)), of(Some(2)), of(Some(1))],
            [17.0, 17.0, 11.0, 7.0].map(Some)
        );
        // Nothing is refined for update 0; of an update that was not made here nothing is known.
        assert_eq!([of(Some(0)), of(Some(3))], [None, None]);
        let older = phases(&[("total", 20.0), ("load", 3.0), ("refine", 16.0)]);
        assert_eq!(refinement_seconds(&older, Some(1), Some(2)), None);
        assert_eq!(refinement_seconds(&older, Some(2), Some(2)), Some(17.0));
        assert_eq!(refinement_seconds(&older, None, None), Some(17.0));
        assert_eq!(refinement_seconds(&phases(&[]), None, None), None);
    }
}
