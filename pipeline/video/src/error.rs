//! Errors of this crate.

use std::path::PathBuf;

use crate::program::INSTALL;

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// What can be wrong with a film.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A name that no form of film has.
    #[error("invalid film `{}`: expected a name that ends in .mp4, .webm or .gif, or a folder for PNG images", .0.display())]
    Form(PathBuf),
    /// Frames or a rate that make no film.
    #[error("{0}")]
    Setting(String),
    /// The program cannot be started.
    #[error("the program `ffmpeg` cannot be run ({INSTALL})")]
    NoProgram(#[source] std::io::Error),
    /// The program was started and failed.
    #[error("`ffmpeg` cannot write `{}`: {said}", path.display())]
    Program {
        /// The film.
        path: PathBuf,
        /// The last line of what the program said.
        said: String,
    },
    /// Something has the name of the folder already.
    #[error("`{}` is there already: name another folder, or remove it", .0.display())]
    Taken(PathBuf),
    /// The operating system refused.
    #[error(transparent)]
    File(#[from] rogs_files::Error),
}
