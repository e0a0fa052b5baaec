//! What a run will cost: a dry run with what earlier attempts took.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;

use crate::columns::columns;
use crate::costs::{duration, node_costs};
use crate::error::Result;
use crate::executor::RunOptions;
use crate::ledger::StageCost;
use crate::plan::{ClipInterval, InputSource, Node, Plan, PlanSelection};
use crate::stage::Provider;
use crate::state::OutputState;
use crate::sys::free_disk;

/// What is to be done and what that will probably cost.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Estimate {
    /// Name of the run.
    pub name: String,
    /// Clips of the plan.
    pub clips: usize,
    /// Which frames of their episodes they are.
    pub intervals: Vec<ClipInterval>,
    /// How many of them have references of each role in a folder of their own; none where the manifest names no folder.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub references: BTreeMap<String, usize>,
    /// The selection that they are of, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub selection: Option<String>,
    /// Cameras that clips are made of, in words.
    pub cameras: String,
    /// Which weights each network has, in words.
    pub weights: Vec<String>,
    /// What to know before the run; the orchestrator leaves it empty for whoever knows the networks.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Per node.
    pub nodes: Vec<NodeEstimate>,
    /// Seconds on this machine with these workers; `None` when nothing is known of a stage.
    pub seconds: Option<f64>,
    /// Bytes that will be written; `None` when nothing is known of a stage.
    pub disk_bytes: Option<u64>,
    /// Bytes free where the run folder lies.
    pub free_bytes: Option<u64>,
    /// Workers that the estimate assumes.
    pub workers: usize,
}

/// One node.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct NodeEstimate {
    /// The node, for example `lift`.
    pub node: String,
    /// Units that are up to date.
    pub up_to_date: usize,
    /// Units to make.
    pub todo: usize,
    /// What earlier units of the stage took; where there are none, what a clip of this size takes about.
    pub cost: Option<StageCost>,
    /// Whether it was measured in this run, or follows from figures of another machine.
    pub measured: bool,
}

/// Looks at the outputs and the ledgers; changes nothing.
///
/// # Errors
/// When the run folder cannot be read.
pub fn estimate(plan: &Plan, options: &RunOptions) -> Result<Estimate> {
    let states = plan.states();
    let costs = node_costs(plan)?;
    let node = |index: usize| {
        let up_to_date = states
            .iter()
            .filter(|clip| clip[index] == OutputState::UpToDate)
            .count();
        NodeEstimate {
            measured: costs[index].measured,
            node: plan.nodes[index].label.clone(),
            up_to_date,
            todo: plan.clips.len() - up_to_date,
            cost: costs[index].cost,
        }
    };
    let nodes: Vec<NodeEstimate> = (0..plan.nodes.len()).map(node).collect();
    let sum = |value: fn(&StageCost) -> f64| -> Option<f64> {
        let mut to_do = nodes.iter().filter(|node| node.todo > 0);
        // Not `sum`, whose value of nothing is -0.
        to_do.try_fold(0.0, |sum, node| {
            Some(sum + value(node.cost.as_ref()?) * node.todo as f64)
        })
    };
    let parallel = options.workers.min(plan.clips.len()).max(1) as f64;
    Ok(Estimate {
        name: plan.name.clone(),
        clips: plan.clips.len(),
        intervals: plan.clip_intervals(),
        references: references(plan),
        selection: plan.selection.as_ref().map(PlanSelection::describe),
        cameras: cameras(plan),
        weights: weights(plan),
        notes: Vec::new(),
        seconds: sum(|cost| cost.seconds).map(|seconds| seconds / parallel),
        disk_bytes: sum(|cost| cost.output_bytes as f64).map(|bytes| bytes as u64),
        free_bytes: plan.run.ancestors().find(|folder| folder.is_dir()).and_then(free_disk),
        workers: options.workers,
        nodes,
    })
}

/// The cameras that clips are made of.
fn cameras(plan: &Plan) -> String {
    let cuts = |node: &&Node| node.stage.spec().interval.is_some();
    let chosen = plan
        .nodes
        .iter()
        .find(cuts)
        .and_then(|node| node.params.get("cameras")?.as_array());
    let ids = chosen
        .into_iter()
        .flatten()
        .filter_map(|camera| camera.get("id")?.as_str());
    let ids: Vec<&str> = ids.collect();
    if ids.is_empty() {
        "all that an episode names".to_owned()
    } else {
        ids.join(", ")
    }
}

/// Which weights the nodes have that take some.
fn weights(plan: &Plan) -> Vec<String> {
    let of = |node: &Node| {
        let taken = node
            .stage
            .spec()
            .inputs
            .iter()
            .filter(|input| matches!(input.provider, Provider::Weights(_)));
        let files: Vec<String> = taken
            .filter_map(|input| {
                let found = node.inputs.iter().find(|own| own.role == input.role)?;
                let InputSource::Source(source) = &found.from else {
                    return None;
                };
                let file = source.path.file_name().unwrap_or_default().to_string_lossy();
                Some(format!("{}: {} `{file}`", node.label, input.role))
            })
            .collect();
        let unfiled = node.params.get("weights").and_then(serde_json::Value::as_str);
        let unfiled = unfiled.map(|word| match word.split(' ').next() {
            Some("builtin") => format!("{}: built-in weights", node.label),
            _ => format!("{}: SEEDED weights: random values, which predict nothing", node.label),
        });
        unfiled.into_iter().chain(files).collect::<Vec<_>>()
    };
    plan.nodes.iter().flat_map(of).collect()
}

/// Clips that have a reference, by role, for all roles that some clip might have.
fn references(plan: &Plan) -> BTreeMap<String, usize> {
    let inputs = plan.nodes.iter().flat_map(|node| &node.inputs);
    let roles = inputs.filter(|input| input.from == InputSource::Reference);
    let mut counts: BTreeMap<String, usize> = roles.map(|input| (input.role.clone(), 0)).collect();
    for role in plan.clips.iter().flat_map(|clip| clip.references.keys()) {
        *counts.entry(role.clone()).or_default() += 1;
    }
    counts
}

/// Most lines about which frames of their episodes the clips are: those of long episodes have many starts, of which the
/// first show the pattern.
const INTERVALS: usize = 4;

impl Estimate {
    /// The estimate as a table for people.
    #[must_use]
    pub fn table(&self) -> String {
        let head = ["stage", "up to date", "to make", "s a clip", "MiB a clip", "peak MiB"];
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        for node in &self.nodes {
            let cost = node.cost.map_or(["?", "?", "?"].map(str::to_owned), |cost| {
                let mebibytes = |bytes: u64| bytes as f64 / f64::from(1 << 20);
                [
                    format!("{:.2}", cost.seconds),
                    format!("{:.2}", mebibytes(cost.output_bytes)),
                    format!("{:.0}", mebibytes(cost.peak_rss_bytes)),
                ]
            });
            let counts = [node.node.clone(), node.up_to_date.to_string(), node.todo.to_string()];
            rows.push(counts.into_iter().chain(cost).collect());
        }
        let units: usize = self.nodes.iter().map(|node| node.up_to_date + node.todo).sum();
        let mut lines = vec![format!("{}: {} clips, {units} units", self.name, self.clips)];
        lines.extend(self.selection.clone());
        lines.extend(self.intervals.iter().take(INTERVALS).map(ToString::to_string));
        if let Some(more) = self.intervals.len().checked_sub(INTERVALS).filter(|&more| more > 0) {
            lines.push(format!("and clips from {more} other frames"));
        }
        let references = self.references.iter();
        lines.extend(references.map(|(role, clips)| format!("{role}: {clips} of {} clips", self.clips)));
        lines.push(format!("cameras: {}", self.cameras));
        lines.extend(self.weights.iter().cloned());
        lines.extend(columns(&rows));
        let guessed = self.nodes.iter().any(|node| node.todo > 0 && !node.measured);
        let from = if guessed {
            ", estimated: not all stages have run here yet"
        } else {
            ""
        };
        lines.push(match self.seconds {
            Some(seconds) => format!("about {} with {} workers{from}", duration(seconds), self.workers),
            None => "no estimate of time: some stage has not run here yet".to_owned(),
        });
        let gibibytes = |bytes: u64| bytes as f64 / f64::from(1 << 30);
        if let (Some(need), Some(free)) = (self.disk_bytes.map(gibibytes), self.free_bytes.map(gibibytes)) {
            lines.push(format!("about {need:.2} GiB to write, {free:.1} GiB free"));
        }
        lines.extend(self.notes.iter().map(|note| format!("note: {note}")));
        lines.join("\n")
    }
}
