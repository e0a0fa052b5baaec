//! Folders of files.

use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

use crate::atomic::{BUFFER_BYTES, rename, sync_folder, temporary_beside};
use crate::error::{Result, io};
use crate::fault_injection::{self, Operation};
use crate::missing::or_missing;

/// A folder that is filled under a temporary name beside its place, `.NAME.PID.PLACE.tmp`, and appears when it is whole.
///
/// Dropped without [`publish`](Self::publish) it is removed.
///
/// ```
/// let root = tempfile::tempdir()?;
/// let place = root.path().join("episode-7");
/// let draft = rogs_files::Draft::begin(&place)?;
/// draft.write("wrist/000000.png", b"...")?;
/// assert!(!place.exists());
/// draft.publish()?;
/// assert!(place.join("wrist/000000.png").exists());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Draft {
    temporary: PathBuf,
    place: PathBuf,
}

impl Draft {
    /// Makes the empty folder.
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn begin(place: &Path) -> Result<Self> {
        let (temporary, ()) = temporary_beside(place, |temporary| std::fs::create_dir(temporary))?;
        Ok(Self {
            temporary,
            place: place.to_owned(),
        })
    }

    /// Creates a file in the folder, and the folders on the way to it. `name` is relative to the draft.
    ///
    /// # Errors
    /// When there is such a file, or the operating system refuses.
    pub fn create(&self, name: impl AsRef<Path>) -> Result<DraftFile> {
        let path = self.temporary.join(name);
        let make = || {
            if let Some(folder) = path.parent() {
                std::fs::create_dir_all(folder)?;
            }
            fault_injection::at(Operation::Create, &path)?;
            OpenOptions::new().write(true).create_new(true).open(&path)
        };
        let file = make().map_err(io("creating", &path))?;
        Ok(DraftFile {
            out: BufWriter::with_capacity(BUFFER_BYTES, file),
            path,
        })
    }

    /// [`create`](Self::create) for bytes at hand.
    ///
    /// # Errors
    /// When there is such a file, or the operating system refuses.
    pub fn write(&self, name: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
        let mut file = self.create(name)?;
        file.append(bytes)?;
        file.finish()
    }

    /// Where a file of the draft lies until it is published, for other programs that write it.
    #[must_use]
    pub fn path_of(&self, name: impl AsRef<Path>) -> PathBuf {
        self.temporary.join(name)
    }

    /// Flushes one file of the draft and gives it the name that the folder was to have, in place of a file that has it; the
    /// rest is removed.
    ///
    /// # Errors
    /// When there is no such file, or the operating system refuses; nothing is in its place then that was not before.
    pub fn publish_file(self, name: impl AsRef<Path>) -> Result<()> {
        let path = self.path_of(name);
        let flush = || or_missing(File::open(&path)?.sync_all());
        flush().map_err(io("flushing", &path))?;
        rename(&path, &self.place)
    }

    /// Flushes the folders and renames the draft to its place.
    ///
    /// # Errors
    /// When something is in its place, or the operating system refuses; the draft is removed then.
    pub fn publish(self) -> Result<()> {
        sync_tree(&self.temporary)?;
        rename(&self.temporary, &self.place)
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        // Nothing is there any more after a rename. Best effort otherwise: a folder that stays behind is swept later.
        let _ = std::fs::remove_dir_all(&self.temporary);
    }
}

/// A file of a [`Draft`]; written through a buffer, it counts when [`finish`](Self::finish) has returned.
#[derive(Debug)]
pub struct DraftFile {
    out: BufWriter<File>,
    path: PathBuf,
}

impl DraftFile {
    /// Appends bytes.
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn append(&mut self, bytes: &[u8]) -> Result<()> {
        self.out.write_all(bytes).map_err(io("writing", &self.path))
    }

    /// Flushes the file to disk.
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn finish(mut self) -> Result<()> {
        let flush = |out: &mut BufWriter<File>| {
            out.flush()?;
            fault_injection::at(Operation::Sync, &self.path)?;
            or_missing(out.get_ref().sync_all())
        };
        flush(&mut self.out).map_err(io("writing", &self.path))
    }
}

/// Flushes a folder and all folders below it.
fn sync_tree(folder: &Path) -> Result<()> {
    for entry in std::fs::read_dir(folder).map_err(io("listing", folder))? {
        let entry = entry.map_err(io("listing", folder))?;
        if entry.file_type().map_err(io("listing", folder))?.is_dir() {
            sync_tree(&entry.path())?;
        }
    }
    sync_folder(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_draft_appears_when_it_is_published_and_never_otherwise() {
        let root = tempfile::tempdir().unwrap();
        let place = root.path().join("episode");
        let draft = Draft::begin(&place).unwrap();
        draft.write("a/b.txt", b"b").unwrap();
        assert!(draft.create("a/b.txt").is_err(), "twice the same file");
        drop(draft);
        assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 0);

        let draft = Draft::begin(&place).unwrap();
        draft.write("a/b.txt", b"b").unwrap();
        draft.publish().unwrap();
        assert_eq!(std::fs::read(place.join("a/b.txt")).unwrap(), b"b");

        let second = Draft::begin(&place).unwrap();
        second.write("c.txt", b"c").unwrap();
        second.publish().unwrap_err();
        assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 1);
        assert!(!place.join("c.txt").exists());
    }
}
