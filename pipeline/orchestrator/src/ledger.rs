//! Reading and writing what was tried.

use std::collections::{HashMap, HashSet};
use std::io::BufRead;
use std::path::{Path, PathBuf};

use rogs_r4c::ledger;
use rogs_schemas::CacheKey;
use rogs_schemas::ledger::{Attempt, LEDGER_FOLDER, Outcome};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::{Result, io};

/// Appends attempts of this process.
#[derive(Debug)]
pub struct Ledger {
    run: PathBuf,
    worker: String,
}

impl Ledger {
    /// A ledger of this process in a run folder.
    #[must_use]
    pub fn new(run: &Path) -> Self {
        Self {
            run: run.to_owned(),
            worker: ledger::this_worker(),
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
        Ok(ledger::note(&self.run, attempt)?)
    }
}

/// The ledgers of a run folder by name. A folder without ledgers has none.
fn files(run: &Path) -> Result<Vec<PathBuf>> {
    let folder = run.join(LEDGER_FOLDER);
    let entries = match std::fs::read_dir(&folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        other => other.map_err(io("cannot list", &folder))?,
    };
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "jsonl"));
    files.sort();
    Ok(files)
}

/// Everything that the ledgers of a run folder say, in the order of files and lines. Of a large run that is a lot: see
/// [`read_costs`] and [`last_failures`].
///
/// # Errors
/// When the operating system refuses. A folder without ledgers has none.
pub fn read_all(run: &Path) -> Result<Vec<Attempt>> {
    let mut attempts = Vec::new();
    for file in files(run)? {
        attempts.extend(ledger::read(&file)?);
    }
    Ok(attempts)
}

/// Visits every line of every ledger without keeping it. Lines that are not UTF-8 are left out.
fn for_each_line(run: &Path, mut visit: impl FnMut(&str)) -> Result<()> {
    for path in files(run)? {
        let file = rogs_files::open(&path).map_err(io("cannot read", &path))?;
        let mut reader = std::io::BufReader::with_capacity(1 << 16, file);
        let mut line = Vec::new();
        while reader.read_until(b'\n', &mut line).map_err(io("cannot read", &path))? > 0 {
            if let Ok(text) = std::str::from_utf8(&line) {
                visit(text);
            }
            line.clear();
        }
    }
    Ok(())
}

/// What most questions need of an attempt.
#[derive(Deserialize)]
struct Brief {
    unix_ms: u64,
    stage: String,
    output: PathBuf,
    key: CacheKey,
    outcome: Outcome,
    #[serde(default)]
    seconds: Total,
    #[serde(default)]
    output_bytes: u64,
    #[serde(default)]
    peak_rss_bytes: u64,
}

/// The sum of the phases.
#[derive(Default, Deserialize)]
struct Total {
    #[serde(default)]
    total: f64,
}

/// Cost by stage from the ledgers of a run, in little memory.
///
/// # Errors
/// When the operating system refuses.
pub fn read_costs(run: &Path) -> Result<HashMap<String, StageCost>> {
    let mut stages: HashMap<String, Samples> = HashMap::new();
    for_each_line(run, |line| {
        let Ok(brief) = serde_json::from_str::<Brief>(line) else {
            return;
        };
        if brief.outcome == Outcome::Done {
            stages
                .entry(brief.stage)
                .or_default()
                .add(brief.seconds.total, brief.output_bytes, brief.peak_rss_bytes);
        }
    })?;
    Ok(stages
        .into_iter()
        .map(|(stage, samples)| (stage, samples.cost()))
        .collect())
}

/// The attempts that failed and have not been followed by another end of the same output with the same key.
///
/// # Errors
/// When the operating system refuses.
pub fn last_failures(run: &Path) -> Result<HashMap<(PathBuf, CacheKey), Attempt>> {
    let mut failures: HashMap<(PathBuf, CacheKey), Attempt> = HashMap::new();
    for_each_line(run, |line| {
        // Most lines tell of success: they are not even parsed.
        if !line.contains("\"failed\"") {
            return;
        }
        let Ok(attempt) = serde_json::from_str::<Attempt>(line) else {
            return;
        };
        let key = (attempt.output.clone(), attempt.key);
        if attempt.outcome == Outcome::Failed && failures.get(&key).is_none_or(|known| known.unix_ms <= attempt.unix_ms)
        {
            failures.insert(key, attempt);
        }
    })?;
    if !failures.is_empty() {
        for_each_line(run, |line| {
            let Ok(brief) = serde_json::from_str::<Brief>(line) else {
                return;
            };
            let key = (brief.output, brief.key);
            if brief.outcome != Outcome::Failed
                && failures.get(&key).is_some_and(|failed| failed.unix_ms <= brief.unix_ms)
            {
                failures.remove(&key);
            }
        })?;
    }
    Ok(failures)
}

/// Those of the wanted outputs of which the ledgers know any attempt.
///
/// # Errors
/// When the operating system refuses.
pub fn tried(run: &Path, wanted: &HashSet<(PathBuf, CacheKey)>) -> Result<HashSet<(PathBuf, CacheKey)>> {
    let mut found = HashSet::new();
    for_each_line(run, |line| {
        let Ok(brief) = serde_json::from_str::<Brief>(line) else {
            return;
        };
        let key = (brief.output, brief.key);
        if wanted.contains(&key) {
            found.insert(key);
        }
    })?;
    Ok(found)
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
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, JsonSchema)]
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

/// What is kept of the attempts at a stage.
#[derive(Default)]
struct Samples {
    seconds: Vec<f64>,
    output_bytes: Vec<u64>,
    peak_rss_bytes: u64,
}

impl Samples {
    fn add(&mut self, seconds: f64, output_bytes: u64, peak_rss_bytes: u64) {
        self.seconds.push(seconds);
        self.output_bytes.push(output_bytes);
        self.peak_rss_bytes = self.peak_rss_bytes.max(peak_rss_bytes);
    }

    /// There is at least one sample.
    fn cost(mut self) -> StageCost {
        self.seconds.sort_by(f64::total_cmp);
        self.output_bytes.sort_unstable();
        let middle = self.seconds.len() / 2;
        StageCost {
            count: self.seconds.len(),
            seconds: self.seconds[middle],
            output_bytes: self.output_bytes[middle],
            peak_rss_bytes: self.peak_rss_bytes,
        }
    }
}

/// Cost by stage.
#[must_use]
pub fn costs(attempts: &[Attempt]) -> HashMap<String, StageCost> {
    let mut stages: HashMap<&str, Samples> = HashMap::new();
    for attempt in attempts.iter().filter(|attempt| attempt.outcome == Outcome::Done) {
        let seconds = attempt.seconds.get("total").copied().unwrap_or(0.0);
        let samples = stages.entry(&attempt.stage).or_default();
        samples.add(seconds, attempt.output_bytes, attempt.peak_rss_bytes);
    }
    let cost = |(stage, samples): (&str, Samples)| (stage.to_owned(), samples.cost());
    stages.into_iter().map(cost).collect()
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
mod tests {
    use rogs_schemas::ledger::Failure;
    use rogs_schemas::protocol::FailureCode;

    use super::*;

    fn attempt(unix_ms: u64, output: &str, outcome: Outcome) -> Attempt {
        Attempt {
            unix_ms,
            clip_id: "a".parse().unwrap(),
            stage: "lift".into(),
            output: output.into(),
            key: CacheKey::default(),
            outcome,
            seconds: [("total".to_owned(), unix_ms as f64)].into(),
            peak_rss_bytes: 10 * unix_ms,
            threads: 2,
            output_bytes: 100 * unix_ms,
            warnings: vec![],
            failure: (outcome == Outcome::Failed).then(|| Failure {
                code: FailureCode::Io,
                message: format!("at {unix_ms}"),
                hint: None,
            }),
            stderr: vec![],
            worker: "host-1".into(),
        }
    }

    #[test]
    fn streaming_says_the_same_as_reading_everything() {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path();
        let file = |name: &str| run.join(LEDGER_FOLDER).join(name);
        assert!(read_costs(run).unwrap().is_empty() && last_failures(run).unwrap().is_empty());
        // A later success lies in an earlier file; a later failure behind a success; a failure that was mended.
        for (name, unix_ms, output, outcome) in [
            ("a.jsonl", 5, "one", Outcome::Done),
            ("a.jsonl", 6, "two", Outcome::Done),
            ("b.jsonl", 2, "one", Outcome::Failed),
            ("b.jsonl", 7, "two", Outcome::Failed),
            ("b.jsonl", 3, "three", Outcome::Failed),
            ("b.jsonl", 4, "three", Outcome::Failed),
        ] {
            ledger::append(&file(name), &attempt(unix_ms, output, outcome)).unwrap();
        }
        std::fs::write(file("c.jsonl"), b"{\"torn\": \n\xff\xfe\n").unwrap();
        let all = read_all(run).unwrap();
        assert_eq!(read_costs(run).unwrap(), costs(&all));
        let mut expected = last_by_output(all);
        expected.retain(|_, attempt| attempt.outcome == Outcome::Failed);
        assert_eq!(expected.len(), 2);
        assert_eq!(last_failures(run).unwrap(), expected);
        let key = |output: &str| (PathBuf::from(output), CacheKey::default());
        let wanted = HashSet::from([key("one"), key("four")]);
        assert_eq!(tried(run, &wanted).unwrap(), HashSet::from([key("one")]));
    }
}
