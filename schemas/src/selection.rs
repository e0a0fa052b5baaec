//! `selection.json`: which episodes are evaluated, fixed before any model runs (`docs/spec/scoring.md` section 1). `rogs
//! cohort` writes it, a manifest names it under `[input]`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Value of [`Selection::schema_version`]. Version 1 had no [`Selection::candidates`].
pub const SELECTION_VERSION: u32 = 2;
/// Value of [`RngNote::algorithm`]: the first entries of `numpy.random.default_rng(seed).permutation(n)`, sorted.
pub const SELECTION_ALGORITHM: &str = "numpy-pcg64-permutation";

/// Contents of `selection.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Selection {
    /// Version of this layout.
    pub schema_version: u32,
    /// Seed of the permutation.
    pub seed: u64,
    /// The test set that episodes had to be in; none when there was no such condition.
    pub source_manifest: Option<SourceManifest>,
    /// Where the list of episodes came from.
    #[serde(default)]
    pub candidates: Option<Candidates>,
    /// Episodes left after every step.
    pub counts: CohortCounts,
    /// Excluded episodes by reason, ascending.
    pub exclusions: BTreeMap<ExclusionReason, Vec<String>>,
    /// Number of excluded episodes by reason.
    pub exclusion_counts: BTreeMap<ExclusionReason, usize>,
    /// Eligible clip names, byte-wise ascending.
    pub eligible_sorted: Vec<String>,
    /// Indices into `eligible_sorted`, ascending.
    pub selected_indices: Vec<u32>,
    /// The selected episodes.
    pub selected: Vec<SelectedEpisode>,
    /// The generator.
    pub rng: RngNote,
}

/// The list of episodes behind a selection.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Candidates {
    /// What it was read from: `list`, `folder` or `manifest`.
    pub source: String,
    /// SHA-256 of the records that were looked at, one JSON value a line, ascending: two lists with the same hash say the
    /// same of the same episodes. Hex.
    pub sha256: String,
    /// Laboratories that were taken; empty for all.
    pub labs: Vec<String>,
    /// Conditions that this source cannot tell anything about: nobody was excluded for them.
    pub not_checked: Vec<ExclusionReason>,
    /// What is wrong with episodes that cannot be read.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub unreadable: BTreeMap<String, String>,
}

/// Episodes left after every step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
pub struct CohortCounts {
    /// Of the held-out laboratories.
    pub reserved: usize,
    /// With prepared clip and stereo references, outside of training and validation.
    pub cached: usize,
    /// In the PointWorld test set.
    pub candidates: usize,
    /// With enough frames, calibration and valid gripper values.
    pub eligible: usize,
    /// Selected.
    pub selected: usize,
}

/// The manifest behind a selection.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SourceManifest {
    /// File name.
    pub path_name: String,
    /// SHA-256, hex.
    pub sha256: String,
    /// Domain.
    pub domain: String,
    /// Seed of the split.
    pub manifest_seed: u64,
    /// Fraction of clips in the test set.
    pub test_fraction: f64,
}

/// One selected episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SelectedEpisode {
    /// Index into `eligible_sorted`.
    pub index: u32,
    /// Clip name.
    pub clip_name: String,
    /// Episode id.
    pub episode_id: String,
    /// Laboratory.
    pub lab: String,
    /// Scene, where it is known.
    pub scene: Option<String>,
}

/// How the random numbers were made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RngNote {
    /// Algorithm.
    pub algorithm: String,
    /// Version.
    pub version: u32,
}

/// Why an episode is not in the cohort. The first reason that applies counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ExclusionReason {
    /// In the training or validation list.
    TrainOrVal,
    /// No prepared clip.
    NoClip,
    /// No stereo references.
    NoStereo,
    /// Not in the PointWorld test set.
    NotInTestManifest,
    /// Fewer than 24 cached frames.
    TooFewFrames,
    /// No calibration metadata.
    NoCalibration,
    /// A gripper value is not finite or leaves [0, 1].
    GripperRange,
    /// Ingest cannot read it; `candidates.unreadable` says why.
    Unreadable,
}

impl ExclusionReason {
    /// Every reason, in the order in which they are asked.
    pub const ALL: [Self; 8] = [
        Self::TrainOrVal,
        Self::NoClip,
        Self::NoStereo,
        Self::NotInTestManifest,
        Self::TooFewFrames,
        Self::NoCalibration,
        Self::GripperRange,
        Self::Unreadable,
    ];

    /// Its name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::TrainOrVal => "train_or_val",
            Self::NoClip => "no_clip",
            Self::NoStereo => "no_stereo",
            Self::NotInTestManifest => "not_in_test_manifest",
            Self::TooFewFrames => "too_few_frames",
            Self::NoCalibration => "no_calibration",
            Self::GripperRange => "gripper_range",
            Self::Unreadable => "unreadable",
        }
    }
}

impl Selection {
    /// Whether its parts agree with each other, but for the draw itself, which needs the generator.
    ///
    /// # Errors
    /// A sentence that says what does not agree.
    pub fn check(&self) -> Result<(), String> {
        if !(1..=SELECTION_VERSION).contains(&self.schema_version) {
            return Err(format!(
                "its version is {}, this program reads up to {SELECTION_VERSION}",
                self.schema_version
            ));
        }
        if self.rng.algorithm != SELECTION_ALGORITHM || self.rng.version != 1 {
            return Err(format!(
                "it was drawn by `{}` version {}, this program knows `{SELECTION_ALGORITHM}` version 1",
                self.rng.algorithm, self.rng.version
            ));
        }
        if !self.eligible_sorted.is_sorted_by(|a, b| a < b) {
            return Err("`eligible_sorted` does not ascend".to_owned());
        }
        let counted = (self.counts.eligible, self.counts.selected);
        let there = (self.eligible_sorted.len(), self.selected.len());
        if counted != there || self.selected_indices.len() != there.1 {
            return Err(format!(
                "it counts {} eligible and {} selected episodes and lists {} and {}",
                counted.0, counted.1, there.0, there.1
            ));
        }
        for (own, &index) in self.selected.iter().zip(&self.selected_indices) {
            let listed = self.eligible_sorted.get(index as usize);
            if own.index != index || listed != Some(&own.clip_name) {
                return Err(format!(
                    "`selected` and `eligible_sorted` differ about `{}`",
                    own.clip_name
                ));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_have_the_names_that_files_have() {
        for reason in ExclusionReason::ALL {
            assert_eq!(serde_json::to_value(reason).unwrap(), reason.name());
        }
        assert!(ExclusionReason::ALL.is_sorted());
    }
}
