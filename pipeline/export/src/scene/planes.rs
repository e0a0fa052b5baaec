//! Arrays of integers as bytes: differences from row to row, small numbers for small differences, byte planes, deflate
//! (`docs/spec/scene.md` section 2).

use miniz_oxide::deflate::compress_to_vec_zlib;
use miniz_oxide::deflate::core::{
    CompressionStrategy, CompressorOxide, TDEFLFlush, TDEFLStatus, compress_to_output,
    create_comp_flags_from_zip_params,
};
use miniz_oxide::inflate::decompress_to_vec_zlib_with_limit;

/// Level of deflate.
const LEVEL: u8 = 6;
/// No deflate stream holds more bytes for one of its own than this.
const MOST_EXPANSION: u64 = 1032;

/// Packs rows of `channels` integers, row-major. Returns bytes a channel, and the packed bytes.
pub(super) fn pack(values: &[i32], channels: usize) -> (Vec<u8>, Vec<u8>) {
    let rows = values.len() / channels.max(1);
    let (mut widths, mut planes) = (Vec::with_capacity(channels), Vec::new());
    let mut folded = Vec::with_capacity(rows);
    for channel in 0..channels {
        folded.clear();
        let (mut before, mut largest) = (0i32, 0u32);
        for row in 0..rows {
            let value = values[row * channels + channel];
            let difference = value.wrapping_sub(before);
            before = value;
            let unsigned = ((difference << 1) ^ (difference >> 31)) as u32;
            largest |= unsigned;
            folded.push(unsigned);
        }
        // Never 0: so what an array takes is bounded by its bytes.
        let width = (32 - largest.leading_zeros()).div_ceil(8).max(1);
        widths.push(width as u8);
        for byte in 0..width {
            planes.extend(folded.iter().map(|value| (value >> (8 * byte)) as u8));
        }
    }
    (widths, deflated(&planes))
}

/// A zlib stream of runs and Huffman codes. Planes hold no other repetitions worth a search: with one, scenes of clips are
/// 4 % smaller and take six times as long.
fn deflated(planes: &[u8]) -> Vec<u8> {
    let flags = create_comp_flags_from_zip_params(i32::from(LEVEL), 15, CompressionStrategy::RLE.into());
    let mut out = Vec::with_capacity(planes.len() / 4);
    let (status, _) = compress_to_output(&mut CompressorOxide::new(flags), planes, TDEFLFlush::Finish, |part| {
        out.extend_from_slice(part);
        true
    });
    if status == TDEFLStatus::Done {
        out
    } else {
        compress_to_vec_zlib(planes, LEVEL)
    }
}

/// The integers of [`pack`], row-major.
///
/// # Errors
/// What is wrong, in words: bytes that are not a deflate stream, or not of this many integers.
pub(super) fn unpack(packed: &[u8], rows: usize, widths: &[u8]) -> Result<Vec<i32>, String> {
    if widths.iter().any(|&width| !(1..=4).contains(&width)) {
        return Err("an integer has 1 to 4 bytes".to_owned());
    }
    let planes: usize = widths.iter().map(|&width| usize::from(width)).sum();
    let length = rows.checked_mul(planes).ok_or("too many integers")?;
    let most = (packed.len() as u64).saturating_mul(MOST_EXPANSION);
    if length as u64 > most {
        return Err(format!("{rows} rows cannot lie in {} bytes", packed.len()));
    }
    let bytes = decompress_to_vec_zlib_with_limit(packed, length).map_err(|error| error.to_string())?;
    if bytes.len() != length {
        return Err(format!("{} bytes for {rows} rows, expected {length}", bytes.len()));
    }
    let channels = widths.len();
    let mut values = vec![0; rows * channels];
    let mut plane = 0;
    for (channel, &width) in widths.iter().enumerate() {
        let mut before = 0i32;
        for row in 0..rows {
            let byte = |k: usize| u32::from(bytes[(plane + k) * rows + row]) << (8 * k);
            let unsigned: u32 = (0..usize::from(width)).map(byte).sum();
            let difference = (unsigned >> 1) as i32 ^ -((unsigned & 1) as i32);
            before = before.wrapping_add(difference);
            values[row * channels + channel] = before;
        }
        plane += usize::from(width);
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_of_every_size_come_back() {
        let mixed = [0, 5, -7, i32::MAX, i32::MIN, 0, 1, -1, 300, -70_000, 1 << 24, 12];
        for channels in [1, 2, 3, 4] {
            let (widths, packed) = pack(&mixed, channels);
            assert_eq!(unpack(&packed, mixed.len() / channels, &widths).unwrap(), mixed);
        }
        let (widths, packed) = pack(&[0; 4000], 4);
        assert_eq!((widths.as_slice(), packed.len() < 40), ([1; 4].as_slice(), true));
        assert_eq!(unpack(&packed, 1000, &widths).unwrap(), [0; 4000]);
    }

    #[test]
    fn what_is_not_there_is_not_allocated() {
        let (widths, packed) = pack(&[1, 2, 3], 1);
        for (rows, widths) in [
            (2, &*widths),
            (4, &widths),
            (usize::MAX, &widths),
            (1 << 40, &[1; 3]),
            (3, &[0]),
            (3, &[5]),
        ] {
            assert!(unpack(&packed, rows, widths).is_err(), "{rows} {widths:?}");
        }
        assert!(unpack(&packed[..packed.len() - 3], 3, &widths).is_err());
        assert!(unpack(b"", 3, &widths).is_err());
    }
}
