//! The tables of the paper from score sheets (`docs/spec/scoring.md` section 10).
//!
//! A row is a method label of the score sheets. Labels of variants are a method and what differs, separated by `/`:
//!
//! | label | meaning |
//! |---|---|
//! | `stage1`, `stage1+2` | this method without and with refinement |
//! | `movies`, `4dgt`, `som` | baselines, run here or as files of others |
//! | `.../no-cross-camera` | each camera lifted alone |
//! | `.../no-mesh`, `.../no-fk`, `.../no-mesh/no-fk` | without mesh anchoring, without FK conditioning, without both |
//! | `.../analytic-fk` | robot motion by analytic FK transport |
//! | `stage1+2/r0` ... `stage1+2/r4` | after that many refinement updates |
//! | `.../latent`, `.../down8` | latent tokens; images averaged down by 8 and brought back |
//! | `4dgt/5-frames` | 4DGT with five input frames |
//!
//! Methods with labels that no table of the paper has appear below the paper's rows in `main`, `additional`, `ci` and `timing`.

mod build;
mod following;
mod footnotes;
mod id;
mod input;
mod layout;
mod measured;
mod published;
mod table;
mod timing;
mod words;

pub use build::table;
pub use id::{TableError, TableId};
pub use input::{MethodSignals, MissingScores, NOT_TOLD, SCALE_ONLY, SIGNALS, TableInput, TableOptions, heading};
pub use table::{Better, Cell, Column, Row, Table};
