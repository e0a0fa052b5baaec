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
            rogs_r4c::Error::Io { source, .. } => (class_of(source), rogs_files::hint(source)),
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

/// Class of an error of the operating system.
fn class_of(error: &std::io::Error) -> FailureCode {
    match error.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge | ErrorKind::OutOfMemory => {
            FailureCode::Resource
        }
        ErrorKind::NotFound
        | ErrorKind::PermissionDenied
        | ErrorKind::ReadOnlyFilesystem
        | ErrorKind::InvalidInput
        | ErrorKind::IsADirectory => FailureCode::BadInput,
        _ if matches!(Errno::from_io_error(error), Some(Errno::MFILE | Errno::NFILE)) => FailureCode::Resource,
        _ => FailureCode::Io,
    }
}
