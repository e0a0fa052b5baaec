//! The Stage-1 lifting network (`docs/spec/stage1.md`).
//!
//! [`Stage1::encode`] turns the source frames of a clip into what the heads read; [`Stage1::head`] gives the dense heads,
//! of which the motion heads are asked once per query time.

pub mod adapter;
pub mod aggregator;
pub mod checkpoint;
pub mod config;
pub mod decode;
pub mod distillation;
pub mod encoded;
pub mod encoder;
pub mod frames;
pub mod geometry;
pub mod head;
pub mod held;
mod held_path;
pub mod import;
pub mod layout;
pub mod losses;
pub mod network;
pub mod positions;
pub mod pyramid;
pub mod seeded;
pub mod stem;
pub mod sweep;

pub use checkpoint::{LoadedStage1, STAGE1, open_stage1, read_stage1, stage1_metadata, verify_stage1};
pub use config::{HeadKind, Stage1Config};
pub use encoded::Encoded;
pub use frames::{Attention, SourceFrames};
pub use geometry::NetworkCamera;
pub use import::{ImportReport, ImportRequest, Origin, generate_stage1, import_stage1, merge_lora};
pub use network::Stage1;
pub use rogs_kernels::Precision;
pub use rogs_tensors::{Error, Result};
