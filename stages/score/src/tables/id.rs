//! Names of the tables, and why one cannot be made.

use std::borrow::Cow;

use schemars::JsonSchema;
use serde::{Serialize, Serializer};

use crate::summary::DuplicateSheet;

/// Which table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum TableId {
    /// Main comparison.
    Main,
    /// Joint multi-camera lifting and refinement.
    Joint,
    /// Mesh anchoring and FK conditioning, Stage 1+2.
    Robot,
    /// The same in Stage 1.
    RobotStage1,
    /// Complementary metrics.
    Additional,
    /// Confidence intervals.
    Ci,
    /// 4DGT with 5 and 17 frames.
    Frames4dgt,
    /// Median-scaled depth diagnostic.
    Scale,
    /// Analytic FK transport against learned motion.
    FkTransport,
    /// Number of refinement updates.
    Recurrence,
    /// Latent-token interface.
    Latent,
    /// Spatial-resolution diagnostic.
    LatentResolution,
    /// Construction of the cohort.
    Cohort,
    /// Signals every method sees.
    Inputs,
    /// Times and memory.
    Timing,
    /// How the robot of the images follows the states.
    Following,
    /// How well the observations agree with each other through the field.
    CrossView,
}

impl TableId {
    /// Every table, in the order of the paper; two of our own follow.
    pub const ALL: [Self; 17] = [
        Self::Main,
        Self::Joint,
        Self::Robot,
        Self::RobotStage1,
        Self::Additional,
        Self::Ci,
        Self::Frames4dgt,
        Self::Scale,
        Self::FkTransport,
        Self::Recurrence,
        Self::Latent,
        Self::LatentResolution,
        Self::Cohort,
        Self::Inputs,
        Self::Timing,
        Self::Following,
        Self::CrossView,
    ];

    /// The id as people and files write it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Main => "main",
            Self::Joint => "joint",
            Self::Robot => "robot",
            Self::RobotStage1 => "robot_stage1",
            Self::Additional => "additional",
            Self::Ci => "ci",
            Self::Frames4dgt => "frames_4dgt",
            Self::Scale => "scale",
            Self::FkTransport => "fk_transport",
            Self::Recurrence => "recurrence",
            Self::Latent => "latent",
            Self::LatentResolution => "latent_resolution",
            Self::Cohort => "cohort",
            Self::Inputs => "inputs",
            Self::Timing => "timing",
            Self::Following => "following",
            Self::CrossView => "cross_view",
        }
    }
}

impl std::fmt::Display for TableId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for TableId {
    type Err = TableError;

    fn from_str(text: &str) -> Result<Self, TableError> {
        Self::ALL
            .into_iter()
            .find(|id| id.name() == text)
            .ok_or_else(|| TableError::UnknownTable { id: text.to_owned() })
    }
}

impl JsonSchema for TableId {
    fn schema_name() -> Cow<'static, str> {
        "TableId".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "type": "string", "enum": Self::ALL.map(Self::name) })
    }
}

impl Serialize for TableId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

/// Why a table cannot be made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TableError {
    /// No table of this name.
    #[error("unknown table `{id}`: expected one of {}", TableId::ALL.map(TableId::name).join(", "))]
    UnknownTable {
        /// What was asked for.
        id: String,
    },
    /// Two sheets of the same method, setting and clip.
    #[error(transparent)]
    Duplicate(#[from] DuplicateSheet),
}
