//! How each record lies in its container: its streams, in the order of `docs/spec/r4c.md`.

mod agreement;
mod arrays;
mod clip;
mod conditioning;
mod field;
mod motion_bases;
mod polynomial;
mod progress;
mod references;
mod refinement;
mod robot;
mod scores;

pub use field::FieldFile;
pub use refinement::read_refinement_of;
