//! The tensor framework (burn) as the networks use it.
//!
//! The device is a value ([`burn::tensor::Device`], opened by [`device::open`]): every function takes tensors of the
//! device its parameters live on, and the CPU (`Device::flex()`) is the default. Parameters come from a
//! [`parameters::Parameters`] store: held in memory (to be trained, or small), or read tensor by tensor from a mapped file
//! so that a network larger than memory still runs. Operations ([`ops`], [`differentiable`]) run on the CPU kernels of
//! `rogs_kernels` where they pay, and through the framework elsewhere; `render` makes the rasteriser one of them.
//! Gradients, `render` and `optimiser` are behind the feature `gradients`, which only training needs.

pub mod device;
pub mod differentiable;
mod error;
pub mod host;
pub mod ops;
#[cfg(feature = "gradients")]
pub mod optimiser;
pub mod parameters;
#[cfg(feature = "gradients")]
pub mod render;

pub use error::{Error, Result};
pub use rogs_kernels::Precision;
