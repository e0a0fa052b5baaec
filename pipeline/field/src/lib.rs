//! Fields of Gaussians over time: the one place that knows what the numbers of a [`Field`] mean.
//!
//! [`attributes`] gives raw attributes their meaning (colour, scale, rotation, opacity), [`gates`] says when a Gaussian
//! takes its query-time attributes, [`Correction`] is what Stage 2 adds, and [`TimedField`] puts the three together:
//! the Gaussians of a field at a stored time, ready to be rendered. [`polynomial`] does so for fields of 4DGT. [`ply`] reads and writes 3DGS PLY files.
//!
//! Records hold metres; Gaussians come out in internal units, 3.5 per metre, in the reconstruction frame.
//!
//! ```
//! use rogs_field::attributes;
//!
//! // A raw value of 0 is a middle grey, and a scale of 0.001 ln 2 internal units: 0.2 millimetres.
//! assert_eq!(attributes::colour(0.0), 0.5);
//! assert!((attributes::scale_iu(0.0) - 0.000_693).abs() < 1e-6);
//! ```
//!
//! [`Field`]: rogs_schemas::records::field::Field

pub mod attributes;
pub mod correction;
pub mod error;
pub mod gates;
pub mod ply;
mod ply_header;
mod ply_packed;
mod ply_scene;
pub mod polynomial;
mod timed;

pub use correction::{Correction, GateGroup, POSITION_BOUND_M};
pub use error::{Error, Result};
pub use gates::{MotionGates, raw_at};
pub use ply::{Axes, export_field, gaussians_in, read_ply, read_ply_file, write_ply};
pub use ply_packed::write_packed_ply;
pub use ply_scene::PlyScene;
pub use polynomial::PolynomialState;
pub use timed::{TimedField, Turned};
