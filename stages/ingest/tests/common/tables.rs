//! Parquet files of tests.

#![allow(clippy::unwrap_used, clippy::disallowed_methods, reason = "files of tests")]
#![allow(dead_code, reason = "each test uses some of it")]

use std::path::Path;
use std::sync::Arc;

use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;

/// A column, one entry a row unless said otherwise.
#[derive(Debug, Clone)]
pub(crate) enum Values {
    Integers(Vec<Option<i64>>),
    Numbers(Vec<f64>),
    Texts(Vec<String>),
    /// A list of this many numbers in each row, one after another.
    Lists(usize, Vec<f64>),
    /// A list of one text in each row.
    TextLists(Vec<String>),
    /// A list of nothing, whose type nobody knows, in each of so many rows.
    EmptyLists(usize),
}

impl Values {
    fn rows(&self) -> usize {
        match self {
            Self::Integers(values) => values.len(),
            Self::Numbers(values) => values.len(),
            Self::Texts(values) | Self::TextLists(values) => values.len(),
            Self::Lists(width, values) => values.len() / width,
            Self::EmptyLists(rows) => *rows,
        }
    }

    fn schema(&self, name: &str) -> String {
        let list =
            |element: &str| format!("optional group {name} (LIST) {{ repeated group list {{ optional {element}; }} }}");
        match self {
            Self::Integers(_) => format!("optional int64 {name};"),
            Self::Numbers(_) => format!("optional double {name};"),
            Self::Texts(_) => format!("optional binary {name} (STRING);"),
            Self::Lists(..) => list("double element"),
            Self::TextLists(_) => list("binary element (STRING)"),
            Self::EmptyLists(_) => list("int32 element (UNKNOWN)"),
        }
    }
}

/// Writes a table, so many rows a row group.
pub(crate) fn write(path: &Path, columns: &[(&str, Values)], group: usize) {
    let fields: Vec<String> = columns.iter().map(|(name, values)| values.schema(name)).collect();
    let schema = Arc::new(parse_message_type(&format!("message table {{ {} }}", fields.join(" "))).unwrap());
    let out = std::fs::File::create(path).unwrap();
    let mut writer = SerializedFileWriter::new(out, schema, Arc::new(WriterProperties::default())).unwrap();
    let rows = columns[0].1.rows();
    for start in (0..rows).step_by(group) {
        let range = start..rows.min(start + group);
        let n = range.len();
        let mut group = writer.next_row_group().unwrap();
        for (_, values) in columns {
            let mut column = group.next_column().unwrap().unwrap();
            let bytes =
                |texts: &[String]| -> Vec<ByteArray> { texts.iter().map(|text| text.as_str().into()).collect() };
            match values {
                Values::Integers(values) => {
                    let part = &values[range.clone()];
                    let levels: Vec<i16> = part.iter().map(|value| i16::from(value.is_some())).collect();
                    let there: Vec<i64> = part.iter().copied().flatten().collect();
                    column.typed::<Int64Type>().write_batch(&there, Some(&levels), None)
                }
                Values::Numbers(values) => {
                    column
                        .typed::<DoubleType>()
                        .write_batch(&values[range.clone()], Some(&vec![1; n]), None)
                }
                Values::Texts(texts) => {
                    column
                        .typed::<ByteArrayType>()
                        .write_batch(&bytes(&texts[range.clone()]), Some(&vec![1; n]), None)
                }
                Values::Lists(width, values) => {
                    let part = &values[range.start * width..range.end * width];
                    let starts: Vec<i16> = (0..part.len()).map(|at| i16::from(at % width > 0)).collect();
                    column
                        .typed::<DoubleType>()
                        .write_batch(part, Some(&vec![3; part.len()]), Some(&starts))
                }
                Values::TextLists(texts) => {
                    let part = bytes(&texts[range.clone()]);
                    column
                        .typed::<ByteArrayType>()
                        .write_batch(&part, Some(&vec![3; n]), Some(&vec![0; n]))
                }
                Values::EmptyLists(_) => column.typed::<parquet::data_type::Int32Type>().write_batch(
                    &[],
                    Some(&vec![1; n]),
                    Some(&vec![0; n]),
                ),
            }
            .unwrap();
            column.close().unwrap();
        }
        group.close().unwrap();
    }
    writer.close().unwrap();
}
