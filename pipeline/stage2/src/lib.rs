//! The Stage-2 refiner: rendering feedback, pooled onto Gaussians, drives a recurrent point-attention updater whose
//! residuals are shared by all query times (`docs/spec/stage2.md`, part B).
//!
//! The frozen half ([`ErrorEncoder`]: ResNet-18 front and multi-view attention) runs on slice kernels,
//! because nothing is ever differentiated through it. The trained half ([`Updater`]: observation projection, input
//! layer, neighbour-attention blocks, head, gates) is made of tensor operations, so that training differentiates the
//! very code that inference runs. [`rogs_field::Correction`] holds what they produce.
//!
//! Lengths are internal units (3.5 per metre) unless a name ends in `_m`.

pub mod config;
pub mod error_encoder;
mod host_updater;
pub mod import;
pub mod knn;
pub mod mv_attention;
pub mod objective;
pub mod observation;
pub mod refiner;
pub mod released;
pub mod resnet;
pub mod tokens;
pub mod updater;
pub mod weights;

pub use burn::tensor::Device;
pub use config::RefinerConfig;
pub use error_encoder::ErrorEncoder;
pub use import::{read_parameters, read_weights};
pub use knn::nearest_neighbours;
pub use refiner::{Refiner, TokenSet};
pub use released::{ReleasedImport, ReleasedModel, import_released, verify_released};
pub use resnet::{FeatureMaps, ResNetFront};
pub use rogs_kernels::FeatureMap;
pub use rogs_tensors::{Error, Result};
pub use tokens::TokenGrid;
pub use updater::Updater;
pub use weights::{parameter_shapes, seeded_parameters, verify_parameters};
