//! The backward pass over the tiles, from back to front (`docs/spec/rasteriser.md` sections 9.1 and 9.2).
//!
//! Batches of sixteen Gaussians: every unit takes its pixel through the batch and leaves weight and `dL/dp` of each pair in
//! shared memory; then four units a Gaussian sum them over the pixels, in fixed order. Every pair has sums of its own, so
//! nothing is added by atomics and the result is the same in every run.

use cubecl::prelude::*;

use super::composite::{ALPHA_CUT, Layout, SHARED, bounds, load};
use super::math::{exp2, falloff_power};
use super::{EXTRA, MOMENTS, PLANES, TILE, UNITS};

/// Gaussians of a batch.
const BATCH: usize = 16;
/// Units per Gaussian in the summing.
const SHARE: usize = UNITS / BATCH;
/// Stride of a Gaussian's row of pixels in shared memory; odd, so that rows start in different banks.
const ROW: usize = UNITS + 1;
/// Sums of one pass.
const SUMS: usize = MOMENTS + EXTRA;

/// Section 9.1, one unit per pixel: gradients with respect to the accumulated channels, `[views, 4 + E, H, W]`, and what is
/// seen behind everything, `[views, H, W]`. `g_image` holds the gradients of red, green, blue, alpha, accumulated and
/// expected depth, `[views, 6, H, W]`; `g_more` those of the accumulated and the normalised extra channels,
/// `[views, 2 E, H, W]`.
#[cube(launch)]
pub fn output_layer(
    image: &[f32],
    more: &[f32],
    g_image: &[f32],
    g_more: &[f32],
    channels_out: &mut [f32],
    behind: &mut [f32],
    count: u32,
    pixels: u32,
    extra_channels: u32,
    background: Background,
) {
    if ABSOLUTE_POS < count as usize {
        let pixels = pixels as usize;
        let channels = extra_channels as usize;
        let view = ABSOLUTE_POS / pixels;
        let pixel = ABSOLUTE_POS % pixels;
        let own = view * PLANES * pixels + pixel;
        let out = view * (4 + channels) * pixels + pixel;
        let alpha = image[own];
        let inverse = 1.0f32 / max(alpha, 1e-10f32);
        let above = select(alpha > 1e-10f32, inverse, 0.0f32.runtime());
        let gradient = view * 6 * pixels + pixel;
        let g_red = g_image[gradient];
        let g_green = g_image[gradient + pixels];
        let g_blue = g_image[gradient + 2 * pixels];
        let mut g_alpha = g_image[gradient + 3 * pixels];
        let g_expected = g_image[gradient + 5 * pixels];
        g_alpha -= above * g_expected * image[own + 4 * pixels] * inverse;
        channels_out[out] = g_red;
        channels_out[out + pixels] = g_green;
        channels_out[out + 2 * pixels] = g_blue;
        channels_out[out + 3 * pixels] = g_image[gradient + 4 * pixels] + g_expected * inverse;
        for k in 0..channels {
            let g = (view * 2 * channels + k) * pixels + pixel;
            let g_normalised = g_more[g + channels * pixels];
            g_alpha -= above * g_normalised * more[(view * channels + k) * pixels + pixel] * inverse;
            channels_out[out + (4 + k) * pixels] = g_more[g] + g_normalised * inverse;
        }
        behind[ABSOLUTE_POS] = g_red * background.red + g_green * background.green + g_blue * background.blue - g_alpha;
    }
}

/// Colour behind everything.
#[derive(CubeLaunch, CubeType, Clone, Copy)]
pub struct Background {
    pub red: f32,
    pub green: f32,
    pub blue: f32,
}

/// Walks a tile from back to front. `sums` is `[pairs, MOMENTS + E]`: `dp (1, l, dy, l l, l dy, dy dy)` with
/// `dp = alpha dL/dalpha`, then the gradients of red, green, blue, z and the extra channels. Later passes
/// (`!first_pass`) carry further extra channels only, and add to the first six.
#[cube(launch)]
pub fn walk(
    records: &[f32],
    extra: &[f32],
    pair_record: &[u32],
    order: &[u32],
    ranges: &[u32],
    image: &[f32],
    ends: &[u32],
    gradients: &[f32],
    behind_all: &[f32],
    sums: &mut [f32],
    layout: Layout,
    #[comptime] first_pass: bool,
    #[comptime] channels: bool,
) {
    let tile = CUBE_POS;
    if tile >= layout.all_tiles as usize {
        terminate!();
    }
    let unit = UNIT_POS as usize;
    let view = tile / layout.tiles as usize;
    let local = tile % layout.tiles as usize;
    let tile_x = (local % layout.columns as usize) * TILE;
    let tile_y = (local / layout.columns as usize) * TILE;
    let x = tile_x + unit % TILE;
    let y = tile_y + unit / TILE;
    let width = layout.width as usize;
    let pixels = width * layout.height as usize;
    let inside = x < width && y < layout.height as usize;
    let px = f32::cast_from(x as u32) + 0.5f32;
    let py = f32::cast_from(y as u32) + 0.5f32;
    let pixel = y * width + x;
    let stride = MOMENTS + layout.extra_channels as usize;

    let mut limits = Shared::<[u32]>::new_slice(2usize);
    let mut batch = Shared::<[f32]>::new_slice(comptime!(BATCH * SHARED));
    let mut weights = Shared::<[f32]>::new_slice(comptime!(BATCH * ROW));
    let mut slopes = Shared::<[f32]>::new_slice(comptime!(BATCH * ROW));
    let mut seen = Shared::<[f32]>::new_slice(comptime!((4 + EXTRA) * UNITS));
    let mut partial = Shared::<[f32]>::new_slice(comptime!(UNITS * SUMS));
    let farthest = Shared::<[Atomic<u32>]>::new_slice(1usize);
    if UNIT_POS == 0u32 {
        farthest[0].store(0u32);
    }
    bounds(ranges, tile, &mut limits);
    let start = workgroup_uniform_load(&limits[0]);
    let end = workgroup_uniform_load(&limits[1]);

    let mut transmittance = 1.0f32;
    let mut behind = 0.0f32;
    let mut last = 0u32;
    let mut v = Array::<f32>::new(comptime!(4 + EXTRA));
    if inside {
        transmittance = image[(view * PLANES + 5) * pixels + pixel];
        last = ends[view * pixels + pixel];
        farthest[0].fetch_max(last);
        let at = view * (4 + layout.extra_channels as usize) * pixels + pixel;
        if comptime!(first_pass) {
            behind = behind_all[view * pixels + pixel];
            #[unroll]
            for k in 0..4usize {
                v[k] = gradients[at + k * pixels];
            }
        }
        if comptime!(channels) {
            #[unroll]
            for k in 0..EXTRA {
                if (k as u32) < layout.channels {
                    v[4 + k] = gradients[at + (4 + layout.first as usize + k) * pixels];
                }
            }
        }
    }
    #[unroll]
    for k in 0..comptime!(4 + EXTRA) {
        seen[k * UNITS + unit] = v[k];
    }
    let reached = workgroup_uniform_load_atomic(&farthest[0]);

    // Nothing behind the last contributor of the tile gets a gradient.
    if comptime!(first_pass) {
        let mut pair = start + reached + UNIT_POS;
        while pair < end {
            let to = order[pair as usize] as usize * stride;
            for k in 0..stride {
                sums[to + k] = 0.0f32;
            }
            pair += comptime!(UNITS as u32);
        }
    }

    let mut remaining = reached;
    while remaining > 0u32 {
        let count = (remaining - 1u32) % comptime!(BATCH as u32) + 1u32;
        let first = remaining - count;
        if UNIT_POS < count {
            let record = pair_record[order[(start + first + UNIT_POS) as usize] as usize];
            load(&mut batch, unit, records, extra, record as usize, &layout, channels);
        }
        sync_cube();
        for back in 0..count {
            let place = count - 1u32 - back;
            let at = place as usize * SHARED;
            let dx = batch[at] - px;
            let dy = batch[at + 1] - py;
            let l = fma(batch[at + 2], dx, batch[at + 3] * dy);
            let unclamped = batch[at + 5] * exp2(falloff_power(l, batch[at + 4], dy));
            let alpha = min(layout.alpha_max, unclamped);
            let mut weight = 0.0f32;
            let mut slope = 0.0f32;
            if alpha >= ALPHA_CUT && first + place < last {
                let through = 1.0f32 - alpha;
                transmittance *= 1.0f32 / through;
                weight = alpha * transmittance;
                let mut colour = 0.0f32;
                if comptime!(first_pass) {
                    colour = v[0] * batch[at + 6];
                    colour = fma(v[1], batch[at + 7], colour);
                    colour = fma(v[2], batch[at + 8], colour);
                    colour = fma(v[3], batch[at + 9], colour);
                }
                if comptime!(channels) {
                    #[unroll]
                    for k in 0..EXTRA {
                        colour = fma(v[4 + k], batch[at + 10 + k], colour);
                    }
                }
                if unclamped <= layout.alpha_max {
                    slope = weight * (colour - behind);
                }
                behind = fma(through, behind, alpha * colour);
            }
            weights[place as usize * ROW + unit] = weight;
            slopes[place as usize * ROW + unit] = slope;
        }
        sync_cube();
        let mut own = Array::<f32>::new(SUMS);
        let place = unit / SHARE;
        if (place as u32) < count {
            let at = place * SHARED;
            for k in 0..comptime!(UNITS / SHARE) {
                let other = k * SHARE + unit % SHARE;
                let weight = weights[place * ROW + other];
                if weight != 0.0f32 {
                    let dp = slopes[place * ROW + other];
                    let dx = batch[at] - (f32::cast_from((tile_x + other % TILE) as u32) + 0.5f32);
                    let dy = batch[at + 1] - (f32::cast_from((tile_y + other / TILE) as u32) + 0.5f32);
                    let l = fma(batch[at + 2], dx, batch[at + 3] * dy);
                    own[0] += dp;
                    own[1] = fma(dp, l, own[1]);
                    own[2] = fma(dp, dy, own[2]);
                    own[3] = fma(dp * l, l, own[3]);
                    own[4] = fma(dp * l, dy, own[4]);
                    own[5] = fma(dp * dy, dy, own[5]);
                    #[unroll]
                    for c in 0..4usize {
                        own[6 + c] = fma(weight, seen[c * UNITS + other], own[6 + c]);
                    }
                    if comptime!(channels) {
                        #[unroll]
                        for c in 0..EXTRA {
                            own[MOMENTS + c] = fma(weight, seen[(4 + c) * UNITS + other], own[MOMENTS + c]);
                        }
                    }
                }
            }
        }
        #[unroll]
        for k in 0..SUMS {
            partial[unit * SUMS + k] = own[k];
        }
        sync_cube();
        let mut index = unit;
        while index < count as usize * SUMS {
            let place = index / SUMS;
            let k = index % SUMS;
            let mut sum = 0.0f32;
            #[unroll]
            for share in 0..SHARE {
                sum += partial[(place * SHARE + share) * SUMS + k];
            }
            let to = order[start as usize + first as usize + place] as usize * stride;
            if k < MOMENTS {
                if comptime!(first_pass) {
                    sums[to + k] = sum;
                } else if k < 6 {
                    sums[to + k] += sum;
                }
            } else if ((k - MOMENTS) as u32) < layout.channels {
                sums[to + MOMENTS + layout.first as usize + (k - MOMENTS)] = sum;
            }
            index += UNITS;
        }
        sync_cube();
        remaining = first;
    }
}
