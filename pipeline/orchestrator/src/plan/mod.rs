//! The plan: which units there are, where their outputs go, and which keys they must carry.
//!
//! A plan is pure: manifest + stage descriptions + content of sources. The same three give the same plan, byte for byte.
//! It is kept as `RUN/plan.jsonl` (a header line, then one line a clip), which is all that `status`, `verify`, the report
//! and other engines need. Units are not stored: they follow from nodes and clips.

mod clips;
mod file;
mod intervals;
mod make;
mod model;
mod nodes;
mod params;
mod rollouts;
mod selection;
mod units;

pub use file::{PLAN_FILE, read_header, read_plan};
pub use intervals::ClipInterval;
pub use make::make_plan;
pub use model::{
    InputSource, Node, NodeInput, PLAN_FORMAT, Plan, PlanSelection, PlannedClip, PlannedSource, RolloutFile, WorkUnit,
};
pub use units::{KeyMaker, UnitKey};
