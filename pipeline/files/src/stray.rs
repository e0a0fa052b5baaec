//! Files that systems put beside data.

use std::ffi::OsStr;
use std::fs::DirEntry;
use std::path::Path;

/// Names without a dot in front that file managers, archives, storage systems and interpreters leave behind.
const KNOWN: [&str; 22] = [
    "thumbs.db",
    "ehthumbs.db",
    "ehthumbs_vista.db",
    "desktop.ini",
    "desktop db",
    "desktop df",
    "icon\r",
    "__macosx",
    "__pycache__",
    "@eadir",
    "@recycle",
    "#recycle",
    "#snapshot",
    "~snapshot",
    "$recycle.bin",
    "recycler",
    "found.000",
    "network trash folder",
    "temporary items",
    "thevolumesettingsfolder",
    "system volume information",
    "lost+found",
];
/// Endings of what is on its way (downloads, copies), of what editors keep, and of backups.
const ENDINGS: [&str; 16] = [
    "~",
    ".tmp",
    ".temp",
    ".part",
    ".partial",
    ".filepart",
    ".crdownload",
    ".download",
    ".aria2",
    ".incomplete",
    ".swp",
    ".swo",
    ".bak",
    ".orig",
    ".old",
    ".lock",
];
/// Beginnings of what offices and editors keep beside a file that is open.
const BEGINNINGS: [&str; 3] = [".", "~$", ".~"];
/// What services that bring folders in step put into the name of a second version of a file.
const SECOND_VERSIONS: [&str; 3] = [".sync-conflict-", "conflicted copy", "[conflict]"];

/// True for the name of a file or folder that nobody put among data on purpose: names that begin with a dot (`._000000.png`
/// of macOS on foreign disks, `.DS_Store`, `.git`), what file managers and storage systems leave, downloads that are on their
/// way (`a.part`), backups (`a~`, `a.bak`), and second versions of services that bring folders in step. Such files are no
/// data: whoever lists, counts or hashes a folder leaves them out ([`entries`]). A file that is named outright is read all
/// the same.
#[must_use]
pub fn is_stray(name: &OsStr) -> bool {
    let name = name.to_string_lossy().to_lowercase();
    let kept_by_an_editor = name.len() > 2 && name.starts_with('#') && name.ends_with('#');
    KNOWN.contains(&name.as_str())
        || BEGINNINGS.iter().any(|beginning| name.starts_with(beginning))
        || ENDINGS.iter().any(|ending| name.ends_with(ending))
        || SECOND_VERSIONS.iter().any(|part| name.contains(part))
        || kept_by_an_editor
}

/// What lies in a folder besides strays ([`is_stray`]), in no order.
///
/// # Errors
/// When the folder cannot be read; an entry that cannot is an error of its own.
pub fn entries(folder: &Path) -> std::io::Result<impl Iterator<Item = std::io::Result<DirEntry>>> {
    let is_data = |entry: &std::io::Result<DirEntry>| match entry {
        Ok(entry) => !is_stray(&entry.file_name()),
        Err(_) => true,
    };
    Ok(std::fs::read_dir(folder)?.filter(is_data))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strays_are_told_from_data() {
        for name in [
            "._000000.png",
            ".DS_Store",
            ".git",
            "Thumbs.db",
            "desktop.ini",
            "__MACOSX",
            "@eaDir",
            "episode.json~",
            "ehthumbs_vista.db",
            "Icon\r",
            "Desktop DB",
            "#recycle",
            "$RECYCLE.BIN",
            "FOUND.000",
            "System Volume Information",
            "lost+found",
            ".ipynb_checkpoints",
            "__pycache__",
            ".nfs000000000001",
            ".Trash-1000",
            "000003.png.part",
            "000003.png.crdownload",
            "episode.json.bak",
            "episode.json.orig",
            "episode.json.tmp",
            "joints.csv.swp",
            "~$joints.xlsx",
            ".~lock.joints.csv#",
            "#joints.csv#",
            "file-000.parquet.lock",
            "joints.sync-conflict-20260131-101010-ABCDEF.csv",
            "joints (Anna's conflicted copy 2026-01-31).csv",
        ] {
            assert!(is_stray(OsStr::new(name)), "{name}");
        }
        for name in [
            "000000.png",
            "episode.json",
            "meta",
            "_hidden",
            "a.b",
            "Icon",
            "~x",
            "#",
            "a#",
            "part",
            "tmp",
            "backup",
            "lost",
            "unlock",
        ] {
            assert!(!is_stray(OsStr::new(name)), "{name}");
        }
    }

    #[test]
    #[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
    fn entries_are_what_is_no_stray() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["b.png", "a.png", "._a.png", "Thumbs.db", "a.png.part"] {
            std::fs::write(folder.path().join(name), b"").unwrap();
        }
        let entries = entries(folder.path()).unwrap();
        let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, ["a.png", "b.png"]);
        assert!(super::entries(&folder.path().join("c")).is_err());
    }
}
