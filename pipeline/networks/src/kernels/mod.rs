//! CPU kernels for the operations that dominate inference: convolution, attention, activations.
//!
//! They run on plain slices, are vectorised for the instruction set found at run time, and give the same bytes for any
//! number of threads: work is cut into tasks whose bounds do not depend on the threads, and each task sums in a fixed
//! order. Operations on tensors that record gradients are in [`differentiable`].

mod attention;
mod axis;
mod bf16;
mod conv;
mod conv_pairs;
mod dense_tail;
pub(crate) mod differentiable;
mod extension;
mod pointwise;
mod product;
mod sweep;
mod transpose;
mod vectorised;
mod winograd;

pub(crate) use attention::{HeadNorm, PackedAttention};
pub(crate) use axis::Axis;
pub(crate) use conv::{After, Conv3x3};
pub(crate) use dense_tail::DenseTail;
pub(crate) use extension::{pack, read, usable};
pub(crate) use pointwise::gelu;
pub(crate) use product::PackedWeight;
pub use product::Precision;
pub(crate) use sweep::{
    FEATURES as SWEEP_FEATURES, FINER as SWEEP_FINER, GROUPS as SWEEP_GROUPS, Partner, Sweep, Taps,
};
pub(crate) use vectorised::vectorised;
pub(crate) use winograd::Winograd;
