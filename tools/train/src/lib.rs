//! Training of the networks on procedural clips with exact references.
//!
//! [`Stage1Trainer`] holds a run of Stage 1 between two updates, [`Stage2Trainer`] one of Stage 2,
//! [`LatentTrainer`] one of the latent adapter, which alone is not trained on procedural clips; [`run::run`] is the loop that
//! every kind of training shares, and [`Stream`] makes the clips of each update in the background. Losses on
//! renders flow through the rasteriser's own backward pass. Everything random follows from the seed and the number of the
//! update, so a resumed run takes the same trainer as an uninterrupted one.

mod builder;
pub mod checkpoint;
pub mod config;
mod device_copies;
mod error;
pub mod latent;
mod perceptual;
mod picture;
pub mod plan;
pub mod props;
pub mod recorded;
pub mod records;
mod report;
pub mod run;
pub mod sample;
mod segments;
pub mod sources;
pub mod stage1;
pub mod stage2;
pub mod stream;

pub use config::Stage1Training;
pub use error::{Error, Result};
pub use latent::{LatentTrainer, LatentTraining};
pub use picture::Picture;
pub use run::{Trainer, UpdateReport};
pub use stage1::Stage1Trainer;
pub use stage2::{Stage2Trainer, Stage2Training};
pub use stream::Stream;
