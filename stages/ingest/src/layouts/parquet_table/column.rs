//! One column of a parquet file: from levels and values to rows.
//!
//! The format stores a column as its values one after another and two numbers beside each: the definition level says how
//! much of the path to the value is there (a missing row, an empty list and a missing element have their own), the
//! repetition level is 0 where a row begins. Writers spell a type in many ways (plain, dictionary, large or viewed text,
//! lists of fixed or any length); below their own notes the file has only these.

use std::ops::Range;

use parquet::basic::{ConvertedType, LogicalType, Repetition, Type as Physical};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{ByteArray, DataType, FixedLenByteArray};
use parquet::errors::ParquetError;
use parquet::file::reader::RowGroupReader;
use parquet::schema::types::{SchemaDescriptor, Type};

/// Rows that are decoded at once.
const BATCH: usize = 8192;

/// Why a column is not read.
#[derive(Debug, Clone)]
pub(super) enum Fault {
    /// The file is damaged.
    Damaged(String),
    /// The column is whole, but neither numbers nor text. It matters only to who asks for it.
    Unsuited(String),
}

impl From<ParquetError> for Fault {
    fn from(error: ParquetError) -> Self {
        Self::Damaged(error.to_string())
    }
}

/// The rows of a column, or some of them.
pub(super) enum Column {
    /// `[rows, width]`; NaN where a row of a single number has none.
    Numbers { width: usize, values: Vec<f64> },
    /// First text of each row (a text, or a list of texts).
    Texts(Vec<String>),
    /// Neither; why.
    Other(String),
}

/// What the stored values of a column are.
#[derive(Clone, Copy)]
enum Meaning {
    Number,
    Unsigned,
    Half,
    /// Divided by ten to this power.
    Decimal(i32),
    Text,
    /// A type for nothing at all, as of an empty list.
    Nothing,
}

/// How a column lies in a file.
pub(super) struct Layout {
    leaf: usize,
    meaning: Meaning,
    /// Definition level of a value that is there.
    present: i16,
    /// For a list: definition level from which on a row has an element.
    element: Option<i16>,
}

impl Layout {
    /// The layout of the column with a name; `None` when there is none.
    pub(super) fn of(schema: &SchemaDescriptor, name: &str) -> Option<Result<Self, Fault>> {
        let mut leaves = (0..schema.num_columns()).filter(|&leaf| schema.get_column_root(leaf).name() == name);
        let leaf = leaves.next()?;
        if leaves.next().is_some() {
            return Some(Err(Fault::Unsuited("it holds several values a row".into())));
        }
        Some(Self::from_root(schema.get_column_root(leaf), leaf))
    }

    fn from_root(root: &Type, leaf: usize) -> Result<Self, Fault> {
        let info = root.get_basic_info();
        let list = info.converted_type() == ConvertedType::LIST || info.logical_type_ref() == Some(&LogicalType::List);
        if root.is_group() && !list {
            return Err(Fault::Unsuited("values in a structure are not read".into()));
        }
        let (mut node, mut level, mut element, mut depth) = (root, 0, None, 0);
        loop {
            let info = node.get_basic_info();
            match info.has_repetition().then(|| info.repetition()) {
                Some(Repetition::OPTIONAL) => level += 1,
                Some(Repetition::REPEATED) => {
                    level += 1;
                    if element.replace(level).is_some() {
                        return Err(Fault::Unsuited("lists of lists or of structures are not read".into()));
                    }
                }
                Some(Repetition::REQUIRED) | None => {}
            }
            match node {
                Type::PrimitiveType { .. } => break,
                // A list is three levels deep: itself, its repeated part, the element.
                Type::GroupType { fields, .. } if fields.len() == 1 && depth < 2 => node = &fields[0],
                Type::GroupType { .. } => {
                    return Err(Fault::Unsuited("lists of lists or of structures are not read".into()));
                }
            }
            depth += 1;
        }
        Ok(Self {
            leaf,
            meaning: meaning(node)?,
            present: level,
            element,
        })
    }

    /// Values that the file says are in the column of a row group.
    pub(super) fn values_in(&self, group: &dyn RowGroupReader) -> u64 {
        u64::try_from(group.metadata().column(self.leaf).num_values()).unwrap_or(u64::MAX)
    }

    /// Some rows of a row group, at most `budget` values and bytes of text.
    pub(super) fn read(&self, group: &dyn RowGroupReader, runs: &[Range<usize>], budget: u64) -> Result<Column, Fault> {
        let rows = runs.iter().map(Range::len).sum();
        if matches!(self.meaning, Meaning::Nothing) {
            return Ok(Column::Texts(vec![String::new(); rows]));
        }
        match group.get_column_reader(self.leaf)? {
            ColumnReader::BoolColumnReader(reader) => {
                self.numbers(&self.stored(reader, runs, budget)?, |&value| f64::from(u8::from(value)))
            }
            ColumnReader::Int32ColumnReader(reader) => {
                let stored = self.stored(reader, runs, budget)?;
                match self.meaning {
                    Meaning::Unsigned => self.numbers(&stored, |&value| f64::from(value as u32)),
                    Meaning::Decimal(scale) => self.numbers(&stored, |&value| f64::from(value) / power(scale)),
                    _ => self.numbers(&stored, |&value| f64::from(value)),
                }
            }
            ColumnReader::Int64ColumnReader(reader) => {
                let stored = self.stored(reader, runs, budget)?;
                match self.meaning {
                    Meaning::Unsigned => self.numbers(&stored, |&value| value as u64 as f64),
                    Meaning::Decimal(scale) => self.numbers(&stored, |&value| value as f64 / power(scale)),
                    _ => self.numbers(&stored, |&value| value as f64),
                }
            }
            ColumnReader::FloatColumnReader(reader) => {
                self.numbers(&self.stored(reader, runs, budget)?, |&value| f64::from(value))
            }
            ColumnReader::DoubleColumnReader(reader) => {
                self.numbers(&self.stored(reader, runs, budget)?, |&value| value)
            }
            ColumnReader::FixedLenByteArrayColumnReader(reader) => {
                let stored = self.stored(reader, runs, budget)?;
                self.numbers(&stored, |value: &FixedLenByteArray| self.of_bytes(value.data()))
            }
            ColumnReader::ByteArrayColumnReader(reader) => {
                let stored = self.stored(reader, runs, budget)?;
                match self.meaning {
                    Meaning::Text => self.texts(&stored, budget),
                    _ => self.numbers(&stored, |value: &ByteArray| self.of_bytes(value.data())),
                }
            }
            ColumnReader::Int96ColumnReader(_) => Err(Fault::Unsuited("times are not numbers".into())),
        }
    }

    fn stored<T: DataType>(
        &self,
        mut reader: ColumnReaderImpl<T>,
        runs: &[Range<usize>],
        budget: u64,
    ) -> Result<Stored<T::T>, Fault> {
        let mut stored = Stored {
            rows: 0,
            definition: Vec::new(),
            repetition: Vec::new(),
            values: Vec::new(),
        };
        let mut at = 0;
        for run in runs {
            if reader.skip_records(run.start - at)? != run.start - at {
                return Err(Fault::Damaged("a column ends early".into()));
            }
            at = run.start;
            while at < run.end {
                let (rows, ..) = reader.read_records(
                    BATCH.min(run.end - at),
                    Some(&mut stored.definition),
                    Some(&mut stored.repetition),
                    &mut stored.values,
                )?;
                if rows == 0 {
                    return Err(Fault::Damaged("a column ends early".into()));
                }
                if stored.values.len().max(stored.definition.len()) as u64 > budget {
                    return Err(Fault::Unsuited("it has too many values".into()));
                }
                at += rows;
                stored.rows += rows;
            }
        }
        // Levels that can only have one value are not stored.
        if self.present == 0 {
            stored.definition = vec![0; stored.values.len()];
        }
        if self.element.is_none() {
            stored.repetition = vec![0; stored.definition.len()];
        }
        Ok(stored)
    }

    /// A number that is stored as bytes: half floats are little-endian, decimals big-endian with a sign.
    fn of_bytes(&self, bytes: &[u8]) -> f64 {
        match (self.meaning, bytes) {
            (Meaning::Half, &[low, high]) => half::f16::from_le_bytes([low, high]).to_f64(),
            (Meaning::Decimal(scale), bytes) if bytes.len() <= 16 => {
                let sign = if bytes.first().is_some_and(|&byte| byte >= 0x80) {
                    -1
                } else {
                    0
                };
                let whole = bytes
                    .iter()
                    .fold(sign, |sum: i128, &byte| (sum << 8) | i128::from(byte));
                whole as f64 / power(scale)
            }
            _ => f64::NAN,
        }
    }

    fn numbers<T>(&self, stored: &Stored<T>, number: impl Fn(&T) -> f64) -> Result<Column, Fault> {
        if matches!(self.meaning, Meaning::Text) {
            return Err(Fault::Damaged("text of an unknown form".into()));
        }
        let mut values = stored.values.iter().map(number);
        let Some(element) = self.element else {
            let row = |&level: &i16| {
                if level == self.present {
                    values.next()
                } else {
                    Some(f64::NAN)
                }
            };
            let values: Option<Vec<f64>> = stored.definition.iter().map(row).collect();
            let values = values.ok_or_else(|| Fault::Damaged("a column has too few values".into()))?;
            return Ok(Column::Numbers { width: 1, values });
        };
        if stored
            .definition
            .iter()
            .any(|&level| level < element - 1 || (element..self.present).contains(&level))
        {
            return Err(Fault::Unsuited("some rows have no value".into()));
        }
        let width = stored.values.len().checked_div(stored.rows).unwrap_or(0);
        if stored.lengths(element).any(|length| length != width) {
            return Err(Fault::Unsuited("its rows have different lengths".into()));
        }
        Ok(Column::Numbers {
            width,
            values: values.collect(),
        })
    }

    fn texts(&self, stored: &Stored<ByteArray>, budget: u64) -> Result<Column, Fault> {
        let mut values = stored.values.iter();
        let (mut texts, mut bytes) = (Vec::with_capacity(stored.rows), 0);
        for (&definition, &repetition) in stored.definition.iter().zip(&stored.repetition) {
            let value = if definition == self.present {
                values.next()
            } else {
                None
            };
            if repetition > 0 {
                continue;
            }
            let text = value.map(ByteArray::as_utf8).transpose()?.unwrap_or_default();
            bytes += text.len() as u64;
            if bytes > budget {
                return Err(Fault::Unsuited("it has too much text".into()));
            }
            texts.push(text.to_owned());
        }
        Ok(Column::Texts(texts))
    }
}

/// What was read of a column: levels of each entry, and the values that are there.
struct Stored<T> {
    rows: usize,
    definition: Vec<i16>,
    repetition: Vec<i16>,
    values: Vec<T>,
}

impl<T> Stored<T> {
    /// Elements of each row of a list.
    fn lengths(&self, element: i16) -> impl Iterator<Item = usize> {
        let starts = (0..self.repetition.len()).filter(|&at| self.repetition[at] == 0);
        let ends = starts.clone().skip(1).chain([self.repetition.len()]);
        starts.zip(ends).map(move |(start, end)| {
            self.definition[start..end]
                .iter()
                .filter(|&&level| level >= element)
                .count()
        })
    }
}

fn power(scale: i32) -> f64 {
    10f64.powi(scale)
}

/// What the values of a leaf are, by its type and what is noted on it.
fn meaning(leaf: &Type) -> Result<Meaning, Fault> {
    let info = leaf.get_basic_info();
    let unsuited = |what: &str| Err(Fault::Unsuited(format!("{what} are not numbers")));
    match info.logical_type_ref() {
        Some(LogicalType::Unknown) => return Ok(Meaning::Nothing),
        Some(LogicalType::Float16) => return Ok(Meaning::Half),
        Some(LogicalType::Date | LogicalType::Time(_) | LogicalType::Timestamp(_)) => return unsuited("times"),
        _ => {}
    }
    match (info.converted_type(), leaf.get_physical_type()) {
        (ConvertedType::UTF8 | ConvertedType::ENUM | ConvertedType::JSON, Physical::BYTE_ARRAY) => Ok(Meaning::Text),
        (ConvertedType::DECIMAL, _) => match *leaf {
            Type::PrimitiveType { scale, .. } => Ok(Meaning::Decimal(scale)),
            Type::GroupType { .. } => unsuited("structures"),
        },
        (ConvertedType::UINT_8 | ConvertedType::UINT_16 | ConvertedType::UINT_32 | ConvertedType::UINT_64, _) => {
            Ok(Meaning::Unsigned)
        }
        (ConvertedType::NONE, Physical::BYTE_ARRAY | Physical::FIXED_LEN_BYTE_ARRAY) => match info.logical_type_ref() {
            Some(LogicalType::String | LogicalType::Enum | LogicalType::Json) => Ok(Meaning::Text),
            _ => unsuited("bytes"),
        },
        (ConvertedType::NONE | ConvertedType::INT_8 | ConvertedType::INT_16 | ConvertedType::INT_32, _)
        | (ConvertedType::INT_64, _) => Ok(Meaning::Number),
        _ => unsuited("times"),
    }
}
