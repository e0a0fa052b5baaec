//! CPU kernels on plain slices: what inference, training and scoring spend their time with.
//!
//! They are vectorised for the instruction set found at run time, and give the same bytes for any number of threads: work
//! is cut into tasks whose bounds do not depend on the threads, and each task sums in a fixed order. Nothing here knows
//! tensors, files or robots.
//!
//! ```
//! use rogs_kernels::{PackedWeight, Precision};
//!
//! // y = W x for two rows x, W = [[1, 2], [3, 4], [5, 6]] as PyTorch stores it: [outputs, inputs].
//! let weight = PackedWeight::new(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 2, Precision::F32);
//! let mut out = [0.0; 6];
//! weight.rows(&[1.0, 0.0, 0.0, 1.0], &mut out, 3, |_, _, _| {});
//! assert_eq!(out, [1.0, 3.0, 5.0, 2.0, 4.0, 6.0]);
//! ```

mod attention;
mod axis;
mod bf16;
mod conv;
mod cubic;
mod feature_map;
pub mod lanes;
mod layers;
mod matrix;
mod neighbours;
#[cfg(test)]
mod noise;
mod norm;
pub mod pointwise;
mod pool;
mod product;
mod rotary;
pub mod sweep;
mod tile;
mod transpose;
mod vectorised;

pub use attention::{Head, PackedAttention};
pub use axis::Axis;
pub use conv::{Conv, Conv3x3, DenseTail, Maps, Pointwise, TileSize, Winograd, pointwise_gradient, weight_gradient};
pub use cubic::{CubicTaps, cubic_taps};
pub use feature_map::{FeatureMap, add_resized};
pub use layers::{LayerNorm, Linear, ROWS_PER_PIECE};
pub use matrix::{Matrix, Precision, bf16_is_fast};
pub use neighbours::neighbour_attention;
pub use norm::{Norm, moments};
pub use pool::MaxPool;
pub use product::PackedWeight;
pub use rotary::RotaryTable;
pub use sweep::{BilinearTaps, Partner, Sweep};
pub use transpose::transposed;
pub use vectorised::vectorised;
