//! The append-only files in which attempts are noted, and who notes them (entries: [`rogs_schemas::ledger`]).

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use rogs_schemas::ids::safe_name;
use rogs_schemas::ledger::{Attempt, LEDGER_FOLDER, LOG_FILE};

use crate::error::{Error, Result};

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
    match name.trim() {
        "" => "host".to_owned(),
        name => safe_name(name),
    }
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
    let mut line = serde_json::to_vec(attempt).map_err(|error| Error::Io {
        action: "appending to",
        path: path.to_owned(),
        source: std::io::Error::other(error),
    })?;
    line.push(b'\n');
    Ok(rogs_files::append(path, &line)?)
}

/// Notes an attempt in the [`files_of`] it in a run folder. Nothing is written behind links in that folder.
///
/// # Errors
/// When a file or its folder is a link, or the operating system refuses.
pub fn note(run: &Path, attempt: &Attempt) -> Result<()> {
    for file in files_of(run, attempt) {
        if let Some(folder) = file.parent() {
            rogs_files::make_folder_below(run, folder)?;
        }
        append(&file, attempt)?;
    }
    Ok(())
}

/// All attempts in a file, in order. Lines that are cut off (the writer was killed) or of a newer kind are left out; a
/// file that is not there holds none.
///
/// # Errors
/// When the operating system refuses.
pub fn read(path: &Path) -> Result<Vec<Attempt>> {
    match rogs_files::read(path) {
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
    use std::collections::BTreeMap;
    use std::io::Write as _;

    use rogs_schemas::CacheKey;
    use rogs_schemas::ledger::{Failure, Outcome};
    use rogs_schemas::protocol::FailureCode;

    use super::*;

    #[test]
    fn a_torn_line_costs_only_itself() {
        let path = std::env::temp_dir().join(format!("rogs-ledger-{}/a/log.jsonl", std::process::id()));
        assert_eq!(read(&path).unwrap(), []);
        let mut attempt = Attempt {
            unix_ms: 1,
            clip_id: "clip".parse().unwrap(),
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
