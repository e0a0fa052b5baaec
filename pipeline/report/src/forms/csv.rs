//! Tables for a spreadsheet.

use rogs_score::tables::{Cell, Column, Table};

/// A table for a spreadsheet: full precision, empty cells for missing values. Every column of the table has five: the
/// mean, the clips it is over, the ends of its interval and the paper's value; what was not asked for is empty, so that
/// the columns of a table are always the same.
pub(super) fn to_csv(table: &Table) -> String {
    let mut header = ["setting", "label", "method", "n"].map(str::to_owned).to_vec();
    for Column { name, .. } in &table.columns {
        header.push((*name).to_owned());
        header.extend(["n", "low", "high", "published"].map(|part| format!("{name} {part}")));
    }
    let mut text = csv_line(&header);
    for row in &table.rows {
        let clips = if table.counted {
            row.clips.to_string()
        } else {
            String::new()
        };
        let mut cells = vec![row.group.clone(), row.label.clone(), row.method.clone(), clips];
        for (index, cell) in row.cells.iter().enumerate() {
            let (value, clips, interval) = match cell {
                Cell::Missing => (String::new(), String::new(), None),
                Cell::Text(text) => (text.clone(), String::new(), None),
                Cell::Count(count) => (count.to_string(), String::new(), None),
                Cell::Mean {
                    value, clips, interval, ..
                } => (value.to_string(), clips.to_string(), *interval),
            };
            let [low, high] = interval.map_or_else(Default::default, |ends| ends.map(|end| end.to_string()));
            let published = row.published.get(index).copied().unwrap_or_default().to_owned();
            cells.extend([value, clips, low, high, published]);
        }
        text.push_str(&csv_line(&cells));
    }
    text
}

fn csv_line(cells: &[String]) -> String {
    let quoted: Vec<String> = cells
        .iter()
        .map(|cell| {
            let plain = !cell.contains([',', '"', '\n', '\r']);
            if plain {
                cell.clone()
            } else {
                format!("\"{}\"", cell.replace('"', "\"\""))
            }
        })
        .collect();
    quoted.join(",") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn csv_cells_are_quoted_when_they_must_be() {
        let cells = ["a", "b,c", "d\"e", ""].map(str::to_owned);
        assert_eq!(csv_line(&cells), "a,\"b,c\",\"d\"\"e\",\n");
    }
}
