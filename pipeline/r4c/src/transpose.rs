//! Byte transposition: byte `k` of element `i` lies at `k * n + i`, so that bytes of equal significance lie together.
//!
//! Done in tiles of 16 elements by 16, 8 or 4 bytes. A tile is a list of 16-byte lanes, seen as one list of bytes whose
//! address has the bits `plane : element` on one side of the transposition and `element : plane` on the other.
//! [`rotate`] interleaves the two halves of that list, which rotates the address bits by one; as many rotations as one
//! part has bits trade the two. Interleaving is one instruction a lane on common CPUs.

/// Elements of a tile.
const TILE: usize = 16;
/// Elements whose bytes stay in the first-level cache while the groups of planes pass over them.
const BLOCK: usize = 256;
/// Bytes after which [`unshuffle`] reports, while they are still in a near cache.
const REPORT: usize = 1 << 15;

type Lane = [u8; TILE];

/// Byte transposition to planes. The length is a multiple of the stride.
pub(super) fn shuffle(bytes: &[u8], stride: usize, planes: &mut [u8]) {
    let count = bytes.len() / stride;
    if count == 0 {
        return;
    }
    for (number, block) in bytes.chunks(BLOCK * stride).enumerate() {
        let start = number * BLOCK;
        let mut k = 0;
        for group in widths(stride) {
            let planes = &mut planes[k * count..(k + group) * count];
            match group {
                16 => shuffle_group::<16>(block, stride, k, planes, count, start),
                8 => shuffle_group::<8>(block, stride, k, planes, count, start),
                4 => shuffle_group::<4>(block, stride, k, planes, count, start),
                _ => shuffle_rest(block, stride, k, planes, start),
            }
            k += group;
        }
    }
}

/// The inverse of [`shuffle`], from one slice a plane. `done` sees the bytes of `out` in order, piece by piece.
pub(super) fn unshuffle(planes: &[&[u8]], out: &mut [u8], mut done: impl FnMut(&[u8])) {
    let stride = planes.len();
    if stride == 0 {
        return;
    }
    let blocks_at_once = (REPORT / (BLOCK * stride)).max(1);
    for (number, piece) in out.chunks_mut(blocks_at_once * BLOCK * stride).enumerate() {
        for (inner, block) in piece.chunks_mut(BLOCK * stride).enumerate() {
            let start = (number * blocks_at_once + inner) * BLOCK;
            let mut k = 0;
            for group in widths(stride) {
                let planes = &planes[k..k + group];
                match group {
                    16 => unshuffle_group::<16>(planes, start, block, stride, k),
                    8 => unshuffle_group::<8>(planes, start, block, stride, k),
                    4 => unshuffle_group::<4>(planes, start, block, stride, k),
                    _ => unshuffle_rest(planes[0], start, block, stride, k),
                }
                k += group;
            }
        }
        done(piece);
    }
}

/// A stride as a sum of group widths: sixteens, then at most one eight, one four, and ones.
fn widths(stride: usize) -> impl Iterator<Item = usize> {
    let rest = stride % 16;
    std::iter::repeat_n(16, stride / 16)
        .chain(std::iter::repeat_n(8, rest / 8))
        .chain(std::iter::repeat_n(4, rest % 8 / 4))
        .chain(std::iter::repeat_n(1, rest % 4))
}

/// Bytes `k..k + G` of every element of a block to `G` planes of `count` bytes, at `start`.
fn shuffle_group<const G: usize>(block: &[u8], stride: usize, k: usize, planes: &mut [u8], count: usize, start: usize) {
    let tiles = block.chunks_exact(TILE * stride);
    let rest = tiles.remainder();
    let whole = block.len() / stride / TILE * TILE;
    for (tile, at) in tiles.zip((start..).step_by(TILE)) {
        let mut lanes = [[0; TILE]; G];
        let bytes = lanes.as_flattened_mut();
        for (element, to) in tile.chunks_exact(stride).zip(bytes.chunks_exact_mut(G)) {
            to.copy_from_slice(&element[k..k + G]);
        }
        lanes = rotate(rotate(rotate(rotate(lanes))));
        for (plane, lane) in planes.chunks_exact_mut(count).zip(&lanes) {
            plane[at..at + TILE].copy_from_slice(lane);
        }
    }
    for (element, at) in rest.chunks_exact(stride).zip(start + whole..) {
        for (plane, &byte) in planes.chunks_exact_mut(count).zip(&element[k..k + G]) {
            plane[at] = byte;
        }
    }
}

fn shuffle_rest(block: &[u8], stride: usize, k: usize, plane: &mut [u8], start: usize) {
    for (element, to) in block.chunks_exact(stride).zip(&mut plane[start..]) {
        *to = element[k];
    }
}

/// `G` planes from `start` on to bytes `k..k + G` of every element of a block.
fn unshuffle_group<const G: usize>(planes: &[&[u8]], start: usize, block: &mut [u8], stride: usize, k: usize) {
    let elements = block.len() / stride;
    let mut sources = [&[][..]; G];
    for (source, plane) in sources.iter_mut().zip(planes) {
        *source = &plane[start..start + elements];
    }
    let whole = elements / TILE * TILE;
    let (tiles, rest) = block.split_at_mut(whole * stride);
    for (tile, at) in tiles.chunks_exact_mut(TILE * stride).zip((0..).step_by(TILE)) {
        let mut lanes = [[0; TILE]; G];
        for (lane, source) in lanes.iter_mut().zip(&sources) {
            lane.copy_from_slice(&source[at..at + TILE]);
        }
        for _ in 0..G.ilog2() {
            lanes = rotate(lanes);
        }
        if stride == G {
            tile.copy_from_slice(lanes.as_flattened());
            continue;
        }
        for (element, from) in tile.chunks_exact_mut(stride).zip(lanes.as_flattened().chunks_exact(G)) {
            element[k..k + G].copy_from_slice(from);
        }
    }
    for (element, at) in rest.chunks_exact_mut(stride).zip(whole..) {
        for (byte, source) in element[k..k + G].iter_mut().zip(&sources) {
            *byte = source[at];
        }
    }
}

fn unshuffle_rest(plane: &[u8], start: usize, block: &mut [u8], stride: usize, k: usize) {
    for (element, &byte) in block.chunks_exact_mut(stride).zip(&plane[start..]) {
        element[k] = byte;
    }
}

/// The bytes of all lanes with the two halves interleaved.
#[inline(always)]
fn rotate<const G: usize>(lanes: [Lane; G]) -> [Lane; G] {
    let mut rotated = [[0; TILE]; G];
    for i in 0..G / 2 {
        [rotated[2 * i], rotated[2 * i + 1]] = interleave(lanes[i], lanes[i + G / 2]);
    }
    rotated
}

/// `a0 b0 a1 b1 ...` as two lanes. Written out it takes twice the time of the whole transposition.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
#[allow(unsafe_code, reason = "the instructions are part of every x86-64 processor")]
fn interleave(a: Lane, b: Lane) -> [Lane; 2] {
    use std::arch::x86_64::{__m128i, _mm_unpackhi_epi8, _mm_unpacklo_epi8};
    let (a, b): (__m128i, __m128i) = (bytemuck::cast(a), bytemuck::cast(b));
    // SAFETY: SSE2, which these need, is part of the x86-64 architecture; they touch no memory.
    let (low, high) = unsafe { (_mm_unpacklo_epi8(a, b), _mm_unpackhi_epi8(a, b)) };
    [bytemuck::cast(low), bytemuck::cast(high)]
}

/// `a0 b0 a1 b1 ...` as two lanes.
#[cfg(not(target_arch = "x86_64"))]
#[inline(always)]
fn interleave(a: Lane, b: Lane) -> [Lane; 2] {
    let mixed = |from: usize| std::array::from_fn(|i| if i % 2 == 0 { a[from + i / 2] } else { b[from + i / 2] });
    [mixed(0), mixed(TILE / 2)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transposition_is_what_it_says_and_has_an_inverse() {
        let bytes: Vec<u8> = (0..40_000u32)
            .map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        for stride in [1, 2, 3, 4, 6, 7, 8, 12, 16, 20, 31, 44, 56, 64, 256] {
            for count in [0, 1, 15, 16, 17, 100, 255, 256, 300] {
                let bytes = &bytes[..(count * stride).min(bytes.len() / stride * stride)];
                let count = bytes.len() / stride;
                let mut planes = vec![0; bytes.len()];
                shuffle(bytes, stride, &mut planes);
                for (i, element) in bytes.chunks_exact(stride).enumerate() {
                    for (k, &byte) in element.iter().enumerate() {
                        assert_eq!(planes[k * count + i], byte, "stride {stride}, element {i}, byte {k}");
                    }
                }
                let mut back = vec![0; bytes.len()];
                let mut seen = Vec::new();
                let planes: Vec<&[u8]> = planes.chunks(count.max(1)).collect();
                unshuffle(&planes, &mut back, |piece| seen.extend_from_slice(piece));
                assert_eq!(back, bytes, "stride {stride}, {count} elements");
                assert_eq!(seen, bytes, "stride {stride}, {count} elements, as reported");
            }
        }
    }
}
