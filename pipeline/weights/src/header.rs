//! The header of a safetensors file, with its limits.

use std::collections::BTreeMap;

use serde::Deserialize;

/// Headers larger than this are refused before anything is allocated for them (the full network needs about 200 kB).
pub(super) const MAX_HEADER_BYTES: u64 = 16 << 20;
/// Tensors with more axes than this are refused.
const MAX_RANK: usize = 8;

/// How numbers are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ElementType {
    /// 32-bit float.
    F32,
    /// 16-bit float with 8 bits of exponent.
    BF16,
    /// 16-bit float with 5 bits of exponent.
    F16,
}

impl ElementType {
    /// Name in a safetensors header.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "F32",
            Self::BF16 => "BF16",
            Self::F16 => "F16",
        }
    }

    /// Bytes of a number.
    #[must_use]
    pub fn bytes(self) -> usize {
        if self == Self::F32 { 4 } else { 2 }
    }

    /// Widens little-endian bytes to f32.
    #[must_use]
    pub fn widen(self, bytes: &[u8]) -> Vec<f32> {
        let half = |pair: &[u8]| u16::from_le_bytes([pair[0], pair[1]]);
        match self {
            Self::F32 => bytes
                .chunks_exact(4)
                .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                .collect(),
            Self::BF16 => bytes
                .chunks_exact(2)
                .map(|b| f32::from_bits(u32::from(half(b)) << 16))
                .collect(),
            Self::F16 => bytes
                .chunks_exact(2)
                .map(|b| half::f16::from_bits(half(b)).to_f32())
                .collect(),
        }
    }

    /// Narrows f32 values to little-endian bytes, rounding to nearest even.
    #[must_use]
    pub fn narrow(self, values: &[f32]) -> Vec<u8> {
        match self {
            Self::F32 => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            Self::BF16 => values
                .iter()
                .flat_map(|&value| half::bf16::from_f32(value).to_le_bytes())
                .collect(),
            Self::F16 => values
                .iter()
                .flat_map(|&value| half::f16::from_f32(value).to_le_bytes())
                .collect(),
        }
    }
}

/// How the numbers of a tensor in a file of somebody are stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum StoredType {
    /// A type that files are written in.
    Written(ElementType),
    /// 64-bit float.
    F64,
    /// Another, by its name: values cannot be read.
    Other(String),
}

impl StoredType {
    /// The type of a name in a safetensors header.
    fn of(name: &str) -> Self {
        match name {
            "F32" => Self::Written(ElementType::F32),
            "BF16" => Self::Written(ElementType::BF16),
            "F16" => Self::Written(ElementType::F16),
            "F64" => Self::F64,
            other => Self::Other(other.to_owned()),
        }
    }

    /// Bytes of a number, where they are known.
    fn bytes(&self) -> Option<usize> {
        match self {
            Self::Written(element) => Some(element.bytes()),
            Self::F64 => Some(8),
            Self::Other(_) => None,
        }
    }

    /// Makes f32 of little-endian bytes; says why where the numbers are none.
    pub(crate) fn to_f32(&self, bytes: &[u8]) -> Result<Vec<f32>, String> {
        match self {
            Self::Written(element) => Ok(element.widen(bytes)),
            Self::F64 => {
                let (numbers, _) = bytes.as_chunks::<8>();
                Ok(numbers.iter().map(|&bytes| f64::from_le_bytes(bytes) as f32).collect())
            }
            Self::Other(name) => Err(format!(
                "has numbers of type {name}; F64, F32, BF16 and F16 are supported"
            )),
        }
    }
}

/// Where a tensor lies in its file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TensorEntry {
    /// How its numbers are stored.
    pub stored: StoredType,
    /// Shape.
    pub shape: Vec<usize>,
    /// First byte, from the end of the header.
    pub start: usize,
    /// Number of bytes.
    pub bytes: usize,
}

/// A parsed header: tensors by name, and metadata.
pub(super) type Header = (BTreeMap<String, TensorEntry>, BTreeMap<String, String>);

#[derive(Deserialize)]
struct RawEntry {
    dtype: String,
    shape: Vec<u64>,
    data_offsets: [u64; 2],
}

/// Parses the JSON of a header and checks it against the number of bytes that follow.
pub(super) fn parse(json: &[u8], data_bytes: usize) -> Result<Header, String> {
    let raw: BTreeMap<String, serde_json::Value> =
        serde_json::from_slice(json).map_err(|error| format!("its header is not a JSON object: {error}"))?;
    let (mut tensors, mut metadata) = (BTreeMap::new(), BTreeMap::new());
    for (name, value) in raw {
        if name == "__metadata__" {
            metadata = serde_json::from_value(value).map_err(|error| format!("its metadata is not text: {error}"))?;
            continue;
        }
        let raw = RawEntry::deserialize(value)
            .map_err(|error| format!("the header entry of `{name}` is damaged: {error}"))?;
        let entry = entry(&raw, data_bytes).map_err(|reason| format!("the tensor `{name}` {reason}"))?;
        tensors.insert(name, entry);
    }
    refuse_overlap(&tensors)?;
    Ok((tensors, metadata))
}

/// Two tensors that share bytes: the format forbids it, and a change of one would change the other.
fn refuse_overlap(tensors: &BTreeMap<String, TensorEntry>) -> Result<(), String> {
    let mut ranges: Vec<(usize, usize, &str)> = tensors
        .iter()
        .filter(|(_, entry)| entry.bytes > 0)
        .map(|(name, entry)| (entry.start, entry.start + entry.bytes, name.as_str()))
        .collect();
    ranges.sort_unstable();
    match ranges.windows(2).find(|pair| pair[1].0 < pair[0].1) {
        Some(pair) => Err(format!("the tensors `{}` and `{}` overlap", pair[0].2, pair[1].2)),
        None => Ok(()),
    }
}

fn entry(raw: &RawEntry, data_bytes: usize) -> Result<TensorEntry, String> {
    let stored = StoredType::of(&raw.dtype);
    if raw.shape.len() > MAX_RANK {
        return Err(format!("has {} axes", raw.shape.len()));
    }
    let shape: Vec<usize> = raw
        .shape
        .iter()
        .map(|&size| usize::try_from(size).unwrap_or(usize::MAX))
        .collect();
    let count = shape.iter().try_fold(1usize, |count, &size| count.checked_mul(size));
    let known = |size| count.and_then(|count| count.checked_mul(size));
    let [start, end] = raw
        .data_offsets
        .map(|offset| usize::try_from(offset).unwrap_or(usize::MAX));
    let fits = |bytes: usize| match stored.bytes() {
        Some(size) => known(size) == Some(bytes),
        // Counters and the like, which nobody reads: that they lie in the file is enough.
        None => count.is_some(),
    };
    if end > data_bytes || start > end || !fits(end - start) {
        return Err(format!(
            "claims bytes {start} to {end} for shape {shape:?}, which does not fit the file"
        ));
    }
    Ok(TensorEntry {
        stored,
        shape,
        start,
        bytes: end - start,
    })
}
