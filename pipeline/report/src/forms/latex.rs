//! Tables for a paper.

use std::fmt::Write as _;

use rogs_score::tables::{Better, Row, Table};

use super::grid::Grid;

/// A table for a paper (`booktabs`), best values of each setting in bold.
pub(super) fn to_latex(table: &Table) -> String {
    let grid = Grid::new(table);
    let columns = "r".repeat(grid.header.len() - 1);
    let mut text = format!(
        "\\begin{{table}}[t]\n\\centering\n\\caption{{{}.}}\n",
        escape(table.title)
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

/// Whether a row has the best printed value of its column in its group. A single value is not the best of anything, and
/// rows of random weights are compared with nothing.
fn is_best(table: &Table, row: &Row, column: usize) -> bool {
    let Some((heading, better)) = table.columns.get(column).and_then(|own| Some((own, own.better?))) else {
        return false;
    };
    let rounded = |row: &Row| {
        let value = row.cells.get(column)?.value()?;
        let scale = 10f64.powi(heading.digits as i32);
        Some((value * scale).round())
    };
    let Some(own) = rounded(row).filter(|_| !row.untrained) else {
        return false;
    };
    let others: Vec<f64> = table
        .rows
        .iter()
        .filter(|other| other.group == row.group && !other.untrained)
        .filter_map(rounded)
        .collect();
    let beats = |other: &f64| match better {
        Better::Higher => own >= *other,
        Better::Lower => own <= *other,
    };
    others.len() > 1 && others.iter().all(beats)
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
