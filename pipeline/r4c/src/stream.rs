//! What a stream is: element type and shape, unit, frame, codec.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Type of a stream's scalars. The order is part of the format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Dtype {
    /// 8-bit unsigned.
    U8,
    /// 16-bit unsigned.
    U16,
    /// 32-bit unsigned.
    U32,
    /// 32-bit signed.
    I32,
    /// IEEE half.
    F16,
    /// IEEE single.
    F32,
    /// IEEE double.
    F64,
}

impl Dtype {
    /// Bytes of one scalar.
    #[must_use]
    pub fn size(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 | Self::F16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// A Rust type that can be a stream's scalar.
pub trait Element: bytemuck::Pod + Send + Sync + PartialEq {
    /// Its type on disk.
    const DTYPE: Dtype;
}

impl Element for u8 {
    const DTYPE: Dtype = Dtype::U8;
}
impl Element for u16 {
    const DTYPE: Dtype = Dtype::U16;
}
impl Element for u32 {
    const DTYPE: Dtype = Dtype::U32;
}
impl Element for i32 {
    const DTYPE: Dtype = Dtype::I32;
}
impl Element for f32 {
    const DTYPE: Dtype = Dtype::F32;
}
impl Element for f64 {
    const DTYPE: Dtype = Dtype::F64;
}

/// Unit of a stream's values. The order is part of the format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// No unit.
    One,
    /// Metres.
    Metre,
    /// Internal units, 3.5 per metre.
    InternalUnit,
    /// Radians.
    Radian,
    /// Pixels.
    Pixel,
    /// Seconds.
    Second,
}

/// Frame of a stream's coordinates. The order is part of the format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Frame {
    /// Not coordinates.
    None,
    /// The reconstruction frame.
    Recon,
    /// The robot's base frame.
    RobotBase,
    /// The camera's own frame (depth along its axis).
    Camera,
}

/// How chunks of a stream are compressed. A chunk that would not shrink is stored raw.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Codec {
    /// As it is.
    Raw,
    /// One zstd frame.
    Zstd,
    /// Bytes transposed so that equal significance lies together, then one zstd frame.
    ShuffleZstd,
    /// Differences of successive scalars (integers only), then shuffle and zstd.
    DeltaShuffleZstd,
    /// Bytes transposed as for `ShuffleZstd`, then each byte plane by itself: one zstd frame, or as it is where that
    /// would hardly be smaller. A list of stored lengths (u32 a plane) comes first. The low bytes of floats are noise, which
    /// costs nothing this way, and the others get statistics of their own. Needs [`FEATURE_PLANES`](crate::FEATURE_PLANES).
    PlanesZstd,
}

impl Codec {
    /// Its number in the index.
    #[must_use]
    pub fn number(self) -> u16 {
        match self {
            Self::Raw => 0,
            Self::Zstd => 1,
            Self::ShuffleZstd => 2,
            Self::DeltaShuffleZstd => 3,
            Self::PlanesZstd => 4,
        }
    }

    /// The codec of a number in the index.
    #[must_use]
    pub fn from_number(number: u16) -> Option<Self> {
        let all = [
            Self::Raw,
            Self::Zstd,
            Self::ShuffleZstd,
            Self::DeltaShuffleZstd,
            Self::PlanesZstd,
        ];
        all.into_iter().find(|codec| codec.number() == number)
    }
}

/// A stream as code declares it; writer and reader of a record use the same declaration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamSpec {
    /// Name, ASCII, at most 64 bytes.
    pub name: &'static str,
    /// Type of the scalars.
    pub dtype: Dtype,
    /// Unit of the values.
    pub unit: Unit,
    /// Frame of the coordinates.
    pub frame: Frame,
    /// Compression.
    pub codec: Codec,
    /// What a NaN or 0 means here; empty when nothing special.
    pub fill: &'static str,
}

impl StreamSpec {
    /// Numbers as records of Gaussians have them: f32, byte planes compressed by zstd.
    #[must_use]
    pub const fn floats(name: &'static str, unit: Unit, frame: Frame) -> Self {
        Self {
            name,
            dtype: Dtype::F32,
            unit,
            frame,
            codec: Codec::PlanesZstd,
            fill: "",
        }
    }

    /// The stream with this shape of one element (at most 4 dimensions; empty for scalars).
    #[must_use]
    pub fn info(&self, shape: &[u32]) -> StreamInfo {
        // A short last axis holds channels of different meaning: transposing by the whole of it puts each channel's
        // bytes together.
        let channels = shape.last().copied().filter(|&last| last <= 64).unwrap_or(1).max(1);
        let stride = match self.codec {
            Codec::Raw | Codec::Zstd => 1,
            Codec::ShuffleZstd | Codec::PlanesZstd => self.dtype.size() as u32 * channels,
            Codec::DeltaShuffleZstd => self.dtype.size() as u32,
        };
        StreamInfo {
            name: self.name.to_owned(),
            dtype: self.dtype,
            shape: shape.to_vec(),
            unit: self.unit,
            frame: self.frame,
            codec: self.codec,
            stride,
            fill: self.fill.to_owned(),
        }
    }
}

/// A stream as the file describes it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StreamInfo {
    /// Name, ASCII, at most 64 bytes.
    pub name: String,
    /// Type of the scalars.
    pub dtype: Dtype,
    /// Shape of one element, row-major, at most 4 dimensions; empty for scalars.
    pub shape: Vec<u32>,
    /// Unit of the values.
    pub unit: Unit,
    /// Frame of the coordinates.
    pub frame: Frame,
    /// Compression.
    pub codec: Codec,
    /// Bytes of one row of the byte transposition; 1 where the codec has none.
    pub stride: u32,
    /// What a NaN or 0 means here.
    pub fill: String,
}

impl StreamInfo {
    /// Scalars of one element; `None` on overflow.
    #[must_use]
    pub fn scalars(&self) -> Option<u64> {
        self.shape
            .iter()
            .try_fold(1u64, |product, &dim| product.checked_mul(u64::from(dim)))
    }

    /// Bytes of one element; `None` on overflow.
    #[must_use]
    pub fn element_bytes(&self) -> Option<u64> {
        self.scalars()?.checked_mul(self.dtype.size() as u64)
    }

    /// What is wrong with the description, if anything.
    pub(crate) fn problem(&self) -> Option<String> {
        let name = &self.name;
        if name.is_empty() || name.len() > 64 || !name.bytes().all(|byte| byte.is_ascii_graphic()) {
            return Some(format!(
                "stream name {name:?} is not 1 to 64 printable ASCII characters"
            ));
        }
        if self.shape.len() > 4 || self.element_bytes().is_none_or(|bytes| bytes > crate::MAX_CHUNK) {
            return Some(format!("stream `{name}` has element shape {:?}", self.shape));
        }
        let integers = matches!(self.dtype, Dtype::U8 | Dtype::U16 | Dtype::U32 | Dtype::I32);
        if self.codec == Codec::DeltaShuffleZstd && !integers {
            return Some(format!("stream `{name}` takes differences of floating-point values"));
        }
        let size = self.dtype.size() as u32;
        let stride_fits = match self.codec {
            Codec::Raw | Codec::Zstd => self.stride == 1,
            Codec::ShuffleZstd | Codec::PlanesZstd => {
                self.stride > 0 && self.stride.is_multiple_of(size) && self.stride <= 64 * size
            }
            Codec::DeltaShuffleZstd => self.stride == size,
        };
        (!stride_fits).then(|| format!("stream `{name}` has transposition stride {}", self.stride))
    }
}
