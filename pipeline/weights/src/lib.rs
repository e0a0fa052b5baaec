//! Weights files: our checkpoints, and the files of others.
//!
//! A checkpoint is a safetensors file whose metadata says what network it holds (`rogs.kind`, `rogs.configuration`),
//! whether it was trained (`rogs.trained`) and where it comes from (`rogs.provenance`). It is mapped into memory
//! ([`TensorFile`]), so that opening one costs nothing and a network can be run without holding all of it; it is written
//! tensor by tensor ([`write()`]), so that it may be larger than memory. Which tensors a network has is not known here.

mod average;
mod bundled;
mod error;
mod file;
mod header;
mod open;
#[cfg(feature = "pytorch")]
mod pytorch;
mod renamed;
mod spec;
mod verify;
mod write;

pub use average::average;
pub use bundled::{BUILTIN, Bundled, SEEDED, Unfiled};
pub use error::{Error, Result};
pub use file::TensorFile;
pub use header::{ElementType, StoredType, TensorEntry};
pub use open::{EXTENSIONS, is_weights_file, open_any};
pub use renamed::Renamed;
pub use spec::{Initial, ParameterSpec, Seeded};
pub use verify::{Verification, verify};
pub use write::{TensorSource, write};

/// Metadata key: which network, `stage1` or another.
pub const KIND: &str = "rogs.kind";
/// Metadata key: configuration as JSON.
pub const CONFIGURATION: &str = "rogs.configuration";
/// Metadata key: `true` for trained weights, `false` for generated ones.
pub const TRAINED: &str = "rogs.trained";
/// Metadata key: for people, where the weights come from.
pub const PROVENANCE: &str = "rogs.provenance";
/// Metadata key: the kind of clips that the weights were trained on, where that is a narrow one.
pub const TRAINING_DOMAIN: &str = "rogs.training_domain";
/// Value of [`TRAINING_DOMAIN`] for weights that have seen nothing but clips of the procedural generator.
pub const PROCEDURAL: &str = "procedural";

/// Where the values of parameters come from when they are not held in memory.
pub trait ParameterSource: Send + Sync {
    /// Shape of a parameter, `None` when there is none of that name.
    fn shape(&self, name: &str) -> Option<&[usize]>;
    /// Values of a parameter widened to f32, row-major.
    ///
    /// # Errors
    /// When it is missing or cannot be read.
    fn values(&self, name: &str) -> Result<Vec<f32>>;
    /// All names, ascending.
    fn names(&self) -> Vec<&str>;
}
