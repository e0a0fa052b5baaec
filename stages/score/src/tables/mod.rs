//! The tables of the paper from score sheets (`docs/spec/scoring.md` section 10).
//!
//! A row is a method label of the score sheets. Labels of variants are a method and what differs, separated by `/`:
//!
//! | label | meaning |
//! |---|---|
//! | `stage1`, `stage1+2` | this method without and with refinement |
//! | `movies`, `4dgt`, `som` | outside methods |
//! | `.../no-cross-camera` | each camera lifted alone |
//! | `.../no-mesh`, `.../no-fk`, `.../no-mesh/no-fk` | without mesh anchoring, without FK conditioning, without both |
//! | `.../analytic-fk` | robot motion by analytic FK transport |
//! | `stage1+2/r0` ... `stage1+2/r4` | after that many refinement updates |
//! | `.../latent`, `.../down8` | latent tokens; images averaged down by 8 and brought back |
//! | `4dgt/5-frames` | 4DGT with five input frames |
//!
//! Methods with labels that no table of the paper has appear below the paper's rows in `main`, `additional`, `ci` and `timing`.

mod build;
mod cells;
mod fixed;
mod format;
mod layout;
mod published;

use serde::Serialize;

pub use build::{TableInput, TableOptions, table};
pub use cells::Cell;
pub use format::{to_csv, to_latex, to_text};

use crate::summary::DuplicateSheet;

/// Which table.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, serde::Deserialize, schemars::JsonSchema,
)]
#[serde(rename_all = "snake_case")]
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
    #[serde(rename = "frames_4dgt")]
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
}

impl TableId {
    /// Every table, in the order of the paper.
    pub const ALL: [Self; 15] = [
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
    ];

    /// The id as people write it.
    #[must_use]
    pub fn name(self) -> &'static str {
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

/// Why a table cannot be made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TableError {
    /// No table of this name.
    #[error("there is no table `{id}`; there are: {}", TableId::ALL.map(TableId::name).join(", "))]
    UnknownTable {
        /// What was asked for.
        id: String,
    },
    /// Two sheets of the same method, setting and clip.
    #[error(transparent)]
    Duplicate(#[from] DuplicateSheet),
}

/// A finished table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Table {
    /// Id.
    pub id: TableId,
    /// Title.
    pub title: String,
    /// Columns of numbers or words, without the row label and without n.
    pub columns: Vec<Column>,
    /// Rows.
    pub rows: Vec<Row>,
    /// What a reader must know.
    pub footnotes: Vec<String>,
    /// Whether rows have a number of clips.
    pub counted: bool,
}

/// One column.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Column {
    /// Heading with its unit.
    pub name: String,
    /// Digits after the point.
    pub digits: usize,
    /// Print the sign of positive numbers as well.
    pub signed: bool,
    /// Which direction is better, where one is.
    pub better: Option<Better>,
}

/// Which direction of a number is better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Better {
    /// Larger numbers.
    Higher,
    /// Smaller numbers.
    Lower,
}

/// One row.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Heading of the group the row belongs to: the setting; empty when there is one group only.
    pub group: String,
    /// What the row is called in print.
    pub label: String,
    /// Method label of the score sheets behind it; empty for rows of words.
    pub method: String,
    /// Clips of the method in the setting.
    pub clips: usize,
    /// One cell a column.
    pub cells: Vec<Cell>,
    /// The paper's values as printed there, one a column; empty when not asked for or not published.
    pub published: Vec<String>,
}
