//! Tables of figures, in Markdown.

use std::fmt::Write as _;

use rogs_score::summary::summarise_with_interval;

/// A table of figures.
#[derive(Debug)]
pub(crate) struct Table {
    /// Title of the first column, then of the others.
    head: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    pub(crate) fn new(first: &str, columns: &[&str]) -> Self {
        let head = std::iter::once(&first).chain(columns);
        Self {
            head: head.map(|name| (*name).to_owned()).collect(),
            rows: Vec::new(),
        }
    }

    pub(crate) fn row(&mut self, name: &str, cells: impl IntoIterator<Item = Cell>) {
        let cells = cells.into_iter().map(|cell| cell.0);
        self.rows.push(std::iter::once(name.to_owned()).chain(cells).collect());
    }

    pub(crate) fn write(&self, page: &mut String) {
        let mut line = |cells: &[String]| {
            // Writing to a string cannot fail.
            let _ = writeln!(page, "| {} |", cells.join(" | "));
        };
        line(&self.head);
        line(&vec!["---".to_owned(); self.head.len()]);
        for row in &self.rows {
            line(row);
        }
    }
}

/// A figure as it is printed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Cell(String);

impl Cell {
    /// A figure, or `-` where there is none.
    pub(crate) fn of(value: Option<f64>, digits: usize) -> Self {
        Self(value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}")))
    }

    /// A mean over clips with its 95 % bootstrap interval and the number of clips.
    pub(crate) fn over_clips(values: &[f64], digits: usize) -> Self {
        let Some((summary, interval)) = summarise_with_interval(values) else {
            return Self("-".to_owned());
        };
        Self(format!(
            "{:.digits$} [{:.digits$}, {:.digits$}], n = {}",
            summary.mean, interval.low, interval.high, summary.clips
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_say_their_interval_and_number() {
        assert_eq!(
            Cell::over_clips(&[2.0, 2.0], 1),
            Cell("2.0 [2.0, 2.0], n = 2".to_owned())
        );
        assert_eq!(Cell::over_clips(&[], 1), Cell("-".to_owned()));
    }
}
