//! Small structured data as bytes: the only module that names bincode.
//!
//! One configuration: little endian, fixed-width integers, a size limit, and every byte consumed. The layout is then the
//! obvious one (integers as they are, `u64` length before strings and lists, `u32` variant index, one byte before an
//! option), so that another implementation can replace the crate without changing a byte.
//!
//! Types that go through here must not contain collections of zero-sized types, `usize`, hash maps, or serde attributes
//! that need a self-describing format (`flatten`, `skip_serializing_if`, untagged enums).

use bincode::config::{Configuration, Fixint, Limit, LittleEndian};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Largest encoding, bytes.
pub const LIMIT: usize = 16 << 20;

const CONFIGURATION: Configuration<LittleEndian, Fixint, Limit<LIMIT>> = bincode::config::standard()
    .with_little_endian()
    .with_fixed_int_encoding()
    .with_limit::<LIMIT>();

/// The bytes of a value.
///
/// # Errors
/// When the encoding is longer than [`LIMIT`].
pub fn encode<T: Serialize>(value: &T) -> Result<Vec<u8>, String> {
    let bytes = bincode::serde::encode_to_vec(value, CONFIGURATION).map_err(|error| error.to_string())?;
    if bytes.len() > LIMIT {
        return Err(format!(
            "structured data of {} bytes is longer than the limit of {LIMIT}",
            bytes.len()
        ));
    }
    Ok(bytes)
}

/// The value of bytes, all of which must belong to it.
///
/// # Errors
/// When the bytes do not encode the type, or when some are left over.
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    if bytes.len() > LIMIT {
        return Err(format!(
            "structured data of {} bytes is longer than the limit of {LIMIT}",
            bytes.len()
        ));
    }
    let (value, consumed) =
        bincode::serde::decode_from_slice(bytes, CONFIGURATION).map_err(|error| format!("not decodable: {error}"))?;
    if consumed != bytes.len() {
        return Err(format!(
            "{} bytes are left over after {consumed}",
            bytes.len() - consumed
        ));
    }
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layout_is_fixed_width_little_endian() {
        let bytes = encode(&(1u16, -2i32, "ab".to_owned(), vec![3u32], Some(true), None::<u8>)).unwrap();
        let expected: &[u8] = &[
            1, 0, 0xfe, 0xff, 0xff, 0xff, 2, 0, 0, 0, 0, 0, 0, 0, b'a', b'b', 1, 0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 1, 1,
            0,
        ];
        assert_eq!(bytes, expected);
    }

    #[test]
    fn left_over_bytes_are_an_error() {
        let mut bytes = encode(&7u32).unwrap();
        assert_eq!(decode::<u32>(&bytes), Ok(7));
        bytes.push(0);
        assert!(decode::<u32>(&bytes).unwrap_err().contains("left over"));
        assert!(decode::<u32>(&bytes[..3]).is_err());
    }

    #[test]
    fn announced_lengths_do_not_allocate() {
        let huge = (1u64 << 40).to_le_bytes();
        assert!(decode::<Vec<f32>>(&huge).is_err());
        assert!(decode::<String>(&huge).is_err());
    }
}
