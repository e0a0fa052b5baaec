//! Faults for tests: lets the n-th file operation of a process fail, or lets the process die at it.
//!
//! Only with the cargo feature `fault-injection`, which tests turn on; without it [`at`] always succeeds. With it
//! nothing happens unless the environment variable `ROGS_FAULTS` is set when the process begins. Its value is a list of
//! `KIND[@PART]:N[+]=WHAT`, separated by commas:
//!
//! | word | meaning |
//! |---|---|
//! | `KIND` | `open` (a container for reading), `create`, `write`, `short` (half of the file is written), `sync`, `rename`, `folder` (flush of the folder), `append` |
//! | `@PART` | only operations on paths that contain this text are counted |
//! | `N` | the first one is 1; with `+` all later ones as well |
//! | `WHAT` | `EIO`, `ENOSPC`, `EDQUOT`, `EINTR`, `EMFILE`, `EROFS`, or `abort`: the process ends as it stands |
//!
//! Each fault that strikes adds a line to the file that `ROGS_FAULTS_LOG` names.

use std::io::{Error, Result};
use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

/// A file operation that can be made to fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operation {
    /// Opening a container for reading.
    Open,
    /// Creating a temporary file.
    Create,
    /// Writing to it.
    Write,
    /// Writing all of it: half of it stays.
    Short,
    /// Flushing it to disk.
    Sync,
    /// Renaming it to its place.
    Rename,
    /// Flushing the entries of a folder.
    Folder,
    /// Adding a line to a log.
    Append,
}

impl Operation {
    /// The word for it in `ROGS_FAULTS`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Open => "open",
            Self::Create => "create",
            Self::Write => "write",
            Self::Short => "short",
            Self::Sync => "sync",
            Self::Rename => "rename",
            Self::Folder => "folder",
            Self::Append => "append",
        }
    }
}

/// One entry of the list.
#[derive(Debug)]
struct Fault {
    kind: String,
    part: String,
    number: u64,
    lasting: bool,
    what: String,
    seen: AtomicU64,
}

/// Fails when the environment wants this operation on this path to fail.
///
/// # Errors
/// The error that was asked for; none without the feature `fault-injection`.
pub fn at(operation: Operation, path: &Path) -> Result<()> {
    static FAULTS: OnceLock<Vec<Fault>> = OnceLock::new();
    if !cfg!(feature = "fault-injection") {
        return Ok(());
    }
    let faults = FAULTS.get_or_init(|| parse(&std::env::var("ROGS_FAULTS").unwrap_or_default()));
    if faults.is_empty() {
        return Ok(());
    }
    strike(faults, operation, path)
}

#[cold]
fn strike(faults: &[Fault], operation: Operation, path: &Path) -> Result<()> {
    for fault in faults {
        if fault.kind != operation.name() || !path.to_string_lossy().contains(&fault.part) {
            continue;
        }
        let seen = 1 + fault.seen.fetch_add(1, Ordering::SeqCst);
        if seen != fault.number && !(fault.lasting && seen > fault.number) {
            continue;
        }
        if let Some(log) = std::env::var_os("ROGS_FAULTS_LOG") {
            let line = format!("{} {} {}\n", operation.name(), fault.what, path.display());
            let file = std::fs::OpenOptions::new().create(true).append(true).open(log);
            let _ = file.and_then(|mut file| std::io::Write::write_all(&mut file, line.as_bytes()));
        }
        let number = match fault.what.as_str() {
            "abort" => std::process::abort(),
            "EINTR" => libc::EINTR,
            "EMFILE" => libc::EMFILE,
            "ENOSPC" => libc::ENOSPC,
            "EDQUOT" => libc::EDQUOT,
            "EROFS" => libc::EROFS,
            _ => libc::EIO,
        };
        return Err(Error::from_raw_os_error(number));
    }
    Ok(())
}

fn parse(text: &str) -> Vec<Fault> {
    let entry = |text: &str| {
        let (head, what) = text.split_once('=')?;
        let (head, number) = head.rsplit_once(':')?;
        let (kind, part) = head.split_once('@').unwrap_or((head, ""));
        Some(Fault {
            kind: kind.trim().to_owned(),
            part: part.to_owned(),
            number: number.trim_end_matches('+').parse().ok()?,
            lasting: number.ends_with('+'),
            what: what.to_owned(),
            seen: AtomicU64::new(0),
        })
    };
    text.split(',').filter_map(entry).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_named_operation_fails_and_later_ones_only_when_asked() {
        let faults = parse("rename@field:2=ENOSPC,sync:1+=EIO,nonsense");
        assert_eq!(faults.len(), 2);
        let (field, clip) = (Path::new("a/field-1.r4c"), Path::new("a/clip.r4c"));
        let number = |operation, path: &Path| {
            strike(&faults, operation, path)
                .err()
                .and_then(|error| error.raw_os_error())
        };
        assert_eq!(number(Operation::Rename, field), None);
        assert_eq!(number(Operation::Rename, clip), None, "another file is not counted");
        assert_eq!(number(Operation::Rename, field), Some(libc::ENOSPC));
        assert_eq!(number(Operation::Rename, field), None);
        assert_eq!(number(Operation::Sync, clip), Some(libc::EIO));
        assert_eq!(number(Operation::Sync, field), Some(libc::EIO));
    }
}
