//! Every table of a made-up run in every form, as it is printed. `UPDATE_EXPECT=1` writes what is expected anew.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

#[path = "../../../stages/score/tests/support/made_up.rs"]
mod made_up;

use expect_test::{ExpectFile, expect_file};
use made_up::{COHORT, run};
use rogs_report::Form;
use rogs_score::tables::{Table, TableId, TableInput, TableOptions, table};
use serde_json::Value;

/// Every table of the made-up run.
fn tables(options: TableOptions) -> Vec<Table> {
    let (sheets, timings) = run();
    let input = TableInput {
        sheets: &sheets,
        timings: &timings,
        cohort: Some(&COHORT),
        ..TableInput::default()
    };
    let make = |id| table(id, &input, options).unwrap();
    TableId::ALL.map(make).to_vec()
}

/// Every table of nothing.
fn empty_tables() -> Vec<Table> {
    let make = |id| table(id, &TableInput::default(), TableOptions::default()).unwrap();
    TableId::ALL.map(make).to_vec()
}

fn published() -> Vec<Table> {
    tables(TableOptions {
        published: true,
        ..TableOptions::default()
    })
}

fn check(tables: &[Table], form: Form, expected: &ExpectFile) {
    let texts: Vec<String> = tables.iter().map(|table| form.print(table).unwrap()).collect();
    expected.assert_eq(&texts.join("\n"));
}

#[test]
fn tables_as_text() {
    check(&published(), Form::Text, &expect_file!["expected/tables.txt"]);
    check(&empty_tables(), Form::Text, &expect_file!["expected/empty-tables.txt"]);
    let options = TableOptions {
        intervals: true,
        hide_empty_rows: true,
        ..TableOptions::default()
    };
    check(
        &tables(options),
        Form::Text,
        &expect_file!["expected/tables-with-intervals.txt"],
    );
}

/// The columns of a spreadsheet do not depend on what was asked for or found.
#[test]
fn tables_as_csv() {
    let (full, empty, plain) = (published(), empty_tables(), tables(TableOptions::default()));
    check(&full, Form::Csv, &expect_file!["expected/tables.csv"]);
    let csv = |table: &Table| Form::Csv.print(table).unwrap();
    for (full, others) in full.iter().zip(empty.iter().zip(&plain)) {
        let text = csv(full);
        let header = text.lines().next();
        assert_eq!(header, csv(others.0).lines().next());
        assert_eq!(header, csv(others.1).lines().next());
        assert_eq!(text.lines().count(), full.rows.len() + 1);
        for line in text.lines() {
            assert_eq!(csv_fields(line), 4 + 5 * full.columns.len(), "{}: {line}", full.id);
        }
    }
}

/// Fields of a line with quoted ones.
fn csv_fields(line: &str) -> usize {
    let mut quoted = false;
    let commas = line.chars().filter(|&c| {
        quoted ^= c == '"';
        c == ',' && !quoted
    });
    1 + commas.count()
}

#[test]
fn tables_as_json() {
    let full = published();
    let shown = [
        TableId::Ci,
        TableId::Cohort,
        TableId::Inputs,
        TableId::Main,
        TableId::Timing,
    ];
    let some: Vec<Table> = full.iter().filter(|table| shown.contains(&table.id)).cloned().collect();
    check(&some, Form::Json, &expect_file!["expected/tables.json"]);
    for table in full {
        let value: Value = serde_json::from_str(&Form::Json.print(&table).unwrap()).unwrap();
        assert_eq!(value["id"], table.id.name());
        assert_eq!(value["rows"].as_array().unwrap().len(), table.rows.len());
    }
}

#[test]
fn tables_as_latex() {
    let full = published();
    check(&full, Form::Latex, &expect_file!["expected/tables.tex"]);
    check(&empty_tables(), Form::Latex, &expect_file!["expected/empty-tables.tex"]);
    for table in full {
        let columns = table.columns.len() + usize::from(table.counted);
        check_latex(&Form::Latex.print(&table).unwrap(), columns, table.id);
    }
}

/// What a LaTeX run would stop at: unbalanced braces and environments, rows with another number of cells than columns,
/// specials that are not escaped, characters that need a package.
fn check_latex(latex: &str, columns: usize, id: TableId) {
    assert!(latex.is_ascii(), "{id}");
    let mut depth = 0;
    let mut before = ' ';
    for c in latex.chars() {
        depth += match c {
            '{' if before != '\\' => 1,
            '}' if before != '\\' => -1,
            _ => 0,
        };
        assert!(depth >= 0, "{id}");
        assert!(!matches!(c, '#' | '%' | '_') || before == '\\', "{id}: {before}{c}");
        before = c;
    }
    assert_eq!((depth, latex.matches('$').count() % 2), (0, 0), "{id}");
    let places: Vec<usize> = [
        "\\begin{table}",
        "\\begin{tabular}",
        "\\toprule",
        "\\midrule",
        "\\bottomrule",
        "\\end{tabular}",
        "\\end{table}",
    ]
    .iter()
    .map(|part| latex.find(part).unwrap_or_else(|| panic!("{id}: {part}")))
    .collect();
    assert!(places.is_sorted(), "{id}");
    let body = &latex[places[2] + "\\toprule".len()..places[4]];
    for row in body.lines().filter_map(|line| line.strip_suffix(" \\\\")) {
        let cells = row.replace("\\&", "").matches('&').count() + 1;
        assert!(cells == columns + 1 || row.starts_with("\\multicolumn"), "{id}: {row}");
        assert!(
            !row.starts_with('['),
            "{id}: an argument of the line break before: {row}"
        );
    }
}
