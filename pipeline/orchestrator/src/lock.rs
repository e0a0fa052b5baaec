//! One process at a time works in a run folder.

use std::path::Path;

use rogs_files::{Lock, LockError};
use rogs_r4c::ledger::host;

use crate::error::{Error, Result};

/// Name of the lock in a run folder.
pub const LOCK_FILE: &str = ".lock";

/// The lock of a run folder, held until dropped.
#[derive(Debug)]
pub struct RunLock {
    lock: Lock,
}

impl RunLock {
    /// Takes the lock without waiting. Makes the run folder where needed.
    ///
    /// # Errors
    /// [`Error::Locked`] when another process holds it; the message says which.
    pub fn acquire(run: &Path) -> Result<Self> {
        rogs_files::make_folder_below(run, run)?;
        let holder = format!("process {} on {}", std::process::id(), host());
        match Lock::acquire(&run.join(LOCK_FILE), &holder) {
            Ok(lock) => Ok(Self { lock }),
            Err(LockError::Held(holder)) => Err(Error::Locked {
                run: run.to_owned(),
                holder,
            }),
            Err(LockError::Io(error)) => Err(error.into()),
        }
    }

    /// What a person should know where the file system has no locks.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        self.lock.without_system().map(|why| {
            format!(
                "the file system of the run folder has no locks ({why}): a lease keeps other processes out, which is \
                 slower to end; mount it with locks (Lustre: `flock`), or use another `out`"
            )
        })
    }
}

/// True while a process works in a run folder. Writes nothing.
#[must_use]
pub fn is_active(run: &Path) -> bool {
    rogs_files::is_locked(&run.join(LOCK_FILE))
}

/// For what only looks, and must not look while somebody works.
///
/// # Errors
/// [`Error::Locked`] while a process works in the folder.
pub(crate) fn refuse_active(run: &Path) -> Result<()> {
    if is_active(run) {
        return Err(Error::Locked {
            run: run.to_owned(),
            holder: "another process".to_owned(),
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_second_is_told_who_is_first() {
        let folder = tempfile::tempdir().unwrap();
        let first = RunLock::acquire(folder.path()).unwrap();
        assert_eq!(first.warning(), None);
        let error = RunLock::acquire(folder.path()).unwrap_err();
        assert!(
            error
                .to_string()
                .contains(&format!("process {} on ", std::process::id())),
            "{error}"
        );
        refuse_active(folder.path()).unwrap_err();
        drop(first);
        refuse_active(folder.path()).unwrap();
        RunLock::acquire(folder.path()).unwrap();
    }
}
