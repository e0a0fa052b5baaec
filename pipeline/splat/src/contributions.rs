//! Contribution sums of a render: mass `W^T 1` and pooled pixel features `W^T E` (`docs/spec/rasteriser.md` section 10).
//!
//! `W[p, i]` is the compositing weight of Gaussian `i` at pixel `p`. It is recorded sparsely while compositing, for the
//! eligible Gaussians only, and laid out by Gaussian, so that pooling reads each Gaussian's few pixels, sums in
//! registers and writes each result once. Entries of a Gaussian are in tile order and, inside a tile, in pixel order,
//! whatever the number of threads.

use std::ops::Range;

use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use crate::camera::{RasterCamera, RasterConfig};
use crate::error::{Result, SplatError};
use crate::gaussians::Gaussians;
use crate::project::{CHUNK, Projection, for_each_view};
use crate::render::{Render, TileOutput, Work, check_views};
use crate::simd::{LANES, SimdLevel, dispatch};
use crate::tile::BLOCK;

/// The Gaussians whose contributions are wanted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Eligible {
    /// All of them.
    All,
    /// Those in these index ranges, ascending and disjoint (one range per source view of a source time).
    Ranges(Vec<Range<usize>>),
    /// Those with `true`. `[N]`
    Mask(Vec<bool>),
}

impl Eligible {
    /// Indices of the eligible Gaussians, ascending.
    ///
    /// # Errors
    /// When ranges overlap, descend or exceed the scene, or the mask has another length.
    pub fn indices(&self, count: usize) -> Result<Vec<u32>> {
        match self {
            Self::All => Ok((0..count as u32).collect()),
            Self::Ranges(ranges) => {
                let mut end = 0;
                for range in ranges {
                    if range.start < end || range.end < range.start || range.end > count {
                        return Err(SplatError::Setting {
                            what: "ranges of eligible Gaussians must ascend, not overlap and lie inside the scene",
                            value: format!("{}..{} of {count}", range.start, range.end),
                        });
                    }
                    end = range.end;
                }
                Ok(ranges.iter().flat_map(|r| r.start as u32..r.end as u32).collect())
            }
            Self::Mask(mask) => {
                SplatError::check("eligible mask", mask.len(), count, "one per Gaussian")?;
                Ok((0..count as u32).filter(|&i| mask[i as usize]).collect())
            }
        }
    }
}

/// The sparse contribution matrix of one or several views, by Gaussian.
#[derive(Debug, Clone, PartialEq)]
pub struct Contributions {
    /// Indices of the eligible Gaussians, ascending; row `r` of every result belongs to Gaussian `rows[r]`. `[R]`
    pub rows: Vec<u32>,
    /// Number of pixels of all views, the rows of the feature matrix: views in order, each `[H, W]`.
    pub pixels: usize,
    views: Vec<ViewContributions>,
    simd: SimdLevel,
}

/// Entries of one view.
#[derive(Debug, Clone, PartialEq)]
struct ViewContributions {
    /// Pixels of the views before.
    pixel_offset: usize,
    /// Pieces of consecutive rows.
    pieces: Vec<Piece>,
}

/// Entries of consecutive rows.
#[derive(Debug, Clone, PartialEq)]
struct Piece {
    rows: Range<usize>,
    /// First entry of every row and the end.
    offsets: Vec<u32>,
    pixels: Vec<u32>,
    weights: Vec<f32>,
}

/// Renders a view and records the contributions of the eligible Gaussians.
///
/// # Errors
/// As [`crate::render()`], and when the eligibility does not fit the scene.
pub fn render_with_contributions(
    gaussians: &Gaussians,
    camera: &RasterCamera,
    config: &RasterConfig,
    eligible: &Eligible,
) -> Result<(Render, Contributions)> {
    let (mut renders, contributions) =
        render_views_with_contributions(gaussians, std::slice::from_ref(camera), config, eligible)?;
    match renders.pop() {
        Some(render) => Ok((render, contributions)),
        None => Err(SplatError::Setting {
            what: "one view was asked for, none was rendered",
            value: String::new(),
        }),
    }
}

/// Renders several views (those of one source time) and records the contributions of the eligible Gaussians to all.
///
/// # Errors
/// As [`render_with_contributions`].
pub fn render_views_with_contributions(
    gaussians: &Gaussians,
    cameras: &[RasterCamera],
    config: &RasterConfig,
    eligible: &Eligible,
) -> Result<(Vec<Render>, Contributions)> {
    let views = check_views(gaussians, cameras, config)?;
    let rows = eligible.indices(gaussians.len())?;
    let mut is_eligible = vec![0_u64; gaussians.len().div_ceil(64)];
    for &row in &rows {
        is_eligible[row as usize / 64] |= 1 << (row % 64);
    }
    let mut pixels = 0;
    let offsets: Vec<usize> = cameras
        .iter()
        .map(|camera| {
            pixels += camera.pixels();
            pixels - camera.pixels()
        })
        .collect();
    let is_eligible = |index: u32| is_eligible[index as usize / 64] >> (index % 64) & 1 != 0;
    let (renders, views) = for_each_view(gaussians, &views, config, |index, view, projection| {
        let work = Work {
            gaussians,
            view,
            config,
            projection: &projection,
            eligible: &is_eligible,
        };
        let mut tiles = work.tiles::<false, true>();
        let render = work.image(&tiles);
        tiles.par_iter_mut().for_each(sort_by_slot);
        let pieces = pieces(&tiles, &projection, &rows, gaussians.len(), view.width);
        let pixel_offset = offsets[index];
        Ok((render, ViewContributions { pixel_offset, pieces }))
    })?
    .into_iter()
    .unzip();
    Ok((
        renders,
        Contributions {
            rows,
            pixels,
            views,
            simd: config.simd,
        },
    ))
}

/// Sorts a tile's entries by slot, keeping pixel order: a counting sort.
fn sort_by_slot(tile: &mut TileOutput) {
    let entries = &mut tile.recorded.contributions;
    let mut next = vec![0_u32; tile.list.len() + 1];
    for entry in entries.iter() {
        next[entry.slot as usize + 1] += 1;
    }
    for slot in 0..tile.list.len() {
        next[slot + 1] += next[slot];
    }
    let mut sorted = entries.clone();
    for entry in entries.iter() {
        let place = &mut next[entry.slot as usize];
        sorted[*place as usize] = *entry;
        *place += 1;
    }
    *entries = sorted;
}

/// Lays the entries of all tiles out by Gaussian, one piece per chunk of the projection.
fn pieces(tiles: &[TileOutput], projection: &Projection, rows: &[u32], count: usize, width: usize) -> Vec<Piece> {
    (0..count.div_ceil(CHUNK))
        .into_par_iter()
        .filter_map(|chunk| {
            let (first, end) = (chunk * CHUNK, ((chunk + 1) * CHUNK).min(count));
            let range = rows.partition_point(|&r| (r as usize) < first)..rows.partition_point(|&r| (r as usize) < end);
            if range.is_empty() {
                return None;
            }
            let mut row_of = vec![u32::MAX; end - first];
            for (local, &row) in rows[range.clone()].iter().enumerate() {
                row_of[row as usize - first] = local as u32;
            }
            let local_row = |tile: &TileOutput, slot: u32| {
                let record = tile.list.records[slot as usize] as usize;
                row_of[projection.records[record].gaussian as usize - first] as usize
            };
            // Entries of this chunk in a tile are those with a slot in the chunk's segment.
            let segment = |tile: &TileOutput| {
                let entries = &tile.recorded.contributions;
                let slots = tile.list.segment(chunk);
                let (low, high) = (slots.start as u32, slots.end as u32);
                entries.partition_point(|e| e.slot < low)..entries.partition_point(|e| e.slot < high)
            };
            let mut offsets = vec![0_u32; range.len() + 1];
            for tile in tiles {
                for entry in &tile.recorded.contributions[segment(tile)] {
                    offsets[local_row(tile, entry.slot) + 1] += 1;
                }
            }
            for row in 0..range.len() {
                offsets[row + 1] += offsets[row];
            }
            let total = offsets[range.len()] as usize;
            let (mut pixels, mut weights) = (vec![0; total], vec![0.0; total]);
            let mut next = offsets.clone();
            for tile in tiles {
                for entry in &tile.recorded.contributions[segment(tile)] {
                    let slot = &mut next[local_row(tile, entry.slot)];
                    pixels[*slot as usize] = tile.image_pixel(entry.pixel, width);
                    weights[*slot as usize] = entry.weight;
                    *slot += 1;
                }
            }
            Some(Piece {
                rows: range,
                offsets,
                pixels,
                weights,
            })
        })
        .collect()
}

impl TileOutput {
    /// Index in the image of a tile's pixel `block * 16 + lane`.
    fn image_pixel(&self, pixel: u32, width: usize) -> u32 {
        let (block, lane) = (pixel as usize / LANES, pixel as usize % LANES);
        let x = self.area.x + (block % self.area.blocks_x) * BLOCK + lane % BLOCK;
        let y = self.area.y + (block / self.area.blocks_x) * BLOCK + lane / BLOCK;
        (y * width + x) as u32
    }
}

impl Contributions {
    /// Number of entries of the matrix.
    #[must_use]
    pub fn len(&self) -> usize {
        self.views.iter().flat_map(|v| &v.pieces).map(|p| p.weights.len()).sum()
    }

    /// True when no eligible Gaussian contributes to any pixel.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Mass of every eligible Gaussian, `W^T 1`, summed in f64. `[R]`
    #[must_use]
    pub fn mass(&self) -> Vec<f32> {
        let mut mass = vec![0.0_f64; self.rows.len()];
        for view in &self.views {
            for piece in &view.pieces {
                for (local, row) in piece.rows.clone().enumerate() {
                    mass[row] += piece.row(local).1.iter().map(|&w| f64::from(w)).sum::<f64>();
                }
            }
        }
        mass.into_iter().map(|m| m as f32).collect()
    }

    /// Pooled pixel features of every eligible Gaussian, `W^T E`; divide by the mass for the weighted mean. `features`
    /// is `[pixels, channels]`, the result `[R, channels]`.
    ///
    /// # Errors
    /// When the features have another number of values.
    pub fn pool(&self, features: &[f32], channels: usize) -> Result<Vec<f32>> {
        let mut pooled = vec![0.0; self.rows.len().saturating_mul(channels)];
        self.pool_into(features, channels, &mut pooled)?;
        Ok(pooled)
    }

    /// As [`Contributions::pool`] into memory of the caller's, which saves the cost of fresh memory when many times are
    /// pooled in turn. What was in it is overwritten.
    ///
    /// # Errors
    /// When the features or the result have another number of values.
    pub fn pool_into(&self, features: &[f32], channels: usize, pooled: &mut [f32]) -> Result<()> {
        let meaning = format!("{} pixels of {channels} channels", self.pixels);
        SplatError::check(
            "pixel features",
            features.len(),
            self.pixels.saturating_mul(channels),
            &meaning,
        )?;
        let meaning = format!("{} rows of {channels} channels", self.rows.len());
        SplatError::check(
            "pooled features",
            pooled.len(),
            self.rows.len().saturating_mul(channels),
            &meaning,
        )?;
        if channels == 0 {
            return Ok(());
        }
        // Views have the same pieces, because these follow from the rows alone.
        let pieces = self.views.first().map_or(0, |view| view.pieces.len());
        let mut rest = pooled;
        let mut jobs = Vec::with_capacity(pieces);
        for piece in 0..pieces {
            let rows = self.views[0].pieces[piece].rows.len();
            let (head, tail) = rest.split_at_mut(rows * channels);
            jobs.push((piece, head));
            rest = tail;
        }
        jobs.into_par_iter().for_each(|(piece, out)| {
            out.fill(0.0);
            for view in &self.views {
                let features = &features[view.pixel_offset * channels..];
                dispatch(
                    self.simd,
                    Pool {
                        piece: &view.pieces[piece],
                        features,
                        channels,
                        out,
                    },
                );
            }
        });
        Ok(())
    }

    /// Calls `f(row, pixel, weight)` for every entry, by view and row; the pixel counts through all views.
    pub fn for_each(&self, mut f: impl FnMut(usize, usize, f32)) {
        for view in &self.views {
            for piece in &view.pieces {
                for (local, row) in piece.rows.clone().enumerate() {
                    let (pixels, weights) = piece.row(local);
                    for (&pixel, &weight) in pixels.iter().zip(weights) {
                        f(row, view.pixel_offset + pixel as usize, weight);
                    }
                }
            }
        }
    }
}

impl Piece {
    #[inline(always)]
    fn row(&self, local: usize) -> (&[u32], &[f32]) {
        let range = self.offsets[local] as usize..self.offsets[local + 1] as usize;
        (&self.pixels[range.clone()], &self.weights[range])
    }
}

/// Adds one view's entries of a piece to its rows of the result.
struct Pool<'a> {
    piece: &'a Piece,
    features: &'a [f32],
    channels: usize,
    out: &'a mut [f32],
}

impl WithSimd for Pool<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self {
            piece,
            features,
            channels,
            out,
        } = self;
        // Eight vectors of channels at a time: they stay in registers over all entries of a row, and that part of the
        // features of the pixels around stays in the second-level cache over the rows of the piece.
        for first in (0..channels).step_by(POOL_CHANNELS) {
            for (local, out) in out.chunks_exact_mut(channels).enumerate() {
                let (pixels, weights) = piece.row(local);
                if pixels.is_empty() {
                    continue;
                }
                let out = &mut out[first..channels.min(first + POOL_CHANNELS)];
                let (wide, narrow) = S::as_mut_simd_f32s(out);
                let whole = wide.len() * LANES;
                if let Ok(wide) = <&mut [S::f32s; POOL_CHANNELS / LANES]>::try_from(&mut *wide) {
                    accumulate(simd, wide, pixels, weights, features, channels, first);
                } else {
                    for (k, one) in wide.iter_mut().enumerate() {
                        let one = std::array::from_mut(one);
                        accumulate::<S, 1>(simd, one, pixels, weights, features, channels, first + k * LANES);
                    }
                }
                for (k, value) in narrow.iter_mut().enumerate() {
                    for (&pixel, &weight) in pixels.iter().zip(weights) {
                        *value = weight.mul_add(features[pixel as usize * channels + first + whole + k], *value);
                    }
                }
            }
        }
    }
}

/// Channels that are pooled at a time.
const POOL_CHANNELS: usize = 8 * LANES;

#[inline(always)]
fn accumulate<S: Simd, const K: usize>(
    simd: S,
    sums: &mut [S::f32s; K],
    pixels: &[u32],
    weights: &[f32],
    features: &[f32],
    channels: usize,
    first: usize,
) {
    let mut acc = *sums;
    for (&pixel, &weight) in pixels.iter().zip(weights) {
        let at = pixel as usize * channels + first;
        let (values, _) = S::as_simd_f32s(&features[at..at + K * LANES]);
        let weight = simd.splat_f32s(weight);
        for k in 0..K {
            acc[k] = simd.mul_add_f32s(weight, values[k], acc[k]);
        }
    }
    *sums = acc;
}
