//! The rasteriser on a GPU (feature `gpu`), through wgpu: Vulkan, Metal or DirectX, nothing needed at build
//! time. Rules, inputs and results are those of the CPU's code; images agree up to rounding.
//!
//! All views of a group go through each step together: one unit per Gaussian and view projects and counts the tiles of
//! 8 x 8 pixels that it reaches; a stable radix sort puts entries in order of depth (ties by index); their pairs of tile and
//! Gaussian are laid out in that order and sorted by tile, so that every tile has its Gaussians from front to back. One cube
//! per tile composites them through shared memory. Backward, a cube walks its tile from back to front in batches of sixteen
//! Gaussians and leaves the sums of each pair in a place of its own; the pairs of a Gaussian lie together, in tile order,
//! and are added in that order. No sum depends on which cube runs first, so that runs repeat bit for bit. Memory grows
//! with the number of pairs.
//!
//! ```no_run
//! use rogs_splat::gpu::{self, GpuDevice, GpuScene};
//! # fn main() -> Result<(), rogs_splat::SplatError> {
//! # let (scene, cameras) = (rogs_splat::Gaussians::empty(), Vec::new());
//! let device = GpuDevice::open()?;
//! let scene = GpuScene::upload(&device, &scene)?;
//! let images = gpu::render_views(&scene, &cameras, &rogs_splat::RasterConfig::default())?;
//! # Ok(())
//! # }
//! ```

mod backward;
mod contributions;
mod device;
mod forward;
mod kernels;
mod scene;

pub use backward::{GpuTape, backward_views, render_views_with_tape};
pub use contributions::{GpuContributions, render_views_with_contributions};
pub use device::GpuDevice;
pub use forward::render_views;
pub use scene::GpuScene;
