//! The lifter inside the program.

use rogs_weights::Bundled;

/// The bundled checkpoint: the `compact-sweep` network in bfloat16, trained on procedural clips only. Its
/// model card is `stages/lift/weights/README.md`.
pub static COMPACT_WEIGHTS: &[u8] = include_bytes!("../weights/compact-stage1.safetensors");

/// The same with its name: what a run takes that names no weights.
pub static BUILTIN: Bundled = Bundled::new("compact-stage1.safetensors", COMPACT_WEIGHTS);

/// Height and width of the images that the bundled checkpoint was trained at, pixels.
pub const BUILTIN_SIZE: [u32; 2] = [84, 154];
