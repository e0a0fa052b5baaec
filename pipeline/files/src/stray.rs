//! Files that systems put beside data.

use std::ffi::OsStr;

/// Names without a dot in front that file managers, archives and storage systems leave behind.
const KNOWN: [&str; 9] = [
    "thumbs.db",
    "ehthumbs.db",
    "desktop.ini",
    "icon\r",
    "__macosx",
    "@eadir",
    "$recycle.bin",
    "system volume information",
    "lost+found",
];

/// True for the name of a file or folder that nobody put among data on purpose: names that begin with a dot (`._000000.png`
/// of macOS on foreign disks, `.DS_Store`, `.git`), backups of editors (`a~`), and what file managers leave. Such files are
/// no data: whoever lists, counts or hashes a folder leaves them out. A file that is named outright is read all the same.
#[must_use]
pub fn is_stray(name: &OsStr) -> bool {
    let name = name.to_string_lossy();
    name.starts_with('.') || name.ends_with('~') || KNOWN.contains(&name.to_lowercase().as_str())
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
        ] {
            assert!(is_stray(OsStr::new(name)), "{name}");
        }
        for name in ["000000.png", "episode.json", "meta", "_hidden", "a.b", "Icon", "~x"] {
            assert!(!is_stray(OsStr::new(name)), "{name}");
        }
    }
}
