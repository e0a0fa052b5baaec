//! Compositing of one tile (`docs/spec/rasteriser.md` section 7).
//!
//! A tile is cut into blocks of 4 x 4 pixels; a block is one vector of sixteen lanes, so that its transmittance and its
//! sums stay in registers while it walks its Gaussians. The tile's list is taken in batches of 64: a batch is laid out
//! component-major, tested exactly against every block (nearest point of the block's rectangle of pixel centres against
//! the level set, sixteen Gaussians at a time), and each block then walks only its own bits.

use pulp::{Simd, WithSimd};

use crate::camera::{ALPHA_CUT, STOP};
use crate::order::TileList;
use crate::project::Projected;
use crate::simd::{LANES, Lanes, bits, exp2, load, prefetch, store};

/// Gaussians of a batch.
pub(crate) const BATCH: usize = 64;
/// Side of a block in pixels.
pub(crate) const BLOCK: usize = 4;
/// Most blocks of a tile.
pub(crate) const MAX_BLOCKS: usize = 16;
/// Extra channels of one pass.
pub(crate) const EXTRA: usize = 4;

/// A batch of Gaussians, component-major.
pub(crate) struct Batch {
    pub(crate) x: [Lanes; BATCH / LANES],
    pub(crate) y: [Lanes; BATCH / LANES],
    pub(crate) la: [Lanes; BATCH / LANES],
    pub(crate) lb: [Lanes; BATCH / LANES],
    pub(crate) lc: [Lanes; BATCH / LANES],
    pub(crate) power_min: [Lanes; BATCH / LANES],
    /// Opacity, red, green, blue, z and the extra channels of each Gaussian.
    pub(crate) values: [[f32; 5 + EXTRA]; BATCH],
    pub(crate) count: usize,
}

impl Batch {
    pub(crate) fn new() -> Self {
        let zero = [Lanes::ZERO; BATCH / LANES];
        Self {
            x: zero,
            y: zero,
            la: zero,
            lb: zero,
            lc: zero,
            power_min: zero,
            values: [[0.0; 5 + EXTRA]; BATCH],
            count: 0,
        }
    }

    /// Lays out the entries `first..` of a tile's list, and asks for those `soon`.
    #[inline(always)]
    pub(crate) fn fill(
        &mut self,
        list: &TileList,
        records: &[Projected],
        first: usize,
        soon: usize,
        extra: &Extra<'_>,
    ) {
        self.count = BATCH.min(list.len() - first);
        for place in soon..(soon + BATCH).min(list.len()) {
            prefetch(&records[list.order[place] as usize]);
        }
        for place in 0..self.count {
            let g = &records[list.order[first + place] as usize];
            let (group, lane) = (place / LANES, place % LANES);
            self.x[group].0[lane] = g.x;
            self.y[group].0[lane] = g.y;
            self.la[group].0[lane] = g.la;
            self.lb[group].0[lane] = g.lb;
            self.lc[group].0[lane] = g.lc;
            self.power_min[group].0[lane] = g.power_min;
            let values = &mut self.values[place];
            *values = [g.opacity, g.rgb[0], g.rgb[1], g.rgb[2], g.z, 0.0, 0.0, 0.0, 0.0];
            extra.copy(g.gaussian as usize, &mut values[5..]);
        }
        // The rest of the last group reaches nothing.
        for place in self.count..self.count.next_multiple_of(LANES) {
            let (group, lane) = (place / LANES, place % LANES);
            self.power_min[group].0[lane] = f32::INFINITY;
        }
    }

    /// For every block of the tile, the Gaussians of the batch that reach it, as bits.
    #[inline(always)]
    pub(crate) fn reach<S: Simd>(&self, simd: S, tile: &TileArea, reach: &mut [u64; MAX_BLOCKS]) {
        *reach = [0; MAX_BLOCKS];
        let side = (BLOCK - 1) as f32;
        let zero = simd.splat_f32s(0.0);
        for group in 0..self.count.div_ceil(LANES) {
            let (gx, gy) = (load::<S>(&self.x[group]), load::<S>(&self.y[group]));
            let (la, lb, lc) = (
                load::<S>(&self.la[group]),
                load::<S>(&self.lb[group]),
                load::<S>(&self.lc[group]),
            );
            let power_min = load::<S>(&self.power_min[group]);
            // Best y on a vertical line and best x on a horizontal line through the mean's origin (see `reaches`).
            let slope_y = simd.div_f32s(simd.mul_f32s(la, lb), simd.negate_mul_add_f32s(lb, lb, lc));
            let slope_x = simd.div_f32s(simd.sub_f32s(zero, lb), la);
            for row in 0..tile.blocks_y {
                let yl = simd.sub_f32s(simd.splat_f32s((tile.y + row * BLOCK) as f32 + 0.5), gy);
                let yh = simd.add_f32s(yl, simd.splat_f32s(side));
                let ey = simd.max_f32s(simd.min_f32s(zero, yh), yl);
                let x_free = simd.mul_f32s(slope_x, ey);
                let lb_ey = simd.mul_f32s(lb, ey);
                let lc_ey = simd.mul_f32s(simd.mul_f32s(lc, ey), ey);
                for column in 0..tile.blocks_x {
                    let xl = simd.sub_f32s(simd.splat_f32s((tile.x + column * BLOCK) as f32 + 0.5), gx);
                    let xh = simd.add_f32s(xl, simd.splat_f32s(side));
                    let ex = simd.max_f32s(simd.min_f32s(zero, xh), xl);
                    let y_best = simd.max_f32s(simd.min_f32s(simd.mul_f32s(slope_y, ex), yh), yl);
                    let x_best = simd.max_f32s(simd.min_f32s(x_free, xh), xl);
                    let l1 = simd.mul_add_f32s(la, ex, simd.mul_f32s(lb, y_best));
                    let p1 = simd.negate_mul_add_f32s(l1, l1, simd.mul_f32s(simd.mul_f32s(lc, y_best), y_best));
                    let l2 = simd.mul_add_f32s(la, x_best, lb_ey);
                    let p2 = simd.negate_mul_add_f32s(l2, l2, lc_ey);
                    let hit = simd.greater_than_or_equal_f32s(simd.max_f32s(p1, p2), power_min);
                    reach[row * tile.blocks_x + column] |= u64::from(bits(simd, hit)) << (group * LANES);
                }
            }
        }
    }
}

/// The extra channels of one pass: up to [`EXTRA`] from `first` on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Extra<'a> {
    pub(crate) values: &'a [f32],
    pub(crate) channels: usize,
    pub(crate) first: usize,
    pub(crate) count: usize,
}

impl Extra<'_> {
    #[inline(always)]
    pub(crate) fn copy(&self, gaussian: usize, to: &mut [f32]) {
        let from = gaussian * self.channels + self.first;
        to[..self.count].copy_from_slice(&self.values[from..from + self.count]);
    }
}

/// Where a tile lies.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TileArea {
    /// First pixel.
    pub(crate) x: usize,
    pub(crate) y: usize,
    /// Blocks that hold pixels of the image.
    pub(crate) blocks_x: usize,
    pub(crate) blocks_y: usize,
    /// Pixels inside the image.
    pub(crate) width: usize,
    pub(crate) height: usize,
}

impl TileArea {
    pub(crate) fn new(tile: usize, columns: usize, size: usize, width: usize, height: usize) -> Self {
        let (x, y) = ((tile % columns) * size, (tile / columns) * size);
        let (w, h) = (size.min(width - x), size.min(height - y));
        Self {
            x,
            y,
            blocks_x: w.div_ceil(BLOCK),
            blocks_y: h.div_ceil(BLOCK),
            width: w,
            height: h,
        }
    }

    pub(crate) fn blocks(&self) -> usize {
        self.blocks_x * self.blocks_y
    }

    /// Pixel centres of a block.
    #[inline(always)]
    pub(crate) fn centres(&self, block: usize) -> (Lanes, Lanes) {
        let x = self.x + (block % self.blocks_x) * BLOCK;
        let y = self.y + (block / self.blocks_x) * BLOCK;
        (
            Lanes(std::array::from_fn(|lane| (x + lane % BLOCK) as f32 + 0.5)),
            Lanes(std::array::from_fn(|lane| (y + lane / BLOCK) as f32 + 0.5)),
        )
    }

    /// 1 for the lanes of a block that are pixels of the image, 0 for those beyond its border.
    pub(crate) fn inside(&self, block: usize) -> Lanes {
        let x = (block % self.blocks_x) * BLOCK;
        let y = (block / self.blocks_x) * BLOCK;
        Lanes(std::array::from_fn(|lane| {
            f32::from(x + lane % BLOCK < self.width && y + lane / BLOCK < self.height)
        }))
    }
}

/// State and sums of one block.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BlockState {
    /// Transmittance behind everything composited so far.
    pub(crate) transmittance: Lanes,
    /// The same, but running on behind the stop: it only falls, so that a pixel stays finished. 0 beyond the border.
    open: Lanes,
    /// Weighted sums: red, green, blue, z, extra channels.
    pub(crate) sums: [Lanes; 4 + EXTRA],
    /// Sum of the weights.
    pub(crate) opacity: Lanes,
    /// Place in the tile's list behind the last contributor, for the backward pass.
    pub(crate) end: [u32; LANES],
    /// Number of contributors.
    pub(crate) contributors: [u32; LANES],
}

/// What a tile's compositing records besides the image.
#[derive(Debug, Default)]
pub(crate) struct Recorded {
    /// Reach bits of every batch that was walked.
    pub(crate) reach: Vec<[u64; MAX_BLOCKS]>,
    /// Contributions of eligible Gaussians, in compositing order per block.
    pub(crate) contributions: Vec<Contribution>,
}

/// One entry of the contribution matrix inside a tile.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Contribution {
    /// Slot in the tile's list.
    pub(crate) slot: u32,
    /// Pixel in the tile: block * 16 + lane.
    pub(crate) pixel: u32,
    pub(crate) weight: f32,
}

/// Composites a tile. `X`: extra channels of this pass; `TRACE`: record what the backward pass needs; `CONTRIBUTE`: record
/// the contributions of eligible Gaussians.
pub(crate) struct Composite<'a, const X: usize, const TRACE: bool, const CONTRIBUTE: bool> {
    pub(crate) list: &'a TileList,
    pub(crate) records: &'a [Projected],
    pub(crate) extra: Extra<'a>,
    pub(crate) area: TileArea,
    pub(crate) alpha_max: f32,
    pub(crate) eligible: &'a (dyn Fn(u32) -> bool + Sync),
    pub(crate) blocks: &'a mut [BlockState; MAX_BLOCKS],
    pub(crate) recorded: &'a mut Recorded,
}

impl<const X: usize, const TRACE: bool, const CONTRIBUTE: bool> WithSimd for Composite<'_, X, TRACE, CONTRIBUTE> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self {
            list,
            records,
            extra,
            area,
            alpha_max,
            eligible,
            blocks,
            recorded,
        } = self;
        let mut unfinished = 0_u32;
        for block in 0..area.blocks() {
            blocks[block] = BlockState::new(area.inside(block));
            unfinished |= 1 << block;
        }
        let mut batch = Batch::new();
        let mut reach = [0_u64; MAX_BLOCKS];
        let mut first = 0;
        while first < list.len() && unfinished != 0 {
            batch.fill(list, records, first, first + BATCH, &extra);
            batch.reach(simd, &area, &mut reach);
            if TRACE {
                recorded.reach.push(reach);
            }
            let mut eligible_bits = 0_u64;
            if CONTRIBUTE {
                for place in 0..batch.count {
                    let gaussian = records[list.order[first + place] as usize].gaussian;
                    eligible_bits |= u64::from(eligible(gaussian)) << place;
                }
            }
            for block in 0..area.blocks() {
                if unfinished >> block & 1 == 0 || reach[block] == 0 {
                    continue;
                }
                let walk = Walk {
                    batch: &batch,
                    reach: reach[block],
                    eligible: eligible_bits,
                    first,
                    block,
                    list,
                };
                let live = walk.run::<S, X, TRACE, CONTRIBUTE>(simd, &area, alpha_max, &mut blocks[block], recorded);
                if !live {
                    unfinished &= !(1 << block);
                }
            }
            first += BATCH;
        }
    }
}

/// One block's way through one batch.
struct Walk<'a> {
    batch: &'a Batch,
    reach: u64,
    eligible: u64,
    first: usize,
    block: usize,
    list: &'a TileList,
}

impl Walk<'_> {
    /// Returns whether any pixel is unfinished.
    #[inline(always)]
    fn run<S: Simd, const X: usize, const TRACE: bool, const CONTRIBUTE: bool>(
        &self,
        simd: S,
        area: &TileArea,
        alpha_max: f32,
        state: &mut BlockState,
        recorded: &mut Recorded,
    ) -> bool {
        let batch = self.batch;
        let (px, py) = area.centres(self.block);
        let (px, py) = (load::<S>(&px), load::<S>(&py));
        let zero = simd.splat_f32s(0.0);
        let cut = simd.splat_f32s(ALPHA_CUT);
        let stop = simd.splat_f32s(STOP);
        let alpha_max = simd.splat_f32s(alpha_max);
        let mut transmittance = load::<S>(&state.transmittance);
        let mut open = load::<S>(&state.open);
        let mut sums: [S::f32s; 4 + EXTRA] = [zero; 4 + EXTRA];
        for k in 0..4 + X {
            sums[k] = load::<S>(&state.sums[k]);
        }
        let mut opacity = load::<S>(&state.opacity);
        let mut end: S::u32s = bytemuck::cast(state.end);
        let mut contributors: S::u32s = bytemuck::cast(state.contributors);

        let mut remaining = self.reach;
        while remaining != 0 {
            let place = remaining.trailing_zeros() as usize;
            remaining &= remaining - 1;
            let (group, lane) = (place / LANES, place % LANES);
            let values = &batch.values[place];
            let dx = simd.sub_f32s(simd.splat_f32s(batch.x[group].0[lane]), px);
            let dy = simd.sub_f32s(simd.splat_f32s(batch.y[group].0[lane]), py);
            let conic = [
                batch.la[group].0[lane],
                batch.lb[group].0[lane],
                batch.lc[group].0[lane],
            ];
            let (power, _) = falloff_power(simd, conic, dx, dy);
            let falloff = exp2(simd, power);
            let alpha = simd.min_f32s(alpha_max, simd.mul_f32s(simd.splat_f32s(values[0]), falloff));
            let touched = simd.greater_than_or_equal_f32s(alpha, cut);
            // Where the Gaussian does not touch, alpha 0 leaves everything as it is. `open` is the only chain from one
            // Gaussian to the next and takes one operation; behind the stop it stays below the stop.
            let alpha = simd.select_f32s(touched, alpha, zero);
            let weight = simd.mul_f32s(alpha, open);
            let behind = simd.negate_mul_add_f32s(alpha, open, open);
            let going = simd.greater_than_f32s(behind, stop);
            let weight = simd.select_f32s(going, weight, zero);
            transmittance = simd.select_f32s(going, behind, transmittance);
            open = behind;
            opacity = simd.add_f32s(opacity, weight);
            for k in 0..4 + X {
                sums[k] = simd.mul_add_f32s(weight, simd.splat_f32s(values[1 + k]), sums[k]);
            }
            if TRACE {
                let added = simd.greater_than_f32s(weight, zero);
                end = simd.select_u32s(added, simd.splat_u32s((self.first + place + 1) as u32), end);
                let more = simd.add_u32s(contributors, simd.splat_u32s(1));
                contributors = simd.select_u32s(added, more, contributors);
            }
            if CONTRIBUTE && self.eligible >> place & 1 != 0 {
                let added = bits(simd, simd.greater_than_f32s(weight, zero));
                self.record(added, store::<S>(weight), place, recorded);
            }
        }

        state.transmittance = store::<S>(transmittance);
        state.open = store::<S>(open);
        for k in 0..4 + X {
            state.sums[k] = store::<S>(sums[k]);
        }
        state.opacity = store::<S>(opacity);
        state.end = bytemuck::cast(end);
        state.contributors = bytemuck::cast(contributors);
        bits(simd, simd.greater_than_f32s(open, stop)) != 0
    }

    #[inline(always)]
    fn record(&self, mut added: u32, weight: Lanes, place: usize, recorded: &mut Recorded) {
        let slot = self.list.slot(self.first + place) as u32;
        while added != 0 {
            let lane = added.trailing_zeros();
            added &= added - 1;
            let pixel = (self.block * LANES) as u32 + lane;
            recorded.contributions.push(Contribution {
                slot,
                pixel,
                weight: weight.0[lane as usize],
            });
        }
    }
}

/// log2 of the falloff of a Gaussian at an offset, and `la dx + lb dy`.
#[inline(always)]
pub(crate) fn falloff_power<S: Simd>(simd: S, conic: [f32; 3], dx: S::f32s, dy: S::f32s) -> (S::f32s, S::f32s) {
    let [la, lb, lc] = conic.map(|q| simd.splat_f32s(q));
    let l = simd.mul_add_f32s(la, dx, simd.mul_f32s(lb, dy));
    (
        simd.negate_mul_add_f32s(l, l, simd.mul_f32s(simd.mul_f32s(lc, dy), dy)),
        l,
    )
}

impl BlockState {
    pub(crate) fn new(inside: Lanes) -> Self {
        Self {
            transmittance: Lanes([1.0; LANES]),
            open: inside,
            sums: [Lanes::ZERO; 4 + EXTRA],
            opacity: Lanes::ZERO,
            end: [0; LANES],
            contributors: [0; LANES],
        }
    }
}
