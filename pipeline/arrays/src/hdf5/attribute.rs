//! Values of HDF5 attributes, and texts.

use hdf5_reader::messages::attribute::AttributeMessage;
use hdf5_reader::messages::dataspace::DataspaceType;
use hdf5_reader::{Datatype, StringPadding, StringSize, VarLenKind};

use super::element::Stored;

/// Value of an attribute.
#[derive(Debug, Clone, PartialEq)]
pub enum Hdf5Value {
    /// A truth value (h5py's `True`, `False`).
    Truth(bool),
    /// An integer.
    Integer(i64),
    /// A number with a fraction, or an integer beyond 64 bits with a sign.
    Real(f64),
    /// A text.
    Text(String),
    /// Several numbers, row-major.
    Numbers(Vec<f64>),
    /// Several texts.
    Texts(Vec<String>),
    /// Nothing: an attribute without elements.
    Empty,
    /// Of a type that is not read (records, references).
    Other,
}

impl Hdf5Value {
    /// The truth value; integers 0 and 1 count, as older writers store them.
    #[must_use]
    pub fn truth(&self) -> Option<bool> {
        match self {
            Self::Truth(truth) => Some(*truth),
            Self::Integer(0) => Some(false),
            Self::Integer(1) => Some(true),
            _ => None,
        }
    }

    /// The number, whole or not.
    #[must_use]
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Integer(integer) => Some(*integer as f64),
            Self::Real(real) => Some(*real),
            _ => None,
        }
    }

    /// The text.
    #[must_use]
    pub fn text(&self) -> Option<&str> {
        match self {
            Self::Text(text) => Some(text),
            _ => None,
        }
    }
}

/// How a text type is stored.
pub(super) enum TextType {
    /// Texts of this many bytes, padded.
    Fixed(usize, StringPadding),
    /// References to texts in the heap.
    Variable(StringPadding),
}

impl TextType {
    pub(super) fn of(datatype: &Datatype) -> Option<Self> {
        match datatype {
            Datatype::String { size, padding, .. } => Some(match size {
                StringSize::Fixed(length) => Self::Fixed(*length as usize, *padding),
                StringSize::Variable => Self::Variable(*padding),
            }),
            Datatype::VarLen {
                base,
                kind: VarLenKind::String,
                padding,
                ..
            } if base.is_vlen_string_base() => Some(Self::Variable(*padding)),
            _ => None,
        }
    }
}

/// A text from its bytes, without its padding. Bytes that are not UTF-8 are replaced.
pub(super) fn text(bytes: &[u8], padding: StringPadding) -> String {
    let bytes = match padding {
        StringPadding::NullTerminate => bytes.split(|&byte| byte == 0).next().unwrap_or_default(),
        StringPadding::NullPad => bytes.trim_suffix_of(0),
        StringPadding::SpacePad => bytes.trim_suffix_of(b' '),
    };
    String::from_utf8_lossy(bytes).into_owned()
}

trait TrimSuffix {
    fn trim_suffix_of(&self, byte: u8) -> &[u8];
}

impl TrimSuffix for [u8] {
    fn trim_suffix_of(&self, byte: u8) -> &[u8] {
        let length = self.iter().rposition(|&found| found != byte).map_or(0, |last| last + 1);
        &self[..length]
    }
}

/// The value of an attribute; `resolve` finds the bytes of a reference to the heap, of `reference` bytes.
pub(super) fn value(
    message: &AttributeMessage,
    reference: usize,
    mut resolve: impl FnMut(&[u8]) -> Result<Vec<u8>, String>,
) -> Result<Hdf5Value, String> {
    let scalar = message.dataspace.dataspace_type == DataspaceType::Scalar;
    let dims = &message.dataspace.dims;
    let count = match message.dataspace.dataspace_type {
        DataspaceType::Null => 0,
        _ => dims
            .iter()
            .try_fold(1_usize, |product, &dim| product.checked_mul(usize::try_from(dim).ok()?))
            .ok_or("its shape is impossible")?,
    };
    if count == 0 {
        return Ok(Hdf5Value::Empty);
    }
    let raw = |size: usize| {
        let length = count.checked_mul(size).filter(|length| *length > 0);
        length
            .and_then(|length| message.raw_data.get(..length))
            .ok_or("it is shorter than its shape")
    };
    if let Some(stored) = Stored::of(&message.datatype) {
        let raw = raw(stored.dtype.size())?;
        if !scalar {
            return Ok(Hdf5Value::Numbers(stored.decode(raw)?));
        }
        return Ok(match stored.decode::<i64>(raw) {
            Ok(integers) if stored.truth => Hdf5Value::Truth(integers.first() == Some(&1)),
            Ok(integers) => Hdf5Value::Integer(integers.first().copied().unwrap_or_default()),
            Err(_) => Hdf5Value::Real(stored.decode::<f64>(raw)?.first().copied().unwrap_or(f64::NAN)),
        });
    }
    let texts = match TextType::of(&message.datatype) {
        None => return Ok(Hdf5Value::Other),
        Some(TextType::Fixed(length, padding)) => raw(length)?
            .chunks(length.max(1))
            .map(|bytes| text(bytes, padding))
            .collect(),
        Some(TextType::Variable(padding)) => {
            let mut texts = Vec::new();
            for at in raw(reference)?.chunks(reference.max(1)) {
                texts.push(text(&resolve(at)?, padding));
            }
            texts
        }
    };
    Ok(match <[String; 1]>::try_from(texts) {
        Ok([text]) if scalar => Hdf5Value::Text(text),
        Ok(one) => Hdf5Value::Texts(one.into()),
        Err(texts) => Hdf5Value::Texts(texts),
    })
}
