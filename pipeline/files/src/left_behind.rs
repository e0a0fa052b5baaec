//! What writers that were killed left behind.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::error::{Result, io};
use crate::writer::Writer;

/// Removes the temporary files and folders of writers that are gone from a folder (not below it) and returns their
/// paths. See [`is_left_behind`].
///
/// # Errors
/// When the folder cannot be listed or something in it cannot be removed.
pub fn sweep(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut removed = Vec::new();
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

/// True for a temporary file or folder whose writer is gone. Of a writer on this system that is known from its process; a
/// writer elsewhere (another host, another container, a system before its last start) may be at work for a day after the
/// last change, which is far more than any file takes.
#[must_use]
pub fn is_left_behind(path: &Path) -> bool {
    let writer = path.file_name().and_then(|name| Writer::of(name.to_str()?));
    writer.is_some_and(|writer| !writer.may_be_at_work(path))
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, SystemTime};

    use super::*;
    use crate::writer::{LEASE, place};

    #[test]
    fn the_sweep_takes_only_what_belongs_to_writers_that_are_gone() {
        if !Path::new("/proc/self").exists() {
            return;
        }
        let scratch = tempfile::tempdir().unwrap();
        let (folder, here) = (scratch.path(), place());
        let mine = format!(".a.r4c.{}.{here}.tmp", std::process::id());
        // No process has the largest number: Linux caps them far below.
        let gone = [
            format!(".b.r4c.4294967295.{here}.tmp"),
            format!(".c.r4c.4294967295-3.{here}.tmp"),
        ];
        let elsewhere = [".f.r4c.4294967295.00000000.tmp", ".g.r4c.4294967295.tmp"];
        let others = [mine.as_str(), ".hidden.tmp", "d.r4c"];
        for name in others
            .into_iter()
            .chain(elsewhere)
            .chain(gone.iter().map(String::as_str))
        {
            std::fs::write(folder.join(name), b"x").unwrap();
        }
        let draft = format!(".e.4294967295.{here}.tmp");
        std::fs::create_dir_all(folder.join(&draft).join("depth")).unwrap();
        let expected = [&gone[0], &gone[1], &draft].map(|name| folder.join(name));
        assert_eq!(sweep(folder).unwrap(), expected);
        assert_eq!(std::fs::read_dir(folder).unwrap().count(), 5);
        // The number is in use, but by a process that began long after the file's last change.
        let age = |name: &str, changed: SystemTime| {
            let file = std::fs::File::options().write(true).open(folder.join(name)).unwrap();
            file.set_modified(changed).unwrap();
        };
        age(&mine, SystemTime::UNIX_EPOCH + Duration::from_secs(1));
        assert_eq!(sweep(folder).unwrap(), [folder.join(&mine)]);
        // Leases of writers elsewhere end.
        age(elsewhere[0], SystemTime::now() - LEASE + Duration::from_secs(60));
        assert_eq!(sweep(folder).unwrap(), [] as [PathBuf; 0]);
        for name in elsewhere {
            age(name, SystemTime::now() - LEASE - Duration::from_secs(60));
        }
        assert_eq!(sweep(folder).unwrap(), elsewhere.map(|name| folder.join(name)));
    }
}
