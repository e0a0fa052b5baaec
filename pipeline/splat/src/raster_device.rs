//! One interface to the rasteriser wherever it runs: on the CPU, or (feature `gpu`) on a GPU.

use rogs_schemas::Device;

use crate::backward::{self, Gradients, PoseGradient, RenderGradient, Tape};
use crate::camera::{RasterCamera, RasterConfig};
use crate::contributions::{self, Contributions, Eligible};
use crate::error::{Result, SplatError};
use crate::gaussians::Gaussians;
use crate::render::{Render, render_views};

#[cfg(feature = "gpu")]
use crate::gpu::{self, GpuContributions, GpuDevice, GpuScene, GpuTape};

/// Where renders run. To keep a scene in the memory of a GPU between renders use the
/// module `gpu` itself.
#[derive(Debug, Clone, Default)]
pub enum RasterDevice {
    /// The CPU, with its widest vector instructions.
    #[default]
    Cpu,
    /// A GPU.
    #[cfg(feature = "gpu")]
    Gpu(GpuDevice),
}

/// What [`RasterDevice::backward_views`] needs of a forward pass on the same device.
pub enum RasterTape {
    /// One tape per view.
    Cpu(Vec<Tape>),
    /// All views.
    #[cfg(feature = "gpu")]
    Gpu(Box<GpuTape>),
}

/// The contribution matrix of a render on any device.
pub enum RasterContributions {
    /// In ordinary memory.
    Cpu(Contributions),
    /// In the memory of a GPU.
    #[cfg(feature = "gpu")]
    Gpu(Box<GpuContributions>),
}

impl RasterDevice {
    /// Opens a device.
    ///
    /// # Errors
    /// When this program was built without the feature `gpu`, or when there is no adapter.
    pub fn open(device: Device) -> Result<Self> {
        match device {
            Device::Cpu => Ok(Self::Cpu),
            #[cfg(feature = "gpu")]
            Device::Gpu => Ok(Self::Gpu(GpuDevice::open()?)),
            #[cfg(not(feature = "gpu"))]
            Device::Gpu => Err(SplatError::Gpu {
                what: "this program was built without it; build it with the feature `gpu`".to_owned(),
            }),
        }
    }

    /// What it is, for a person.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::Cpu => Device::Cpu.name(),
            #[cfg(feature = "gpu")]
            Self::Gpu(device) => device.name(),
        }
    }

    /// As [`crate::render_views`].
    ///
    /// # Errors
    /// As there, and when the device fails.
    pub fn render_views(
        &self,
        gaussians: &Gaussians,
        cameras: &[RasterCamera],
        config: &RasterConfig,
    ) -> Result<Vec<Render>> {
        match self {
            Self::Cpu => render_views(gaussians, cameras, config),
            #[cfg(feature = "gpu")]
            Self::Gpu(device) => gpu::render_views(&GpuScene::upload(device, gaussians)?, cameras, config),
        }
    }

    /// As [`crate::render_views_with_tape`].
    ///
    /// # Errors
    /// As there, and when the device fails.
    pub fn render_views_with_tape(
        &self,
        gaussians: &Gaussians,
        cameras: &[RasterCamera],
        config: &RasterConfig,
    ) -> Result<(Vec<Render>, RasterTape)> {
        match self {
            Self::Cpu => {
                let (renders, tapes) = backward::render_views_with_tape(gaussians, cameras, config)?;
                Ok((renders, RasterTape::Cpu(tapes)))
            }
            #[cfg(feature = "gpu")]
            Self::Gpu(device) => {
                let scene = GpuScene::upload(device, gaussians)?;
                let (renders, tape) = gpu::render_views_with_tape(&scene, cameras, config)?;
                Ok((renders, RasterTape::Gpu(Box::new(tape))))
            }
        }
    }

    /// As [`crate::backward_views`], on the device that made the tape; `gaussians` and `config` must be those of the
    /// forward pass.
    ///
    /// # Errors
    /// As there, and when the device fails.
    pub fn backward_views(
        &self,
        gaussians: &Gaussians,
        config: &RasterConfig,
        tape: &RasterTape,
        gradients: &[RenderGradient<'_>],
    ) -> Result<(Gradients, Vec<PoseGradient>)> {
        match tape {
            RasterTape::Cpu(tapes) => backward::backward_views(gaussians, config, tapes, gradients),
            #[cfg(feature = "gpu")]
            RasterTape::Gpu(tape) => gpu::backward_views(tape, gradients),
        }
    }

    /// As [`crate::render_views_with_contributions`].
    ///
    /// # Errors
    /// As there, and when the device fails.
    pub fn render_views_with_contributions(
        &self,
        gaussians: &Gaussians,
        cameras: &[RasterCamera],
        config: &RasterConfig,
        eligible: &Eligible,
    ) -> Result<(Vec<Render>, RasterContributions)> {
        match self {
            Self::Cpu => {
                let (renders, sums) =
                    contributions::render_views_with_contributions(gaussians, cameras, config, eligible)?;
                Ok((renders, RasterContributions::Cpu(sums)))
            }
            #[cfg(feature = "gpu")]
            Self::Gpu(device) => {
                let scene = GpuScene::upload(device, gaussians)?;
                let (renders, sums) = gpu::render_views_with_contributions(&scene, cameras, config, eligible)?;
                Ok((renders, RasterContributions::Gpu(Box::new(sums))))
            }
        }
    }
}

impl RasterContributions {
    /// Indices of the eligible Gaussians, ascending. `[R]`
    #[must_use]
    pub fn rows(&self) -> &[u32] {
        match self {
            Self::Cpu(sums) => &sums.rows,
            #[cfg(feature = "gpu")]
            Self::Gpu(sums) => &sums.rows,
        }
    }

    /// As [`Contributions::mass`].
    ///
    /// # Errors
    /// When the device fails.
    pub fn mass(&self) -> Result<Vec<f32>> {
        match self {
            Self::Cpu(sums) => Ok(sums.mass()),
            #[cfg(feature = "gpu")]
            Self::Gpu(sums) => sums.mass(),
        }
    }

    /// As [`Contributions::pool`].
    ///
    /// # Errors
    /// As there, and when the device fails.
    pub fn pool(&self, features: &[f32], channels: usize) -> Result<Vec<f32>> {
        match self {
            Self::Cpu(sums) => sums.pool(features, channels),
            #[cfg(feature = "gpu")]
            Self::Gpu(sums) => sums.pool(features, channels),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_are_opened_where_the_program_has_them() {
        assert_eq!(RasterDevice::open(Device::Cpu).unwrap().name(), "cpu");
        #[cfg(not(feature = "gpu"))]
        assert!(
            RasterDevice::open(Device::Gpu)
                .unwrap_err()
                .to_string()
                .contains("built without")
        );
    }
}
