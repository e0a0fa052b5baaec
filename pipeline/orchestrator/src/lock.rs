//! One process at a time works in a run folder.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::Path;

use rogs_r4c::ledger::host;

use crate::error::{Error, Result, io};

/// Name of the lock in a run folder. The file stays; only the system's lock on it counts, which ends with its holder.
pub const LOCK_FILE: &str = ".lock";

/// The lock of a run folder, held until dropped.
#[derive(Debug)]
pub struct RunLock {
    file: File,
}

impl RunLock {
    /// Takes the lock without waiting. Makes the run folder where needed.
    ///
    /// # Errors
    /// [`Error::Locked`] when another process holds it; the message says which.
    pub fn acquire(run: &Path) -> Result<Self> {
        std::fs::create_dir_all(run).map_err(io("cannot make the run folder", run))?;
        let path = run.join(LOCK_FILE);
        let open = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path);
        let mut file = open.map_err(io("cannot open the lock", &path))?;
        match patiently(&file) {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut holder = String::new();
                let _ = file.take(200).read_to_string(&mut holder);
                let holder = if holder.trim().is_empty() {
                    "another process".to_owned()
                } else {
                    holder.trim().to_owned()
                };
                return Err(Error::Locked {
                    run: run.to_owned(),
                    holder,
                });
            }
            Err(TryLockError::Error(error)) => return Err(io("cannot lock", &path)(error)),
        }
        let text = format!("process {} on {}\n", std::process::id(), host());
        let write = file
            .set_len(0)
            .and_then(|()| file.rewind())
            .and_then(|()| file.write_all(text.as_bytes()));
        write.map_err(io("cannot write the lock", &path))?;
        Ok(Self { file })
    }
}

impl Drop for RunLock {
    fn drop(&mut self) {
        // Said aloud, because a child that is just being started may hold a copy of the descriptor for a moment.
        let _ = self.file.unlock();
    }
}

/// Tries for a fifth of a second: `status` holds the lock for the blink in which it looks whether anyone works here.
fn patiently(file: &File) -> std::result::Result<(), TryLockError> {
    for _ in 0..10 {
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => std::thread::sleep(std::time::Duration::from_millis(20)),
            other => return other,
        }
    }
    file.try_lock()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_second_is_told_who_is_first() {
        let folder = tempfile::tempdir().unwrap();
        let first = RunLock::acquire(folder.path()).unwrap();
        let error = RunLock::acquire(folder.path()).unwrap_err();
        assert!(
            error
                .to_string()
                .contains(&format!("process {} on ", std::process::id())),
            "{error}"
        );
        drop(first);
        RunLock::acquire(folder.path()).unwrap();
    }
}
