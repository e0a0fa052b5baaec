//! The records that pass from stage to stage, one module each.

mod arrays_io;
mod check;
pub mod clip;
mod clip_io;
pub mod conditioning;
mod conditioning_io;
pub mod field;
mod field_io;
pub mod refinement;
mod refinement_io;
pub mod robot;
mod robot_io;
pub mod scores;
mod scores_io;
