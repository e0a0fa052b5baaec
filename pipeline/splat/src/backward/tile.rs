//! `docs/spec/rasteriser.md` section 9.2 for one tile, from back to front.

use pulp::{Simd, WithSimd};

use super::{MOMENTS, PixelGradient};
use crate::camera::ALPHA_CUT;
use crate::project::Projected;
use crate::render::TileOutput;
use crate::simd::{LANES, Lanes, exp2, horizontal_sums, load, prefetch, store};
use crate::tile::{BATCH, EXTRA, Extra, MAX_BLOCKS, falloff_power};

/// The slots of a tile that the walk touches, and a row for each.
pub(super) struct Touched {
    /// Row of every slot that is touched. `[slots]`
    row: Vec<u32>,
    /// Records of the rows, ascending.
    pub(super) records: Vec<u32>,
    /// First row of every chunk and the end. `[chunks + 1]`
    pub(super) chunks: Vec<u32>,
}

impl Touched {
    /// Rows in the order of the slots, so that a chunk later finds its own side by side.
    pub(super) fn new(tile: &TileOutput) -> Self {
        let last = last_contributors(tile);
        let end = last.iter().copied().max().unwrap_or(0) as usize;
        let mut row = vec![0; tile.list.len()];
        let mut count = 0;
        for (number, reach) in tile.recorded.reach.iter().enumerate().take(end.div_ceil(BATCH)) {
            let first = number * BATCH;
            let mut any = 0;
            for (reach, &last) in reach.iter().zip(&last[..tile.area.blocks()]) {
                any |= reach & ahead(last, first);
            }
            count += any.count_ones() as usize;
            while any != 0 {
                row[tile.list.slot(first + any.trailing_zeros() as usize)] = 1;
                any &= any - 1;
            }
        }
        let mut records = Vec::with_capacity(count);
        let mut chunks = Vec::with_capacity(tile.list.segments.len());
        let mut next = 0;
        for &end in &tile.list.segments {
            for slot in next..end as usize {
                if row[slot] != 0 {
                    row[slot] = records.len() as u32;
                    records.push(tile.list.records[slot]);
                }
            }
            chunks.push(records.len() as u32);
            next = end as usize;
        }
        Self { row, records, chunks }
    }
}

/// Place behind the last contributor of any pixel of each block.
fn last_contributors(tile: &TileOutput) -> [u32; MAX_BLOCKS] {
    let mut last = [0; MAX_BLOCKS];
    for (last, ends) in last.iter_mut().zip(tile.end.chunks_exact(LANES)) {
        *last = ends.iter().copied().max().unwrap_or(0);
    }
    last
}

/// The places of a batch that lie before `last`, as bits.
#[inline(always)]
fn ahead(last: u32, first: usize) -> u64 {
    let ahead = (last as usize).saturating_sub(first);
    if ahead >= BATCH { u64::MAX } else { (1 << ahead) - 1 }
}

/// Sums the moments of every touched slot of a tile. `X`: extra channels of this pass.
pub(super) struct Walk<'a, const X: usize> {
    pub(super) tile: &'a TileOutput,
    pub(super) touched: &'a Touched,
    pub(super) records: &'a [Projected],
    pub(super) extra: Extra<'a>,
    pub(super) alpha_max: f32,
    pub(super) pixels: &'a PixelGradient,
    /// `[touched, MOMENTS + E]`; all of it is written.
    pub(super) rows: &'a mut [f32],
}

/// State of a block on the way to the front, and its gradient image.
#[derive(Clone, Copy)]
struct Block {
    x: Lanes,
    y: Lanes,
    transmittance: Lanes,
    behind: Lanes,
    gradient: [Lanes; 4 + EXTRA],
    end: [u32; LANES],
}

impl<const X: usize> WithSimd for Walk<'_, X> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self {
            tile,
            touched,
            records,
            extra,
            alpha_max,
            pixels,
            rows,
        } = self;
        let area = &tile.area;
        let mut blocks = [Block::new(); MAX_BLOCKS];
        let first_pass = extra.first == 0;
        for block in 0..area.blocks() {
            blocks[block].load(tile, pixels, block, &extra, first_pass);
        }
        let last = last_contributors(tile);
        let end = last.iter().copied().max().unwrap_or(0) as usize;
        let stride = MOMENTS + extra.channels;
        let batches = end.div_ceil(BATCH);
        let mut soon = Reached::NOTHING;
        if batches > 0 {
            soon = Reached::of(tile, records, &last, batches - 1);
        }
        for number in (0..batches).rev() {
            let first = number * BATCH;
            let mut now = soon;
            soon = Reached::NOTHING;
            if number > 0 {
                soon = Reached::of(tile, records, &last, number - 1);
            }
            while now.any != 0 {
                let place = now.any.ilog2() as usize;
                now.any ^= 1 << place;
                let at = now.blocks(place);
                let here = first + place;
                let record = &records[tile.list.order[here] as usize];
                let mut values = [0.0; EXTRA];
                extra.copy(record.gaussian as usize, &mut values);
                let sums = one::<S, X>(simd, record, &values, here, alpha_max, at, &mut blocks);
                let row = touched.row[tile.list.slot(here)] as usize * stride;
                let to = &mut rows[row..row + stride];
                if first_pass {
                    to[..MOMENTS].copy_from_slice(&sums.0[..MOMENTS]);
                } else {
                    for k in 0..6 {
                        to[k] += sums.0[k];
                    }
                }
                for k in 0..extra.count {
                    to[MOMENTS + extra.first + k] = sums.0[MOMENTS + k];
                }
            }
        }
    }
}

/// Which blocks the Gaussians of a batch reach before their last contributor.
struct Reached {
    /// Row `i` of blocks 0 to 7 and of blocks 8 to 15: its byte `k` has a bit for every block that place `8 k + i` reaches.
    rows: [[u64; 8]; 2],
    /// Places that reach any block, as bits.
    any: u64,
}

impl Reached {
    const NOTHING: Self = Self {
        rows: [[0; 8]; 2],
        any: 0,
    };

    /// Those of a batch; asks for the records that will be read.
    #[inline(always)]
    fn of(tile: &TileOutput, records: &[Projected], last: &[u32; MAX_BLOCKS], number: usize) -> Self {
        let first = number * BATCH;
        let mut reached = Self::NOTHING;
        for block in 0..MAX_BLOCKS {
            let bits = tile.recorded.reach[number][block] & ahead(last[block], first);
            reached.rows[block / 8][block % 8] = bits;
            reached.any |= bits;
        }
        for rows in &mut reached.rows {
            transpose_bits(rows);
        }
        let mut remaining = reached.any;
        while remaining != 0 {
            let place = first + remaining.trailing_zeros() as usize;
            remaining &= remaining - 1;
            prefetch(&records[tile.list.order[place] as usize]);
        }
        reached
    }

    #[inline(always)]
    fn blocks(&self, place: usize) -> u32 {
        let byte = |half: usize| (self.rows[half][place % 8] >> (place / 8 * 8)) as u8;
        u32::from(byte(0)) | u32::from(byte(1)) << 8
    }
}

/// Transposes the 8x8 bits of every byte column: bit `b` of byte `k` of row `i` goes to bit `i` of byte `k` of row `b`.
#[inline(always)]
fn transpose_bits(rows: &mut [u64; 8]) {
    for (step, mask) in [
        (4, 0x0f0f_0f0f_0f0f_0f0f),
        (2, 0x3333_3333_3333_3333),
        (1, 0x5555_5555_5555_5555),
    ] {
        for i in 0..8 {
            if i & step == 0 {
                let swap = (rows[i] >> step ^ rows[i + step]) & mask;
                rows[i + step] ^= swap;
                rows[i] ^= swap << step;
            }
        }
    }
}

/// One Gaussian over the blocks in `at`: its moments, then its extra channels, one a lane.
#[inline(always)]
fn one<S: Simd, const X: usize>(
    simd: S,
    record: &Projected,
    extra: &[f32; EXTRA],
    place: usize,
    alpha_max: f32,
    mut at: u32,
    blocks: &mut [Block; MAX_BLOCKS],
) -> Lanes {
    let zero = simd.splat_f32s(0.0);
    let unit = simd.splat_f32s(1.0);
    let cut = simd.splat_f32s(ALPHA_CUT);
    let alpha_max = simd.splat_f32s(alpha_max);
    let (gx, gy) = (simd.splat_f32s(record.x), simd.splat_f32s(record.y));
    let conic = [record.la, record.lb, record.lc];
    let [red, green, blue] = record.rgb;
    let [e0, e1, e2, e3] = *extra;
    let values = [red, green, blue, record.z, e0, e1, e2, e3];
    let opacity = simd.splat_f32s(record.opacity);
    let here = simd.splat_u32s(place as u32);
    let mut sums = [zero; LANES];
    while at != 0 {
        let block = &mut blocks[at.trailing_zeros() as usize];
        at &= at - 1;
        let dx = simd.sub_f32s(gx, load::<S>(&block.x));
        let dy = simd.sub_f32s(gy, load::<S>(&block.y));
        let (power, l) = falloff_power(simd, conic, dx, dy);
        let unclamped = simd.mul_f32s(opacity, exp2(simd, power));
        let alpha = simd.min_f32s(alpha_max, unclamped);
        let touched = simd.greater_than_or_equal_f32s(alpha, cut);
        let before_end = simd.greater_than_u32s(bytemuck::cast(block.end), here);
        let alpha = simd.select_f32s(simd.and_m32s(touched, before_end), alpha, zero);
        let through = simd.sub_f32s(unit, alpha);
        let transmittance = simd.mul_f32s(load::<S>(&block.transmittance), simd.div_f32s(unit, through));
        block.transmittance = store::<S>(transmittance);
        let weight = simd.mul_f32s(alpha, transmittance);
        let mut seen = simd.mul_f32s(load::<S>(&block.gradient[0]), simd.splat_f32s(values[0]));
        for k in 1..4 + X {
            seen = simd.mul_add_f32s(load::<S>(&block.gradient[k]), simd.splat_f32s(values[k]), seen);
        }
        let behind = load::<S>(&block.behind);
        let difference = simd.sub_f32s(seen, behind);
        block.behind = store::<S>(simd.mul_add_f32s(through, behind, simd.mul_f32s(alpha, seen)));
        let free = simd.less_than_or_equal_f32s(unclamped, alpha_max);
        let dp = simd.select_f32s(free, simd.mul_f32s(weight, difference), zero);
        let (dpl, dpy) = (simd.mul_f32s(dp, l), simd.mul_f32s(dp, dy));
        sums[0] = simd.add_f32s(sums[0], dp);
        sums[1] = simd.add_f32s(sums[1], dpl);
        sums[2] = simd.add_f32s(sums[2], dpy);
        sums[3] = simd.mul_add_f32s(dpl, l, sums[3]);
        sums[4] = simd.mul_add_f32s(dpl, dy, sums[4]);
        sums[5] = simd.mul_add_f32s(dpy, dy, sums[5]);
        for k in 0..4 + X {
            sums[6 + k] = simd.mul_add_f32s(weight, load::<S>(&block.gradient[k]), sums[6 + k]);
        }
    }
    horizontal_sums(simd, &sums)
}

impl Block {
    fn new() -> Self {
        Self {
            x: Lanes::ZERO,
            y: Lanes::ZERO,
            transmittance: Lanes::ZERO,
            behind: Lanes::ZERO,
            gradient: [Lanes::ZERO; 4 + EXTRA],
            end: [0; LANES],
        }
    }

    /// Later passes carry further extra channels only: colour, depth and background are counted in the first.
    fn load(&mut self, tile: &TileOutput, pixels: &PixelGradient, block: usize, extra: &Extra<'_>, first_pass: bool) {
        let range = block * LANES..(block + 1) * LANES;
        let stride = tile.area.blocks() * LANES;
        let lanes = |values: &[f32]| Lanes(std::array::from_fn(|lane| values[range.start + lane]));
        (self.x, self.y) = tile.area.centres(block);
        self.transmittance = lanes(&tile.transmittance);
        if first_pass {
            self.behind = lanes(&pixels.behind);
            for k in 0..4 {
                self.gradient[k] = lanes(&pixels.channels[k * stride..]);
            }
        }
        for k in 0..extra.count {
            self.gradient[4 + k] = lanes(&pixels.channels[(4 + extra.first + k) * stride..]);
        }
        self.end.copy_from_slice(&tile.end[range]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_transposed() {
        let mut state = 5_u64;
        let rows: [u64; 8] = std::array::from_fn(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            state
        });
        let mut turned = rows;
        transpose_bits(&mut turned);
        for place in 0..64 {
            for row in 0..8 {
                assert_eq!(turned[place % 8] >> (place / 8 * 8 + row) & 1, rows[row] >> place & 1);
            }
        }
    }
}
