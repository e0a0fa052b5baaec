//! Reading and writing what was tried.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use rogs_schemas::CacheKey;
use rogs_schemas::ledger::{self, Attempt, Outcome};
use serde::Serialize;

use crate::error::{Result, io};

/// Name of the folder with the ledgers in a run folder.
pub const LEDGER_FOLDER: &str = "ledger";

/// Name of the log in a clip's folder.
pub const LOG_FILE: &str = "log.jsonl";

/// Appends attempts of this process.
#[derive(Debug)]
pub struct Ledger {
    run: PathBuf,
    file: PathBuf,
    worker: String,
}

impl Ledger {
    /// A ledger of this process in a run folder.
    #[must_use]
    pub fn new(run: &Path) -> Self {
        let worker = format!("{}-{}", crate::lock::host(), std::process::id());
        Self {
            run: run.to_owned(),
            file: run.join(LEDGER_FOLDER).join(format!("{worker}.jsonl")),
            worker,
        }
    }

    /// Who writes here.
    #[must_use]
    pub fn worker(&self) -> &str {
        &self.worker
    }

    /// Notes an attempt here and in the clip's log.
    ///
    /// # Errors
    /// When the operating system refuses.
    pub fn note(&self, attempt: &Attempt) -> Result<()> {
        let log = self.run.join("clips").join(&attempt.clip_id).join(LOG_FILE);
        ledger::append(&log, attempt)?;
        Ok(ledger::append(&self.file, attempt)?)
    }
}

/// Everything that the ledgers of a run folder say, in the order of files and lines.
///
/// # Errors
/// When the operating system refuses. A folder without ledgers has none.
pub fn read_all(run: &Path) -> Result<Vec<Attempt>> {
    let folder = run.join(LEDGER_FOLDER);
    let entries = match std::fs::read_dir(&folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        other => other.map_err(io("cannot list", &folder))?,
    };
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "jsonl"));
    files.sort();
    let mut attempts = Vec::new();
    for file in files {
        attempts.extend(ledger::read(&file)?);
    }
    Ok(attempts)
}

/// The last attempt at each output with a given key.
#[must_use]
pub fn last_by_output(attempts: Vec<Attempt>) -> HashMap<(PathBuf, CacheKey), Attempt> {
    let mut last: HashMap<(PathBuf, CacheKey), Attempt> = HashMap::new();
    for attempt in attempts {
        let key = (attempt.output.clone(), attempt.key);
        if last.get(&key).is_none_or(|known| known.unix_ms <= attempt.unix_ms) {
            last.insert(key, attempt);
        }
    }
    last
}

/// What earlier attempts say about the cost of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct StageCost {
    /// Units that were done.
    pub count: usize,
    /// Median seconds of a unit.
    pub seconds: f64,
    /// Median length of an output, bytes.
    pub output_bytes: u64,
    /// Largest peak memory of a worker, bytes.
    pub peak_rss_bytes: u64,
}

/// Cost by stage.
#[must_use]
pub fn costs(attempts: &[Attempt]) -> HashMap<String, StageCost> {
    let mut by_stage: HashMap<&str, Vec<&Attempt>> = HashMap::new();
    for attempt in attempts.iter().filter(|attempt| attempt.outcome == Outcome::Done) {
        by_stage.entry(&attempt.stage).or_default().push(attempt);
    }
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let cost = |attempts: Vec<&Attempt>| StageCost {
        count: attempts.len(),
        seconds: median(
            attempts
                .iter()
                .map(|attempt| attempt.seconds.get("total").copied().unwrap_or(0.0))
                .collect(),
        ),
        output_bytes: median(attempts.iter().map(|attempt| attempt.output_bytes as f64).collect()) as u64,
        peak_rss_bytes: attempts.iter().map(|attempt| attempt.peak_rss_bytes).max().unwrap_or(0),
    };
    by_stage
        .into_iter()
        .map(|(stage, attempts)| (stage.to_owned(), cost(attempts)))
        .collect()
}
