//! What lies at a place: files are read only where they are files, and nothing is written through links.

use std::fs::{File, FileType, Metadata, OpenOptions};
use std::io::{Error as IoError, ErrorKind, Read as _, Write as _};
use std::os::unix::fs::{FileExt as _, FileTypeExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Component, Path};

use crate::error::{Result, io};
use crate::fault_injection::{self, Operation};

/// Opens a file for reading, as [`File::open`] does, where it is a file: following links, but never waiting for the other
/// end of a pipe and never reading a device, which may have no end.
///
/// # Errors
/// The error of the operating system, [`ErrorKind::InvalidInput`] where something else has the name, or
/// [`ErrorKind::InvalidData`] where the file only stands for one that was not fetched.
pub fn open(path: &Path) -> std::io::Result<File> {
    let file = OpenOptions::new()
        .read(true)
        .custom_flags(libc::O_NONBLOCK)
        .open(path)?;
    let metadata = file.metadata()?;
    if !metadata.is_file() {
        return Err(not_a_file(metadata.file_type()));
    }
    refuse_stand_in(&file, metadata.len())?;
    Ok(file)
}

/// What programs leave in place of files that they keep elsewhere: how it begins, whose it is and how to get the file.
const STAND_INS: [(&[u8], &str, &str); 2] = [
    (b"version https://git-lfs.github.com/spec/", "Git LFS", "git lfs pull"),
    (b"/annex/objects/", "git-annex", "git annex get"),
];

/// An error for a file that stands for another; they are short.
fn refuse_stand_in(file: &File, length: u64) -> std::io::Result<()> {
    const LONGEST: u64 = 1024;
    if length > LONGEST {
        return Ok(());
    }
    let mut begin = [0; 64];
    let read = file.read_at(&mut begin, 0)?;
    let found = STAND_INS
        .iter()
        .find(|(beginning, ..)| begin[..read].starts_with(beginning));
    found.map_or(Ok(()), |(_, of, command)| {
        let what = format!("it is a pointer of {of}, the file itself was not fetched: `{command}` gets it");
        Err(IoError::new(ErrorKind::InvalidData, what))
    })
}

/// Reads a file, as [`std::fs::read`] does, where [`open`] opens it.
///
/// # Errors
/// See [`open`].
pub fn read(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut file = open(path)?;
    let mut bytes = Vec::with_capacity(file.metadata().map_or(0, |file| file.len()).min(1 << 30) as usize);
    file.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// [`read`] for text.
///
/// # Errors
/// See [`open`]; [`ErrorKind::InvalidData`] when it is not UTF-8.
pub fn read_to_string(path: &Path) -> std::io::Result<String> {
    let mut text = String::new();
    open(path)?.read_to_string(&mut text)?;
    Ok(text)
}

/// The error for what is there instead of a file.
fn not_a_file(kind: FileType) -> IoError {
    let what = if kind.is_dir() {
        "a folder"
    } else if kind.is_fifo() {
        "a pipe"
    } else if kind.is_socket() {
        "a socket"
    } else if kind.is_char_device() || kind.is_block_device() {
        "a device"
    } else if kind.is_symlink() {
        "a link"
    } else {
        "no file"
    };
    IoError::new(ErrorKind::InvalidInput, format!("it is {what}, expected a file"))
}

/// The error for a link where something is to be written.
fn is_link() -> IoError {
    IoError::new(
        ErrorKind::InvalidInput,
        "it is a link, and nothing is written through links: remove it, or use another folder",
    )
}

/// What has the name itself, links not followed; `None` when nothing has.
pub(crate) fn here(path: &Path) -> std::io::Result<Option<Metadata>> {
    match std::fs::symlink_metadata(path) {
        Ok(found) => Ok(Some(found)),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// Opens a file of our own for reading and writing, making it where needed; never what lies behind a link. A file that
/// has another name elsewhere (a hard link) is replaced by a copy first, so that the other one stays as it is.
pub(crate) fn open_own(path: &Path, options: &mut OpenOptions) -> std::io::Result<File> {
    if let Some(found) = here(path)? {
        if found.is_symlink() {
            return Err(is_link());
        }
        if !found.is_file() {
            return Err(not_a_file(found.file_type()));
        }
        if found.nlink() > 1 {
            crate::write_bytes(path, &read(path)?)?;
        }
    }
    let opened = options
        .create(true)
        .custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK)
        .open(path);
    let file = opened.map_err(|error| match error.raw_os_error() {
        Some(libc::ELOOP) => is_link(),
        _ => error,
    })?;
    let kind = file.metadata()?.file_type();
    if kind.is_file() {
        Ok(file)
    } else {
        Err(not_a_file(kind))
    }
}

/// Appends bytes to a file in one write, making the file and its folder where needed. For logs, which only grow. Nothing
/// is appended through a link.
///
/// # Errors
/// When the place is a link or no file, or the operating system refuses.
pub fn append(path: &Path, bytes: &[u8]) -> Result<()> {
    let open = || open_own(path, OpenOptions::new().append(true));
    let write = || {
        fault_injection::at(Operation::Append, path)?;
        let mut file = match open() {
            Err(error) if error.kind() == ErrorKind::NotFound => {
                std::fs::create_dir_all(crate::paths::folder_of(path))?;
                open()?
            }
            other => other?,
        };
        file.write_all(bytes)
    };
    write().map_err(io("appending to", path))
}

/// Makes the folder `path` below `root`, with the folders on the way to it. `root` may lie anywhere and be a link itself;
/// nothing below it may be one, so that what is written there stays there.
///
/// # Errors
/// When something on the way is a link or no folder, when `path` does not lie below `root`, or the operating system
/// refuses.
pub fn make_folder_below(root: &Path, path: &Path) -> Result<()> {
    std::fs::create_dir_all(root).map_err(io("making the folder", root))?;
    let below = path.strip_prefix(root).ok();
    let inside = |below: &&Path| below.components().all(|part| matches!(part, Component::Normal(_)));
    let Some(below) = below.filter(inside) else {
        let error = IoError::new(ErrorKind::InvalidInput, "it does not lie in the folder");
        return Err(io("making the folder", path)(error));
    };
    let mut folder = root.to_owned();
    for part in below.components() {
        folder.push(part);
        let make = || match here(&folder)? {
            None => match std::fs::create_dir(&folder) {
                // Another process was faster.
                Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(()),
                other => other,
            },
            Some(found) if found.is_dir() => Ok(()),
            Some(found) if found.is_symlink() => Err(is_link()),
            Some(_) => Err(IoError::new(
                ErrorKind::NotADirectory,
                "it is a file, expected a folder",
            )),
        };
        make().map_err(io("making the folder", &folder))?;
    }
    Ok(())
}

/// Removes a file below `root`, or the link that has its name; nothing when it is gone. What lies behind a folder that is a
/// link is not below `root`.
///
/// # Errors
/// When a folder on the way is a link, or the operating system refuses.
pub fn remove_below(root: &Path, path: &Path) -> Result<()> {
    let folders = path.ancestors().skip(1).take_while(|folder| *folder != root);
    for folder in folders.filter(|folder| folder.starts_with(root)) {
        if here(folder)
            .map_err(io("removing", path))?
            .is_some_and(|found| found.is_symlink())
        {
            return Err(io("removing", path)(is_link()));
        }
    }
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(io("removing", path)(error)),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn pointers_to_files_that_were_not_fetched_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("video.mp4");
        for (content, command) in [
            (
                "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a214614ab2935c943f9e0ff69d22eadbb8f32b1\nsize 12345\n",
                Some("git lfs pull"),
            ),
            (
                "/annex/objects/MD5E-s12345--d41d8cd98f00b204e9800998ecf8427e.mp4\n",
                Some("git annex get"),
            ),
            ("version 2\n", None),
            ("", None),
        ] {
            std::fs::write(&path, content).unwrap();
            let error = open(&path).err();
            assert_eq!(
                error.as_ref().map(IoError::kind),
                command.map(|_| ErrorKind::InvalidData)
            );
            let told = error.map(|error| error.to_string()).unwrap_or_default();
            assert!(told.contains(command.unwrap_or_default()), "{told}");
        }
    }

    #[test]
    fn what_is_no_file_is_refused_without_waiting() {
        let scratch = tempfile::tempdir().unwrap();
        let pipe = scratch.path().join("pipe");
        assert!(
            std::process::Command::new("mkfifo")
                .arg(&pipe)
                .status()
                .unwrap()
                .success()
        );
        for (path, what) in [
            (pipe.as_path(), "a pipe"),
            (Path::new("/dev/zero"), "a device"),
            (scratch.path(), "a folder"),
        ] {
            let link = scratch.path().join("link");
            symlink(path, &link).unwrap();
            for path in [path, &link] {
                let error = open(path).unwrap_err();
                assert_eq!(error.kind(), ErrorKind::InvalidInput);
                assert!(error.to_string().contains(what), "{error}");
            }
            std::fs::remove_file(link).unwrap();
        }
        let file = scratch.path().join("file");
        std::fs::write(&file, "text").unwrap();
        symlink(&file, scratch.path().join("link")).unwrap();
        assert_eq!(read_to_string(&scratch.path().join("link")).unwrap(), "text");
        assert_eq!(read(&file).unwrap(), b"text");
    }

    #[test]
    fn nothing_is_appended_through_links() {
        let scratch = tempfile::tempdir().unwrap();
        let (victim, log) = (scratch.path().join("victim"), scratch.path().join("a/log"));
        std::fs::write(&victim, "mine").unwrap();
        append(&log, b"one\n").unwrap();
        append(&log, b"two\n").unwrap();
        assert_eq!(std::fs::read(&log).unwrap(), b"one\ntwo\n");
        std::fs::remove_file(&log).unwrap();
        symlink(&victim, &log).unwrap();
        let error = append(&log, b"three\n").unwrap_err();
        assert!(error.source.to_string().contains("a link"), "{}", error.source);
        std::fs::remove_file(&log).unwrap();
        std::fs::hard_link(&victim, &log).unwrap();
        append(&log, b"four\n").unwrap();
        assert_eq!(std::fs::read(&victim).unwrap(), b"mine");
        assert_eq!(std::fs::read(&log).unwrap(), b"minefour\n");
        append(scratch.path(), b"x").unwrap_err();
    }

    #[test]
    fn folders_are_made_below_a_root_and_never_behind_links() {
        let scratch = tempfile::tempdir().unwrap();
        let (root, real, elsewhere) = (
            scratch.path().join("run"),
            scratch.path().join("real"),
            scratch.path().join("elsewhere"),
        );
        for folder in [&real, &elsewhere] {
            std::fs::create_dir(folder).unwrap();
        }
        symlink(&real, &root).unwrap();
        make_folder_below(&root, &root.join("clips/a")).unwrap();
        make_folder_below(&root, &root.join("clips/a")).unwrap();
        assert!(real.join("clips/a").is_dir());
        symlink(&elsewhere, root.join("clips/b")).unwrap();
        make_folder_below(&root, &root.join("clips/b/c")).unwrap_err();
        make_folder_below(&root, &root.join("clips/b")).unwrap_err();
        make_folder_below(&root, &root.join("../up")).unwrap_err();
        make_folder_below(&root, &elsewhere).unwrap_err();
        std::fs::write(root.join("file"), "x").unwrap();
        make_folder_below(&root, &root.join("file/x")).unwrap_err();
        // Nothing is removed behind them either.
        std::fs::write(elsewhere.join("theirs"), "x").unwrap();
        remove_below(&root, &root.join("clips/b/theirs")).unwrap_err();
        std::fs::rename(elsewhere.join("theirs"), root.join("clips/a/ours")).unwrap();
        remove_below(&root, &root.join("clips/a/ours")).unwrap();
        remove_below(&root, &root.join("clips/a/ours")).unwrap();
        remove_below(&root, &root.join("clips/b")).unwrap();
        assert!(!root.join("clips/a/ours").exists() && !root.join("clips/b").exists());
        assert_eq!(std::fs::read_dir(&elsewhere).unwrap().count(), 0);
    }
}
