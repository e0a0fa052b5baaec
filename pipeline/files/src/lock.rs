//! One process at a time.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read as _, Seek as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::{Duration, SystemTime};

use crate::error::{Error, Result, io};
use crate::missing::is_missing_operation;
use crate::paths::folder_of;
use crate::place::{here, open, open_own};
use crate::writer::{is_running_since, place, temporaries};

/// A lease that its holder has not renewed for so long has ended.
const EXPIRY: Duration = Duration::from_secs(180);

/// How often a holder renews its lease.
const RENEWAL: Duration = Duration::from_secs(20);

/// A lock by the name of a file, held until dropped. The file stays; only the system's lock on it counts, which ends with
/// its holder.
///
/// Where the file system has no locks, the holder has a lease instead: a file `NAME.lease` beside it that names host and
/// process and is written again every 20 seconds. It counts while that process runs, as far as that can be seen from
/// here, and otherwise for three minutes after the last renewal.
#[derive(Debug)]
pub struct Lock {
    held: Held,
    without_system: Option<String>,
}

#[derive(Debug)]
enum Held {
    System(File),
    Lease(Lease),
}

/// Why a lock could not be taken.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// Another process holds it; what that process wrote of itself, or nothing.
    #[error("held by {0}")]
    Held(String),
    /// The operating system refused.
    #[error(transparent)]
    Io(#[from] Error),
}

impl Lock {
    /// Takes the lock without waiting. `holder` tells others who has it, in one line.
    ///
    /// # Errors
    /// [`LockError::Held`] when another process has it; [`LockError::Io`] when the place is a link or no file, or the
    /// operating system refuses.
    pub fn acquire(path: &Path, holder: &str) -> std::result::Result<Self, LockError> {
        let mut file = open_own(path, OpenOptions::new().read(true).write(true).truncate(false))
            .map_err(io("opening the lock", path))?;
        let without_system = match patiently(&file) {
            Ok(()) => None,
            Err(TryLockError::WouldBlock) => return Err(LockError::Held(first_line(&mut file))),
            Err(TryLockError::Error(error)) if is_missing_operation(&error) => Some(error.to_string()),
            Err(TryLockError::Error(error)) => return Err(io("locking", path)(error).into()),
        };
        let lease = match without_system {
            None => None,
            Some(_) => Some(Lease::acquire(path, holder)?),
        };
        let write = file
            .set_len(0)
            .and_then(|()| file.rewind())
            .and_then(|()| file.write_all(format!("{holder}\n").as_bytes()));
        write.map_err(io("writing the lock", path))?;
        Ok(Self {
            held: lease.map_or(Held::System(file), Held::Lease),
            without_system,
        })
    }

    /// What the system says where it has no locks and a lease is held instead.
    #[must_use]
    pub fn without_system(&self) -> Option<&str> {
        self.without_system.as_deref()
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        match &mut self.held {
            // Said aloud, because a child that is just being started may hold a copy of the descriptor for a moment.
            Held::System(file) => drop(file.unlock()),
            Held::Lease(lease) => lease.end(),
        }
    }
}

/// True while another process holds the lock. Writes nothing.
#[must_use]
pub fn is_locked(path: &Path) -> bool {
    let system = open(path).is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)));
    let lease = lease_of(path);
    system || (here(&lease).is_ok_and(|found| found.is_some()) && may_be_held(&lease, SystemTime::now()))
}

/// Tries for a fifth of a second: whoever only looks holds the lock for a blink.
fn patiently(file: &File) -> std::result::Result<(), TryLockError> {
    for _ in 0..10 {
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(20)),
            other => return other,
        }
    }
    file.try_lock()
}

/// What the holder wrote of itself.
fn first_line(file: &mut File) -> String {
    let mut bytes = Vec::new();
    let _ = file.take(200).read_to_end(&mut bytes);
    let text = String::from_utf8_lossy(&bytes).into_owned();
    match text.lines().next().map(str::trim) {
        Some(line) if !line.is_empty() => line.to_owned(),
        _ => "another process".to_owned(),
    }
}

/// Where the lease of a lock lies.
fn lease_of(lock: &Path) -> PathBuf {
    let mut name = lock.as_os_str().to_owned();
    name.push(".lease");
    PathBuf::from(name)
}

/// A lease, renewed by a thread.
#[derive(Debug)]
struct Lease {
    path: PathBuf,
    text: String,
    renewal: Option<(Sender<()>, std::thread::JoinHandle<()>)>,
}

impl Lease {
    fn acquire(lock: &Path, holder: &str) -> std::result::Result<Self, LockError> {
        let path = lease_of(lock);
        let text = format!("{holder}\n{} {}\n", std::process::id(), place());
        let make = || {
            let made = OpenOptions::new().write(true).create_new(true).open(&path);
            made.and_then(|mut file| file.write_all(text.as_bytes()).map(|()| file))
        };
        let held = || {
            let line = open(&path).map(|mut file| first_line(&mut file));
            LockError::Held(line.unwrap_or_else(|_| "another process".to_owned()))
        };
        let file = match make() {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                if may_be_held(&path, now_of(folder_of(&path))?) {
                    return Err(held());
                }
                let _ = std::fs::remove_file(&path);
                make()
            }
            other => other,
        };
        let file = match file {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => return Err(held()),
            other => other.map_err(io("making the lease", &path))?,
        };
        // Two that found the same old lease may both have removed one: only one of them reads its own words afterwards.
        std::thread::sleep(Duration::from_millis(100));
        if crate::read_to_string(&path).ok().as_deref() != Some(&text) {
            return Err(held());
        }
        let (end, ended) = channel();
        let again = text.clone();
        let renew = move || {
            let mut file = file;
            while ended.recv_timeout(RENEWAL) == Err(RecvTimeoutError::Timeout) {
                // A renewal that fails is tried again: the lease lasts for several.
                let _ = file.rewind().and_then(|()| file.write_all(again.as_bytes()));
            }
        };
        let thread = std::thread::Builder::new().name("lease".into()).spawn(renew);
        let thread = thread.map_err(io("renewing the lease", &path))?;
        Ok(Self {
            path,
            text,
            renewal: Some((end, thread)),
        })
    }

    /// Ends the lease, unless somebody else has taken it.
    fn end(&mut self) {
        if let Some((end, thread)) = self.renewal.take() {
            drop(end);
            let _ = thread.join();
        }
        if crate::read_to_string(&self.path).ok().as_deref() == Some(&self.text) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Whether the holder of a lease may still be at work.
fn may_be_held(lease: &Path, now: SystemTime) -> bool {
    let renewed = std::fs::symlink_metadata(lease).and_then(|found| found.modified()).ok();
    let text = crate::read_to_string(lease).unwrap_or_default();
    let holder = text.lines().nth(1).and_then(|line| line.split_once(' '));
    if let Some((process, of)) = holder
        && of == place()
        && let Ok(process) = process.parse()
        && Path::new("/proc/self").exists()
    {
        return is_running_since(process, renewed);
    }
    let age = renewed.and_then(|renewed| now.duration_since(renewed).ok());
    age.is_none_or(|age| age < EXPIRY)
}

/// The time by the clock that stamps the files of a folder, which on a network file system is not ours.
fn now_of(folder: &Path) -> Result<SystemTime> {
    let probe = temporaries(folder, "now").find_map(|path| {
        let made = OpenOptions::new().write(true).create_new(true).open(&path);
        Some((made.ok()?, path))
    });
    let Some((mut file, path)) = probe else {
        return Ok(SystemTime::now());
    };
    let now = file.write_all(b"x").and_then(|()| file.metadata()?.modified());
    let _ = std::fs::remove_file(&path);
    now.map_err(io("reading the time of", folder))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_second_is_told_who_is_first() {
        let scratch = tempfile::tempdir().unwrap();
        let path = scratch.path().join("lock");
        let first = Lock::acquire(&path, "the first").unwrap();
        assert_eq!(first.without_system(), None);
        assert!(is_locked(&path));
        let Err(LockError::Held(holder)) = Lock::acquire(&path, "the second") else {
            panic!("taken twice");
        };
        assert_eq!(holder, "the first");
        drop(first);
        assert!(!is_locked(&path));
        Lock::acquire(&path, "the second").unwrap();
    }

    #[test]
    fn a_lock_that_is_a_link_is_refused_and_what_it_names_stays() {
        let scratch = tempfile::tempdir().unwrap();
        let (path, victim) = (scratch.path().join("lock"), scratch.path().join("victim"));
        std::fs::write(&victim, "mine").unwrap();
        std::os::unix::fs::symlink(&victim, &path).unwrap();
        let error = Lock::acquire(&path, "me").unwrap_err();
        assert!(matches!(error, LockError::Io(_)), "{error}");
        assert_eq!(std::fs::read(&victim).unwrap(), b"mine");
        std::fs::remove_file(&path).unwrap();
        std::fs::hard_link(&victim, &path).unwrap();
        Lock::acquire(&path, "me").unwrap();
        assert_eq!(std::fs::read(&victim).unwrap(), b"mine");
    }

    #[test]
    fn leases_keep_others_out_until_their_holders_are_gone() {
        let scratch = tempfile::tempdir().unwrap();
        let path = scratch.path().join("lock");
        let lease = lease_of(&path);
        let mut first = Lease::acquire(&path, "the first").unwrap();
        assert!(is_locked(&path));
        let Err(LockError::Held(holder)) = Lease::acquire(&path, "the second") else {
            panic!("taken twice");
        };
        assert_eq!(holder, "the first");
        first.end();
        assert!(!is_locked(&path) && !lease.exists());
        // No process has the largest number.
        std::fs::write(&lease, format!("one that is gone\n4294967295 {}\n", place())).unwrap();
        Lease::acquire(&path, "me").unwrap().end();
        // Elsewhere only time tells.
        std::fs::write(&lease, "one elsewhere\n4294967295 00000000\n").unwrap();
        assert!(Lease::acquire(&path, "me").is_err());
        let file = File::options().write(true).open(&lease).unwrap();
        file.set_modified(SystemTime::now() - 2 * EXPIRY).unwrap();
        Lease::acquire(&path, "me").unwrap().end();
    }
}
