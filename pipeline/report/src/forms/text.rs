//! Tables for a terminal.

use std::fmt::Write as _;

use rogs_orchestrator::columns;
use rogs_score::tables::Table;

use super::grid::Grid;

/// A table for a terminal: one block a setting, columns aligned, footnotes below.
pub(super) fn to_text(table: &Table) -> String {
    let grid = Grid::new(table);
    // Widths are those of all blocks together.
    let rows: Vec<_> = std::iter::once(&grid.header)
        .chain(grid.lines.iter().map(|line| &line.cells))
        .cloned()
        .collect();
    let lines = columns(&rows);
    let width = lines.iter().map(|line| line.chars().count()).max().unwrap_or(0);
    let mut text = format!(
        "{} ({})\n\n{}\n{}\n",
        table.title,
        table.id,
        lines[0],
        "-".repeat(width)
    );
    let mut group = "";
    for (row, line) in grid.lines.iter().zip(&lines[1..]) {
        if row.group != group {
            group = row.group;
            let _ = writeln!(text, "{group}");
        }
        let _ = writeln!(text, "{line}");
    }
    if grid.lines.is_empty() {
        text.push_str("(no scores)\n");
    }
    if !table.footnotes.is_empty() {
        text.push('\n');
    }
    for note in &table.footnotes {
        let _ = writeln!(text, "* {note}");
    }
    text
}
