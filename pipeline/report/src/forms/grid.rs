//! A table as lines of words, for the forms that people read.

use rogs_score::tables::{Row, Table};

use super::cell;

/// A table as printed lines; published values are lines of their own below ours.
pub(super) struct Grid<'a> {
    pub(super) header: Vec<String>,
    pub(super) lines: Vec<Line<'a>>,
}

/// One printed line.
pub(super) struct Line<'a> {
    /// Heading of the group that it belongs to.
    pub(super) group: &'a str,
    /// The label, then one cell a column of the header.
    pub(super) cells: Vec<String>,
    /// The row behind the line; none for published values.
    pub(super) source: Option<&'a Row>,
}

impl<'a> Grid<'a> {
    pub(super) fn new(table: &'a Table) -> Self {
        let mut header = vec![String::new()];
        header.extend(table.columns.iter().map(|column| column.name.to_owned()));
        if table.counted {
            header.push("n".to_owned());
        }
        let mut lines = Vec::new();
        for row in &table.rows {
            let mut cells = vec![row.label.clone()];
            cells.extend(cell::print_row(table, row));
            if table.counted {
                cells.push(row.clips.to_string());
            }
            lines.push(Line {
                group: &row.group,
                cells,
                source: Some(row),
            });
            if !row.published.is_empty() {
                let mut cells = vec!["  published".to_owned()];
                let values = row.published.iter();
                cells.extend(values.map(|text| if text.is_empty() { "-" } else { text }.to_owned()));
                cells.resize(header.len(), String::new());
                lines.push(Line {
                    group: &row.group,
                    cells,
                    source: None,
                });
            }
        }
        Self { header, lines }
    }
}
