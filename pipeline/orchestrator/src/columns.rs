//! Text in columns, for every table that is printed in a terminal.

use rogs_schemas::shown;

/// One line a row: the first column to the left, the others to the right, two spaces between. Columns are as wide as their
/// widest cell; a cell is one line, whatever is in it.
#[must_use]
pub fn columns<Cell: AsRef<str>>(rows: &[Vec<Cell>]) -> Vec<String> {
    let shown = |row: &Vec<Cell>| row.iter().map(|cell| shown::line(cell.as_ref()).into_owned()).collect();
    let rows: Vec<Vec<String>> = rows.iter().map(shown).collect();
    let count = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..count).map(width).collect();
    let line = |row: &Vec<String>| {
        let cell = |(column, (cell, &width)): (usize, (&String, &usize))| match column {
            0 => format!("{cell:width$}"),
            _ => format!("  {cell:>width$}"),
        };
        let text: String = row.iter().zip(&widths).enumerate().map(cell).collect();
        text.trim_end().to_owned()
    };
    rows.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_as_wide_as_their_widest_cell_counted_in_characters() {
        let rows = [vec!["stage", "s", "n"], vec!["Ænima", "12.50", ""], vec!["x"]];
        assert_eq!(columns(&rows), ["stage      s  n", "Ænima  12.50", "x"]);
        assert!(columns::<String>(&[]).is_empty());
    }
}
