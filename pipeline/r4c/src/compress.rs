//! Compressing and decompressing one chunk.

use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::TryReserveError;

use zstd::bulk::{Compressor, Decompressor};

use crate::stream::{Codec, Dtype};
use crate::transpose;

/// Level of every frame. On Gaussians level 6 compressed 2.6 times as slowly, to a file no smaller.
const LEVEL: i32 = 3;

/// Bytes with NaN payloads and signs removed, so that equal fields give equal files. -0.0 stays.
pub(crate) fn canonical(dtype: Dtype, bytes: &[u8]) -> Cow<'_, [u8]> {
    match dtype {
        Dtype::F32 => canonical_words(bytes, u32::from_le_bytes, 0x7fc0_0000, |bits| {
            bits & 0x7fff_ffff > 0x7f80_0000
        }),
        Dtype::F64 => canonical_words(bytes, u64::from_le_bytes, 0x7ff8 << 48, |bits| {
            bits & (u64::MAX >> 1) > 0x7ff0 << 48
        }),
        Dtype::F16 => canonical_words(bytes, u16::from_le_bytes, 0x7e00, |bits| bits & 0x7fff > 0x7c00),
        Dtype::U8 | Dtype::U16 | Dtype::U32 | Dtype::I32 => Cow::Borrowed(bytes),
    }
}

fn canonical_words<const N: usize, W: Copy + PartialEq + ToBytes<N>>(
    bytes: &[u8],
    read: fn([u8; N]) -> W,
    nan: W,
    is_nan: fn(W) -> bool,
) -> Cow<'_, [u8]> {
    let (words, _) = bytes.as_chunks::<N>();
    let strange = |word: &[u8; N]| is_nan(read(*word)) & (read(*word) != nan);
    // Blocks, so that the scan needs no branch per value.
    if !words
        .chunks(1024)
        .any(|block| block.iter().fold(false, |any, word| any | strange(word)))
    {
        return Cow::Borrowed(bytes);
    }
    let mut owned = bytes.to_vec();
    for word in owned.as_chunks_mut::<N>().0 {
        if strange(word) {
            *word = nan.to_bytes();
        }
    }
    Cow::Owned(owned)
}

/// Little-endian bytes of an integer.
trait ToBytes<const N: usize> {
    fn to_bytes(self) -> [u8; N];
}
impl ToBytes<2> for u16 {
    fn to_bytes(self) -> [u8; 2] {
        self.to_le_bytes()
    }
}
impl ToBytes<4> for u32 {
    fn to_bytes(self) -> [u8; 4] {
        self.to_le_bytes()
    }
}
impl ToBytes<8> for u64 {
    fn to_bytes(self) -> [u8; 8] {
        self.to_le_bytes()
    }
}

/// True when the bytes are copies of their first `size` bytes.
pub(crate) fn is_constant(bytes: &[u8], size: usize) -> bool {
    bytes.len() > size && bytes[size..] == bytes[..bytes.len() - size]
}

/// Buffers and zstd contexts of one thread, used again from chunk to chunk: fresh memory and fresh contexts cost as much
/// as the decompression itself.
#[derive(Default)]
pub(crate) struct Scratch {
    stored: Buffer,
    planes: Buffer,
    deltas: Vec<u8>,
    compressor: Option<Compressor<'static>>,
    decompressor: Option<Decompressor<'static>>,
}

/// Memory that grows when it must and is not cleared between uses.
#[derive(Default)]
pub(crate) struct Buffer(Vec<u8>);

impl Buffer {
    /// That many bytes of whatever was there before; an error instead of an abort when there is no memory.
    pub(crate) fn take(&mut self, length: usize) -> std::result::Result<&mut [u8], TryReserveError> {
        if self.0.len() < length {
            // Nothing is worth copying to a larger place.
            self.0.clear();
            self.0.try_reserve_exact(length)?;
            self.0.resize(length, 0);
        }
        Ok(&mut self.0[..length])
    }
}

/// Largest buffer that a thread keeps from one chunk to the next.
const KEPT: usize = 16 << 20;

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Runs `work` with the buffers of this thread.
pub(crate) fn with_scratch<R>(work: impl FnOnce(&mut Scratch) -> R) -> R {
    // Taken out, so that work inside of work finds other ones instead of a locked cell.
    let mut scratch = SCRATCH.take();
    let result = work(&mut scratch);
    let Scratch {
        stored, planes, deltas, ..
    } = &mut scratch;
    for buffer in [&mut stored.0, &mut planes.0, deltas] {
        if buffer.capacity() > KEPT {
            *buffer = Vec::new();
        }
    }
    SCRATCH.set(scratch);
    result
}

impl Scratch {
    /// The memory for stored bytes, to be given back with [`Scratch::give_back`].
    pub(crate) fn stored(&mut self) -> Buffer {
        std::mem::take(&mut self.stored)
    }

    /// Keeps what [`Scratch::stored`] handed out.
    pub(crate) fn give_back(&mut self, stored: Buffer) {
        self.stored = stored;
    }

    /// The compressed form of a chunk's bytes, or `None` when it would not be smaller.
    pub(crate) fn compress(
        &mut self,
        codec: Codec,
        dtype: Dtype,
        stride: usize,
        bytes: &[u8],
    ) -> std::io::Result<Option<Vec<u8>>> {
        let compressor = match &mut self.compressor {
            Some(compressor) => compressor,
            none => none.insert(new_compressor()?),
        };
        let input = match codec {
            Codec::Raw => return Ok(None),
            Codec::Zstd => bytes,
            Codec::ShuffleZstd | Codec::PlanesZstd => {
                let planes = self.planes.take(bytes.len())?;
                transpose::shuffle(bytes, stride, planes);
                planes
            }
            Codec::DeltaShuffleZstd => {
                self.deltas.clear();
                self.deltas.extend_from_slice(bytes);
                delta(&mut self.deltas, dtype.size());
                let planes = self.planes.take(bytes.len())?;
                transpose::shuffle(&self.deltas, stride, planes);
                planes
            }
        };
        let stored = if codec == Codec::PlanesZstd {
            compress_planes(compressor, &mut self.stored, input, stride)?
        } else {
            compressor.compress(input)?
        };
        Ok((stored.len() < bytes.len()).then_some(stored))
    }

    /// Decompresses a chunk into `out`, whose length is the decoded length, and returns the CRC-32C of `out`.
    pub(crate) fn decompress(
        &mut self,
        codec: Codec,
        dtype: Dtype,
        stride: usize,
        stored: &[u8],
        out: &mut [u8],
    ) -> Result<u32, String> {
        if codec == Codec::Raw {
            if stored.len() != out.len() {
                return Err(format!("{} stored bytes for {} decoded ones", stored.len(), out.len()));
            }
            out.copy_from_slice(stored);
            return Ok(crc32c::crc32c(out));
        }
        let decompressor = match &mut self.decompressor {
            Some(decompressor) => decompressor,
            none => none.insert(Decompressor::new().map_err(|error| error.to_string())?),
        };
        if codec == Codec::PlanesZstd {
            return decompress_planes(decompressor, &mut self.planes, stride, stored, out);
        }
        check_frame(stored, out.len())?;
        if !out.len().is_multiple_of(stride) {
            return Err(format!("{} bytes are not planes of stride {stride}", out.len()));
        }
        if codec == Codec::Zstd {
            decompress_exactly(decompressor, stored, out)?;
            return Ok(crc32c::crc32c(out));
        }
        let planes = self.planes.take(out.len()).map_err(|error| error.to_string())?;
        decompress_exactly(decompressor, stored, planes)?;
        let planes: Vec<&[u8]> = planes.chunks_exact((out.len() / stride).max(1)).collect();
        let crc = unshuffle(&planes, out);
        if codec == Codec::DeltaShuffleZstd {
            undelta(out, dtype.size());
            return Ok(crc32c::crc32c(out));
        }
        Ok(crc)
    }
}

/// The inverse of the transposition, and the CRC-32C of the bytes, taken while they are in the cache.
fn unshuffle(planes: &[&[u8]], out: &mut [u8]) -> u32 {
    let mut crc = 0;
    transpose::unshuffle(planes, out, |piece| crc = crc32c::crc32c_append(crc, piece));
    crc
}

/// A plane that shrinks by less than this part of itself is stored as it is: reading it costs more than it saves.
const LEAST_GAIN: usize = 16;

/// Lengths of the stored planes, then the planes. `buffer` is memory to work in.
fn compress_planes(
    compressor: &mut Compressor<'_>,
    buffer: &mut Buffer,
    planes: &[u8],
    stride: usize,
) -> std::io::Result<Vec<u8>> {
    let count = planes.len() / stride;
    // A plane that hardly shrinks is copied over what its frame left behind.
    let room = zstd::zstd_safe::compress_bound(count);
    let all = buffer.take(4 * stride + planes.len() + room)?;
    let mut end = 4 * stride;
    for (number, plane) in planes.chunks_exact(count.max(1)).enumerate() {
        let mut length = compressor.compress_to_buffer(plane, &mut all[end..end + room])?;
        if length + plane.len() / LEAST_GAIN > plane.len() {
            length = plane.len();
            all[end..end + length].copy_from_slice(plane);
        }
        // A chunk has at most 2^28 bytes.
        all[4 * number..4 * number + 4].copy_from_slice(&(length as u32).to_le_bytes());
        end += length;
    }
    Ok(all[..end].to_vec())
}

/// The inverse of [`compress_planes`] and the transposition, with the CRC-32C. Planes stored as they are are not copied
/// in between.
fn decompress_planes(
    decompressor: &mut Decompressor<'_>,
    buffer: &mut Buffer,
    stride: usize,
    stored: &[u8],
    out: &mut [u8],
) -> Result<u32, String> {
    let count = out.len() / stride;
    if count == 0 || !out.len().is_multiple_of(stride) {
        return Err(format!("{} bytes are not planes of stride {stride}", out.len()));
    }
    let (lengths, mut rest) = stored
        .split_at_checked(4 * stride)
        .ok_or_else(|| "the lengths of the planes are cut off".to_owned())?;
    let buffer = buffer.take(out.len()).map_err(|error| error.to_string())?;
    let mut planes: Vec<&[u8]> = Vec::with_capacity(stride);
    for (length, target) in lengths.as_chunks::<4>().0.iter().zip(buffer.chunks_exact_mut(count)) {
        let length = u32::from_le_bytes(*length) as usize;
        let (plane, after) = rest
            .split_at_checked(length)
            .ok_or_else(|| "a plane is cut off".to_owned())?;
        rest = after;
        if length == count {
            planes.push(plane);
            continue;
        }
        check_frame(plane, count)?;
        decompress_exactly(decompressor, plane, target)?;
        planes.push(target);
    }
    if !rest.is_empty() {
        return Err(format!("{} bytes are left over behind the planes", rest.len()));
    }
    Ok(unshuffle(&planes, out))
}

fn new_compressor() -> std::io::Result<Compressor<'static>> {
    let mut compressor = Compressor::new(LEVEL)?;
    compressor.include_checksum(false)?;
    compressor.include_contentsize(true)?;
    compressor.include_dictid(false)?;
    Ok(compressor)
}

/// One zstd frame of some bytes, as the schema and index blocks have it.
pub(crate) fn compress_block(bytes: &[u8]) -> std::io::Result<Vec<u8>> {
    new_compressor()?.compress(bytes)
}

/// The bytes of a schema or index block of known decoded length.
pub(crate) fn decompress_block(stored: &[u8], decoded: usize) -> Result<Vec<u8>, String> {
    check_frame(stored, decoded)?;
    let mut out = Vec::new();
    out.try_reserve_exact(decoded).map_err(|error| error.to_string())?;
    out.resize(decoded, 0);
    let mut decompressor = Decompressor::new().map_err(|error| error.to_string())?;
    decompress_exactly(&mut decompressor, stored, &mut out)?;
    Ok(out)
}

fn decompress_exactly(decompressor: &mut Decompressor<'_>, stored: &[u8], out: &mut [u8]) -> Result<(), String> {
    let length = decompressor
        .decompress_to_buffer(stored, out)
        .map_err(|error| format!("zstd: {error}"))?;
    if length == out.len() {
        Ok(())
    } else {
        Err(format!("decompressed to {length} bytes instead of {}", out.len()))
    }
}

/// Demands exactly one frame that announces the expected size.
fn check_frame(stored: &[u8], decoded: usize) -> Result<(), String> {
    match zstd::zstd_safe::get_frame_content_size(stored) {
        Ok(Some(size)) if size == decoded as u64 => {}
        Ok(size) => return Err(format!("the zstd frame announces {size:?} bytes instead of {decoded}")),
        Err(_) => return Err("not a zstd frame".into()),
    }
    match zstd::zstd_safe::find_frame_compressed_size(stored) {
        Ok(length) if length == stored.len() => Ok(()),
        Ok(length) => Err(format!("the zstd frame ends after {length} of {} bytes", stored.len())),
        Err(_) => Err("the zstd frame is not whole".into()),
    }
}

/// Replaces each integer by its difference to the one before (the first by its difference to 0), wrapping.
fn delta(bytes: &mut [u8], size: usize) {
    let mut before = 0u32;
    for word in bytes.chunks_exact_mut(size) {
        let value = load(word);
        store(word, value.wrapping_sub(before));
        before = value;
    }
}

/// The inverse of [`delta`].
fn undelta(bytes: &mut [u8], size: usize) {
    let mut value = 0u32;
    for word in bytes.chunks_exact_mut(size) {
        value = value.wrapping_add(load(word));
        store(word, value);
    }
}

fn load(word: &[u8]) -> u32 {
    word.iter().rev().fold(0, |value, &byte| (value << 8) | u32::from(byte))
}

fn store(word: &mut [u8], value: u32) {
    for (byte, source) in word.iter_mut().zip(value.to_le_bytes()) {
        *byte = source;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_have_an_inverse() {
        let bytes: Vec<u8> = (0..3000u32)
            .map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        for size in [1, 2, 4] {
            let mut changed = bytes.clone();
            delta(&mut changed, size);
            undelta(&mut changed, size);
            assert_eq!(changed, bytes, "size {size}");
        }
    }

    #[test]
    fn nan_becomes_canonical_and_negative_zero_stays() {
        let values = [
            f32::from_bits(0xffc0_1234),
            -0.0,
            f32::INFINITY,
            f32::from_bits(0x7f80_0001),
            1.5,
        ];
        let bytes = canonical(Dtype::F32, bytemuck::cast_slice(&values)).into_owned();
        let words: Vec<u32> = bytes
            .chunks_exact(4)
            .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        assert_eq!(words, [0x7fc0_0000, 0x8000_0000, 0x7f80_0000, 0x7fc0_0000, 0x3fc0_0000]);
        assert!(matches!(
            canonical(Dtype::F32, bytemuck::cast_slice(&[f32::NAN, 1.0])),
            Cow::Borrowed(_)
        ));
    }

    #[test]
    fn a_bomb_and_a_second_frame_are_refused() {
        let bomb = compress_block(&vec![0; 1 << 20]).unwrap();
        assert!(decompress_block(&bomb, 100).unwrap_err().contains("announces"));
        let mut two = compress_block(&[1, 2, 3]).unwrap();
        two.extend(compress_block(&[]).unwrap());
        assert!(decompress_block(&two, 3).unwrap_err().contains("ends after"));
    }
}
