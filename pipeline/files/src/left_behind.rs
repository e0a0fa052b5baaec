//! What writers that were killed left behind.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::error::{Result, io};

/// Removes the temporary files and folders of writers that are gone from a folder (not below it) and returns their
/// paths.
///
/// A writer is gone when the system has a `/proc` and no process of that number is in it; without `/proc` nothing is
/// removed.
///
/// # Errors
/// When the folder cannot be listed or something in it cannot be removed.
pub fn sweep(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut removed = Vec::new();
    if !Path::new("/proc/self").exists() {
        return Ok(removed);
    }
    for entry in std::fs::read_dir(folder).map_err(io("listing", folder))? {
        let entry = entry.map_err(io("listing", folder))?;
        let path = entry.path();
        if !is_left_behind(&path) {
            continue;
        }
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        let gone = if is_folder {
            std::fs::remove_dir_all(&path)
        } else {
            std::fs::remove_file(&path)
        };
        match gone {
            Ok(()) => removed.push(path),
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(io("removing", &path)(error)),
        }
    }
    removed.sort();
    Ok(removed)
}

/// True for a temporary file or folder whose writer is gone. Without a `/proc` no writer is known to be gone.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sweep_takes_only_what_belongs_to_writers_that_are_gone() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path();
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
        std::fs::create_dir_all(folder.join(".e.4294967295.tmp/depth")).unwrap();
        if !Path::new("/proc/self").exists() {
            return;
        }
        let expected = [".b.r4c.4294967295.tmp", ".c.r4c.4294967295-3.tmp", ".e.4294967295.tmp"];
        assert_eq!(sweep(folder).unwrap(), expected.map(|name| folder.join(name)));
        assert_eq!(std::fs::read_dir(folder).unwrap().count(), 3);
        // The number is in use, but by a process that began long after the file's last change.
        let old = std::fs::File::options().write(true).open(folder.join(&mine)).unwrap();
        old.set_modified(std::time::UNIX_EPOCH + std::time::Duration::from_secs(1))
            .unwrap();
        assert_eq!(sweep(folder).unwrap(), [folder.join(&mine)]);
    }
}
