//! Optimisation of the Gaussians of one clip: motion, losses and updates, with gradients written by hand.
//!
//! | module | what |
//! |---|---|
//! | [`six`] | rotations as six numbers, and back |
//! | [`bases`] | Gaussians moved by a mixture of shared rigid motions |
//! | [`losses`] | what an update makes small: images, depth, tracks, smoothness |
//! | [`adam`] | the update rule |
//! | [`procrustes`] | the rigid motion that takes one set of points to another |
//! | [`clusters`] | points that move alike |
//! | [`tracks`] | 2D tracks with depth become 3D tracks |
//! | [`depth_maps`] | aligned and filtered depth, normals of a depth map |
//! | [`masks`] | foreground, background and the band between |
//! | [`neighbours`] | distances to the nearest points |
//! | [`watched`] | how well source views are shown, for whoever watches |
//!
//! The motion model and the losses are those of Shape of Motion (`docs/spec/baseline-som.md`); the stage `fit` takes what
//! it needs of them. Images are rendered and differentiated by `rogs_splat`; this crate knows no rasteriser, no file and no
//! robot. Sums are taken in pieces of fixed size that are added in order: the same bits for any number of threads.

pub mod adam;
pub mod bases;
pub mod clusters;
pub mod depth_maps;
pub mod error;
pub mod losses;
pub mod masks;
pub mod neighbours;
pub mod procrustes;
pub mod six;
pub mod statistics;
pub mod tracks;
pub mod watched;

pub use adam::Adam;
pub use bases::{BaseMotion, MotionBases, MotionGradient, Moved};
pub use error::{OptimiseError, Result};
pub use losses::Loss;
pub use watched::Watched;
