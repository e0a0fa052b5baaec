//! Single files.

use std::fs::{File, OpenOptions};
use std::io::{BufWriter, ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result, io};
use crate::fault_injection::{self, Operation};
use crate::missing::or_missing;
use crate::paths::folder_of;
use crate::writer::temporaries;

/// Capacity of the buffer in front of a file, bytes.
pub(crate) const BUFFER_BYTES: usize = 1 << 18;

/// Writes a file beside its place, flushes it to disk, renames it over `path` and flushes the folder.
///
/// `fill` gets the open temporary file `.NAME.PID.PLACE.tmp`; when it fails, or anything after it, the temporary file is
/// removed and `path` is as it was.
///
/// # Errors
/// The error of `fill`, or of the operating system.
pub fn write_with(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>) -> Result<()> {
    try_write_with(path, |file| fill(file).map_err(io("writing", path)))
}

/// [`write_with`] for a `fill` that has errors of its own.
///
/// # Errors
/// The error of `fill`, or of the operating system.
pub fn try_write_with<E: From<Error>>(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> std::result::Result<(), E>,
) -> std::result::Result<(), E> {
    let (temporary, file) = temporary_beside(path, |temporary| {
        OpenOptions::new().write(true).create_new(true).open(temporary)
    })?;
    let mut file = BufWriter::with_capacity(BUFFER_BYTES, file);
    let written = fault_injection::at(Operation::Write, path)
        .map_err(|error| E::from(io("writing", path)(error)))
        .and_then(|()| fill(&mut file))
        .and_then(|()| {
            finish(&mut file, path).map_err(io("writing", path))?;
            rename(&temporary, path).map_err(|error| E::from(taken_away(error, &temporary)))
        });
    if written.is_err() {
        // The first error is the one to report; a file that stays behind is swept later. When only the flush of the
        // folder failed there is none.
        drop(file);
        let _ = std::fs::remove_file(&temporary);
    }
    written
}

/// [`write_with`] for bytes at hand.
///
/// # Errors
/// The error of the operating system.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write_with(path, |file| file.write_all(bytes))
}

/// Gives a file that is whole and flushed its name, in place of one that has it, and flushes the folder.
///
/// # Errors
/// The error of the operating system.
pub fn rename(from: &Path, to: &Path) -> Result<()> {
    fault_injection::at(Operation::Rename, to)
        .and_then(|()| std::fs::rename(from, to))
        .map_err(io("renaming to", to))?;
    sync_folder(folder_of(to))
}

/// Flushes the buffer, and the file to disk.
fn finish(file: &mut BufWriter<File>, path: &Path) -> std::io::Result<()> {
    file.flush()?;
    half_of(file.get_ref(), path)?;
    fault_injection::at(Operation::Sync, path)?;
    or_missing(file.get_ref().sync_all())
}

/// The error of a rename whose temporary file is not there any more: a passing fault, as writing again will do.
fn taken_away(error: Error, temporary: &Path) -> Error {
    if error.source.kind() == ErrorKind::NotFound && !temporary.exists() {
        let source = std::io::Error::other("something removed the temporary file while it was written");
        return Error { source, ..error };
    }
    error
}

/// For tests: a write that ends half way.
fn half_of(file: &File, path: &Path) -> std::io::Result<()> {
    fault_injection::at(Operation::Short, path).or_else(|error| {
        file.set_len(file.metadata()?.len() / 2)?;
        Err(error)
    })
}

/// Makes something under the temporary name `.NAME.PID.PLACE.tmp` (or `.NAME.PID-N.PLACE.tmp`) beside `path`. `create`
/// must fail when something has the name.
pub(crate) fn temporary_beside<T>(path: &Path, create: impl Fn(&Path) -> std::io::Result<T>) -> Result<(PathBuf, T)> {
    let name = path.file_name().ok_or_else(|| {
        io("writing", path)(std::io::Error::new(
            ErrorKind::InvalidInput,
            "the path does not end in a file name",
        ))
    })?;
    for temporary in temporaries(folder_of(path), &name.to_string_lossy()) {
        match fault_injection::at(Operation::Create, path).and_then(|()| create(&temporary)) {
            Ok(made) => return Ok((temporary, made)),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(io("creating", path)(error)),
        }
    }
    Err(io("creating a temporary file beside", path)(std::io::Error::from(
        ErrorKind::AlreadyExists,
    )))
}

/// Flushes the entries of a folder to disk, where systems can.
pub(crate) fn sync_folder(folder: &Path) -> Result<()> {
    if cfg!(unix) {
        fault_injection::at(Operation::Folder, folder)
            .and_then(|()| File::open(folder))
            .and_then(|folder| or_missing(folder.sync_all()))
            .map_err(io("flushing", folder))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(folder: &Path) -> usize {
        std::fs::read_dir(folder).unwrap().count()
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.r4c");
        write_bytes(&path, b"old").unwrap();
        let error = write_with(&path, |file| {
            file.write_all(b"half")?;
            Err(std::io::Error::other("disk full"))
        });
        assert!(matches!(error, Err(Error { action: "writing", .. })));
        let error: std::io::Result<()> = try_write_with(&path, |file| {
            file.write_all(b"half")?;
            Err(std::io::Error::other("no values"))
        });
        assert_eq!(error.unwrap_err().to_string(), "no values");
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(entries(folder.path()), 1);
    }

    #[test]
    fn a_target_that_is_a_folder_fails_and_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("taken");
        std::fs::create_dir(&path).unwrap();
        assert!(write_bytes(&path, b"x").is_err());
        assert_eq!(entries(folder.path()), 1);
        assert!(write_bytes(Path::new("/"), b"x").is_err());
    }

    #[test]
    fn a_file_gets_its_name_in_place_of_another() {
        let folder = tempfile::tempdir().unwrap();
        let (part, path) = (folder.path().join("a.part"), folder.path().join("a"));
        std::fs::write(&part, b"new").unwrap();
        std::fs::write(&path, b"old").unwrap();
        rename(&part, &path).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(entries(folder.path()), 1);
    }
}
