//! Gaussian fields, spherical harmonics and the differentiable rasteriser.

pub mod backward;
pub mod camera;
pub mod contributions;
pub mod error;
pub mod field;
pub mod gaussians;
mod order;
pub mod ply;
mod project;
pub mod render;
pub mod sh;
mod simd;
mod tile;

pub use backward::{Gradients, RenderGradient, Tape, backward, backward_into, render_with_tape};
pub use camera::{Camera, Mode, RasterConfig};
pub use contributions::{
    Contributions, Eligible, pool_in_parts, render_views_with_contributions, render_with_contributions,
};
pub use error::{Result, SplatError};
pub use field::{TimedField, field_camera};
pub use gaussians::{Colour, Gaussians};
pub use ply::{PlyScene, export_field, read_ply, read_ply_file, write_ply};
pub use render::{Counts, Render, render, render_views};
pub use simd::SimdLevel;
