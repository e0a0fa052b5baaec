//! Files that appear whole or not at all.

use std::fs::{File, OpenOptions};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::fault;

/// Writes a file beside its place, flushes it to disk, renames it over `path` and flushes the folder.
///
/// `fill` gets the open temporary file `.NAME.PID.tmp`; when it fails, or anything after it, the temporary file is
/// removed and `path` is as it was.
///
/// # Errors
/// The error of `fill`, or of the operating system.
pub fn write_with(path: &Path, fill: impl FnOnce(&mut File) -> std::io::Result<()>) -> Result<()> {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let (temporary, mut file) = create_temporary(folder, path)?;
    let written = fault::at("write", path)
        .and_then(|()| fill(&mut file))
        .and_then(|()| half_of(&file, path))
        .and_then(|()| fault::at("sync", path).and_then(|()| file.sync_all()))
        .map_err(io("writing", &temporary))
        .and_then(|()| {
            fault::at("rename", path)
                .and_then(|()| std::fs::rename(&temporary, path))
                .map_err(io("renaming to", path))
        });
    if let Err(error) = written {
        drop(file);
        // The first error is the one to report; a file that stays behind is swept later.
        let _ = std::fs::remove_file(&temporary);
        return Err(error);
    }
    sync_folder(folder)
}

/// For tests: a write that ends half way.
fn half_of(file: &File, path: &Path) -> std::io::Result<()> {
    fault::at("short", path).or_else(|error| {
        file.set_len(file.metadata()?.len() / 2)?;
        Err(error)
    })
}

/// [`write_with`] for bytes at hand.
///
/// # Errors
/// The error of the operating system.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write_with(path, |file| std::io::Write::write_all(file, bytes))
}

/// Removes the temporary files of writers that are gone from a folder (not below it) and returns their paths.
///
/// A writer is gone when the system has a `/proc` and no process of that number is in it; without `/proc` nothing is
/// removed.
///
/// # Errors
/// When the folder cannot be listed or a file in it cannot be removed.
pub fn sweep(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut removed = Vec::new();
    if !Path::new("/proc/self").exists() {
        return Ok(removed);
    }
    for entry in std::fs::read_dir(folder).map_err(io("listing", folder))? {
        let path = entry.map_err(io("listing", folder))?.path();
        if !is_left_behind(&path) {
            continue;
        }
        match std::fs::remove_file(&path) {
            Ok(()) => removed.push(path),
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(io("removing", &path)(error)),
        }
    }
    removed.sort();
    Ok(removed)
}

/// True for a temporary file of [`write_with`] whose writer is gone. Without a `/proc` no writer is known to be gone.
#[must_use]
pub fn is_left_behind(path: &Path) -> bool {
    let writer = path.file_name().and_then(|name| writer_of(name.to_str()?));
    writer.is_some_and(|writer| Path::new("/proc/self").exists() && !may_be_writing(writer, path))
}

/// Whether the process of that number can be the one that writes the file: it runs, and did so before the last change of
/// the file. Numbers are used again, and a killed process keeps its number until its parent has taken note.
fn may_be_writing(process: u32, file: &Path) -> bool {
    let Ok(stat) = std::fs::read_to_string(format!("/proc/{process}/stat")) else {
        return false;
    };
    // `PID (NAME) STATE ...`; the name may hold spaces and parentheses.
    let Some((_, fields)) = stat.rsplit_once(") ") else {
        return true;
    };
    let fields: Vec<&str> = fields.split(' ').collect();
    if matches!(fields.first(), Some(&"Z" | &"X")) {
        return false;
    }
    // Field 22 of the whole line: start in hundredths of a second after boot.
    let started = fields
        .get(19)
        .and_then(|ticks| ticks.parse::<f64>().ok())
        .map(|ticks| ticks / 100.0);
    let booted = std::fs::read_to_string("/proc/stat").ok().and_then(|stat| {
        stat.lines()
            .find_map(|line| line.strip_prefix("btime ")?.trim().parse::<f64>().ok())
    });
    let changed = std::fs::metadata(file)
        .and_then(|metadata| metadata.modified())
        .ok()
        .and_then(|time| Some(time.duration_since(std::time::UNIX_EPOCH).ok()?.as_secs_f64()));
    match (started, booted, changed) {
        // The boot time is given in whole seconds.
        (Some(started), Some(booted), Some(changed)) => booted + started <= changed + 2.0,
        _ => true,
    }
}

/// Process number in `.NAME.PID.tmp` or `.NAME.PID-N.tmp`.
fn writer_of(name: &str) -> Option<u32> {
    let stem = name.strip_prefix('.')?.strip_suffix(".tmp")?;
    let (_, writer) = stem.rsplit_once('.')?;
    writer.split('-').next()?.parse().ok()
}

fn create_temporary(folder: &Path, path: &Path) -> Result<(PathBuf, File)> {
    let name = path.file_name().ok_or_else(|| {
        io("writing", path)(std::io::Error::new(
            ErrorKind::InvalidInput,
            "the path does not end in a file name",
        ))
    })?;
    let name = name.to_string_lossy();
    let process = std::process::id();
    // A process that was killed may have had our number and left its file behind; another host may have it now.
    for attempt in 0..1000 {
        let suffix = if attempt == 0 {
            String::new()
        } else {
            format!("-{attempt}")
        };
        let temporary = folder.join(format!(".{name}.{process}{suffix}.tmp"));
        let create = || OpenOptions::new().write(true).create_new(true).open(&temporary);
        match fault::at("create", path).and_then(|()| create()) {
            Ok(file) => return Ok((temporary, file)),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(io("creating", &temporary)(error)),
        }
    }
    Err(io("creating a temporary file beside", path)(std::io::Error::from(
        ErrorKind::AlreadyExists,
    )))
}

fn sync_folder(folder: &Path) -> Result<()> {
    if cfg!(unix) {
        fault::at("folder", folder)
            .and_then(|()| File::open(folder))
            .and_then(|folder| folder.sync_all())
            .map_err(io("flushing", folder))?;
    }
    Ok(())
}

fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Error {
    let path = path.to_owned();
    move |source| Error::Io { action, path, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scratch(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("rogs-atomic-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = scratch("fail");
        let path = folder.join("a.r4c");
        write_bytes(&path, b"old").unwrap();
        let error = write_with(&path, |file| {
            std::io::Write::write_all(file, b"half")?;
            Err(std::io::Error::other("disk full"))
        });
        assert!(matches!(error, Err(Error::Io { action: "writing", .. })));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_target_that_is_a_folder_fails_and_leaves_nothing() {
        let folder = scratch("dir");
        let path = folder.join("taken");
        std::fs::create_dir(&path).unwrap();
        assert!(write_bytes(&path, b"x").is_err());
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn the_sweep_takes_only_files_of_writers_that_are_gone() {
        let folder = scratch("sweep");
        let mine = format!(".a.r4c.{}.tmp", std::process::id());
        // No process has the largest number: Linux caps them far below.
        for name in [
            mine.as_str(),
            ".b.r4c.4294967295.tmp",
            ".c.r4c.4294967295-3.tmp",
            ".hidden.tmp",
            "d.r4c",
        ] {
            std::fs::write(folder.join(name), b"x").unwrap();
        }
        if Path::new("/proc/self").exists() {
            let removed = sweep(&folder).unwrap();
            assert_eq!(
                removed,
                [
                    folder.join(".b.r4c.4294967295.tmp"),
                    folder.join(".c.r4c.4294967295-3.tmp")
                ]
            );
            assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 3);
            // The number is in use, but by a process that began long after the file's last change.
            let old = std::fs::File::options().write(true).open(folder.join(&mine)).unwrap();
            old.set_modified(std::time::UNIX_EPOCH + std::time::Duration::from_secs(1))
                .unwrap();
            assert_eq!(sweep(&folder).unwrap(), [folder.join(&mine)]);
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
