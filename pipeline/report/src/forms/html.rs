//! Tables for the page.

use maud::{Markup, html};
use rogs_score::tables::{Row, Table};

use super::cell::print_row;

/// A table with its heading and notes; groups stand before the labels.
pub(crate) fn to_html(table: &Table) -> Markup {
    let label = |row: &Row| match row.group.as_str() {
        "" => row.label.clone(),
        group => format!("{group}: {}", row.label),
    };
    html! {
        h2 { (table.title) }
        table {
            tr {
                th { "method" }
                @for column in &table.columns { th { (column.name) } }
            }
            @for row in &table.rows {
                tr {
                    td { (label(row)) }
                    @for cell in print_row(table, row) { td { (cell) } }
                }
            }
        }
        @for note in &table.footnotes { p.note { (note) } }
    }
}
