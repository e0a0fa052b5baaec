//! The perceptual loss: its weights are the user's.

use std::path::Path;

use burn::tensor::Device;
use rogs_lpips::{LpipsTensors, LpipsWeights};

use crate::error::Result;

/// The network of LPIPS on a device, when there are weights for it.
///
/// # Errors
/// When they cannot be read.
pub(crate) fn perceptual(weights: Option<&Path>, device: &Device) -> Result<Option<LpipsTensors>> {
    let weights = weights.map(LpipsWeights::open).transpose()?;
    Ok(weights.map(|weights| LpipsTensors::new(&weights, device)))
}
