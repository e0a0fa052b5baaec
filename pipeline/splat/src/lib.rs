//! Gaussians, spherical harmonics and the differentiable rasteriser.
//!
//! [`render()`] draws a scene of 3D [`Gaussians`] into a [`RasterCamera`]: colour, accumulated opacity, expected depth and any
//! number of further channels, all with the same compositing weights. [`render_with_tape`] and [`backward`](fn@backward)
//! give the gradients of all outputs with respect to everything that went in, the camera pose included.
//! [`render_views_with_contributions`] records the compositing weights of chosen Gaussians sparsely and pools pixel
//! features with them (Stage 2). What a Gaussian of a field is, is not known here (`rogs_field`). The rules are those of
//! `docs/spec/rasteriser.md`.
//!
//! Results are equal bit for bit for every number of threads, every tile size and every instruction set. Gaussians with
//! values that are not numbers are dropped and counted, never drawn.
//!
//! How it works: `project` takes sixteen Gaussians at a time to the image and files `(depth, index)` keys by tile;
//! `order` sorts each tile's keys; `tile` composites blocks of 4 x 4 pixels, one vector each; `backward` walks the same
//! lists from back to front. Nothing is shared between tiles or chunks, and their results are put together in order.
//!
//! ```
//! use rogs_splat::{Colour, Gaussians, RasterCamera, RasterConfig, render};
//!
//! let scene = Gaussians {
//!     means: vec![0.0, 0.0, 2.0],
//!     quats: vec![1.0, 0.0, 0.0, 0.0],
//!     scales: vec![0.1, 0.1, 0.1],
//!     opacities: vec![0.9],
//!     colour: Colour::Rgb(vec![1.0, 0.5, 0.0]),
//!     extra: Vec::new(),
//!     extra_channels: 0,
//! };
//! let camera = RasterCamera {
//!     width: 32,
//!     height: 24,
//!     fx: 30.0,
//!     fy: 30.0,
//!     cx: 16.0,
//!     cy: 12.0,
//!     rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
//!     translation: [0.0; 3],
//! };
//! let image = render(&scene, &camera, &RasterConfig::default())?;
//! let centre = 12 * 32 + 16;
//! assert!(image.alpha[centre] > 0.8 && (image.depth_expected[centre] - 2.0).abs() < 1e-5);
//! # Ok::<(), rogs_splat::SplatError>(())
//! ```

pub mod backward;
mod buffers;
pub mod camera;
pub mod contributions;
pub mod error;
pub mod gaussians;
#[cfg(feature = "gpu")]
pub mod gpu;
mod moved;
mod order;
mod project;
pub mod raster_device;
pub mod render;
pub mod sh;
mod simd;

mod tile;

pub use backward::{
    Gradients, PoseGradient, RenderGradient, Tape, backward, backward_into, backward_views, backward_with_screen,
    render_views_with_tape, render_with_tape,
};
pub use camera::{Mode, RasterCamera, RasterConfig};
pub use contributions::{Contributions, Eligible, render_views_with_contributions, render_with_contributions};
pub use error::{Result, SplatError};
pub use gaussians::{Colour, Gaussians};
#[cfg(feature = "gpu")]
pub use gpu::{GpuContributions, GpuDevice, GpuScene, GpuTape};
pub use raster_device::{RasterContributions, RasterDevice, RasterTape};
pub use render::{Counts, Render, render, render_views};
pub use simd::SimdLevel;
