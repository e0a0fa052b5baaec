//! What the file system of a folder can do.

use std::io::Error;
use std::path::Path;

use crate::error::{Result, io};
use crate::missing::is_missing_operation;

/// Does in a folder what a run does with its outputs - writes beside, flushes, renames, flushes the folder, locks - and says
/// which of these operations the file system does not have.
///
/// # Errors
/// When one of them fails.
pub fn probe(folder: &Path) -> Result<Vec<&'static str>> {
    let target = folder.join(format!(".rogs-probe.{}", std::process::id()));
    let mut missing = Vec::new();
    let mut note = |what: &'static str, outcome: std::io::Result<()>| match outcome {
        Err(error) if is_missing_operation(&error) => {
            missing.push(what);
            Ok(())
        }
        other => other,
    };
    let written = crate::write_with(&target, |file| {
        note("lock on files", file.get_ref().try_lock().map_err(Error::from))?;
        note("flush of files", file.get_ref().sync_all())
    });
    let written = written.and_then(|()| {
        let flush = std::fs::File::open(folder).and_then(|folder| folder.sync_all());
        note("flush of folders", flush).map_err(io("flushing", folder))
    });
    let _ = std::fs::remove_file(&target);
    written.map(|()| missing)
}
