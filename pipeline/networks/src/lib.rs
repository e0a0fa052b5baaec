//! The networks of rogs on one framework (burn): the Stage-1 lifter, the Stage-2 refiner and LPIPS.
//!
//! The device is a value ([`burn::tensor::Device`], opened by [`device::open`]): every function takes tensors of the
//! device its parameters live on, and the CPU (`Device::flex()`) is the default. Parameters are named as in the released
//! checkpoints and come from a [`parameters::Parameters`] store: held in memory (to be trained, or small), or read tensor
//! by tensor from a mapped file so that a network larger than memory allows still runs.
//!
//! Lengths inside the networks are internal units, 3.5 per metre.

pub mod checkpoint;
pub mod device;
pub mod error;
mod kernels;
pub mod lpips;
pub mod ops;
pub mod optimiser;
pub mod parameters;
pub mod render;
pub mod stage1;
pub mod stage2;

pub use error::{Error, Result};
