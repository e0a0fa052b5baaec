//! Tables as text, CSV and LaTeX. JSON is the table's own serialisation.

use std::fmt::Write as _;

use crate::tables::{Better, Cell, Column, Row, Table};

/// A table for a terminal: one block a setting, columns aligned, footnotes below.
#[must_use]
pub fn to_text(table: &Table) -> String {
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

/// A table for a spreadsheet: full precision, empty cells for missing values. Every column of the table has five: the
/// mean, the clips it is over, the ends of its interval and the paper's value; what was not asked for is empty, so that
/// the columns of a table are always the same.
#[must_use]
pub fn to_csv(table: &Table) -> String {
    let mut header = ["setting", "label", "method", "n"].map(str::to_owned).to_vec();
    for Column { name, .. } in &table.columns {
        header.push(name.clone());
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
            let published = row.published.get(index).cloned().unwrap_or_default();
            cells.extend([value, clips, low, high, published]);
        }
        text.push_str(&csv_line(&cells));
    }
    text
}

/// A table for a paper (`booktabs`), best values of each setting in bold.
#[must_use]
pub fn to_latex(table: &Table) -> String {
    let grid = Grid::new(table);
    let columns = "r".repeat(grid.header.len() - 1);
    let mut text = format!(
        "\\begin{{table}}[t]\n\\centering\n\\caption{{{}.}}\n",
        escape(&table.title)
    );
    let _ = writeln!(text, "\\label{{tab:{}}}", table.id.name().replace('_', "-"));
    let _ = writeln!(text, "\\begin{{tabular}}{{@{{}}l{columns}@{{}}}}\n\\toprule");
    let mut header: Vec<String> = grid.header.iter().map(|cell| escape(cell)).collect();
    for (cell, column) in header.iter_mut().skip(1).zip(&table.columns) {
        match column.better {
            Some(Better::Higher) => cell.push_str(" $\\uparrow$"),
            Some(Better::Lower) => cell.push_str(" $\\downarrow$"),
            None => {}
        }
    }
    let _ = writeln!(text, "{} \\\\\n\\midrule", header.join(" & "));
    let mut group = "";
    for row in &grid.lines {
        if row.group != group {
            group = row.group;
            let _ = writeln!(
                text,
                "\\multicolumn{{{}}}{{@{{}}l}}{{\\textit{{{}}}}} \\\\",
                grid.header.len(),
                escape(group)
            );
        }
        let print = |(index, cell): (usize, &String)| {
            let bold = index > 0 && row.source.is_some_and(|own| is_best(table, own, index - 1));
            match (cell.as_str(), bold) {
                ("-", _) => "\\textemdash".to_owned(),
                (text, true) => format!("\\textbf{{{}}}", number_text(text, index)),
                (text, false) => number_text(text, index),
            }
        };
        let cells: Vec<String> = row.cells.iter().enumerate().map(print).collect();
        let _ = writeln!(text, "{} \\\\", cells.join(" & "));
    }
    text.push_str("\\bottomrule\n\\end{tabular}\n");
    for note in &table.footnotes {
        let _ = writeln!(text, "\\par{{\\footnotesize {}}}", escape(note));
    }
    text.push_str("\\end{table}\n");
    text
}

/// A table as printed lines; published values are lines of their own below ours.
struct Grid<'a> {
    header: Vec<String>,
    lines: Vec<Line<'a>>,
}

struct Line<'a> {
    group: &'a str,
    cells: Vec<String>,
    /// The row behind the line; none for published values.
    source: Option<&'a Row>,
}

impl<'a> Grid<'a> {
    fn new(table: &'a Table) -> Self {
        let mut header = vec![String::new()];
        header.extend(table.columns.iter().map(|column| column.name.clone()));
        if table.counted {
            header.push("n".to_owned());
        }
        let mut lines = Vec::new();
        for row in &table.rows {
            let mut cells = vec![row.label.clone()];
            cells.extend(
                row.cells
                    .iter()
                    .zip(&table.columns)
                    .map(|(cell, column)| cell.print(column, row.clips)),
            );
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
                cells.extend(
                    row.published
                        .iter()
                        .map(|text| if text.is_empty() { "-".to_owned() } else { text.clone() }),
                );
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

/// Whether a row has the best printed value of its column in its group. A single value is not the best of anything.
fn is_best(table: &Table, row: &Row, column: usize) -> bool {
    let Some((heading, better)) = table.columns.get(column).and_then(|own| Some((own, own.better?))) else {
        return false;
    };
    let rounded = |row: &Row| {
        let value = row.cells.get(column)?.value()?;
        let scale = 10f64.powi(heading.digits as i32);
        Some((value * scale).round())
    };
    let Some(own) = rounded(row) else { return false };
    let others: Vec<f64> = table
        .rows
        .iter()
        .filter(|other| other.group == row.group)
        .filter_map(rounded)
        .collect();
    let beats = |other: &f64| match better {
        Better::Higher => own >= *other,
        Better::Lower => own <= *other,
    };
    others.len() > 1 && others.iter().all(beats)
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

/// A cell in LaTeX: the minus signs of numbers (columns after the first) are minus signs.
fn number_text(text: &str, column: usize) -> String {
    let escaped = escape(text);
    let number = column > 0 && text.contains(|c: char| c.is_ascii_digit());
    if number && (text.starts_with('-') || text.contains("[-") || text.contains(", -")) {
        let inner = escaped.replace("[-", "[$-$").replace(", -", ", $-$");
        return inner
            .strip_prefix('-')
            .map_or(inner.clone(), |rest| format!("$-${rest}"));
    }
    escaped
}

fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => {
                out.push('\\');
                out.push(c);
            }
            '\\' => out.push_str("\\textbackslash{}"),
            '~' => out.push_str("\\textasciitilde{}"),
            '^' => out.push_str("\\textasciicircum{}"),
            '<' => out.push_str("$<$"),
            '>' => out.push_str("$>$"),
            _ => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn csv_cells_are_quoted_when_they_must_be() {
        let cells = ["a", "b,c", "d\"e", ""].map(str::to_owned);
        assert_eq!(csv_line(&cells), "a,\"b,c\",\"d\"\"e\",\n");
    }

    #[test]
    fn negative_numbers_have_a_minus_sign_in_latex() {
        assert_eq!(number_text("-0.004 [-0.1, -0.01]", 1), "$-$0.004 [$-$0.1, $-$0.01]");
        assert_eq!(number_text("+0.01", 1), "+0.01");
        assert_eq!(number_text("scale-only", 1), "scale-only");
        assert_eq!(number_text("-x 2", 0), "-x 2");
    }

    #[test]
    fn latex_specials_are_escaped() {
        assert_eq!(
            escape("95 % of a_b & {c}\\"),
            "95 \\% of a\\_b \\& \\{c\\}\\textbackslash{}"
        );
    }
}
