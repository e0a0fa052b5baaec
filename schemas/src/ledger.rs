//! What was tried: one JSON line per attempt at a unit, in append-only files.
//!
//! Nothing decides by these entries whether an output is up to date; they tell people what happened and plans how long
//! things take.

use std::collections::BTreeMap;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ids::ClipId;
use crate::key::CacheKey;
use crate::protocol::{FailureCode, Job};

/// One attempt at one unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Attempt {
    /// When it ended, milliseconds since 1970 by the clock of the machine; for people only.
    pub unix_ms: u64,
    /// The clip.
    pub clip_id: ClipId,
    /// The stage.
    pub stage: String,
    /// The output's file, relative to the run folder.
    pub output: PathBuf,
    /// Key that the output has or would have had.
    pub key: CacheKey,
    /// How it ended.
    pub outcome: Outcome,
    /// Seconds by phase; `total` is always there when the unit is done.
    #[serde(default)]
    pub seconds: BTreeMap<String, f64>,
    /// Peak resident memory of the worker process so far, bytes.
    #[serde(default)]
    pub peak_rss_bytes: u64,
    /// Threads that computed; 0 when it is not known.
    #[serde(default)]
    pub threads: u32,
    /// Length of the output, bytes.
    #[serde(default)]
    pub output_bytes: u64,
    /// What a person should know.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    /// Why it failed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure: Option<Failure>,
    /// Last lines that the worker wrote to stderr, when it failed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stderr: Vec<String>,
    /// Who tried: `HOST-PID`.
    pub worker: String,
}

/// How an attempt ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The output lies in its place.
    Done,
    /// It failed.
    Failed,
    /// It was given up because of a signal; nothing is wrong with it.
    Stopped,
}

/// Why an attempt failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Failure {
    /// Class, for the retry policy.
    pub code: FailureCode,
    /// What, where.
    pub message: String,
    /// What to do about it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hint: Option<String>,
}

/// A line of an exported plan: one unit, ready to run by a stage program's `batch` face.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedUnit {
    /// The shard that this unit belongs to, `0..shards`.
    pub shard: u32,
    /// Number of shards of the plan.
    pub shards: u32,
    /// The run folder; attempts are noted in its `ledger` folder and the clip's log.
    pub run: PathBuf,
    /// What to do.
    #[serde(flatten)]
    pub job: Job,
}

/// Name of the folder with the ledgers in a run folder.
pub const LEDGER_FOLDER: &str = "ledger";

/// Name of the log in a clip's folder.
pub const LOG_FILE: &str = "log.jsonl";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_read_as_they_were_written() {
        for (text, code) in [("resource", FailureCode::Resource), ("deadline", FailureCode::Deadline)] {
            let line = format!("{{\"code\": \"{text}\", \"message\": \"m\"}}");
            assert_eq!(serde_json::from_str::<Failure>(&line).unwrap().code, code);
        }
    }
}
