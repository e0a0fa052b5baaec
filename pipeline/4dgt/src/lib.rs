//! The network of 4DGT (`docs/spec/baseline-4dgt.md`): images of one camera to Gaussians that move along polynomials of
//! time.
//!
//! [`mean_frame`] recentres the poses of a stream, [`FourDgt::lift`] makes one Gaussian of every pixel, and
//! [`Recentring::undo`] brings them back to the frame that the poses came in. What the Gaussians do over time is
//! `rogs_field::polynomial`. Weights are files of others: [`import`] brings them in, checked name by name.

pub mod checkpoint;
pub mod config;
pub mod decode;
pub mod import;
pub mod layout;
pub mod network;
pub mod rays;
pub mod recentre;

pub use checkpoint::{ENCODER, FOUR_DGT, Loaded, open_encoder, open_network, seeded_encoder, seeded_network};
pub use config::FourDgtConfig;
pub use import::{import_encoder, import_network};
pub use network::{FourDgt, Stream};
pub use recentre::{Recentring, mean_frame};
pub use rogs_tensors::{Error, Result};
