//! Everything that lies on disk between the stages of rogs: the chunk container (`.r4c`), the records in it, cache keys
//! and provenance, and the worker protocol. This crate knows no other crate of the workspace.

pub mod episode;
pub mod error;
mod identity;
pub mod ids;
pub mod json;
pub mod key;
pub mod ledger;
mod memory;
pub mod pose;
pub mod protocol;
pub mod r4c;
pub mod record;
pub mod records;
pub mod source;
pub mod units;

pub use rogs_files as atomic;

pub use error::{Error, Result};
pub use identity::{FileInfo, SchemaId};
pub use ids::ClipId;
pub use json::{canonical_json, overlay};
pub use key::{CacheKey, ContentHash, KeyMaterial, Provenance};
pub use pose::{Intrinsics, RigidPose};
pub use record::{Record, read_record, write_record};
