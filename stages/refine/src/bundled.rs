//! The refiner inside the program.

use rogs_weights::Bundled;

/// The bundled refiner: the `ci` preset, trained on fields of the built-in Stage 1 on procedural clips
/// only. Its model card is `stages/refine/weights/README.md`.
pub static CI_WEIGHTS: &[u8] = include_bytes!("../weights/ci-stage2.safetensors");

/// The same with its name: what a run takes that names no weights.
pub static BUILTIN: Bundled = Bundled::new("ci-stage2.safetensors", CI_WEIGHTS);
