//! 2-D convolutions with zero padding.
//!
//! One formula, several ways to its sums. Which is right depends on what a layer looks like:
//! * [`Winograd`]: 3x3, stride 1, many channels. Fewer products than the definition has.
//! * [`Conv3x3`]: 3x3, stride 1, few channels, planar images. Direct sums over register tiles, where the transforms of
//!   Winograd would cost more than the products that they save; also with bfloat16 products, and for gradients.
//!   [`DenseTail`] runs it on a map that is enlarged on the way.
//! * [`Pointwise`]: 1x1, planar images; and for gradients.
//! * [`Conv`]: any size and stride, channels last. Receptive fields are copied together, which makes a convolution one
//!   matrix product.

mod band;
mod direct;
mod pairs;
mod patches;
mod pointwise;
mod tail;
mod weight_gradient;
mod weight_pairs;
mod weight_tile;
mod winograd;

pub use direct::Conv3x3;
pub use patches::Conv;
pub use pointwise::{Pointwise, pointwise_gradient};
pub use tail::DenseTail;
pub use weight_gradient::{Maps, weight_gradient};
pub use winograd::{TileSize, Winograd};
