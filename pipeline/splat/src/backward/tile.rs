//! Section 9.2 for one tile, from back to front.

use pulp::{Simd, WithSimd};

use super::{MOMENTS, PixelGradient};
use crate::camera::ALPHA_CUT;
use crate::project::Projected;
use crate::render::TileOutput;
use crate::simd::{LANES, Lanes, exp2, load, store};
use crate::tile::{BATCH, Batch, EXTRA, Extra, MAX_BLOCKS, falloff_power};

/// Sums the moments of every slot of a tile. `X`: extra channels of this pass.
pub(super) struct Walk<'a, const X: usize> {
    pub(super) tile: &'a TileOutput,
    pub(super) records: &'a [Projected],
    pub(super) extra: Extra<'a>,
    pub(super) alpha_max: f32,
    pub(super) pixels: &'a PixelGradient,
    pub(super) slots: &'a mut Slots,
}

/// Moments and extra channels of the slots that were touched.
#[derive(Debug, Default)]
pub(super) struct Slots {
    /// Row of every slot plus one, 0 for slots without.
    pub(super) index: Vec<u32>,
    /// `[rows, MOMENTS + E]`
    pub(super) rows: Vec<f32>,
}

impl Slots {
    /// The values of a slot, zeros where it is new.
    #[inline(always)]
    fn row(&mut self, slot: usize, stride: usize) -> &mut [f32] {
        if self.index[slot] == 0 {
            self.rows.resize(self.rows.len() + stride, 0.0);
            self.index[slot] = (self.rows.len() / stride) as u32;
        }
        let row = self.index[slot] as usize - 1;
        &mut self.rows[row * stride..(row + 1) * stride]
    }
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
    last: u32,
}

impl<const X: usize> WithSimd for Walk<'_, X> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self {
            tile,
            records,
            extra,
            alpha_max,
            pixels,
            slots,
        } = self;
        let area = &tile.area;
        let mut blocks = [Block::new(); MAX_BLOCKS];
        let first_pass = extra.first == 0;
        for block in 0..area.blocks() {
            blocks[block].load(tile, pixels, block, &extra, first_pass);
        }
        let end = blocks[..area.blocks()].iter().map(|b| b.last).max().unwrap_or(0) as usize;
        let stride = MOMENTS + extra.channels;
        let mut batch = Batch::new();
        for number in (0..end.div_ceil(BATCH)).rev() {
            let first = number * BATCH;
            batch.fill(&tile.list, records, first, first.saturating_sub(BATCH), &extra);
            let at = blocks_of(&tile.recorded.reach[number], &blocks[..area.blocks()], first);
            for place in (0..batch.count.min(end - first)).rev() {
                let at = u32::from(at[place]);
                if at == 0 {
                    continue;
                }
                let sums = one::<S, X>(simd, &batch, place, first, alpha_max, at, &mut blocks);
                let slot = tile.list.slot(first + place);
                let to = slots.row(slot, stride);
                if first_pass {
                    for k in 0..MOMENTS {
                        to[k] = simd.reduce_sum_f32s(sums[k]);
                    }
                } else {
                    for k in 0..6 {
                        to[k] += simd.reduce_sum_f32s(sums[k]);
                    }
                }
                for k in 0..extra.count {
                    to[MOMENTS + extra.first + k] = simd.reduce_sum_f32s(sums[MOMENTS + k]);
                }
            }
        }
    }
}

/// For every Gaussian of a batch, the blocks that it reaches before their last contributor, as bits.
#[inline(always)]
fn blocks_of(reach: &[u64; MAX_BLOCKS], blocks: &[Block], first: usize) -> [u16; BATCH] {
    let mut at = [0_u16; BATCH];
    for (number, block) in blocks.iter().enumerate() {
        let ahead = (block.last as usize).saturating_sub(first);
        let mut remaining = if ahead >= BATCH {
            reach[number]
        } else {
            reach[number] & ((1 << ahead) - 1)
        };
        while remaining != 0 {
            at[remaining.trailing_zeros() as usize] |= 1 << number;
            remaining &= remaining - 1;
        }
    }
    at
}

/// One Gaussian over the blocks in `at`.
#[inline(always)]
fn one<S: Simd, const X: usize>(
    simd: S,
    batch: &Batch,
    place: usize,
    first: usize,
    alpha_max: f32,
    mut at: u32,
    blocks: &mut [Block; MAX_BLOCKS],
) -> [S::f32s; MOMENTS + EXTRA] {
    let (group, lane) = (place / LANES, place % LANES);
    let zero = simd.splat_f32s(0.0);
    let unit = simd.splat_f32s(1.0);
    let cut = simd.splat_f32s(ALPHA_CUT);
    let alpha_max = simd.splat_f32s(alpha_max);
    let (gx, gy) = (
        simd.splat_f32s(batch.x[group].0[lane]),
        simd.splat_f32s(batch.y[group].0[lane]),
    );
    let conic = [
        batch.la[group].0[lane],
        batch.lb[group].0[lane],
        batch.lc[group].0[lane],
    ];
    let values = &batch.values[place];
    let opacity = simd.splat_f32s(values[0]);
    let here = simd.splat_u32s((first + place) as u32);
    let mut sums = [zero; MOMENTS + EXTRA];
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
        let mut seen = simd.mul_f32s(load::<S>(&block.gradient[0]), simd.splat_f32s(values[1]));
        for k in 1..4 + X {
            seen = simd.mul_add_f32s(load::<S>(&block.gradient[k]), simd.splat_f32s(values[1 + k]), seen);
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
    sums
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
            last: 0,
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
        self.last = self.end.iter().copied().max().unwrap_or(0);
    }
}
