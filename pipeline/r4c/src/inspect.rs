//! Describing any container file for a person or a script.

use std::path::Path;

use rogs_schemas::key::{CacheKey, ContentHash, Provenance};
use schemars::JsonSchema;
use serde::Serialize;

use crate::error::Result;
use crate::layout::{FLAG_CONSTANT, IndexEntry};
use crate::reader::Reader;
use crate::stream::{Codec, Dtype, Frame, StreamInfo, Unit};

/// Everything `rogs inspect` shows.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct InspectReport {
    /// Schema name.
    pub schema: String,
    /// Schema version, `1.0`.
    pub version: String,
    /// Container version, `1.0`.
    pub container: String,
    /// Length of the file, bytes.
    pub file_bytes: u64,
    /// Cache key.
    pub key: CacheKey,
    /// Hash of the decoded content.
    pub content: ContentHash,
    /// How it was made.
    pub provenance: Provenance,
    /// Streams in file order.
    pub streams: Vec<StreamReport>,
}

/// One stream.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct StreamReport {
    /// Name.
    pub name: String,
    /// Type of the scalars.
    pub dtype: Dtype,
    /// Shape of one element.
    pub shape: Vec<u32>,
    /// Unit.
    pub unit: Unit,
    /// Frame.
    pub frame: Frame,
    /// Codec.
    pub codec: Codec,
    /// What a NaN or 0 means; empty when nothing special.
    pub fill: String,
    /// Sizes.
    #[serde(flatten)]
    pub totals: ChunkTotals,
    /// Smallest value that is not NaN.
    pub min: Option<f64>,
    /// Largest value that is not NaN.
    pub max: Option<f64>,
    /// Number of NaN.
    pub nan: u64,
}

/// Sums over a stream's chunks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, JsonSchema)]
pub struct ChunkTotals {
    /// Chunks.
    pub chunks: u64,
    /// Chunks stored as a single value.
    pub constant_chunks: u64,
    /// Elements.
    pub elements: u64,
    /// Bytes in the file.
    pub stored_bytes: u64,
    /// Bytes when decoded.
    pub decoded_bytes: u64,
}

/// Reads and checks a whole file and describes it.
///
/// # Errors
/// When it is missing or damaged.
pub fn inspect(path: &Path) -> Result<InspectReport> {
    let reader = Reader::open(path)?;
    let header = reader.header();
    let ranges = reader.check_all(|entry, bytes| range(reader.streams()[entry.stream as usize].dtype, bytes))?;
    let report = |(number, stream): (usize, &StreamInfo)| {
        let chunks = reader
            .entries()
            .iter()
            .zip(&ranges)
            .filter(|(entry, _)| entry.stream as usize == number);
        stream_report(stream, chunks)
    };
    let version = |(major, minor): (u16, u16)| format!("{major}.{minor}");
    Ok(InspectReport {
        schema: header.schema,
        version: version(header.version),
        container: version(reader.container_version()),
        file_bytes: header.length,
        key: header.key,
        content: header.info.content,
        provenance: header.info.provenance,
        streams: reader.streams().iter().enumerate().map(report).collect(),
    })
}

fn stream_report<'a>(stream: &StreamInfo, chunks: impl Iterator<Item = (&'a IndexEntry, &'a Range)>) -> StreamReport {
    let mut totals = ChunkTotals::default();
    let mut all = Range::default();
    for (entry, range) in chunks {
        totals.chunks += 1;
        totals.constant_chunks += u64::from(entry.flags & FLAG_CONSTANT);
        totals.elements += u64::from(entry.elements);
        totals.stored_bytes += u64::from(entry.stored);
        totals.decoded_bytes += u64::from(entry.decoded);
        all.join(*range);
    }
    StreamReport {
        name: stream.name.clone(),
        dtype: stream.dtype,
        shape: stream.shape.clone(),
        unit: stream.unit,
        frame: stream.frame,
        codec: stream.codec,
        fill: stream.fill.clone(),
        totals,
        min: all.bounds.map(|(min, _)| min),
        max: all.bounds.map(|(_, max)| max),
        nan: all.nan,
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct Range {
    bounds: Option<(f64, f64)>,
    nan: u64,
}

impl Range {
    fn add(&mut self, value: f64) {
        if value.is_nan() {
            self.nan += 1;
        } else {
            self.join(Self {
                bounds: Some((value, value)),
                nan: 0,
            });
        }
    }

    fn join(&mut self, other: Self) {
        self.nan += other.nan;
        self.bounds = match (self.bounds, other.bounds) {
            (Some((a, b)), Some((c, d))) => Some((a.min(c), b.max(d))),
            (one, two) => one.or(two),
        };
    }
}

fn range(dtype: Dtype, bytes: &[u8]) -> Range {
    let mut range = Range::default();
    let mut fold = |values: &mut dyn Iterator<Item = f64>| values.for_each(|value| range.add(value));
    let (two, four, eight) = (
        bytes.as_chunks::<2>().0,
        bytes.as_chunks::<4>().0,
        bytes.as_chunks::<8>().0,
    );
    match dtype {
        Dtype::U8 => fold(&mut bytes.iter().map(|&byte| f64::from(byte))),
        Dtype::U16 => fold(&mut two.iter().map(|&b| f64::from(u16::from_le_bytes(b)))),
        Dtype::F16 => fold(&mut two.iter().map(|&b| half(u16::from_le_bytes(b)))),
        Dtype::U32 => fold(&mut four.iter().map(|&b| f64::from(u32::from_le_bytes(b)))),
        Dtype::I32 => fold(&mut four.iter().map(|&b| f64::from(i32::from_le_bytes(b)))),
        Dtype::F32 => fold(&mut four.iter().map(|&b| f64::from(f32::from_le_bytes(b)))),
        Dtype::F64 => fold(&mut eight.iter().map(|&b| f64::from_le_bytes(b))),
    }
    range
}

/// The value of an IEEE half.
fn half(bits: u16) -> f64 {
    let sign = if bits >> 15 == 0 { 1.0 } else { -1.0 };
    let fraction = f64::from(bits & 0x3ff);
    match (bits >> 10) & 0x1f {
        0 => sign * fraction * libm::exp2(-24.0),
        31 if fraction == 0.0 => sign * f64::INFINITY,
        31 => f64::NAN,
        exponent => sign * (1024.0 + fraction) * libm::exp2(f64::from(exponent) - 25.0),
    }
}
