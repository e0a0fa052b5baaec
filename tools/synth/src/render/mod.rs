//! The renderer: scan conversion to five samples a pixel, deferred shading, shadow and sky maps.
//!
//! Depth and ids come from the sample at the pixel centre; depth is solved again in f64 from the plane of the triangle that
//! is seen. Colour averages the four other samples. No result depends on the number of threads: every camera of every frame
//! is drawn by itself.

mod photo;
mod prepared;
mod raster;
mod seen;
mod sensor;
mod shade;
mod shadow;
mod texture;
mod view;

pub use photo::Photo;
pub(crate) use prepared::PreparedMesh;
pub(crate) use sensor::{Finish, Sensor, blurred};
pub(crate) use shadow::ShadowRegion;
pub(crate) use texture::{Material, Pattern};
pub use view::View;
pub(crate) use view::{LitScene, NEAR, render_geometry, render_view};
