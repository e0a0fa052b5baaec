//! The kernels. One unit is one invocation; cubes are workgroups. Indices are 32 bit, the host checks sizes before.

// The macro makes public items of its own for every kernel.
#![allow(missing_docs, unreachable_pub)]

pub(crate) mod chain;
pub(crate) mod composite;
pub(crate) mod contribute;
pub(crate) mod math;
pub(crate) mod project;
pub(crate) mod scan;
pub(crate) mod sort;
pub(crate) mod walk;

/// Side of the tiles, pixels. It never changes the image.
pub(crate) const TILE: usize = 8;
/// Units of a tile's cube: one a pixel.
pub(crate) const UNITS: usize = TILE * TILE;
/// Units of all other cubes.
pub(crate) const WIDE: usize = 256;
/// Words of a shape: mean, quaternion, scales, opacity.
pub(crate) const SHAPE: usize = 11;
/// Words of a record: x, y, la, lb, lc, opacity, red, green, blue, z, power_min (see `crate::project::Projected`).
pub(crate) const RECORD: usize = 11;
/// Words of an entry: tile columns, tile rows (first in the low half), number of pairs, bits of z.
pub(crate) const ENTRY: usize = 4;
/// Words of a view; see `super::scene::view_words`.
pub(crate) const VIEW: usize = 30;
/// Extra channels of one pass.
pub(crate) const EXTRA: usize = 4;
/// Planes of an accumulated image: weight sum, red, green, blue, z, transmittance behind everything.
pub(crate) const PLANES: usize = 6;
/// Sums per pair before the extra channels; see `crate::backward`.
pub(crate) const MOMENTS: usize = 10;
/// Words of a pose gradient: rotation, translation.
pub(crate) const POSE: usize = 12;
/// Marks a pair that was reserved but not needed.
pub(crate) const NO_RECORD: u32 = 0xffff_ffff;
