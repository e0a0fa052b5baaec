//! Slice kernels of the frozen error encoder: dense products, normalisation, activations, convolution, attention.
//!
//! Images are row-major with channels last, tokens are rows. Work is split into pieces whose size does not depend on
//! the number of threads and every piece is summed in one order, so results are the same bytes for any thread count.

mod attention;
mod conv;
mod dense;
mod neighbours;
mod plane;

pub use attention::self_attention;
pub use conv::{Conv, max_pool_3x3_stride_2};
pub use dense::{LayerNorm, Linear, add_assign, gelu_in_place, relu_in_place};
pub use neighbours::neighbour_attention;
pub use plane::Plane;
pub use plane::add_resized;

/// Rows that one piece of work handles.
pub const ROWS_PER_PIECE: usize = 256;
