//! Errors as exceptions: the message names the file and, where it is one's fault, the stream.

use pyo3::exceptions::{PyException, PyFileNotFoundError, PyOSError};
use pyo3::prelude::*;

pyo3::create_exception!(
    rogs,
    RogsError,
    PyException,
    "Something of rogs could not be done; the message says what to do."
);
pyo3::create_exception!(
    rogs,
    DamagedError,
    RogsError,
    "A file is cut off or damaged, or its parts contradict each other."
);
pyo3::create_exception!(
    rogs,
    WrongKindError,
    RogsError,
    "A file is whole but is something else than was asked for."
);

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("RogsError", py.get_type::<RogsError>())?;
    module.add("DamagedError", py.get_type::<DamagedError>())?;
    module.add("WrongKindError", py.get_type::<WrongKindError>())
}

/// An error and its causes in one line.
pub(crate) fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        text += &format!(": {inner}");
        cause = inner.source();
    }
    text
}

/// Any error of a library.
pub(crate) fn said(error: impl std::error::Error) -> PyErr {
    RogsError::new_err(chain(&error))
}

/// An error of reading a container.
pub(crate) fn read(error: rogs_r4c::Error) -> PyErr {
    let text = chain(&error);
    match error {
        rogs_r4c::Error::Io { source, .. } if source.kind() == std::io::ErrorKind::NotFound => {
            PyFileNotFoundError::new_err(text)
        }
        rogs_r4c::Error::Io { .. } => PyOSError::new_err(text),
        rogs_r4c::Error::WrongKind { .. } => WrongKindError::new_err(text),
        _ => DamagedError::new_err(text),
    }
}
