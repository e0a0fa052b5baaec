//! How a stage fails.

use std::io::ErrorKind;

use rogs_schemas::protocol::FailureCode;
use rustix::io::Errno;

/// Result of a stage.
pub type StageResult<T> = Result<T, StageError>;

/// A failure as a person will read it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{message}")]
pub struct StageError {
    /// Class, for the retry policy.
    pub code: FailureCode,
    /// What, where (file, clip, frame, joint); lower case, no full stop.
    pub message: String,
    /// What to do about it.
    pub hint: Option<String>,
}

impl StageError {
    /// The input is wrong.
    pub fn bad_input(message: impl Into<String>) -> Self {
        Self {
            code: FailureCode::BadInput,
            message: message.into(),
            hint: None,
        }
    }

    /// The parameters are wrong.
    pub fn bad_params(message: impl Into<String>) -> Self {
        Self {
            code: FailureCode::BadParams,
            message: message.into(),
            hint: None,
        }
    }

    /// Reading or writing failed.
    pub fn io(message: impl Into<String>) -> Self {
        Self {
            code: FailureCode::Io,
            message: message.into(),
            hint: None,
        }
    }

    /// A bug, for example a panic that was caught.
    pub fn internal(message: impl Into<String>) -> Self {
        Self {
            code: FailureCode::Internal,
            message: message.into(),
            hint: None,
        }
    }

    /// The same error with a hint.
    #[must_use]
    pub fn with_hint(self, hint: impl Into<String>) -> Self {
        Self {
            hint: Some(hint.into()),
            ..self
        }
    }
}

impl From<rogs_r4c::Error> for StageError {
    fn from(error: rogs_r4c::Error) -> Self {
        let (code, hint) = match &error {
            rogs_r4c::Error::Io { source, .. } => classify_io(source),
            _ => (FailureCode::BadInput, None),
        };
        let mut message = error.to_string();
        let mut source = std::error::Error::source(&error);
        while let Some(cause) = source {
            message = format!("{message}: {cause}");
            source = cause.source();
        }
        Self {
            code,
            message,
            hint: hint.map(str::to_owned),
        }
    }
}

/// Class and hint of an error of the operating system.
fn classify_io(error: &std::io::Error) -> (FailureCode, Option<&'static str>) {
    match error.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => (
            FailureCode::Resource,
            Some("free some space on the disk of the run folder, then run again"),
        ),
        ErrorKind::FileTooLarge => (
            FailureCode::Resource,
            Some("raise the limit on file sizes (`ulimit -f`)"),
        ),
        ErrorKind::OutOfMemory => (
            FailureCode::Resource,
            Some("use fewer workers or a machine with more memory"),
        ),
        ErrorKind::NotFound => (FailureCode::BadInput, None),
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => (
            FailureCode::BadInput,
            Some("check the permissions of the file and of its folder"),
        ),
        _ if matches!(Errno::from_io_error(error), Some(Errno::MFILE | Errno::NFILE)) => (
            FailureCode::Resource,
            Some("too many open files: use fewer workers or raise `ulimit -n`"),
        ),
        _ => (FailureCode::Io, None),
    }
}
