//! Columns of a parquet file as plain vectors.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow::array::{Array, ArrayRef, AsArray as _, BooleanArray, FixedSizeListArray, RecordBatch};
use arrow::compute::cast;
use arrow::datatypes::{DataType, Field, FieldRef, Float64Type, UInt64Type};
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{ArrowPredicateFn, ParquetRecordBatchReaderBuilder, RowFilter};
use parquet::file::metadata::{ParquetMetaData, RowGroupMetaData};
use parquet::file::statistics::Statistics;
use rogs_worker::StageResult;

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

enum Column {
    /// `[rows, width]`; NaN where a row of a single number has none.
    Numbers { width: usize, values: Vec<f64> },
    /// First text of each row (a text, or a list of texts).
    Texts(Vec<String>),
    /// Neither; why. It matters only to who asks for it.
    Other(String),
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
        let mut builder = ParquetRecordBatchReaderBuilder::try_new(file).map_err(|error| bad(&error))?;
        let rows = u64::try_from(builder.metadata().file_metadata().num_rows()).unwrap_or(u64::MAX);
        // Numbers are held in eight bytes, once more while they are converted.
        if rows > MAX_VALUES.min(rogs_arrays::budget(length) / 16) {
            return Err(bad(&format!("{rows} rows in {length} bytes")));
        }
        let groups = match only {
            Some((column, value)) => admitting(builder.metadata(), column, value),
            None => (0..builder.metadata().num_row_groups()).collect(),
        };
        let in_group = |&group: &usize| u64::try_from(builder.metadata().row_group(group).num_rows()).unwrap_or(0);
        work.rows += groups.iter().map(in_group).sum::<u64>();
        builder = builder.with_row_groups(groups);
        if let Some((column, value)) = only {
            builder = match filter(&builder, column, value) {
                Some(filter) => builder.with_row_filter(filter),
                None => return Err(wrong(path, format!("there is no column `{column}`"))),
            };
        }
        let schema = builder.schema().clone();
        let roots: Vec<usize> = (0..schema.fields().len())
            .filter(|&index| wanted(schema.field(index).name()))
            .collect();
        let mask = ProjectionMask::roots(builder.parquet_schema(), roots.iter().copied());
        let reader = builder
            .with_projection(mask)
            .with_batch_size(8192)
            .build()
            .map_err(|error| bad(&error))?;
        let mut table = Self {
            path: path.to_owned(),
            rows: 0,
            of: rows,
            columns: BTreeMap::new(),
        };
        for batch in reader {
            let batch = batch.map_err(|error| bad(&error))?;
            for (field, array) in batch.schema().fields().iter().zip(batch.columns()) {
                let name = field.name();
                if let Err(what) = table.append(name, array) {
                    table.columns.insert(name.to_owned(), Column::Other(what));
                }
            }
            table.rows += batch.num_rows();
        }
        Ok(table)
    }

    fn append(&mut self, name: &str, array: &ArrayRef) -> Result<(), String> {
        let part = column(array)?;
        let Some(column) = self.columns.get_mut(name) else {
            self.columns.insert(name.to_owned(), part);
            return Ok(());
        };
        match (column, part) {
            (
                Column::Numbers { width, values },
                Column::Numbers {
                    width: more,
                    values: added,
                },
            ) if *width == more => {
                if (values.len() + added.len()) as u64 > MAX_VALUES {
                    return Err("it has too many values".into());
                }
                values.extend(added);
                Ok(())
            }
            (Column::Texts(texts), Column::Texts(added)) => {
                texts.extend(added);
                Ok(())
            }
            (Column::Other(_), _) => Ok(()),
            _ => Err("its rows have different lengths".into()),
        }
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

/// Keeps the rows in which a column has a value; `None` when there is no such column.
fn filter(builder: &ParquetRecordBatchReaderBuilder<File>, column: &str, value: u64) -> Option<RowFilter> {
    let position = builder
        .schema()
        .fields()
        .iter()
        .position(|field| field.name() == column)?;
    let mask = ProjectionMask::roots(builder.parquet_schema(), [position]);
    let fits = move |batch: RecordBatch| {
        let values = cast(batch.column(0), &DataType::UInt64)?;
        let values = values.as_primitive::<UInt64Type>();
        Ok(values
            .iter()
            .map(|found| Some(found == Some(value)))
            .collect::<BooleanArray>())
    };
    Some(RowFilter::new(vec![Box::new(ArrowPredicateFn::new(mask, fits))]))
}

fn column(array: &ArrayRef) -> Result<Column, String> {
    let array = &usual(array)?;
    match array.data_type() {
        DataType::Null => Ok(Column::Texts(vec![String::new(); array.len()])),
        DataType::Utf8 => {
            let texts = cast(array, &DataType::Utf8).map_err(|error| error.to_string())?;
            Ok(Column::Texts(
                texts
                    .as_string::<i32>()
                    .iter()
                    .map(|text| text.unwrap_or_default().to_owned())
                    .collect(),
            ))
        }
        DataType::FixedSizeList(_, width) => {
            let list: &FixedSizeListArray = array.as_fixed_size_list();
            let width = usize::try_from(*width).map_err(|_| "a list of negative length".to_owned())?;
            let values = list.values().slice(list.value_offset_at(0), list.len() * width);
            Ok(Column::Numbers {
                width,
                values: numbers(&values, list.null_count())?,
            })
        }
        DataType::List(_) => {
            let list = array.as_list::<i32>();
            let offsets = list.value_offsets();
            let (first, last) = (offsets[0] as usize, offsets[list.len()] as usize);
            let values = list.values().slice(first, last - first);
            if matches!(values.data_type(), DataType::Null | DataType::Utf8) {
                let firsts = offsets
                    .windows(2)
                    .map(|ends| (ends[0] < ends[1]).then_some(ends[0] as usize - first));
                let Column::Texts(texts) = column(&values)? else {
                    return Err("mixed".into());
                };
                return Ok(Column::Texts(
                    firsts
                        .map(|at| at.map_or(String::new(), |at| texts[at].clone()))
                        .collect(),
                ));
            }
            let width = if list.is_empty() {
                0
            } else {
                (offsets[1] - offsets[0]) as usize
            };
            if offsets.windows(2).any(|ends| (ends[1] - ends[0]) as usize != width) {
                return Err("its rows have different lengths".into());
            }
            Ok(Column::Numbers {
                width,
                values: numbers(&values, list.null_count())?,
            })
        }
        _ => Ok(Column::Numbers {
            width: 1,
            values: scalars(array)?,
        }),
    }
}

/// The types that the usual writers use, as the few that are read: polars writes large lists and views, pandas
/// dictionaries, and an empty list has no type at all.
fn usual(array: &ArrayRef) -> Result<ArrayRef, String> {
    let plain = |kind: &DataType| match kind {
        DataType::LargeUtf8 | DataType::Utf8View => DataType::Utf8,
        DataType::Dictionary(_, values) if matches!(**values, DataType::LargeUtf8 | DataType::Utf8View) => {
            DataType::Utf8
        }
        DataType::Dictionary(_, values) => (**values).clone(),
        other => other.clone(),
    };
    let list = |field: &FieldRef| {
        let kind = plain(field.data_type());
        DataType::List(Arc::new(Field::new("item", kind, true)))
    };
    let wanted = match array.data_type() {
        DataType::List(field)
        | DataType::LargeList(field)
        | DataType::ListView(field)
        | DataType::LargeListView(field) => list(field),
        DataType::FixedSizeList(field, _) if !field.data_type().is_numeric() => list(field),
        other => plain(other),
    };
    if wanted == *array.data_type() {
        return Ok(Arc::clone(array));
    }
    cast(array, &wanted).map_err(|_| format!("values of type {} are not read", array.data_type()))
}

/// One number a row; a row without one is NaN, so that it fails what reads this row alone.
fn scalars(array: &ArrayRef) -> Result<Vec<f64>, String> {
    if array.null_count() == 0 || !array.data_type().is_numeric() {
        return numbers(array, 0);
    }
    let values = cast(array, &DataType::Float64).map_err(|error| error.to_string())?;
    let values = values.as_primitive::<Float64Type>();
    Ok(values.iter().map(|value| value.unwrap_or(f64::NAN)).collect())
}

fn numbers(array: &ArrayRef, null_rows: usize) -> Result<Vec<f64>, String> {
    if !(array.data_type().is_numeric() || *array.data_type() == DataType::Boolean) {
        return Err(format!("values of type {} are not numbers", array.data_type()));
    }
    if null_rows > 0 || array.null_count() > 0 {
        return Err("some rows have no value".into());
    }
    let values = cast(array, &DataType::Float64).map_err(|error| error.to_string())?;
    Ok(values.as_primitive::<Float64Type>().values().to_vec())
}
