//! What tables are made of, and how.

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
}

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

/// The setting of scores over recordings.
pub(crate) const RECORDED: &str = "recorded";
/// The setting of scores over videos that a world model made.
pub(crate) const ROLLOUT: &str = "rollout";

/// What a setting is called in print.
pub(crate) fn heading(setting: &str) -> String {
    match setting {
        RECORDED => "Recorded observations".to_owned(),
        ROLLOUT => "World-model rollouts".to_owned(),
        other => other.to_owned(),
    }
}
