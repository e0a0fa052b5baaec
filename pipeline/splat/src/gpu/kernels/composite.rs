//! Compositing: one cube per tile, one unit per pixel, Gaussians in batches through shared memory
//! (`docs/spec/rasteriser.md` section 7).

use cubecl::prelude::*;

use super::math::{exp2, falloff_power};
use super::{EXTRA, PLANES, RECORD, TILE, UNITS};

pub(crate) const ALPHA_CUT: f32 = 1.0 / 255.0;
pub(crate) const STOP: f32 = 1e-4;
/// Words of a Gaussian in shared memory: record without power_min, then the extra channels of the pass.
pub(crate) const SHARED: usize = 10 + EXTRA;

/// Where a tile lies, in scalars of the launch.
#[derive(CubeLaunch, CubeType, Clone, Copy)]
pub struct Layout {
    pub columns: u32,
    pub tiles: u32,
    /// Tiles of all views.
    pub all_tiles: u32,
    pub width: u32,
    pub height: u32,
    pub gaussians: u32,
    pub extra_channels: u32,
    /// First extra channel of this pass.
    pub first: u32,
    /// Number of extra channels of this pass.
    pub channels: u32,
    pub alpha_max: f32,
}

/// Copies one Gaussian to shared memory, together with extra channels.
#[cube]
pub fn load(
    shared: &mut Shared<[f32]>,
    place: usize,
    records: &[f32],
    extra: &[f32],
    record: usize,
    layout: &Layout,
    #[comptime] channels: bool,
) {
    let to = place * SHARED;
    let from = record * RECORD;
    #[unroll]
    for k in 0..10usize {
        shared[to + k] = records[from + k];
    }
    if comptime!(channels) {
        let gaussian = record % layout.gaussians as usize;
        let from = gaussian * layout.extra_channels as usize + layout.first as usize;
        #[unroll]
        for k in 0..EXTRA {
            let mut value = 0.0f32;
            if (k as u32) < layout.channels {
                value = extra[from + k];
            }
            shared[to + 10 + k] = value;
        }
    }
}

/// First and last pair of this cube's tile, the same for all units.
#[cube]
pub fn bounds(ranges: &[u32], tile: usize, limits: &mut Shared<[u32]>) {
    if UNIT_POS < 2u32 {
        limits[UNIT_POS as usize] = ranges[2 * tile + UNIT_POS as usize];
    }
    sync_cube();
}

/// Composites a tile. `first_pass`: colour, depth and weights are written as well; `channels`: up to four extra channels.
///
/// `image` is `[views, PLANES, H, W]`, `more` `[views, E, H, W]`, `ends` the place behind the last contributor.
#[cube(launch)]
pub fn composite(
    records: &[f32],
    extra: &[f32],
    pair_record: &[u32],
    order: &[u32],
    ranges: &[u32],
    image: &mut [f32],
    more: &mut [f32],
    ends: &mut [u32],
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
    let x = (local % layout.columns as usize) * TILE + unit % TILE;
    let y = (local / layout.columns as usize) * TILE + unit / TILE;
    let width = layout.width as usize;
    let inside = x < width && y < layout.height as usize;
    let px = f32::cast_from(x as u32) + 0.5f32;
    let py = f32::cast_from(y as u32) + 0.5f32;

    let mut limits = Shared::<[u32]>::new_slice(2usize);
    let mut batch = Shared::<[f32]>::new_slice(comptime!(UNITS * SHARED));
    let live = Shared::<[Atomic<u32>]>::new_slice(1usize);
    bounds(ranges, tile, &mut limits);
    let start = workgroup_uniform_load(&limits[0]);
    let end = workgroup_uniform_load(&limits[1]);

    let mut open = select(inside, 1.0f32.runtime(), 0.0f32.runtime());
    let mut transmittance = 1.0f32;
    let mut alpha_sum = 0.0f32;
    let mut red = 0.0f32;
    let mut green = 0.0f32;
    let mut blue = 0.0f32;
    let mut depth = 0.0f32;
    let mut last = 0u32;
    let mut sums = Array::<f32>::new(EXTRA);

    let mut base = start;
    while base < end {
        let count = min(end - base, comptime!(UNITS as u32));
        if UNIT_POS < count {
            let record = pair_record[order[(base + UNIT_POS) as usize] as usize];
            load(&mut batch, unit, records, extra, record as usize, &layout, channels);
        }
        if UNIT_POS == 0u32 {
            live[0].store(0u32);
        }
        sync_cube();
        if open > STOP {
            for place in 0..count {
                let at = place as usize * SHARED;
                let dx = batch[at] - px;
                let dy = batch[at + 1] - py;
                let l = fma(batch[at + 2], dx, batch[at + 3] * dy);
                let power = falloff_power(l, batch[at + 4], dy);
                let alpha = min(layout.alpha_max, batch[at + 5] * exp2(power));
                if alpha >= ALPHA_CUT {
                    let behind = fma(-alpha, open, open);
                    if behind > STOP {
                        let weight = alpha * open;
                        alpha_sum += weight;
                        if comptime!(first_pass) {
                            red = fma(weight, batch[at + 6], red);
                            green = fma(weight, batch[at + 7], green);
                            blue = fma(weight, batch[at + 8], blue);
                            depth = fma(weight, batch[at + 9], depth);
                        }
                        if comptime!(channels) {
                            #[unroll]
                            for k in 0..EXTRA {
                                sums[k] = fma(weight, batch[at + 10 + k], sums[k]);
                            }
                        }
                        transmittance = behind;
                        last = base + place + 1u32 - start;
                    }
                    // Behind the stop it only falls, so that the pixel stays finished.
                    open = behind;
                }
            }
            if open > STOP {
                live[0].fetch_add(1u32);
            }
        }
        let still = workgroup_uniform_load_atomic(&live[0]);
        base = select(still > 0u32, base + comptime!(UNITS as u32), end);
        sync_cube();
    }

    if inside {
        let pixels = width * layout.height as usize;
        let pixel = y * width + x;
        if comptime!(first_pass) {
            let at = view * PLANES * pixels + pixel;
            image[at] = alpha_sum;
            image[at + pixels] = red;
            image[at + 2 * pixels] = green;
            image[at + 3 * pixels] = blue;
            image[at + 4 * pixels] = depth;
            image[at + 5 * pixels] = transmittance;
            ends[view * pixels + pixel] = last;
        }
        if comptime!(channels) {
            let at = (view * layout.extra_channels as usize + layout.first as usize) * pixels + pixel;
            #[unroll]
            for k in 0..EXTRA {
                if (k as u32) < layout.channels {
                    more[at + k * pixels] = sums[k];
                }
            }
        }
    }
}
