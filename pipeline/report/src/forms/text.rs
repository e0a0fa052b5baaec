//! Tables for a terminal.

use std::fmt::Write as _;

use rogs_score::tables::Table;

use super::grid::Grid;

/// A table for a terminal: one block a setting, columns aligned, footnotes below.
pub(super) fn to_text(table: &Table) -> String {
    let grid = Grid::new(table);
    let widths: Vec<usize> = (0..grid.header.len())
        .map(|column| {
            let cells = grid.lines.iter().filter_map(|line| line.cells.get(column));
            cells
                .chain([&grid.header[column]])
                .map(|cell| cell.chars().count())
                .max()
                .unwrap_or(0)
        })
        .collect();
    let line = |cells: &[String]| {
        let mut text = String::new();
        for (column, (cell, width)) in cells.iter().zip(&widths).enumerate() {
            let padding = " ".repeat(width - cell.chars().count());
            // Labels to the left, everything else to the right.
            if column == 0 {
                let _ = write!(text, "{cell}{padding}");
            } else {
                let _ = write!(text, "  {padding}{cell}");
            }
        }
        text.trim_end().to_owned()
    };
    let mut text = format!("{} ({})\n\n{}\n", table.title, table.id, line(&grid.header));
    let width = widths.iter().sum::<usize>() + 2 * (widths.len() - 1);
    let _ = writeln!(text, "{}", "-".repeat(width));
    let mut group = "";
    for row in &grid.lines {
        if row.group != group {
            group = row.group;
            let _ = writeln!(text, "{group}");
        }
        let _ = writeln!(text, "{}", line(&row.cells));
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
