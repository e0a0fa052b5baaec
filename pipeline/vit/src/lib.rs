//! Vision transformers as several networks have them: the pre-norm block, the projection of patches, and the image encoder
//! DINOv2 with its learned grid of positions.
//!
//! Stage 1 (`docs/spec/stage1.md` sections 3 and 5) and 4DGT (`docs/spec/baseline-4dgt.md` sections 3 and 4) are made of
//! them; what is their own (sizes, tokens, heads) is theirs.

mod block;
mod encoder;
mod patches;
mod positions;

pub use block::{Block, BlockKind, HeadNorm};
pub use encoder::{EncoderSizes, ImageEncoder};
pub use patches::patch_projection;
pub use positions::{PositionGrid, resampling_matrix};
pub use rogs_tensors::{Error, Result};
