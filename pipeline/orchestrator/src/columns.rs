//! Text in columns, for every table that is printed in a terminal.

/// One line a row: the first column to the left, the others to the right, two spaces between. Columns are as wide as their
/// widest cell.
#[must_use]
pub fn columns<Cell: AsRef<str>>(rows: &[Vec<Cell>]) -> Vec<String> {
    let count = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        cells.map(|cell| cell.as_ref().chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..count).map(width).collect();
    let line = |row: &Vec<Cell>| {
        let cell = |(column, (cell, &width)): (usize, (&Cell, &usize))| match column {
            0 => format!("{:width$}", cell.as_ref()),
            _ => format!("  {:>width$}", cell.as_ref()),
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
