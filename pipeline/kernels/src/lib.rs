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
mod conv_pairs;
mod dense_tail;
pub mod lanes;
pub mod pointwise;
mod product;
pub mod products;
mod rotary;
pub mod rows;
pub mod sweep;
mod transpose;
mod vectorised;
mod weight_gradient;
mod weight_pairs;
mod winograd;

pub use attention::{HeadNorm, PackedAttention};
pub use axis::Axis;
pub use conv::{After, Conv3x3};
pub use dense_tail::DenseTail;
pub use pointwise::gelu;
pub use product::{PackedWeight, Precision};
pub use rotary::RotaryTable;
pub use sweep::{Partner, Sweep, Taps};
pub use transpose::transposed;
pub use vectorised::vectorised;
pub use weight_gradient::{Maps, weight_gradient};
pub use winograd::Winograd;

/// Values of a layer do not have the sizes its configuration says.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ShapeError(pub String);
