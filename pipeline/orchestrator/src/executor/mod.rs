//! The local executor: worker processes on this machine, resume by output keys.

mod policy;
mod process;
mod progress;
mod queue;
mod schedule;
mod slot;

use std::collections::BTreeMap;
use std::path::PathBuf;

use rogs_schemas::{ClipId, shown};
use schemars::JsonSchema;
use serde::Serialize;

pub use progress::ProgressMode;
pub use schedule::execute;

use crate::exit::Exit;
use crate::manifest::{Manifest, parse_size};
use crate::programs::StagePrograms;
use crate::stage::StageId;
use crate::sys::{Interrupts, available_memory};

/// How to run. Nothing here changes a result.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// Where the stage programs are.
    pub programs: StagePrograms,
    /// Worker processes at a time.
    pub workers: usize,
    /// Threads of each worker.
    pub threads: usize,
    /// Memory that all workers together may take, bytes.
    pub memory: u64,
    /// Memory that a worker of a stage is expected to take until it has been measured, bytes.
    pub stage_memory: BTreeMap<StageId, u64>,
    /// Seconds after which a unit is given up, by stage.
    pub deadline: BTreeMap<StageId, f64>,
    /// Seconds that units in hand may still take after the first signal.
    pub grace: f64,
    /// What is shown on stderr.
    pub progress: ProgressMode,
    /// Termination signals.
    pub interrupts: Interrupts,
    /// Only these clips (indices into the plan); `None`: all.
    pub only: Option<Vec<usize>>,
}

impl RunOptions {
    /// The options that a manifest asks for, with defaults for this machine.
    #[must_use]
    pub fn of(manifest: &Manifest, programs: StagePrograms) -> Self {
        let executor = &manifest.executor;
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let workers = executor.workers.unwrap_or_else(|| match executor.threads {
            Some(threads) => cores / threads,
            None => cores.div_ceil(2),
        });
        let workers = workers.max(1);
        let size = |text: &String| parse_size(text).ok();
        let stage_memory = executor
            .stage_memory
            .iter()
            .filter_map(|(&stage, text)| Some((stage, size(text)?)));
        Self {
            programs,
            workers,
            threads: executor.threads.unwrap_or((cores / workers).max(1)),
            memory: executor
                .memory
                .as_ref()
                .and_then(size)
                .unwrap_or_else(|| available_memory() / 100 * 85),
            stage_memory: stage_memory.collect(),
            deadline: executor.deadline.clone(),
            grace: executor.grace.unwrap_or(10.0),
            progress: ProgressMode::for_stderr(),
            interrupts: Interrupts::none(),
            only: None,
        }
    }
}

/// What a run came to.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct RunSummary {
    /// Name of the run.
    pub name: String,
    /// The run folder.
    pub run: PathBuf,
    /// How it ended.
    pub exit: Exit,
    /// Units by outcome.
    pub units: UnitCounts,
    /// Clips by outcome.
    pub clips: ClipCounts,
    /// Every failure of this run.
    pub failures: Vec<UnitFailure>,
    /// Things a person should know, with the clip and stage that said them.
    pub warnings: Vec<String>,
    /// Seconds from start to end.
    pub seconds: f64,
}

/// Units by outcome.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, JsonSchema)]
pub struct UnitCounts {
    /// All.
    pub total: usize,
    /// Up to date before this run.
    pub up_to_date: usize,
    /// Made by this run.
    pub made: usize,
    /// Failed.
    pub failed: usize,
    /// Not tried, because what they need failed.
    pub blocked: usize,
    /// Not done, because the run was stopped.
    pub left: usize,
}

/// Clips by outcome.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, JsonSchema)]
pub struct ClipCounts {
    /// All.
    pub total: usize,
    /// Every unit is up to date.
    pub done: usize,
    /// At least one unit failed.
    pub failed: usize,
    /// Neither.
    pub left: usize,
}

/// A unit that failed.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct UnitFailure {
    /// The clip.
    pub clip: ClipId,
    /// Id of its episode.
    pub episode: String,
    /// The node, for example `lift`.
    pub node: String,
    /// Class.
    pub code: rogs_schemas::protocol::FailureCode,
    /// What, where.
    pub message: String,
    /// What to do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hint: Option<String>,
    /// Nodes that could not be tried because of it.
    pub blocks: Vec<String>,
}

impl UnitFailure {
    /// For people: what failed, why, what to do.
    #[must_use]
    pub fn text(&self) -> String {
        let hint = self
            .hint
            .as_ref()
            .map(|hint| format!("\n  hint: {}", shown::line(hint)))
            .unwrap_or_default();
        format!("{} {}: {}{hint}", self.clip, self.node, shown::line(&self.message))
    }
}
