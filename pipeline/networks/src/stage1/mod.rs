//! The Stage-1 lifting network (`docs/spec/stage1.md`).
//!
//! [`Stage1::encode`] turns the source frames of a clip into what the heads read; [`Stage1::head`] gives the dense heads,
//! of which the motion heads are asked once per query time.

pub mod adapter;
pub mod aggregator;
pub mod block;
pub mod config;
pub mod decode;
pub mod distillation;
pub mod encoder;
pub mod geometry;
pub mod head;
pub mod layout;
pub mod losses;
pub mod network;
pub mod positions;
pub mod seeded;
pub mod stem;
pub mod sweep;

pub use crate::kernels::Precision;
pub use aggregator::Attention;
pub use config::{HeadKind, Stage1Config};
pub use geometry::{Camera, FramePose};
pub use network::{Encoded, SourceFrames, Stage1};
