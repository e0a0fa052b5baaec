//! What the commands about weights print as JSON.

use std::collections::BTreeMap;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::Serialize;

/// A checkpoint made of a released file.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Imported {
    /// The checkpoint.
    pub(super) out: PathBuf,
    /// Tensors in it.
    pub(super) tensors: usize,
    /// Which network the released file holds, where it was told by its names.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) origin: Option<String>,
    /// Tensors that the file has none of: they start from a seed.
    pub(super) from_a_seed: Vec<String>,
}

/// A checkpoint of random values.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Generated {
    /// The checkpoint.
    pub(super) out: PathBuf,
    /// Name of its configuration.
    pub(super) configuration: String,
    /// Seed.
    pub(super) seed: u64,
}

/// A checkpoint whose low-rank updates are folded in.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Merged {
    /// The checkpoint.
    pub(super) out: PathBuf,
}

/// An average of checkpoints.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Averaged {
    /// The checkpoint.
    pub(super) out: PathBuf,
    /// What was averaged, each with its share.
    pub(super) inputs: Vec<(PathBuf, f64)>,
}

/// What a safetensors file holds.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Listed {
    /// Its tensors.
    pub(super) tensors: Vec<Shape>,
    /// Numbers in all of them.
    pub(super) elements: usize,
    /// What the file says of itself.
    pub(super) metadata: BTreeMap<String, String>,
}

/// A tensor.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Shape {
    /// Name.
    pub(super) name: String,
    /// Sides.
    pub(super) shape: Vec<usize>,
}

/// What a check of a weights file found.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Checked {
    /// What it was compared with, in words.
    pub(super) network: String,
    /// Whether all is well.
    pub(super) good: bool,
    /// SHA-256 of the file, hexadecimal.
    pub(super) sha256: String,
    /// Whether that is the one asked for; null where none was.
    pub(super) sha256_is_right: Option<bool>,
    /// Tensors as they should be.
    pub(super) matching: usize,
    /// Names of tensors that are not there.
    pub(super) missing: Vec<String>,
    /// Names of tensors that the network has none of.
    pub(super) unexpected: Vec<String>,
    /// Tensors of other shapes than the network's.
    pub(super) misshapen: Vec<Misshapen>,
    /// Tensors with values that are not finite, in words.
    pub(super) not_finite: Vec<String>,
    /// What a person should know.
    pub(super) note: Option<String>,
}

/// A tensor of another shape than the network's.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Misshapen {
    /// Name.
    pub(super) name: String,
    /// Sides that it has.
    pub(super) found: Vec<usize>,
    /// Sides that it should have.
    pub(super) needed: Vec<usize>,
}

/// A file that was fetched.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Fetched {
    /// Name on the command line.
    pub(super) name: &'static str,
    /// Where it lies.
    pub(super) file: PathBuf,
    /// Its length.
    pub(super) bytes: u64,
    /// Its SHA-256, hexadecimal.
    pub(super) sha256: String,
    /// Who says that this is right.
    pub(super) sha256_from: &'static str,
    /// Bytes that an earlier attempt had left.
    pub(super) resumed_from: u64,
}
