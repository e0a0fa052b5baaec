//! Weights files: our checkpoints, and the files of others.
//!
//! A checkpoint is a safetensors file whose metadata says what network it holds (`rogs.kind`, `rogs.configuration`),
//! whether it was trained (`rogs.trained`) and where it comes from (`rogs.provenance`). It is mapped into memory
//! ([`TensorFile`]), so that opening one costs nothing and a network can be run without holding all of it; it is written
//! tensor by tensor ([`write()`]), so that it may be larger than memory. Which tensors a network has is not known here.

use std::collections::BTreeMap;

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

/// A narrow kind of clips that weights were trained on, as [`TRAINING_DOMAIN`] says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrainingDomain {
    /// Nothing but clips of the procedural generator.
    Procedural,
    /// Procedural clips, and recorded rooms without a robot.
    ProceduralAndRooms,
}

impl TrainingDomain {
    /// Its value in metadata.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Procedural => "procedural",
            Self::ProceduralAndRooms => "procedural and rooms",
        }
    }

    /// What metadata say; `None` where they name no narrow kind.
    #[must_use]
    pub fn of(metadata: &BTreeMap<String, String>) -> Option<Self> {
        let named = metadata.get(TRAINING_DOMAIN)?;
        [Self::Procedural, Self::ProceduralAndRooms]
            .into_iter()
            .find(|domain| domain.name() == named)
    }
}

impl std::fmt::Display for TrainingDomain {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Procedural => "procedural clips",
            Self::ProceduralAndRooms => "procedural clips and rooms without a robot",
        })
    }
}

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
