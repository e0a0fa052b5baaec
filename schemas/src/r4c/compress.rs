//! Compressing and decompressing one chunk.

use std::borrow::Cow;

use zstd::bulk::{Compressor, Decompressor};

use super::stream::{Codec, Dtype};

/// Level of every frame. Level 6 costs much time for nothing (`performance.md` section 7).
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

/// Buffers and zstd contexts of one thread, used again from chunk to chunk.
#[derive(Default)]
pub(crate) struct Scratch {
    planes: Vec<u8>,
    deltas: Vec<u8>,
    compressor: Option<Compressor<'static>>,
    decompressor: Option<Decompressor<'static>>,
}

impl Scratch {
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
                shuffle(bytes, stride, &mut self.planes);
                &self.planes
            }
            Codec::DeltaShuffleZstd => {
                self.deltas.clear();
                self.deltas.extend_from_slice(bytes);
                delta(&mut self.deltas, dtype.size());
                shuffle(&self.deltas, stride, &mut self.planes);
                &self.planes
            }
        };
        let stored = if codec == Codec::PlanesZstd {
            compress_planes(compressor, input, stride)?
        } else {
            compressor.compress(input)?
        };
        Ok((stored.len() < bytes.len()).then_some(stored))
    }

    /// Decompresses a chunk into `out`, whose length is the decoded length.
    pub(crate) fn decompress(
        &mut self,
        codec: Codec,
        dtype: Dtype,
        stride: usize,
        stored: &[u8],
        out: &mut [u8],
    ) -> Result<(), String> {
        if codec == Codec::Raw {
            if stored.len() != out.len() {
                return Err(format!("{} stored bytes for {} decoded ones", stored.len(), out.len()));
            }
            out.copy_from_slice(stored);
            return Ok(());
        }
        let decompressor = match &mut self.decompressor {
            Some(decompressor) => decompressor,
            none => none.insert(Decompressor::new().map_err(|error| error.to_string())?),
        };
        if codec == Codec::PlanesZstd {
            return decompress_planes(decompressor, &mut self.planes, stride, stored, out);
        }
        check_frame(stored, out.len())?;
        if codec == Codec::Zstd {
            return decompress_exactly(decompressor, stored, out);
        }
        self.planes.clear();
        self.planes
            .try_reserve_exact(out.len())
            .map_err(|error| error.to_string())?;
        self.planes.resize(out.len(), 0);
        decompress_exactly(decompressor, stored, &mut self.planes)?;
        let planes: Vec<&[u8]> = self.planes.chunks_exact((out.len() / stride).max(1)).collect();
        unshuffle(&planes, out);
        if codec == Codec::DeltaShuffleZstd {
            undelta(out, dtype.size());
        }
        Ok(())
    }
}

/// Lengths of the stored planes, then the planes.
fn compress_planes(compressor: &mut Compressor<'_>, planes: &[u8], stride: usize) -> std::io::Result<Vec<u8>> {
    let count = planes.len() / stride;
    let mut stored = vec![0; 4 * stride];
    stored.reserve(planes.len());
    for (number, plane) in planes.chunks_exact(count.max(1)).enumerate() {
        let frame = compressor.compress(plane)?;
        let smaller = if frame.len() < plane.len() { &frame } else { plane };
        // A chunk has at most 2^28 bytes.
        stored[4 * number..4 * number + 4].copy_from_slice(&(smaller.len() as u32).to_le_bytes());
        stored.extend_from_slice(smaller);
    }
    Ok(stored)
}

/// The inverse of [`compress_planes`] and the transposition. Planes stored as they are are not copied in between.
fn decompress_planes(
    decompressor: &mut Decompressor<'_>,
    scratch: &mut Vec<u8>,
    stride: usize,
    stored: &[u8],
    out: &mut [u8],
) -> Result<(), String> {
    let count = out.len() / stride;
    if count == 0 || !out.len().is_multiple_of(stride) {
        return Err(format!("{} bytes are no planes of stride {stride}", out.len()));
    }
    let (lengths, mut rest) = stored
        .split_at_checked(4 * stride)
        .ok_or_else(|| "the lengths of the planes are cut off".to_owned())?;
    scratch.clear();
    scratch
        .try_reserve_exact(out.len())
        .map_err(|error| error.to_string())?;
    scratch.resize(out.len(), 0);
    let mut planes: Vec<&[u8]> = Vec::with_capacity(stride);
    for (length, target) in lengths.as_chunks::<4>().0.iter().zip(scratch.chunks_exact_mut(count)) {
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
    unshuffle(&planes, out);
    Ok(())
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

/// Elements handled at once by the transposition: a block stays in the first-level cache.
const BLOCK: usize = 256;

/// Byte transposition: byte `k` of element `i` goes to `k * n + i`. The length is a multiple of the stride.
fn shuffle(bytes: &[u8], stride: usize, planes: &mut Vec<u8>) {
    planes.clear();
    planes.resize(bytes.len(), 0);
    let count = bytes.len() / stride;
    for start in (0..count).step_by(BLOCK) {
        let elements = BLOCK.min(count - start);
        let block = &bytes[start * stride..(start + elements) * stride];
        let mut k = 0;
        // Four bytes of four elements at once, as whole words.
        while k + 4 <= stride {
            let mut rest = &mut planes[k * count..(k + 4) * count];
            let lanes = [0; 4].map(|_| {
                let (plane, after) = std::mem::take(&mut rest).split_at_mut(count);
                rest = after;
                &mut plane[start..start + elements]
            });
            shuffle_four(block, stride, k, lanes);
            k += 4;
        }
        for k in k..stride {
            let plane = &mut planes[k * count + start..][..elements];
            for (out, element) in plane.iter_mut().zip(block.chunks_exact(stride)) {
                *out = element[k];
            }
        }
    }
}

/// Bytes `k..k + 4` of every element of a block to four planes.
fn shuffle_four(block: &[u8], stride: usize, k: usize, [a, b, c, d]: [&mut [u8]; 4]) {
    let word = |element: &[u8]| u32::from_le_bytes([element[k], element[k + 1], element[k + 2], element[k + 3]]);
    let fours = a.as_chunks_mut::<4>().0.iter_mut().zip(b.as_chunks_mut::<4>().0);
    let fours = fours.zip(c.as_chunks_mut::<4>().0).zip(d.as_chunks_mut::<4>().0);
    for ((((a, b), c), d), elements) in fours.zip(block.chunks_exact(4 * stride)) {
        let (one, rest) = elements.split_at(stride);
        let (two, rest) = rest.split_at(stride);
        let (three, four) = rest.split_at(stride);
        let planes = transpose([word(one), word(two), word(three), word(four)]);
        [*a, *b, *c, *d] = planes.map(u32::to_le_bytes);
    }
    let done = a.len() / 4 * 4;
    for (index, element) in block.chunks_exact(stride).enumerate().skip(done) {
        (a[index], b[index], c[index], d[index]) = (element[k], element[k + 1], element[k + 2], element[k + 3]);
    }
}

/// The 4x4 bytes of four words with rows and columns traded.
fn transpose([a, b, c, d]: [u32; 4]) -> [u32; 4] {
    const EVEN: u32 = 0x00ff_00ff;
    let pairs = |x: u32, y: u32| ((x & EVEN) | ((y & EVEN) << 8), ((x >> 8) & EVEN) | (y & !EVEN));
    let ((ab_even, ab_odd), (cd_even, cd_odd)) = (pairs(a, b), pairs(c, d));
    let low = |x: u32, y: u32| (x & 0xffff) | (y << 16);
    let high = |x: u32, y: u32| (x >> 16) | (y & 0xffff_0000);
    [
        low(ab_even, cd_even),
        low(ab_odd, cd_odd),
        high(ab_even, cd_even),
        high(ab_odd, cd_odd),
    ]
}

/// The inverse of [`shuffle`], from one slice a plane.
fn unshuffle(planes: &[&[u8]], out: &mut [u8]) {
    let stride = planes.len();
    if stride == 0 {
        return;
    }
    for (number, block) in out.chunks_mut(BLOCK * stride).enumerate() {
        let start = number * BLOCK;
        let elements = block.len() / stride;
        let (fours, ones) = planes.as_chunks::<4>();
        for (group, four) in fours.iter().enumerate() {
            unshuffle_four(
                four.map(|plane| &plane[start..start + elements]),
                block,
                stride,
                4 * group,
            );
        }
        for (k, plane) in (4 * fours.len()..).zip(ones) {
            for (element, &byte) in block.chunks_exact_mut(stride).zip(&plane[start..]) {
                element[k] = byte;
            }
        }
    }
}

/// Four planes to bytes `k..k + 4` of every element of a block.
fn unshuffle_four([a, b, c, d]: [&[u8]; 4], block: &mut [u8], stride: usize, k: usize) {
    let fours = a.as_chunks::<4>().0.iter().zip(b.as_chunks::<4>().0);
    let fours = fours.zip(c.as_chunks::<4>().0).zip(d.as_chunks::<4>().0);
    for ((((a, b), c), d), elements) in fours.zip(block.chunks_exact_mut(4 * stride)) {
        let words = transpose([*a, *b, *c, *d].map(u32::from_le_bytes));
        for (element, word) in elements.chunks_exact_mut(stride).zip(words) {
            element[k..k + 4].copy_from_slice(&word.to_le_bytes());
        }
    }
    let done = a.len() / 4 * 4;
    for (index, element) in block.chunks_exact_mut(stride).enumerate().skip(done) {
        element[k..k + 4].copy_from_slice(&[a[index], b[index], c[index], d[index]]);
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
    fn transposition_and_differences_have_inverses() {
        let bytes: Vec<u8> = (0..3001u32)
            .map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        for stride in [1, 2, 3, 4, 8, 12, 44] {
            let bytes = &bytes[..bytes.len() / stride * stride];
            let mut planes = Vec::new();
            shuffle(bytes, stride, &mut planes);
            let mut back = vec![0; bytes.len()];
            unshuffle(&planes.chunks(bytes.len() / stride).collect::<Vec<_>>(), &mut back);
            assert_eq!(back, bytes, "stride {stride}");
        }
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
