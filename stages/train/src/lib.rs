//! Training of the networks on procedural clips with exact references.
//!
//! [`Trainer`] holds a run of Stage 1 between two updates, [`Stage2Trainer`] one of Stage 2; [`run::run`] is the loop that every kind of training shares, and [`Stream`] makes the clips of each update in the
//! background. Losses of
//! the network's outputs are differentiated by the framework, losses of renders by the rasteriser's backward pass
//! ([`renders`]). Everything random follows from the seed and the number of the update, so a resumed run takes the same
//! course as an uninterrupted one.

pub mod checkpoint;
pub mod config;
mod error;
pub mod evaluate;
pub mod forward;
pub mod objective;
pub mod optimiser;
pub mod records;
pub mod refining;
pub mod renders;
mod report;
pub mod run;
pub mod sample;
pub mod start;
pub mod stream;
pub mod trainer;

pub use config::Stage1Training;
pub use error::{Error, Result};
pub use refining::{Stage2Trainer, Stage2Training};
pub use run::{Course, UpdateReport};
pub use stream::Stream;
pub use trainer::Trainer;
