//! What the parts of rogs say to each other, as plain data: the records that pass from stage to stage with their checks,
//! cache keys and provenance, ids, poses and units, the worker protocol and the entries of the ledger. Nothing here opens
//! a file (`rogs_r4c` does), and this crate knows no other crate of the workspace.
//!
//! ```
//! use rogs_schemas::records::robot::{RobotMaps, RobotSpec};
//!
//! // A record is checked before it is written and after it is read.
//! let maps = RobotMaps {
//!     clip_id: "kitchen-0".parse()?,
//!     link_names: vec![RobotSpec::default().base_link],
//!     base_from_link: vec![],
//!     base_from_camera: vec![],
//!     recon_from_base: rogs_schemas::RigidPose::IDENTITY,
//!     tool_m: vec![],
//!     height: 288,
//!     width: 512,
//!     maps: vec![],
//! };
//! assert_eq!(maps.check(), Err("there are no link poses".to_owned()));
//! # Ok::<(), rogs_schemas::ids::InvalidName>(())
//! ```

pub mod device;
pub mod episode;
mod identity;
pub mod ids;
pub mod index;
pub mod interim;
pub mod json;
pub mod key;
pub mod ledger;
pub mod pose;
pub mod protocol;
pub mod records;
pub mod robots;
pub mod selection;
pub mod shown;
pub mod units;
pub mod written_pose;

pub use device::Device;
pub use identity::{FileInfo, SchemaId};
pub use ids::ClipId;
pub use index::{CameraIndex, EpisodeFrame, FrameIndex};
pub use json::{canonical_json, overlay};
pub use key::{CacheKey, ContentHash, KeyMaterial, Provenance};
pub use pose::{Intrinsics, RigidPose};
pub use written_pose::WrittenPose;
