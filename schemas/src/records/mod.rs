//! The records that pass from stage to stage, one module each, with their checks.

pub mod agreement;
pub mod check;
pub mod clip;
pub mod conditioning;
pub mod field;
pub mod motion_bases;
pub mod origin;
pub mod polynomial;
pub mod progress;
pub mod references;
pub mod refinement;
pub mod robot;
pub mod scores;
