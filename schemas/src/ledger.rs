//! What was tried: one JSON line per attempt at a unit, in append-only files.
//!
//! Nothing decides by these records whether an output is up to date; they tell people what happened and plans how long
//! things take.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use rogs_files::fault_injection::{self, Operation};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::key::CacheKey;
use crate::protocol::{FailureCode, Job};

/// One attempt at one unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Attempt {
    /// When it ended, milliseconds since 1970 by the clock of the machine; for people only.
    pub unix_ms: u64,
    /// The clip.
    pub clip_id: String,
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
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
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
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

/// The files of a run folder in which an attempt is noted: the log of its clip and the ledger of who tried.
#[must_use]
pub fn files_of(run: &Path, attempt: &Attempt) -> [PathBuf; 2] {
    [
        run.join("clips").join(&attempt.clip_id).join(LOG_FILE),
        run.join(LEDGER_FOLDER).join(format!("{}.jsonl", attempt.worker)),
    ]
}

/// This process as [`Attempt::worker`] names it: `HOST-PID`.
#[must_use]
pub fn this_worker() -> String {
    format!("{}-{}", host(), std::process::id())
}

/// Name of this machine, safe as a part of file names: characters other than `[A-Za-z0-9._-]` become `_`.
#[must_use]
pub fn host() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname")
        .ok()
        .or_else(|| std::env::var("HOSTNAME").ok())
        .unwrap_or_default();
    let safe = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    let name: String = (name.trim().chars()).map(|c| if safe(c) { c } else { '_' }).collect();
    if name.is_empty() { "host".to_owned() } else { name }
}

/// Now, for [`Attempt::unix_ms`].
#[must_use]
pub fn now_ms() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |time| time.as_millis() as u64)
}

/// Appends one attempt to a file as one line in one write, making the file and its folder where needed.
///
/// # Errors
/// When the operating system refuses.
pub fn append(path: &Path, attempt: &Attempt) -> Result<()> {
    let io = |source| Error::Io {
        action: "appending to",
        path: path.to_owned(),
        source,
    };
    fault_injection::at(Operation::Append, path).map_err(io)?;
    let mut line = serde_json::to_vec(attempt).map_err(|error| io(std::io::Error::other(error)))?;
    line.push(b'\n');
    let open = || std::fs::OpenOptions::new().create(true).append(true).open(path);
    let mut file = match open() {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            std::fs::create_dir_all(path.parent().unwrap_or(Path::new("."))).map_err(io)?;
            open().map_err(io)?
        }
        other => other.map_err(io)?,
    };
    file.write_all(&line).map_err(io)
}

/// All attempts in a file, in order. Lines that are cut off (the writer was killed) or of a newer kind are left out; a
/// file that is not there holds none.
///
/// # Errors
/// When the operating system refuses.
pub fn read(path: &Path) -> Result<Vec<Attempt>> {
    match std::fs::read(path) {
        Ok(bytes) => Ok(bytes
            .split(|&byte| byte == b'\n')
            .filter_map(|line| serde_json::from_slice(line).ok())
            .collect()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(source) => Err(Error::Io {
            action: "reading",
            path: path.to_owned(),
            source,
        }),
    }
}

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

    #[test]
    fn a_torn_line_costs_only_itself() {
        let path = std::env::temp_dir().join(format!("rogs-ledger-{}/a/log.jsonl", std::process::id()));
        assert_eq!(read(&path).unwrap(), []);
        let mut attempt = Attempt {
            unix_ms: 1,
            clip_id: "clip".into(),
            stage: "lift".into(),
            output: "clips/clip/field-1.r4c".into(),
            key: CacheKey::default(),
            outcome: Outcome::Failed,
            seconds: BTreeMap::new(),
            peak_rss_bytes: 0,
            threads: 0,
            output_bytes: 0,
            warnings: vec![],
            failure: Some(Failure {
                code: FailureCode::Io,
                message: "disk".into(),
                hint: None,
            }),
            stderr: vec![],
            worker: "host-1".into(),
        };
        append(&path, &attempt).unwrap();
        std::fs::OpenOptions::new()
            .append(true)
            .open(&path)
            .unwrap()
            .write_all(b"{\"unix_ms\": 2, \"cl\n")
            .unwrap();
        attempt.unix_ms = 3;
        append(&path, &attempt).unwrap();
        let times: Vec<u64> = read(&path).unwrap().iter().map(|attempt| attempt.unix_ms).collect();
        assert_eq!(times, [1, 3]);
        std::fs::remove_dir_all(path.ancestors().nth(2).unwrap()).unwrap();
    }
}
