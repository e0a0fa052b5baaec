//! The error of this crate.

use std::path::{Path, PathBuf};

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// The operating system refused.
#[derive(Debug, thiserror::Error)]
#[error("{action} `{}`", path.display())]
pub struct Error {
    /// What was tried, for example `writing`.
    pub action: &'static str,
    /// The file or folder.
    pub path: PathBuf,
    /// Why it failed.
    pub source: std::io::Error,
}

/// What to do about an error of the operating system, where something is known.
#[must_use]
pub fn hint(error: &std::io::Error) -> Option<&'static str> {
    use std::io::ErrorKind::{FileTooLarge, PermissionDenied, QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    match error.kind() {
        StorageFull | QuotaExceeded => {
            Some("free some space on that disk, then run the same command again: finished outputs are kept")
        }
        FileTooLarge => Some("raise the limit on file sizes (`ulimit -f`)"),
        PermissionDenied | ReadOnlyFilesystem => Some("check the permissions of the file and of its folder"),
        _ if matches!(error.raw_os_error(), Some(libc::EMFILE | libc::ENFILE)) => {
            Some("too many open files: use fewer workers or raise `ulimit -n`")
        }
        _ => None,
    }
}

impl From<Error> for std::io::Error {
    fn from(error: Error) -> Self {
        Self::new(error.source.kind(), error)
    }
}

/// For `map_err`: the error of this action on this path.
pub(crate) fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Error {
    let path = path.to_owned();
    move |source| Error { action, path, source }
}
