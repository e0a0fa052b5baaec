//! From the name of a table to the table.

use crate::summary::SheetSet;
use crate::tables::id::{TableError, TableId};
use crate::tables::input::{TableInput, TableOptions};
use crate::tables::layout::layout;
use crate::tables::table::Table;
use crate::tables::{following, measured, timing, words};

/// Makes a table. Methods without scores have dashes.
///
/// # Errors
/// When two sheets have the same method, setting and clip.
pub fn table(id: TableId, input: &TableInput<'_>, options: TableOptions) -> Result<Table, TableError> {
    let set = SheetSet::new(input.sheets)?;
    Ok(match (id, layout(id)) {
        (_, Some(layout)) => measured::table(id, layout, &set, input, options),
        (TableId::Cohort, _) => words::cohort(input.cohort, options),
        (TableId::Following, _) => following::table(input.agreements),
        (TableId::Timing, _) => timing::table(&set, input, options),
        _ => words::inputs(input.signals, options),
    })
}
