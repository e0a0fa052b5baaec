//! What is done, what failed, what is left: from the plan, the outputs and the ledgers.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use rogs_schemas::interim::{self, Figures, Interim};
use rogs_schemas::ledger::Failure;
use rogs_schemas::{CacheKey, ClipId, shown};
use schemars::JsonSchema;
use serde::Serialize;

use crate::columns::columns;
use crate::error::Result;
use crate::exit::Exit;
use crate::ledger::last_failures;
use crate::lock::is_active;
use crate::plan::{Plan, WorkUnit, read_plan};
use crate::state::OutputState;

/// State of a unit for people.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum UnitState {
    /// Up to date.
    Done,
    /// Not there, and nothing is in its way.
    Todo,
    /// There, but made from something else.
    Stale,
    /// There, but not whole.
    Damaged,
    /// The last attempt at it failed.
    Failed,
    /// Something it needs failed.
    Blocked,
}

/// State of a run.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Status {
    /// Name of the run.
    pub name: String,
    /// The run folder.
    pub run: PathBuf,
    /// True while a process works in it.
    pub active: bool,
    /// What the run comes to as it is now.
    pub exit: Exit,
    /// Clips that are done, failed, all.
    pub clips: StatusClips,
    /// Per node of the plan.
    pub nodes: Vec<NodeStatus>,
    /// Failures.
    pub failures: Vec<StatusFailure>,
    /// Units that show how far they are: those in work, and those that were killed.
    pub interim: Vec<StatusInterim>,
    /// Per clip, the state of each node.
    pub units: Vec<ClipStatus>,
}

/// Clips by state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, JsonSchema)]
pub struct StatusClips {
    /// All.
    pub total: usize,
    /// Every unit is done.
    pub done: usize,
    /// At least one unit failed or is damaged.
    pub failed: usize,
}

/// Units of one node by state.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub struct NodeStatus {
    /// The node, for example `lift`.
    pub node: String,
    /// Units that are done.
    pub done: usize,
    /// Units to do, stale and damaged ones among them.
    pub todo: usize,
    /// Units that failed.
    pub failed: usize,
    /// Units that are blocked.
    pub blocked: usize,
}

/// A failure.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct StatusFailure {
    /// The clip.
    pub clip: ClipId,
    /// The node.
    pub node: String,
    /// Why.
    #[serde(flatten)]
    pub failure: Failure,
}

/// How far a unit is.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct StatusInterim {
    /// The clip.
    pub clip: ClipId,
    /// The node.
    pub node: String,
    /// How far.
    #[serde(flatten)]
    pub figures: Figures,
    /// Observed images and renders, a PNG, relative to the run folder.
    pub picture: PathBuf,
}

/// The units of one clip.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub struct ClipStatus {
    /// The clip.
    pub clip: ClipId,
    /// States in the order of [`Status::nodes`].
    pub states: Vec<UnitState>,
}

/// Looks at a run folder.
///
/// # Errors
/// When it is none, or cannot be read.
pub fn status(run: &Path) -> Result<Status> {
    Ok(status_of(&read_plan(run)?)?.0)
}

/// The status of a plan, and the plain states of its outputs.
///
/// # Errors
/// When the run folder cannot be read.
pub fn status_of(plan: &Plan) -> Result<(Status, Vec<Vec<OutputState>>)> {
    let states = plan.states();
    let done = states.iter().flatten().all(|state| *state == OutputState::UpToDate);
    let last = if done {
        HashMap::new()
    } else {
        last_failures(&plan.run)?
    };
    let maker = plan.key_maker();
    let units: Vec<Units> = (0..plan.clips.len())
        .into_par_iter()
        .map(|clip| {
            let mut units = Vec::with_capacity(plan.nodes.len());
            let (mut failures, mut interim) = (Vec::new(), Vec::new());
            // Most clips of most runs are done: then nothing else has to be known.
            if states[clip].iter().all(|state| *state == OutputState::UpToDate) {
                return (vec![UnitState::Done; plan.nodes.len()], failures, interim);
            }
            let keys = maker.keys(clip);
            let begun = plan.clip_folder(clip).is_dir();
            for node in 0..plan.nodes.len() {
                let output = plan.output(WorkUnit { clip, node }, &keys);
                if begun && states[clip][node] != OutputState::UpToDate {
                    let figures = shown_beside(&plan.run.join(&output), keys[node].key);
                    interim.extend(figures.map(|figures| StatusInterim {
                        clip: plan.clips[clip].id.clone(),
                        node: plan.nodes[node].label.clone(),
                        figures,
                        picture: interim::beside(&output, interim::PICTURE),
                    }));
                }
                let attempt = last.get(&(output, keys[node].key));
                let blocked = plan
                    .upstream(node)
                    .any(|upstream| matches!(units[upstream], UnitState::Failed | UnitState::Blocked));
                units.push(match (&states[clip][node], attempt) {
                    (OutputState::UpToDate, _) => UnitState::Done,
                    (_, Some(attempt)) => {
                        if let Some(failure) = &attempt.failure {
                            let (clip, node) = (plan.clips[clip].id.clone(), plan.nodes[node].label.clone());
                            failures.push(StatusFailure {
                                clip,
                                node,
                                failure: failure.clone(),
                            });
                        }
                        UnitState::Failed
                    }
                    _ if blocked => UnitState::Blocked,
                    (OutputState::Stale(_), None) => UnitState::Stale,
                    (OutputState::Damaged(_), None) => UnitState::Damaged,
                    (OutputState::Missing, None) => UnitState::Todo,
                });
            }
            (units, failures, interim)
        })
        .collect();
    Ok((summarise(plan, units), states))
}

/// States of the units of a clip, why some failed, and how far some are.
type Units = (Vec<UnitState>, Vec<StatusFailure>, Vec<StatusInterim>);

/// How far the job of an output with this key is, where one was begun that shows it.
fn shown_beside(output: &Path, key: CacheKey) -> Option<Figures> {
    let bytes = rogs_files::read(&interim::beside(output, interim::FIGURES)).ok()?;
    let interim: Interim = serde_json::from_slice(&bytes).ok()?;
    (interim.key == key).then_some(interim.figures)
}

fn summarise(plan: &Plan, units: Vec<Units>) -> Status {
    let count = |node: usize, wanted: &[UnitState]| {
        units
            .iter()
            .filter(|(states, ..)| wanted.contains(&states[node]))
            .count()
    };
    let nodes: Vec<NodeStatus> = (0..plan.nodes.len())
        .map(|node| NodeStatus {
            node: plan.nodes[node].label.clone(),
            done: count(node, &[UnitState::Done]),
            todo: count(node, &[UnitState::Todo, UnitState::Stale, UnitState::Damaged]),
            failed: count(node, &[UnitState::Failed]),
            blocked: count(node, &[UnitState::Blocked]),
        })
        .collect();
    let done = units
        .iter()
        .filter(|(states, ..)| states.iter().all(|state| *state == UnitState::Done))
        .count();
    let failed = units
        .iter()
        .filter(|(states, ..)| states.contains(&UnitState::Failed))
        .count();
    let total = units.len();
    let exit = match (done, failed) {
        (done, 0) if done == total => Exit::Done,
        (_, 0) => Exit::Stopped,
        (done, failed) if done > 0 || failed < total => Exit::Partial,
        _ => Exit::Failed,
    };
    let (mut failures, mut interim) = (Vec::new(), Vec::new());
    let mut clips = Vec::with_capacity(total);
    for ((states, failed, shown), clip) in units.into_iter().zip(&plan.clips) {
        failures.extend(failed);
        interim.extend(shown);
        clips.push(ClipStatus {
            clip: clip.id.clone(),
            states,
        });
    }
    Status {
        name: plan.name.clone(),
        run: plan.run.clone(),
        active: is_active(&plan.run),
        exit,
        clips: StatusClips { total, done, failed },
        nodes,
        failures,
        interim,
        units: clips,
    }
}

impl Status {
    /// The status as a table for people.
    #[must_use]
    pub fn table(&self) -> String {
        let StatusClips { total, done, failed } = self.clips;
        let active = if self.active { " (running)" } else { "" };
        let mut lines = vec![format!(
            "{}{active}: {done} of {total} clips done, {failed} failed",
            self.name
        )];
        let mut rows = vec![
            ["stage", "done", "to do", "failed", "blocked"]
                .map(str::to_owned)
                .to_vec(),
        ];
        rows.extend(self.nodes.iter().map(|node| {
            let counts = [node.done, node.todo, node.failed, node.blocked].map(|count| count.to_string());
            std::iter::once(node.node.clone()).chain(counts).collect()
        }));
        lines.extend(columns(&rows));
        for own in &self.interim {
            let words = own.figures.words();
            lines.push(format!("{} at {}: {}", own.clip, own.node, shown::line(&words)));
            lines.push(format!("  picture: {}", self.run.join(&own.picture).display()));
        }
        for StatusFailure { clip, node, failure } in &self.failures {
            lines.push(format!("failed: {clip} at {node}: {}", shown::line(&failure.message)));
            lines.extend(failure.hint.iter().map(|hint| format!("  hint: {}", shown::line(hint))));
        }
        lines.join("\n")
    }
}
