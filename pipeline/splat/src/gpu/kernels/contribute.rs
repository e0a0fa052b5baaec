//! The sparse contribution matrix: which pixels every pair touches, their weights, and the sums over them
//! (`docs/spec/rasteriser.md` section 10).

use cubecl::prelude::*;

use super::composite::{ALPHA_CUT, Layout, STOP, bounds};
use super::math::{exp2, falloff_power};
use super::{ENTRY, RECORD, TILE, UNITS, WIDE};

/// Composites a tile again with exactly the arithmetic of the image. Counting (`write` false): `counts` gets the number of
/// pixels that each pair of an eligible Gaussian touches. Writing: pixel and weight of each, in pixel order, from
/// `offsets` on. `eligible` is 0 for Gaussians that are not wanted.
#[cube(launch)]
pub fn touch(
    records: &[f32],
    pair_record: &[u32],
    order: &[u32],
    ranges: &[u32],
    eligible: &[u32],
    counts: &mut [u32],
    offsets: &[u32],
    touched: &mut [u32],
    weights: &mut [f32],
    layout: Layout,
    #[comptime] write: bool,
) {
    let tile = CUBE_POS;
    if tile >= layout.all_tiles as usize {
        terminate!();
    }
    let unit = UNIT_POS as usize;
    let local = tile % layout.tiles as usize;
    let x = (local % layout.columns as usize) * TILE + unit % TILE;
    let y = (local / layout.columns as usize) * TILE + unit / TILE;
    let inside = x < layout.width as usize && y < layout.height as usize;
    let px = f32::cast_from(x as u32) + 0.5f32;
    let py = f32::cast_from(y as u32) + 0.5f32;
    let pixel = y as u32 * layout.width + x as u32;

    let mut limits = Shared::<[u32]>::new_slice(2usize);
    let mut batch = Shared::<[f32]>::new_slice(comptime!(UNITS * 6));
    let mut wanted = Shared::<[u32]>::new_slice(UNITS);
    // Pixels that each Gaussian of the batch touches, as bits.
    let bits = Shared::<[Atomic<u32>]>::new_slice(comptime!(2 * UNITS));
    bounds(ranges, tile, &mut limits);
    let start = workgroup_uniform_load(&limits[0]);
    let end = workgroup_uniform_load(&limits[1]);
    let mut open = select(inside, 1.0f32.runtime(), 0.0f32.runtime());
    let word = unit / 32;
    let bit = 1u32 << (UNIT_POS % 32u32);

    let mut base = start;
    while base < end {
        let count = min(end - base, comptime!(UNITS as u32));
        let mut pair = 0usize;
        if UNIT_POS < count {
            pair = order[(base + UNIT_POS) as usize] as usize;
            let record = pair_record[pair] as usize;
            #[unroll]
            for k in 0..6usize {
                batch[unit * 6 + k] = records[record * RECORD + k];
            }
            wanted[unit] = eligible[record % layout.gaussians as usize];
        }
        bits[2 * unit].store(0u32);
        bits[2 * unit + 1].store(0u32);
        sync_cube();
        let before = open;
        if open > STOP {
            for place in 0..count {
                let weight = step(&batch, place as usize, px, py, layout.alpha_max, &mut open);
                if weight > 0.0f32 && wanted[place as usize] != 0u32 {
                    bits[2 * place as usize + word].fetch_or(bit);
                }
            }
        }
        sync_cube();
        if comptime!(write) {
            // Once more, now that every pixel's rank among those of a pair is known.
            open = before;
            if open > STOP {
                for place in 0..count {
                    let weight = step(&batch, place as usize, px, py, layout.alpha_max, &mut open);
                    if weight > 0.0f32 && wanted[place as usize] != 0u32 {
                        let at = 2 * place as usize;
                        let mut rank = (bits[at + word].load() & (bit - 1u32)).count_ones();
                        if word == 1 {
                            rank += bits[at].load().count_ones();
                        }
                        let to = (offsets[order[(base + place) as usize] as usize] + rank) as usize;
                        touched[to] = pixel;
                        weights[to] = weight;
                    }
                }
            }
        } else if UNIT_POS < count {
            counts[pair] = bits[2 * unit].load().count_ones() + bits[2 * unit + 1].load().count_ones();
        }
        sync_cube();
        base += comptime!(UNITS as u32);
    }
}

/// Takes a pixel past one Gaussian and returns its weight, 0 where it does not touch.
#[cube]
fn step(batch: &Shared<[f32]>, place: usize, px: f32, py: f32, alpha_max: f32, open: &mut f32) -> f32 {
    let at = place * 6;
    let dx = batch[at] - px;
    let dy = batch[at + 1] - py;
    let l = fma(batch[at + 2], dx, batch[at + 3] * dy);
    let alpha = min(alpha_max, batch[at + 5] * exp2(falloff_power(l, batch[at + 4], dy)));
    let mut weight = 0.0f32;
    if alpha >= ALPHA_CUT {
        let behind = fma(-alpha, *open, *open);
        if behind > STOP {
            weight = alpha * *open;
        }
        *open = behind;
    }
    weight
}

/// Mass of every eligible Gaussian: one unit a row, views in order.
#[cube(launch)]
pub fn mass(
    rows: &[u32],
    entries: &[u32],
    first_pair: &[u32],
    offsets: &[u32],
    weights: &[f32],
    out: &mut [f32],
    count: u32,
    gaussians: u32,
    views: u32,
) {
    if ABSOLUTE_POS < count as usize {
        let mut sum = out[ABSOLUTE_POS];
        for view in 0..views {
            let entry = (view * gaussians + rows[ABSOLUTE_POS]) as usize;
            let pairs = entries[entry * ENTRY + 2];
            if pairs > 0u32 {
                let pair = first_pair[entry] as usize;
                let from = offsets[pair];
                let to = offsets[pair + pairs as usize];
                // Entries of one view are summed apart: their number is small, so that rounding stays so too.
                let mut own = 0.0f32;
                for k in from..to {
                    own += weights[k as usize];
                }
                sum += own;
            }
        }
        out[ABSOLUTE_POS] = sum;
    }
}

/// Pooled features of one view for every eligible Gaussian, added to `out`: one cube a row, one unit a channel. `features`
/// is `[pixels, channels]`.
#[cube(launch)]
pub fn pool(
    rows: &[u32],
    entries: &[u32],
    first_pair: &[u32],
    offsets: &[u32],
    touched: &[u32],
    weights: &[f32],
    features: &[f32],
    out: &mut [f32],
    count: u32,
    gaussians: u32,
    view: u32,
    channels: u32,
) {
    if CUBE_POS < count as usize {
        let mut channel = UNIT_POS;
        while channel < channels {
            let at = CUBE_POS * channels as usize + channel as usize;
            let entry = (view * gaussians + rows[CUBE_POS]) as usize;
            let pairs = entries[entry * ENTRY + 2];
            if pairs > 0u32 {
                let pair = first_pair[entry] as usize;
                let from = offsets[pair];
                let to = offsets[pair + pairs as usize];
                let mut sum = out[at];
                for k in from..to {
                    let feature = touched[k as usize] * channels + channel;
                    sum = fma(weights[k as usize], features[feature as usize], sum);
                }
                out[at] = sum;
            }
            channel += comptime!(WIDE as u32);
        }
    }
}
