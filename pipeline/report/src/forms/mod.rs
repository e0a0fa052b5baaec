//! The forms of a table.

mod cell;
mod csv;
mod grid;
mod html;
mod latex;
mod text;

use rogs_score::tables::Table;

pub(crate) use html::to_html;

/// A form in which a table is printed; the page has one of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// For a terminal: one block a setting, columns aligned, footnotes below.
    Text,
    /// For a spreadsheet: full precision, empty cells for missing values.
    Csv,
    /// For a paper (`booktabs`): the best values of each setting in bold.
    Latex,
    /// For programs: the table's own serialisation.
    Json,
}

impl Form {
    /// Every form.
    pub const ALL: [Self; 4] = [Self::Text, Self::Csv, Self::Latex, Self::Json];

    /// How names of files of this form end.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Text => "txt",
            Self::Csv => "csv",
            Self::Latex => "tex",
            Self::Json => "json",
        }
    }

    /// The table in this form, with a line end.
    ///
    /// # Errors
    /// When its JSON cannot be made.
    pub fn print(self, table: &Table) -> serde_json::Result<String> {
        Ok(match self {
            Self::Text => text::to_text(table),
            Self::Csv => csv::to_csv(table),
            Self::Latex => latex::to_latex(table),
            Self::Json => serde_json::to_string_pretty(table)? + "\n",
        })
    }
}
