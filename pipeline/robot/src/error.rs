//! Errors of this crate.

use std::path::PathBuf;

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// What can be wrong with a robot, a mesh or a joint table.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused.
    #[error("{action} `{}`", path.display())]
    Io {
        /// What was tried, for example `reading`.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// Why it failed.
        source: std::io::Error,
    },
    /// A URDF file that cannot be used.
    #[error("robot `{}`: {what}", path.display())]
    Urdf {
        /// The file.
        path: PathBuf,
        /// What is wrong, with the link or joint where it is known.
        what: String,
    },
    /// A mesh file that cannot be used.
    #[error("mesh `{}`: {what}", path.display())]
    Mesh {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// A file reference that leads out of the robot's folder or to nothing.
    #[error("file reference `{reference}`: {what}")]
    Reference {
        /// The reference as written in the file, or the path of a file that is too large.
        reference: String,
        /// What is wrong, and what to do.
        what: String,
    },
    /// A name that the robot does not have.
    #[error("the robot has no {kind} `{name}`{suggestion}")]
    Unknown {
        /// `link` or `joint`.
        kind: &'static str,
        /// The name that was asked for.
        name: String,
        /// Empty, or `; did you mean ...?`.
        suggestion: String,
    },
    /// Joint values that make no robot state.
    #[error("joint `{joint}`: {what}")]
    Joint {
        /// The joint.
        joint: String,
        /// What is wrong with its value.
        what: String,
    },
    /// A joint table (CSV) that cannot be read.
    #[error("joint table, {place}: {what}")]
    Table {
        /// Row and column.
        place: String,
        /// What is wrong.
        what: String,
    },
    /// A picture that cannot be drawn.
    #[error("mesh rasteriser: {what}")]
    Raster {
        /// What is wrong.
        what: String,
    },
}

impl Error {
    /// The message with its causes, in one line.
    #[must_use]
    pub fn chain(&self) -> String {
        let mut message = self.to_string();
        let mut source = std::error::Error::source(self);
        while let Some(cause) = source {
            message = format!("{message}: {cause}");
            source = cause.source();
        }
        message
    }
}

impl From<rogs_robot_files::ReferenceError> for Error {
    fn from(rogs_robot_files::ReferenceError { reference, what }: rogs_robot_files::ReferenceError) -> Self {
        Self::Reference { reference, what }
    }
}
