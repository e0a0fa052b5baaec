//! A finished table: columns, rows, cells, notes. Programs print it in the form that they need.

use schemars::JsonSchema;
use serde::Serialize;

use crate::tables::id::TableId;

/// A finished table.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Table {
    /// Id.
    pub id: TableId,
    /// Title.
    pub title: &'static str,
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Column {
    /// Heading with its unit.
    pub name: &'static str,
    /// Digits after the point.
    pub digits: usize,
    /// Print the sign of positive numbers as well.
    pub signed: bool,
    /// Which direction is better, where one is.
    pub better: Option<Better>,
}

impl Column {
    /// A column of words, or of numbers with two digits.
    pub(crate) const fn plain(name: &'static str) -> Self {
        Self {
            name,
            digits: 2,
            signed: false,
            better: None,
        }
    }
}

/// Which direction of a number is better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Better {
    /// Larger numbers.
    Higher,
    /// Smaller numbers.
    Lower,
}

/// One row.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Row {
    /// Heading of the group the row belongs to: the setting; empty when there is one group only.
    pub group: String,
    /// What the row is called in print.
    pub label: String,
    /// Method label of the score sheets behind it; empty for rows of words.
    pub method: String,
    /// Clips of the method in the setting.
    pub clips: usize,
    /// Made with seeded random weights: told in the label, and compared with nothing.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub untrained: bool,
    /// One cell a column.
    pub cells: Vec<Cell>,
    /// The paper's values as printed there, one a column, "" where it has none; empty when not asked for or not
    /// published.
    pub published: &'static [&'static str],
}

impl Row {
    /// A row of no method, without cells yet.
    pub(crate) fn of_words(label: &str) -> Self {
        Self {
            group: String::new(),
            label: label.to_owned(),
            method: String::new(),
            clips: 0,
            untrained: false,
            cells: Vec::new(),
            published: &[],
        }
    }
}

/// One cell.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Cell {
    /// Nothing was measured. Printed as a dash, never as 0.
    Missing,
    /// A mean over clips in full precision.
    Mean {
        /// The mean.
        value: f64,
        /// Clips it is over.
        clips: usize,
        /// 95 % bootstrap interval, where asked for.
        interval: Option<[f64; 2]>,
        /// Digits after the point where they differ from the column's.
        digits: Option<usize>,
    },
    /// A count.
    Count(u64),
    /// Words.
    Text(String),
}

impl Cell {
    /// A mean over so many clips without an interval, or nothing.
    pub(crate) fn mean(found: Option<(f64, usize)>) -> Self {
        found.map_or(Self::Missing, |(value, clips)| Self::Mean {
            value,
            clips,
            interval: None,
            digits: None,
        })
    }

    /// The number in the cell.
    #[must_use]
    pub fn value(&self) -> Option<f64> {
        match self {
            Self::Mean { value, .. } => Some(*value),
            Self::Count(count) => Some(*count as f64),
            Self::Missing | Self::Text(_) => None,
        }
    }
}
