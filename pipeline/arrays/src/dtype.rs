//! Types of numbers, and their little-endian bytes.

/// Type of an array's numbers. Truth values count as [`U8`](Self::U8).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dtype {
    /// 8-bit unsigned, or truth values.
    U8,
    /// 8-bit signed.
    I8,
    /// 16-bit unsigned.
    U16,
    /// 16-bit signed.
    I16,
    /// IEEE half.
    F16,
    /// 32-bit unsigned.
    U32,
    /// 32-bit signed.
    I32,
    /// IEEE single.
    F32,
    /// 64-bit unsigned.
    U64,
    /// 64-bit signed.
    I64,
    /// IEEE double.
    F64,
}

/// Numbers as most callers want them: bytes stay bytes, for 8-bit images are scaled; all other types become f32
/// (integers up to 2^24 exactly).
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// 8-bit unsigned.
    Bytes(Vec<u8>),
    /// Everything else.
    Floats(Vec<f32>),
}

impl Dtype {
    /// Bytes of one number.
    #[must_use]
    pub const fn size(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 | Self::F16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// The type of numpy's name for it, little-endian ones only.
    pub(crate) fn of_numpy(name: &str) -> Result<Self, String> {
        Ok(match name {
            "|u1" | "|b1" => Self::U8,
            "|i1" => Self::I8,
            "<u2" => Self::U16,
            "<i2" => Self::I16,
            "<f2" => Self::F16,
            "<u4" => Self::U32,
            "<i4" => Self::I32,
            "<f4" => Self::F32,
            "<u8" => Self::U64,
            "<i8" => Self::I64,
            "<f8" => Self::F64,
            other => return Err(format!("values of type `{other}` are not supported; use 32-bit floats")),
        })
    }

    /// Numpy's name for it.
    pub(crate) const fn numpy(self) -> &'static str {
        match self {
            Self::U8 => "|u1",
            Self::I8 => "|i1",
            Self::U16 => "<u2",
            Self::I16 => "<i2",
            Self::F16 => "<f2",
            Self::U32 => "<u4",
            Self::I32 => "<i4",
            Self::F32 => "<f4",
            Self::U64 => "<u8",
            Self::I64 => "<i8",
            Self::F64 => "<f8",
        }
    }

    pub(crate) fn of_safetensors(dtype: safetensors::Dtype) -> Result<Self, String> {
        use safetensors::Dtype as Found;
        Ok(match dtype {
            Found::BOOL | Found::U8 => Self::U8,
            Found::I8 => Self::I8,
            Found::U16 => Self::U16,
            Found::I16 => Self::I16,
            Found::F16 => Self::F16,
            Found::U32 => Self::U32,
            Found::I32 => Self::I32,
            Found::F32 => Self::F32,
            Found::U64 => Self::U64,
            Found::I64 => Self::I64,
            Found::F64 => Self::F64,
            other => return Err(format!("values of type {other:?} are not supported; use 32-bit floats")),
        })
    }

    /// Little-endian numbers as f32; bytes stay bytes. A rest shorter than a number is left out.
    pub(crate) fn values(self, data: &[u8]) -> Values {
        let floats = match self {
            Self::U8 => return Values::Bytes(data.to_vec()),
            Self::I8 => each(data, |[byte]| f32::from(byte as i8)),
            Self::U16 => each(data, |b| f32::from(u16::from_le_bytes(b))),
            Self::I16 => each(data, |b| f32::from(i16::from_le_bytes(b))),
            Self::F16 => each(data, |b| half::f16::from_le_bytes(b).to_f32()),
            Self::U32 => each(data, |b| u32::from_le_bytes(b) as f32),
            Self::I32 => each(data, |b| i32::from_le_bytes(b) as f32),
            Self::F32 => each(data, f32::from_le_bytes),
            Self::U64 => each(data, |b| u64::from_le_bytes(b) as f32),
            Self::I64 => each(data, |b| i64::from_le_bytes(b) as f32),
            Self::F64 => each(data, |b| f64::from_le_bytes(b) as f32),
        };
        Values::Floats(floats)
    }

    /// Little-endian numbers as f64 (integers up to 2^53 exactly). A rest shorter than a number is left out.
    pub(crate) fn doubles(self, data: &[u8]) -> Vec<f64> {
        match self {
            Self::U8 => each(data, |[byte]| f64::from(byte)),
            Self::I8 => each(data, |[byte]| f64::from(byte as i8)),
            Self::U16 => each(data, |b| f64::from(u16::from_le_bytes(b))),
            Self::I16 => each(data, |b| f64::from(i16::from_le_bytes(b))),
            Self::F16 => each(data, |b| half::f16::from_le_bytes(b).to_f64()),
            Self::U32 => each(data, |b| f64::from(u32::from_le_bytes(b))),
            Self::I32 => each(data, |b| f64::from(i32::from_le_bytes(b))),
            Self::F32 => each(data, |b| f64::from(f32::from_le_bytes(b))),
            Self::U64 => each(data, |b| u64::from_le_bytes(b) as f64),
            Self::I64 => each(data, |b| i64::from_le_bytes(b) as f64),
            Self::F64 => each(data, f64::from_le_bytes),
        }
    }
}

fn each<const N: usize, T>(data: &[u8], value: impl Fn([u8; N]) -> T) -> Vec<T> {
    let (parts, _) = data.as_chunks::<N>();
    parts.iter().map(|part| value(*part)).collect()
}

/// A Rust type that arrays are written from.
pub trait Scalar: bytemuck::Pod {
    /// Its type in a file.
    const DTYPE: Dtype;

    /// The number with its lowest byte first in memory.
    #[must_use]
    fn little_endian(self) -> Self;
}

macro_rules! scalars {
    ($($number:ty => $dtype:ident, $little_endian:expr;)*) => {$(
        impl Scalar for $number {
            const DTYPE: Dtype = Dtype::$dtype;

            fn little_endian(self) -> Self {
                $little_endian(self)
            }
        }
    )*};
}

scalars! {
    u8 => U8, u8::to_le;
    u16 => U16, u16::to_le;
    u32 => U32, u32::to_le;
    f32 => F32, |number: f32| f32::from_bits(number.to_bits().to_le());
    f64 => F64, |number: f64| f64::from_bits(number.to_bits().to_le());
}

/// The little-endian bytes of numbers.
#[must_use]
pub fn le_bytes<T: Scalar>(values: &[T]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(size_of_val(values));
    for value in values {
        bytes.extend_from_slice(bytemuck::bytes_of(&value.little_endian()));
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_survive_their_bytes() {
        let bytes = le_bytes(&[1.5_f32, -2.0]);
        assert_eq!(Dtype::F32.values(&bytes), Values::Floats(vec![1.5, -2.0]));
        assert_eq!(Dtype::F32.doubles(&bytes), [1.5, -2.0]);
        assert_eq!(le_bytes(&[0x0102_0304_u32]), [4, 3, 2, 1]);
        assert_eq!(Dtype::I16.doubles(&[1, 0, 255, 255]), [1.0, -1.0]);
        assert_eq!(Dtype::F16.doubles(&half::f16::from_f32(0.25).to_le_bytes()), [0.25]);
        for dtype in [Dtype::U8, Dtype::I8, Dtype::U16, Dtype::I16, Dtype::F16, Dtype::U32] {
            assert_eq!(Dtype::of_numpy(dtype.numpy()), Ok(dtype));
        }
        assert!(Dtype::of_numpy(">f4").unwrap_err().contains("not supported"));
    }
}
