//! Conditioning: FK conditioning maps per source view, source time and query time (`docs/spec/stage1.md` section 11).
//!
//! For every supported pixel of a source view the point on the mesh is moved with its link: `d = T_l(t) T_l(s)^-1 p - p`
//! in the reconstruction frame, internal units. The maps are stored sparse ([`fk_maps::SourcePoints`]) and expand to
//! dense ones without loss ([`Conditioning::dense`](rogs_schemas::records::conditioning::Conditioning::dense)).

mod build;
pub mod fk_maps;
mod stage;

pub use build::{Params, build};
pub use stage::ConditioningStage;
