//! Numbers of HDF5 data sets, and the Rust types that they are read as.

use hdf5_reader::{ByteOrder, Datatype};

use crate::dtype::Dtype;

/// A Rust type that numbers are read as.
///
/// Floats take any number: integers above 2^53 (f64) or 2^24 (f32) and doubles as f32 are rounded. Integers take
/// integers that fit, truth values as 0 and 1; anything else is an error.
pub trait Hdf5Element: Sized + Send + Clone + sealed::Sealed {
    /// What the type is called in messages.
    #[doc(hidden)]
    const NAME: &'static str;

    #[doc(hidden)]
    fn of_integer(value: i128) -> Option<Self>;

    #[doc(hidden)]
    fn of_real(value: f64) -> Option<Self>;
}

mod sealed {
    pub trait Sealed {}
}

macro_rules! floats {
    ($($number:ty),*) => {$(
        impl sealed::Sealed for $number {}

        impl Hdf5Element for $number {
            const NAME: &'static str = "numbers";

            fn of_integer(value: i128) -> Option<Self> {
                Some(value as $number)
            }

            fn of_real(value: f64) -> Option<Self> {
                Some(value as $number)
            }
        }
    )*};
}

macro_rules! integers {
    ($($number:ty, $name:literal;)*) => {$(
        impl sealed::Sealed for $number {}

        impl Hdf5Element for $number {
            const NAME: &'static str = $name;

            fn of_integer(value: i128) -> Option<Self> {
                <$number>::try_from(value).ok()
            }

            fn of_real(_: f64) -> Option<Self> {
                None
            }
        }
    )*};
}

floats! { f32, f64 }
integers! {
    u8, "integers of 0 to 255";
    u16, "integers of 0 to 65535";
    i64, "integers";
}

/// How numbers are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Stored {
    pub(super) dtype: Dtype,
    big_endian: bool,
    /// An enumeration of FALSE and TRUE, as h5py stores truth values.
    pub(super) truth: bool,
}

impl Stored {
    /// The number type of a data type, if it is one.
    pub(super) fn of(datatype: &Datatype) -> Option<Self> {
        let (dtype, order) = match datatype {
            Datatype::Enum { base, members } => {
                let named = |name: &str| members.iter().any(|member| member.name == name);
                let truth = members.len() == 2 && named("FALSE") && named("TRUE");
                return Self::of(base).map(|stored| Self { truth, ..stored });
            }
            Datatype::FloatingPoint { size, byte_order } => match size {
                2 => (Dtype::F16, byte_order),
                4 => (Dtype::F32, byte_order),
                8 => (Dtype::F64, byte_order),
                _ => return None,
            },
            Datatype::FixedPoint {
                size,
                signed,
                byte_order,
            } => match (size, signed) {
                (1, false) => (Dtype::U8, byte_order),
                (1, true) => (Dtype::I8, byte_order),
                (2, false) => (Dtype::U16, byte_order),
                (2, true) => (Dtype::I16, byte_order),
                (4, false) => (Dtype::U32, byte_order),
                (4, true) => (Dtype::I32, byte_order),
                (8, false) => (Dtype::U64, byte_order),
                (8, true) => (Dtype::I64, byte_order),
                _ => return None,
            },
            _ => return None,
        };
        Some(Self {
            dtype,
            big_endian: *order == ByteOrder::BigEndian,
            truth: false,
        })
    }

    /// All numbers in these bytes; a rest shorter than a number is left out.
    pub(super) fn decode<T: Hdf5Element>(self, raw: &[u8]) -> Result<Vec<T>, String> {
        let big = self.big_endian;
        match self.dtype {
            Dtype::U8 => each(raw, big, |b| T::of_integer(u8::from_le_bytes(b).into())),
            Dtype::I8 => each(raw, big, |b| T::of_integer(i8::from_le_bytes(b).into())),
            Dtype::U16 => each(raw, big, |b| T::of_integer(u16::from_le_bytes(b).into())),
            Dtype::I16 => each(raw, big, |b| T::of_integer(i16::from_le_bytes(b).into())),
            Dtype::U32 => each(raw, big, |b| T::of_integer(u32::from_le_bytes(b).into())),
            Dtype::I32 => each(raw, big, |b| T::of_integer(i32::from_le_bytes(b).into())),
            Dtype::U64 => each(raw, big, |b| T::of_integer(u64::from_le_bytes(b).into())),
            Dtype::I64 => each(raw, big, |b| T::of_integer(i64::from_le_bytes(b).into())),
            Dtype::F16 => each(raw, big, |b| T::of_real(half::f16::from_le_bytes(b).into())),
            Dtype::F32 => each(raw, big, |b| T::of_real(f32::from_le_bytes(b).into())),
            Dtype::F64 => each(raw, big, |b| T::of_real(f64::from_le_bytes(b))),
        }
        .ok_or_else(|| format!("its values are {:?}, and not all of them {}", self.dtype, T::NAME))
    }
}

fn each<const N: usize, T>(raw: &[u8], big_endian: bool, value: impl Fn([u8; N]) -> Option<T>) -> Option<Vec<T>> {
    let (parts, _) = raw.as_chunks::<N>();
    let little = |mut part: [u8; N]| {
        if big_endian {
            part.reverse();
        }
        part
    };
    parts.iter().map(|part| value(little(*part))).collect()
}

/// One number in the form that the reader asks for.
#[derive(Debug, Clone)]
pub(super) struct Cell<T>(pub(super) T);

impl<T: Hdf5Element> hdf5_reader::H5Type for Cell<T> {
    fn hdf5_type() -> Datatype {
        // Asked by nobody: every read goes by the type of the file.
        f64::hdf5_type()
    }

    fn from_bytes(bytes: &[u8], datatype: &Datatype) -> hdf5_reader::error::Result<Self> {
        let wrong = || hdf5_reader::error::Error::Other("its values are no numbers".to_owned());
        let stored = Stored::of(datatype).ok_or_else(wrong)?;
        let one = bytes.get(..stored.dtype.size()).ok_or_else(wrong)?;
        let numbers = stored.decode::<T>(one).map_err(hdf5_reader::error::Error::Other)?;
        numbers.into_iter().next().map(Cell).ok_or_else(wrong)
    }

    fn element_size(datatype: &Datatype) -> usize {
        Stored::of(datatype).map_or(0, |stored| stored.dtype.size())
    }

    fn decode_vec(raw: &[u8], datatype: &Datatype, count: usize) -> Option<hdf5_reader::error::Result<Vec<Self>>> {
        let stored = Stored::of(datatype)?;
        let raw = raw.get(..count.checked_mul(stored.dtype.size())?)?;
        let numbers = stored.decode::<T>(raw).map_err(hdf5_reader::error::Error::Other);
        Some(numbers.map(|numbers| numbers.into_iter().map(Cell).collect()))
    }
}
