//! What tables are made of, and how.

use rogs_schemas::records::agreement::Agreements;
pub(crate) use rogs_schemas::records::clip::{RECORDED, ROLLOUT};
use rogs_schemas::records::scores::ScoreSheet;

use crate::cohort::CohortCounts;
use crate::timing::ClipTiming;

/// What tables are made of.
#[derive(Debug, Clone, Copy, Default)]
pub struct TableInput<'a> {
    /// Score sheets of every method, setting and clip.
    pub sheets: &'a [ScoreSheet],
    /// Times and memory, where they are known.
    pub timings: &'a [ClipTiming],
    /// Counts of the cohort's construction, where they are known.
    pub cohort: Option<&'a CohortCounts>,
    /// What every method was given, where it is known.
    pub signals: &'a [MethodSignals],
    /// Whether the robot lies on the observations, where it was measured.
    pub agreements: &'a [Agreements],
    /// Clips that a method has no scores of, and why.
    pub missing: &'a [MissingScores],
}

/// A clip that a method has no scores of.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct MissingScores {
    /// Setting, as in score sheets.
    pub setting: String,
    /// Method, as in score sheets.
    pub method: String,
    /// Clip.
    pub clip: String,
    /// Why, in words.
    pub reason: String,
}

/// What a method was given in a setting, in words: one row of the table of inputs.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct MethodSignals {
    /// Setting, as in its score sheets.
    pub setting: String,
    /// Method, as in its score sheets.
    pub method: String,
    /// One entry a signal of [`SIGNALS`].
    pub given: [String; SIGNALS.len()],
}

/// The signals that the table of inputs tells of.
pub const SIGNALS: [&str; 9] = [
    "observations",
    "visual input",
    "calibrated cameras",
    "joint and gripper states",
    "robot mesh",
    "source-time stereo depth",
    "held-out RGB and depth",
    "3D track references",
    "fitting to target depth",
];

/// A signal of an outside method of which its files say nothing.
pub const NOT_TOLD: &str = "not told";
/// One factor per camera and no more.
pub const SCALE_ONLY: &str = "scale only";

/// How tables are printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TableOptions {
    /// Put the paper's values beside ours.
    pub published: bool,
    /// Give every mean its bootstrap interval.
    pub intervals: bool,
    /// Leave out rows of methods without scores.
    pub hide_empty_rows: bool,
}

/// What a setting is called in print.
#[must_use]
pub fn heading(setting: &str) -> String {
    match setting {
        RECORDED => "Recorded observations".to_owned(),
        ROLLOUT => "World-model rollouts".to_owned(),
        other => other.to_owned(),
    }
}
