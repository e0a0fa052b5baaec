//! The worker protocol: one job a line of JSON on stdin, events as lines of JSON on stdout.

use std::collections::BTreeMap;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ids::ClipId;
use crate::key::{CacheKey, KeyMaterial};

/// Number of a job, by which the events of a worker say what they are about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct JobId(pub u64);

/// Most threads of a worker; more than any machine has, and few enough to be started in a moment.
pub const MOST_THREADS: usize = 4096;

/// Longest grace of a worker, seconds: a day.
pub const LONGEST_GRACE: f64 = 86_400.0;

/// One unit of work: one stage on one clip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// Id that the events answer with.
    pub job: JobId,
    /// The clip, for messages.
    pub clip_id: ClipId,
    /// Input files and folders by role (`episode`, `clip`, `robot-model`, `robot`, `conditioning`, `field`, `weights`, ...).
    pub inputs: BTreeMap<String, PathBuf>,
    /// Where the output goes; its folder exists.
    pub output: PathBuf,
    /// The stage's parameters; missing ones have their defaults.
    pub params: serde_json::Value,
    /// What the plan hashed into the key; written into the output's provenance.
    pub material: KeyMaterial,
    /// The key the output must carry; equals `material.key()`.
    pub key: CacheKey,
}

/// What a worker says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The worker is up and waits for jobs.
    Ready {
        /// Stage name.
        stage: String,
        /// Stage version.
        stage_version: u32,
    },
    /// The job has begun.
    Started {
        /// Id of the job.
        job: JobId,
    },
    /// How far the job is.
    Progress {
        /// Id of the job.
        job: JobId,
        /// 0..=1.
        fraction: f64,
        /// What is being done, a few words.
        message: String,
    },
    /// The output lies in its place.
    Done {
        /// Id of the job.
        job: JobId,
        /// Seconds by phase; `total` is always there.
        seconds: BTreeMap<String, f64>,
        /// Peak resident memory of the worker process so far, bytes.
        peak_rss_bytes: u64,
        /// Threads that computed; 0 when an older worker does not say.
        #[serde(default)]
        threads: u32,
        /// Things a person should know that did not stop the job.
        warnings: Vec<String>,
    },
    /// The job failed; the worker continues with the next.
    Failed {
        /// Id of the job.
        job: JobId,
        /// What kind of failure, for the retry policy.
        code: FailureCode,
        /// What, where (file, frame, joint).
        message: String,
        /// What to do about it, if anything is known.
        hint: Option<String>,
    },
}

/// Classes of failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FailureCode {
    /// The input is wrong; trying again will not help.
    BadInput,
    /// The parameters are wrong; trying again will not help.
    BadParams,
    /// Out of memory, disk or handles; fewer workers or more memory may help.
    Resource,
    /// Reading or writing failed; trying again may help.
    Io,
    /// It took longer than the run allows and was given up; trying again would take as long.
    Deadline,
    /// A bug: the worker caught a panic.
    Internal,
}

/// Answer of `rogs-STAGE describe`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Description {
    /// Stage name.
    pub stage: String,
    /// One sentence.
    pub summary: String,
    /// Version of the stage's behaviour.
    pub stage_version: u32,
    /// Inputs.
    pub inputs: Vec<InputDescription>,
    /// Schema of the output: name and version, `rogs.clip 1.0`.
    pub output_schema: String,
    /// Parameters with their defaults.
    pub default_params: serde_json::Value,
    /// JSON schema of the parameters.
    pub params_schema: serde_json::Value,
}

/// One input of a stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InputDescription {
    /// Role: the key in [`Job::inputs`].
    pub role: String,
    /// Whether the stage can run without it.
    pub required: bool,
    /// Schema name of a container input, or `folder` / `file` for anything else.
    pub kind: String,
}

impl InputDescription {
    /// An input without which the stage cannot run.
    #[must_use]
    pub fn required(role: &str, kind: &str) -> Self {
        Self {
            role: role.to_owned(),
            required: true,
            kind: kind.to_owned(),
        }
    }

    /// An input that a job may leave out.
    #[must_use]
    pub fn optional(role: &str, kind: &str) -> Self {
        Self {
            required: false,
            ..Self::required(role, kind)
        }
    }

    /// True for an output of another stage, false for a source.
    #[must_use]
    pub fn is_record(&self) -> bool {
        self.kind.starts_with("rogs.")
    }
}
