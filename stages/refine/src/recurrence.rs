//! What a refinement starts from, and its state between two updates.

use rogs_field::Correction;
use rogs_schemas::FrameIndex;
use rogs_schemas::key::CacheKey;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::field::Field;
use rogs_schemas::records::refinement::{Refinement, RefinementStep};
use rogs_schemas::records::robot::RobotMaps;

/// The records of one clip.
#[derive(Clone, Copy)]
pub struct ClipInputs<'a> {
    /// The clip.
    pub clip: &'a Clip,
    /// Its robot maps, for the camera poses.
    pub robot: &'a RobotMaps,
    /// The Stage-1 field.
    pub field: &'a Field,
    /// Key of the field's file.
    pub field_key: CacheKey,
    /// An earlier refinement of the same field to continue from.
    pub resume: Option<&'a Refinement>,
}

/// The recurrent state after some updates.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Recurrence {
    /// Updates done.
    pub(crate) update: u32,
    /// Accumulated correction.
    pub(crate) correction: Correction,
    /// Hidden state of the tokens of each source time. `[times]` of `[tokens, S]`
    pub(crate) states: Vec<Vec<f32>>,
    /// Corrections to keep, without the last.
    pub(crate) steps: Vec<RefinementStep>,
}

/// Name of the stored hidden state of a source time.
pub(crate) fn state_name(frame: FrameIndex) -> String {
    format!("state.{frame:04}")
}
