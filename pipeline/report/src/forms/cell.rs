//! Cells as people read them.

use rogs_score::tables::{Cell, Column, Row, Table};

/// The cells of a row in words, one a column.
pub(super) fn print_row<'a>(table: &'a Table, row: &'a Row) -> impl Iterator<Item = String> + 'a {
    let cells = row.cells.iter().zip(&table.columns);
    cells.map(|(cell, column)| print(cell, column, row.clips))
}

/// The cell in words. A mean over fewer clips than `row_clips` says so.
fn print(cell: &Cell, column: &Column, row_clips: usize) -> String {
    match cell {
        Cell::Missing => "-".to_owned(),
        Cell::Text(text) => text.clone(),
        Cell::Count(count) => thousands(*count),
        Cell::Mean {
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
            name: "",
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
        assert_eq!(print(&mean(15.517), &column(2, false), 3), "15.52");
        assert_eq!(print(&mean(-0.001), &column(2, true), 3), "0.00");
        assert_eq!(print(&mean(0.5), &column(1, true), 4), "+0.5 (n=3)");
        assert_eq!(print(&Cell::Missing, &column(2, false), 3), "-");
        assert_eq!([7, 1026, 1_234_567].map(thousands), ["7", "1,026", "1,234,567"]);
        let with = Cell::Mean {
            value: 1.0,
            clips: 1,
            interval: Some([0.5, 1.5]),
            digits: None,
        };
        assert_eq!(print(&with, &column(1, false), 1), "1.0 [0.5, 1.5]");
    }
}
