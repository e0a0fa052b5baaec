//! Score: render the field at the query plan, measure, write scores.
//!
//! [`metrics`] holds the measures as functions of arrays, [`measure`] applies them to the predictions of a clip, and
//! [`Score`] is the stage that renders those predictions from a field. Nothing in the measures depends on how the
//! predictions were made, so that outside methods are scored by the same code.
//!
//! [`summary`] and [`tables`] turn score sheets into the paper's tables, with the [`origins`] of the references; [`cohort`] selects the
//! episodes, [`folders`] scores images without a manifest, [`outside`] evaluates the fields of other methods.

pub mod cohort;
mod cross_view;
pub mod folders;
pub mod measure;
pub mod metrics;
pub mod origins;
pub mod outside;
mod perceptual;
pub mod pictures;
mod render;
mod stage;
pub mod summary;
pub mod tables;
pub mod timing;

pub use outside::FieldFrame;
pub use stage::{FieldScale, KeepRenders, PredictionParams, Score, ScoreParams};
