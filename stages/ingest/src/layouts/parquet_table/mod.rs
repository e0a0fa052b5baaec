//! Columns of a parquet file as plain vectors.

mod column;

use std::collections::BTreeMap;
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use parquet::file::metadata::{ParquetMetaData, RowGroupMetaData};
use parquet::file::reader::{FileReader as _, RowGroupReader, SerializedFileReader};
use parquet::file::statistics::Statistics;
use rogs_worker::StageResult;

use self::column::{Column, Fault, Layout};
use crate::fault::{io_error, wrong};

/// Most numbers read from one column.
const MAX_VALUES: u64 = 1 << 28;

/// What reading took, for tests: it must not grow with the data set where one episode is read.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Work {
    /// Rows of the parts of parquet files that had to be looked at.
    pub(crate) rows: u64,
    /// Bytes of text.
    pub(crate) bytes: u64,
}

/// Some columns of a file, all rows or some.
pub(crate) struct Table {
    path: PathBuf,
    /// Rows.
    pub(crate) rows: usize,
    /// Rows of the whole file.
    pub(crate) of: u64,
    columns: BTreeMap<String, Column>,
}

impl Table {
    /// Reads those of the wanted columns that the file has: all rows, or those in which a column of whole numbers has a
    /// value. Row groups whose statistics rule it out are not read, of the others first this column alone.
    pub(crate) fn read_where(
        path: &Path,
        wanted: &dyn Fn(&str) -> bool,
        only: Option<(&str, u64)>,
        work: &mut Work,
    ) -> StageResult<Self> {
        let file = rogs_files::open(path).map_err(|error| io_error(path, &error))?;
        // The reader below trusts some numbers of a file that was damaged on its way.
        let read = std::panic::AssertUnwindSafe(|| Self::read_file(path, file, wanted, only, work));
        rogs_worker::quietly(read).unwrap_or_else(|| Err(wrong(path, "not a readable parquet file: it is damaged")))
    }

    fn read_file(
        path: &Path,
        file: File,
        wanted: &dyn Fn(&str) -> bool,
        only: Option<(&str, u64)>,
        work: &mut Work,
    ) -> StageResult<Self> {
        let length = file.metadata().map_err(|error| io_error(path, &error))?.len();
        let bad = |error: &dyn std::fmt::Display| wrong(path, format!("not a readable parquet file: {error}"));
        let reader = SerializedFileReader::new(file).map_err(|error| bad(&error))?;
        let metadata = reader.metadata();
        let rows = u64::try_from(metadata.file_metadata().num_rows()).unwrap_or(u64::MAX);
        // Numbers are held in eight bytes, once more while they are converted.
        let budget = MAX_VALUES.min(rogs_arrays::budget(length) / 16);
        if rows > budget {
            return Err(bad(&format!("{rows} rows in {length} bytes")));
        }
        let schema = metadata.file_metadata().schema_descr();
        let (groups, filter) = match only {
            Some((column, value)) => {
                let layout =
                    Layout::of(schema, column).ok_or_else(|| wrong(path, format!("there is no column `{column}`")))?;
                (admitting(metadata, column, value), Some((column, value, layout)))
            }
            None => ((0..metadata.num_row_groups()).collect(), None),
        };
        let mut table = Self {
            path: path.to_owned(),
            rows: 0,
            of: rows,
            columns: BTreeMap::new(),
        };
        let fields = schema.root_schema().get_fields();
        let names = fields.iter().map(|field| field.name()).filter(|name| wanted(name));
        let layouts: Vec<_> = names
            .filter_map(|name| Some((name, Layout::of(schema, name)?)))
            .collect();
        for group in groups {
            let group = reader.get_row_group(group).map_err(|error| bad(&error))?;
            let group = group.as_ref();
            let all = usize::try_from(group.metadata().num_rows()).map_err(|error| bad(&error))?;
            work.rows += all as u64;
            let runs = match &filter {
                None => std::iter::once(0..all).filter(|rows| !rows.is_empty()).collect(),
                Some((column, value, layout)) => match read(layout, group, std::slice::from_ref(&(0..all)), budget) {
                    Ok(Column::Numbers { width: 1, values }) => runs(&values, *value as f64),
                    Ok(_) => {
                        return Err(wrong(
                            path,
                            format!("column `{column}` does not hold one number per row"),
                        ));
                    }
                    Err(Fault::Unsuited(what)) => return Err(wrong(path, format!("column `{column}`: {what}"))),
                    Err(Fault::Damaged(what)) => return Err(bad(&what)),
                },
            };
            if runs.is_empty() {
                continue;
            }
            for (name, layout) in &layouts {
                let part = match read(layout, group, &runs, budget) {
                    Ok(part) => part,
                    Err(Fault::Unsuited(what)) => Column::Other(what),
                    Err(Fault::Damaged(what)) => return Err(bad(&what)),
                };
                table.append(name, part);
            }
            table.rows += runs.iter().map(Range::len).sum::<usize>();
        }
        Ok(table)
    }

    /// Adds the rows of one more row group.
    fn append(&mut self, name: &str, part: Column) {
        let Some(column) = self.columns.get_mut(name) else {
            self.columns.insert(name.to_owned(), part);
            return;
        };
        let fault = match (&mut *column, part) {
            (Column::Other(_), _) => return,
            (
                Column::Numbers { width, values },
                Column::Numbers {
                    width: more,
                    values: added,
                },
            ) if *width == more => {
                if (values.len() + added.len()) as u64 <= MAX_VALUES {
                    values.extend(added);
                    return;
                }
                "it has too many values".to_owned()
            }
            (Column::Texts(texts), Column::Texts(added)) => {
                texts.extend(added);
                return;
            }
            (_, Column::Other(what)) => what,
            _ => "its rows have different lengths".to_owned(),
        };
        *column = Column::Other(fault);
    }

    /// True when the file has the column.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.columns.contains_key(name)
    }

    /// A column of numbers: values per row, and all values.
    pub(crate) fn numbers(&self, name: &str) -> StageResult<(usize, &[f64])> {
        match self.columns.get(name) {
            Some(Column::Numbers { width, values }) => Ok((*width, values)),
            Some(Column::Texts(_)) => Err(wrong(
                &self.path,
                format!("column `{name}` holds text, expected numbers"),
            )),
            Some(Column::Other(what)) => Err(wrong(&self.path, format!("column `{name}`: {what}"))),
            None => Err(wrong(&self.path, format!("there is no column `{name}`"))),
        }
    }

    /// The number of a row in a column of one number per row.
    pub(crate) fn number(&self, name: &str, row: usize) -> StageResult<f64> {
        let (width, values) = self.numbers(name)?;
        let value = values.get(row).filter(|_| width == 1).copied();
        value.ok_or_else(|| wrong(&self.path, format!("column `{name}` does not hold one number per row")))
    }

    /// The whole number of a row in a column of one per row.
    pub(crate) fn integer(&self, name: &str, row: usize) -> StageResult<u64> {
        let value = self.number(name, row)?;
        whole(value).ok_or_else(|| {
            wrong(
                &self.path,
                format!("column `{name}` holds {value} in row {row}, expected a whole number"),
            )
        })
    }

    /// A column of one whole number per row.
    pub(crate) fn integers(&self, name: &str) -> StageResult<Vec<u64>> {
        let (width, values) = self.numbers(name)?;
        let integers: Option<Vec<u64>> = values.iter().map(|&value| whole(value)).collect();
        integers.filter(|_| width == 1).ok_or_else(|| {
            wrong(
                &self.path,
                format!("column `{name}` does not hold one whole number per row"),
            )
        })
    }

    /// A column of text: the first of each row.
    pub(crate) fn texts(&self, name: &str) -> StageResult<&[String]> {
        match self.columns.get(name) {
            Some(Column::Texts(texts)) => Ok(texts),
            _ => Err(wrong(&self.path, format!("there is no column of text `{name}`"))),
        }
    }
}

/// A number that counts something.
fn whole(value: f64) -> Option<u64> {
    (value >= 0.0 && value.fract() == 0.0 && value < 9e15).then_some(value as u64)
}

/// Row groups that may hold a value of a column, by their statistics.
fn admitting(metadata: &ParquetMetaData, column: &str, value: u64) -> Vec<usize> {
    let admits = |group: &RowGroupMetaData| {
        let chunk = group
            .columns()
            .iter()
            .find(|chunk| chunk.column_path().string() == column);
        let range = match chunk.and_then(|chunk| chunk.statistics()) {
            Some(Statistics::Int64(range)) => range.min_opt().copied().zip(range.max_opt().copied()),
            Some(Statistics::Int32(range)) => {
                let wide = |bound: &i32| i64::from(*bound);
                range.min_opt().map(wide).zip(range.max_opt().map(wide))
            }
            _ => None,
        };
        range.is_none_or(|(low, high)| i64::try_from(value).is_ok_and(|value| (low..=high).contains(&value)))
    };
    (0..metadata.num_row_groups())
        .filter(|&group| admits(metadata.row_group(group)))
        .collect()
}

/// Some rows of a column, once its layout is known to be readable.
fn read(
    layout: &Result<Layout, Fault>,
    group: &dyn RowGroupReader,
    rows: &[Range<usize>],
    budget: u64,
) -> Result<Column, Fault> {
    match layout {
        Ok(layout) if layout.values_in(group) > budget => Err(Fault::Unsuited("it has too many values".into())),
        Ok(layout) => layout.read(group, rows, budget),
        Err(fault) => Err(fault.clone()),
    }
}

/// Ranges of rows that hold a value.
fn runs(values: &[f64], wanted: f64) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for row in (0..values.len()).filter(|&row| values[row] == wanted) {
        match runs.last_mut() {
            Some(run) if run.end == row => run.end += 1,
            _ => runs.push(row..row + 1),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(writer: &str) -> Table {
        let path = format!("{}/tests/tables/{writer}.parquet", env!("CARGO_MANIFEST_DIR"));
        Table::read_where(Path::new(&path), &|_| true, None, &mut Work::default()).unwrap()
    }

    /// Rows of the tables, as `tests/tables/make.py` writes them.
    fn rows<T>(of: impl Fn(i32) -> T) -> Vec<T> {
        (0..5).map(of).collect()
    }

    fn states() -> Vec<f64> {
        (0..5)
            .flat_map(|row| [f64::from(row) + 0.25, f64::from(-row), 8.0])
            .collect()
    }

    #[test]
    fn what_the_usual_writers_write_is_read() {
        let (whole, real) = (rows(|row| f64::from(3 * row)), rows(|row| 0.5 * f64::from(row) - 1.0));
        for writer in ["pyarrow", "polars", "pandas", "fastparquet", "duckdb"] {
            let table = table(writer);
            assert_eq!((table.rows, table.of), (5, 5), "{writer}");
            assert_eq!(table.numbers("int64").unwrap(), (1, whole.as_slice()), "{writer}");
            assert_eq!(table.numbers("float64").unwrap(), (1, real.as_slice()), "{writer}");
            let (width, holes) = table.numbers("holes").unwrap();
            assert_eq!(
                (width, &holes[..2], &holes[3..]),
                (1, &real[..2], &real[3..]),
                "{writer}"
            );
            assert!(holes[2].is_nan(), "{writer}");
            assert_eq!(
                table.texts("text").unwrap(),
                rows(|row| format!("task {row}")),
                "{writer}"
            );
            if writer != "fastparquet" {
                assert_eq!(table.numbers("state").unwrap(), (3, states().as_slice()), "{writer}");
                assert_eq!(
                    table.texts("texts").unwrap(),
                    rows(|row| format!("task {row}")),
                    "{writer}"
                );
            }
        }
    }

    #[test]
    fn every_type_of_a_column_is_read_or_refused_by_name() {
        let table = table("pyarrow");
        let (whole, real) = (rows(|row| f64::from(3 * row)), rows(|row| 0.5 * f64::from(row) - 1.0));
        for name in ["int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"] {
            assert_eq!(table.numbers(name).unwrap(), (1, whole.as_slice()), "{name}");
        }
        for name in ["float16", "float32", "float64", "decimal", "decimal32"] {
            assert_eq!(table.numbers(name).unwrap(), (1, real.as_slice()), "{name}");
        }
        let large = rows(|row| 2f64.powi(63) + f64::from(2048 * row));
        assert_eq!(table.numbers("large").unwrap(), (1, large.as_slice()));
        assert_eq!(table.numbers("bool").unwrap(), (1, &[0.0, 1.0, 0.0, 1.0, 0.0][..]));
        for name in ["text", "large_text", "view", "dictionary", "texts"] {
            assert_eq!(table.texts(name).unwrap(), rows(|row| format!("task {row}")), "{name}");
        }
        for name in ["nothing", "empty"] {
            assert_eq!(table.texts(name).unwrap(), [""; 5], "{name}");
        }
        for name in ["state", "large_state", "fixed_state"] {
            assert_eq!(table.numbers(name).unwrap(), (3, states().as_slice()), "{name}");
        }
        for (name, why) in [
            ("ragged", "its rows have different lengths"),
            ("list_hole", "some rows have no value"),
            ("missing_list", "some rows have no value"),
            ("bytes", "bytes are not numbers"),
            ("time", "times are not numbers"),
            ("date", "times are not numbers"),
            ("pair", "it holds several values a row"),
            ("single", "values in a structure are not read"),
            ("nested", "lists of lists or of structures"),
            ("pairs", "lists of lists or of structures"),
        ] {
            let error = table.numbers(name).unwrap_err().to_string();
            assert!(error.contains(why), "{name}: {error}");
        }
    }

    #[test]
    fn one_value_finds_its_rows_and_reads_no_other_group() {
        let path = format!("{}/tests/tables/pyarrow.parquet", env!("CARGO_MANIFEST_DIR"));
        let mut work = Work::default();
        let table = Table::read_where(Path::new(&path), &|_| true, Some(("int64", 9)), &mut work).unwrap();
        assert_eq!((table.rows, table.of, work.rows), (1, 5, 2));
        assert_eq!(table.integer("uint8", 0).unwrap(), 9);
        assert_eq!(table.texts("texts").unwrap(), ["task 3"]);
        assert_eq!(table.numbers("state").unwrap(), (3, &states()[9..12]));
        let missing = Table::read_where(Path::new(&path), &|_| true, Some(("frame", 9)), &mut work);
        assert!(
            missing
                .err()
                .unwrap()
                .to_string()
                .contains("there is no column `frame`")
        );
    }
}
