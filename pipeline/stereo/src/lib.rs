//! Classical stereo: disparity and depth of a rectified pair by semi-global matching (`docs/spec/references.md` section 1).
//!
//! Census cost, costs aggregated along eight paths, the least sum with its fraction, then only what both eyes agree on, what
//! has texture, and what is no speck. Costs are integers, so that any number of threads gives the same bytes. What is not
//! known is NaN, never a guess. [`diagnose`] reads off the images whether the eyes are swapped or the pair is not rectified.
//!
//! ```
//! use rogs_stereo::{Grey, MatcherParams, Rig, match_pair};
//!
//! // A textured wall, seen 4 pixels further to the left by the right eye.
//! let texture = |x: usize, y: usize| ((x * 7919 + y * 104_729) * 2_654_435_761 >> 7) as u8;
//! let eye = |shift: usize| {
//!     let pixels = (0..40 * 64).map(|at| texture(at % 64 + shift, at / 64)).collect();
//!     Grey::new(64, 40, pixels).unwrap()
//! };
//! let rig = Rig { focal_px: 80.0, baseline_m: 0.1, shift_px: 0.0 };
//! let params = MatcherParams { near_m: 0.5, ..MatcherParams::default() };
//! let found = match_pair(&eye(0), &eye(4), &rig, &params).unwrap();
//! let middle = 20 * 64 + 32;
//! assert!((found.left_px[middle] - 4.0).abs() < 0.1);
//! assert!((rig.depth_m(found.left_px[middle]) - 2.0).abs() < 0.1);
//! ```

mod aggregate;
mod clean;
mod cost;
mod diagnose;
mod error;
mod fraction;
mod image;
mod matcher;
mod params;
mod rig;
mod winner;

pub use diagnose::{Concern, diagnose};
pub use error::{Error, Result};
pub use image::Grey;
pub use matcher::{StereoMatch, match_offset_pair, match_pair};
pub use params::{MAX_DISPARITIES, MatcherParams};
pub use rig::Rig;
