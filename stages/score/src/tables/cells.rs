//! What a table cell holds and how it is printed.

use serde::Serialize;

use crate::tables::Column;

/// One cell.
#[derive(Debug, Clone, PartialEq, Serialize)]
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
    /// The number in the cell.
    #[must_use]
    pub fn value(&self) -> Option<f64> {
        match self {
            Self::Mean { value, .. } => Some(*value),
            Self::Count(count) => Some(*count as f64),
            Self::Missing | Self::Text(_) => None,
        }
    }

    /// The cell as people read it. A mean over fewer clips than `row_clips` says so.
    #[must_use]
    pub fn print(&self, column: &Column, row_clips: usize) -> String {
        match self {
            Self::Missing => "-".to_owned(),
            Self::Text(text) => text.clone(),
            Self::Count(count) => thousands(*count),
            Self::Mean {
                value,
                clips,
                interval,
                digits,
            } => {
                let number = |value: f64| number(value, digits.unwrap_or(column.digits), column.signed);
                let mut text = number(*value);
                if let Some([low, high]) = interval {
                    text = format!("{text} [{}, {}]", number(*low), number(*high));
                }
                if *clips == row_clips {
                    text
                } else {
                    format!("{text} (n={clips})")
                }
            }
        }
    }
}

/// A number with so many digits; no negative zero.
fn number(value: f64, digits: usize, signed: bool) -> String {
    let text = if signed {
        format!("{value:+.digits$}")
    } else {
        format!("{value:.digits$}")
    };
    let zero = text.chars().all(|c| !c.is_ascii_digit() || c == '0');
    if zero {
        text.trim_start_matches(['-', '+']).to_owned()
    } else {
        text
    }
}

/// `1026` as `1,026`.
fn thousands(count: u64) -> String {
    let digits = count.to_string();
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(digits: usize, signed: bool) -> Column {
        Column {
            name: String::new(),
            digits,
            signed,
            better: None,
        }
    }

    #[test]
    fn cells_print_as_people_expect() {
        let mean = |value| Cell::Mean {
            value,
            clips: 3,
            interval: None,
            digits: None,
        };
        assert_eq!(mean(15.517).print(&column(2, false), 3), "15.52");
        assert_eq!(mean(-0.001).print(&column(2, true), 3), "0.00");
        assert_eq!(mean(0.5).print(&column(1, true), 4), "+0.5 (n=3)");
        assert_eq!(Cell::Missing.print(&column(2, false), 3), "-");
        assert_eq!([7, 1026, 1_234_567].map(thousands), ["7", "1,026", "1,234,567"]);
        let with = Cell::Mean {
            value: 1.0,
            clips: 1,
            interval: Some([0.5, 1.5]),
            digits: None,
        };
        assert_eq!(with.print(&column(1, false), 1), "1.0 [0.5, 1.5]");
    }
}
