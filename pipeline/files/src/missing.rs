//! Operations that some file systems do not have, and what follows from it. Nobody else looks at the number of an error to
//! decide that.
//!
//! | operation | where it is missing | what is done instead |
//! |---|---|---|
//! | flush of a folder | SMB and FUSE mounts, some network file systems | nothing: the file is flushed, its name may be lost when the machine loses power |
//! | flush of a file | special mounts | nothing, as above |
//! | lock on a file (`flock`) | Lustre without the mount option `flock`, NFS without `lockd` | a lease, see [`crate::Lock`] |
//!
//! Links are never made, so that a file system without them serves as well.

use std::io::{Error, ErrorKind};

/// True for an error that says that the file system does not have the operation, as opposed to one that failed.
#[must_use]
pub fn is_missing_operation(error: &Error) -> bool {
    // Network file systems answer with either of the first two; EINVAL is what Linux says of descriptors that cannot be
    // flushed, ENOLCK what it says of NFS without a lock daemon, EBADF what some say of a folder opened for reading.
    error.kind() == ErrorKind::Unsupported
        || matches!(
            error.raw_os_error(),
            Some(libc::ENOSYS | libc::EOPNOTSUPP | libc::EINVAL | libc::ENOLCK | libc::EBADF | libc::ENOTTY)
        )
}

/// The outcome of an operation that may be missing: what is missing counts as done.
pub(crate) fn or_missing(outcome: std::io::Result<()>) -> std::io::Result<()> {
    match outcome {
        Err(error) if is_missing_operation(&error) => Ok(()),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_is_told_from_what_failed() {
        for missing in [libc::ENOSYS, libc::ENOTSUP, libc::EINVAL, libc::ENOLCK] {
            assert!(is_missing_operation(&Error::from_raw_os_error(missing)), "{missing}");
            or_missing(Err(Error::from_raw_os_error(missing))).unwrap();
        }
        for failed in [
            libc::EIO,
            libc::ENOSPC,
            libc::EDQUOT,
            libc::EINTR,
            libc::EROFS,
            libc::EACCES,
        ] {
            assert!(!is_missing_operation(&Error::from_raw_os_error(failed)), "{failed}");
            or_missing(Err(Error::from_raw_os_error(failed))).unwrap_err();
        }
    }
}
