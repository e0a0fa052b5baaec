//! Projection of 3D Gaussians to the image and their assignment to tiles (`docs/spec/rasteriser.md` sections 3 to 6).
//!
//! Gaussians are taken in chunks of consecutive indices. A chunk projects sixteen at a time in plain lane loops that the
//! compiler vectorises for the instruction set at hand (no contraction, so every level gives the same bits), keeps the
//! visible ones and files `(depth, record)` keys by tile. Chunks are independent; a tile later collects its keys from all
//! chunks in order, so that neither threads nor chunks show in the result.

use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use crate::buffers::{Buffer, Pool};
use crate::camera::{ALPHA_CUT, Mode, RasterConfig, View};
use crate::error::{Result, SplatError};
use crate::gaussians::{Colour, Gaussians};
use crate::sh;
use crate::simd::{LANES, dispatch};

/// Gaussians per chunk.
pub(crate) const CHUNK: usize = 8192;
/// Most tile entries of one view; more is refused rather than allocated.
const MAX_TILE_ENTRIES: usize = 1 << 29;
const LOG2_E: f32 = std::f32::consts::LOG2_E;
/// log2 of the falloff is `-FALLOFF * d^T Sigma^-1 d`.
pub(crate) const FALLOFF: f32 = 0.5 * LOG2_E;

/// A visible Gaussian in the image. One cache line.
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(64))]
pub(crate) struct Projected {
    /// Mean in pixels.
    pub(crate) x: f32,
    pub(crate) y: f32,
    /// Conic in factored form: log2 of the falloff at d is `lc dy^2 - (la dx + lb dy)^2`. It is never positive, and it
    /// does not cancel for needles as `A dx^2 + 2 B dx dy + C dy^2` does.
    pub(crate) la: f32,
    pub(crate) lb: f32,
    pub(crate) lc: f32,
    /// Opacity with the compensation.
    pub(crate) opacity: f32,
    /// Colour, evaluated and clamped.
    pub(crate) rgb: [f32; 3],
    /// Camera z of the centre.
    pub(crate) z: f32,
    /// Lower bound of the log2 of the falloff where alpha reaches the cut (a little below the exact value).
    pub(crate) power_min: f32,
    /// Index of the Gaussian.
    pub(crate) gaussian: u32,
    pad: [u32; 4],
}

/// Keys of one chunk, filed by tile.
#[derive(Debug, Default)]
pub(crate) struct ChunkBins {
    /// First key of every tile and the end. `[tiles + 1]`
    pub(crate) offsets: Vec<u32>,
    /// Depth bits in the high word, record index in the low word, records ascending inside a tile.
    pub(crate) keys: Vec<u64>,
    /// Number of records.
    pub(crate) visible: usize,
    invalid: usize,
}

/// All visible Gaussians of a view, and where they are.
pub(crate) struct Projection {
    /// Records; chunk `c` starts at `c * CHUNK` and uses as many as it has visible Gaussians.
    pub(crate) records: Buffer<Projected>,
    pub(crate) chunks: Vec<ChunkBins>,
    pub(crate) grid: Grid,
    pub(crate) visible: usize,
    pub(crate) invalid: usize,
}

/// Buffers of records, up to 256 MB each.
static RECORDS: Pool<Projected> = Pool::new(1 << 22);

/// The tiles of an image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Grid {
    pub(crate) tile: usize,
    pub(crate) columns: usize,
    pub(crate) rows: usize,
}

impl Grid {
    pub(crate) fn new(view: &View, tile: usize) -> Self {
        Self {
            tile,
            columns: view.width.div_ceil(tile),
            rows: view.height.div_ceil(tile),
        }
    }

    pub(crate) fn tiles(&self) -> usize {
        self.columns * self.rows
    }
}

/// Projects a scene into several views at once: every Gaussian is loaded, checked and turned into its 3D shape once.
///
/// # Errors
/// When so many Gaussians cover so many tiles that the lists would not fit in memory.
pub(crate) fn project_views(gaussians: &Gaussians, views: &[View], config: &RasterConfig) -> Result<Vec<Projection>> {
    let count = gaussians.len();
    let mut buffers: Vec<Buffer<Projected>> = views.iter().map(|_| RECORDS.take(count)).collect();
    let grids: Vec<Grid> = views
        .iter()
        .map(|view| Grid::new(view, config.tile_size as usize))
        .collect();
    // Records of every chunk: one slice per view.
    let mut pieces: Vec<Vec<&mut [Projected]>> = Vec::new();
    pieces.resize_with(count.div_ceil(CHUNK), || Vec::with_capacity(views.len()));
    for buffer in &mut buffers {
        for (piece, records) in pieces.iter_mut().zip(buffer.chunks_mut(CHUNK)) {
            piece.push(records);
        }
    }
    let chunks: Vec<Vec<ChunkBins>> = pieces
        .into_par_iter()
        .enumerate()
        .map_init(
            || vec![Vec::new(); views.len()],
            |entries, (chunk, records)| {
                let kernel = ProjectChunk {
                    gaussians,
                    views,
                    config,
                    grids: &grids,
                    first: chunk * CHUNK,
                    records,
                    entries,
                };
                dispatch(config.simd, kernel)
            },
        )
        .collect::<Result<_>>()?;
    let mut projections: Vec<Projection> = buffers
        .into_iter()
        .zip(grids)
        .map(|(records, grid)| Projection {
            records,
            chunks: Vec::with_capacity(chunks.len()),
            grid,
            visible: 0,
            invalid: 0,
        })
        .collect();
    for views in chunks {
        for (projection, chunk) in projections.iter_mut().zip(views) {
            projection.visible += chunk.visible;
            projection.invalid += chunk.invalid;
            projection.chunks.push(chunk);
        }
    }
    let entries = |projection: &Projection| projection.chunks.iter().map(|c| c.keys.len()).sum::<usize>();
    if projections
        .iter()
        .any(|projection| entries(projection) > MAX_TILE_ENTRIES)
    {
        return Err(too_many());
    }
    Ok(projections)
}

/// Views that are projected together. Their records are in memory at the same time, and as many buffers are kept from
/// one group to the next.
const GROUP: usize = 4;

/// Projects a scene into all views, group by group, and hands every projection on; results are in the order of the views.
///
/// # Errors
/// As [`project_views`] and the function's own; the first view's in order of the groups.
pub(crate) fn for_each_view<T: Send>(
    gaussians: &Gaussians,
    views: &[View],
    config: &RasterConfig,
    f: impl Fn(usize, &View, Projection) -> Result<T> + Sync,
) -> Result<Vec<T>> {
    let mut results = Vec::with_capacity(views.len());
    for (group, views) in views.chunks(GROUP).enumerate() {
        let projections = project_views(gaussians, views, config)?;
        results.extend::<Vec<Result<T>>>(
            projections
                .into_par_iter()
                .zip(views)
                .enumerate()
                .map(|(index, (projection, view))| f(group * GROUP + index, view, projection))
                .collect(),
        );
    }
    results.into_iter().collect()
}

fn too_many() -> SplatError {
    SplatError::Setting {
        what: "the Gaussians cover too many image tiles for one render; use a larger tile size or a smaller scene",
        value: format!("more than {MAX_TILE_ENTRIES} tile entries"),
    }
}

/// Tiles reached: (tile, depth bits and record).
type Entries = Vec<(u32, u64)>;

struct ProjectChunk<'a> {
    gaussians: &'a Gaussians,
    views: &'a [View],
    config: &'a RasterConfig,
    grids: &'a [Grid],
    first: usize,
    /// One slice per view.
    records: Vec<&'a mut [Projected]>,
    /// One list per view, reused from chunk to chunk.
    entries: &'a mut [Entries],
}

impl WithSimd for ProjectChunk<'_> {
    /// One per view.
    type Output = Result<Vec<ChunkBins>>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> Result<Vec<ChunkBins>> {
        let Self {
            gaussians,
            views,
            config,
            grids,
            first,
            mut records,
            entries,
        } = self;
        entries.iter_mut().for_each(Vec::clear);
        let mut bins: Vec<ChunkBins> = views.iter().map(|_| ChunkBins::default()).collect();
        let mut block = Block::new();
        let mut out = BlockOut::new();
        let length = records.first().map_or(0, |records| records.len());
        let mut start = 0;
        while start < length {
            let count = LANES.min(length - start);
            block.load(gaussians, first + start, count);
            block.prepare();
            for (view, own) in views.iter().enumerate() {
                project_lanes(&block, own, config, grids[view].tile as f32, &mut out);
                let (bins, entries) = (&mut bins[view], &mut entries[view]);
                for lane in 0..count {
                    let gaussian = first + start + lane;
                    if out.valid[lane] == 0 || !tail_is_usable(gaussians, gaussian) {
                        bins.invalid += 1;
                        continue;
                    }
                    if out.visible[lane] == 0 {
                        continue;
                    }
                    let record = out.record(lane, gaussian, own, gaussians);
                    let before = entries.len();
                    file(
                        &record,
                        &out,
                        lane,
                        (first + bins.visible) as u32,
                        &grids[view],
                        entries,
                    );
                    if entries.len() == before {
                        continue;
                    }
                    if entries.len() > MAX_TILE_ENTRIES {
                        return Err(too_many());
                    }
                    records[view][bins.visible] = record;
                    bins.visible += 1;
                }
            }
            start += count;
        }
        for ((bins, entries), grid) in bins.iter_mut().zip(entries).zip(grids) {
            bins.sort(entries, grid.tiles());
        }
        Ok(bins)
    }
}

impl ChunkBins {
    /// Counting sort by tile; records stay ascending inside a tile.
    fn sort(&mut self, entries: &[(u32, u64)], tiles: usize) {
        let mut offsets = vec![0_u32; tiles + 1];
        for &(tile, _) in entries {
            offsets[tile as usize + 1] += 1;
        }
        for tile in 0..tiles {
            offsets[tile + 1] += offsets[tile];
        }
        let mut next = offsets.clone();
        self.keys = vec![0; entries.len()];
        for &(tile, key) in entries {
            let slot = &mut next[tile as usize];
            self.keys[*slot as usize] = key;
            *slot += 1;
        }
        self.offsets = offsets;
    }
}

/// Largest size of colours, coefficients and extra channels: sums of any number of them with weights that add up to at most
/// one, and of harmonics, stay in the range of f32.
const MAX_CHANNEL: f32 = 1e30;

/// Colour and extra channels are only needed of visible Gaussians, but a bad value makes the Gaussian invalid anywhere.
#[inline(always)]
fn tail_is_usable(gaussians: &Gaussians, index: usize) -> bool {
    let usable = |values: &[f32]| values.iter().fold(true, |all, v| all & (v.abs() <= MAX_CHANNEL));
    let extra = gaussians.extra_channels;
    let harmonics = match &gaussians.colour {
        Colour::Rgb(_) => &[],
        Colour::Sh { degree, coefficients } => {
            let per = 3 * sh::coefficient_count(*degree);
            &coefficients[index * per..(index + 1) * per]
        }
    };
    usable(harmonics) && usable(&gaussians.extra[index * extra..(index + 1) * extra])
}

/// Adds the tiles that a Gaussian reaches: those of its bounding box whose nearest point lies inside the level set.
#[inline(always)]
fn file(record: &Projected, out: &BlockOut, lane: usize, index: u32, grid: &Grid, entries: &mut Entries) {
    let (column0, column1) = (out.tiles[0][lane] as usize, out.tiles[1][lane] as usize);
    let (row0, row1) = (out.tiles[2][lane] as usize, out.tiles[3][lane] as usize);
    let key = (u64::from(record.z.to_bits()) << 32) | u64::from(index);
    if column0 == column1 && row0 == row1 {
        entries.push(((row0 * grid.columns + column0) as u32, key));
        return;
    }
    if column0 == column1 || row0 == row1 {
        // The level set touches all sides of its box, so it reaches every tile of a single row or column.
        for row in row0..=row1 {
            for column in column0..=column1 {
                entries.push(((row * grid.columns + column) as u32, key));
            }
        }
        return;
    }
    let tile = grid.tile;
    for row in row0..=row1 {
        for column in column0..=column1 {
            if reaches(record, column * tile, row * tile, tile) {
                entries.push(((row * grid.columns + column) as u32, key));
            }
        }
    }
}

/// Slack of the reach tests in log2 units, far above the rounding of the exponential and the opacity.
const REACH_SLACK: f32 = 1e-4;
/// Bound of the relative rounding of `la dx` and `lb dy` in the reach tests and in the kernel together.
const REACH_ROUNDING: f32 = 1e-6;

/// Whether the level set of a Gaussian reaches the rectangle of the pixel centres of a block of `size` pixels at (x, y).
/// The slack in `power_min` keeps every pixel that the compositing kernel would keep, so that tiles never show.
#[inline(always)]
pub(crate) fn reaches(g: &Projected, x: usize, y: usize, size: usize) -> bool {
    let (xl, yl) = (x as f32 + 0.5 - g.x, y as f32 + 0.5 - g.y);
    let (xh, yh) = (xl + (size - 1) as f32, yl + (size - 1) as f32);
    let ex = 0.0_f32.min(xh).max(xl);
    let ey = 0.0_f32.min(yh).max(yl);
    // Best point on the vertical line through ex and on the horizontal line through ey.
    let y_best = (g.la * g.lb / (g.lc - g.lb * g.lb) * ex).min(yh).max(yl);
    let x_best = (-g.lb / g.la * ey).min(xh).max(xl);
    let power = |dx: f32, dy: f32| {
        let l = g.la * dx + g.lb * dy;
        g.lc * dy * dy - l * l
    };
    power(ex, y_best).max(power(x_best, ey)) >= g.power_min
}

/// Inputs of sixteen Gaussians, component-major, and what follows from them for every view.
struct Block {
    mean: [[f32; LANES]; 3],
    quat: [[f32; LANES]; 4],
    scale: [[f32; LANES]; 3],
    opacity: [f32; LANES],
    /// Plain colours; zeros for harmonics.
    rgb: [[f32; LANES]; 3],
    /// Rotation matrix, row-major.
    rotation: [[f32; LANES]; 9],
    valid: [u32; LANES],
}

impl Block {
    fn new() -> Self {
        let three = [[0.0; LANES]; 3];
        Self {
            mean: three,
            quat: [[0.0; LANES]; 4],
            scale: three,
            opacity: [0.0; LANES],
            rgb: three,
            rotation: [[0.0; LANES]; 9],
            valid: [0; LANES],
        }
    }

    #[inline(always)]
    fn load(&mut self, gaussians: &Gaussians, first: usize, count: usize) {
        transpose(&mut self.mean, &gaussians.means[3 * first..3 * (first + count)]);
        transpose(&mut self.quat, &gaussians.quats[4 * first..4 * (first + count)]);
        transpose(&mut self.scale, &gaussians.scales[3 * first..3 * (first + count)]);
        self.opacity[..count].copy_from_slice(&gaussians.opacities[first..first + count]);
        if let Colour::Rgb(rgb) = &gaussians.colour {
            transpose(&mut self.rgb, &rgb[3 * first..3 * (first + count)]);
        }
    }

    /// What does not depend on the view: whether the values make sense, and the rotation.
    #[inline(always)]
    fn prepare(&mut self) {
        for l in 0..LANES {
            let m = [self.mean[0][l], self.mean[1][l], self.mean[2][l]];
            let q = [self.quat[0][l], self.quat[1][l], self.quat[2][l], self.quat[3][l]];
            let s = [self.scale[0][l], self.scale[1][l], self.scale[2][l]];
            let o = self.opacity[l];
            let norm2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
            let rgb = [self.rgb[0][l], self.rgb[1][l], self.rgb[2][l]].map(f32::abs);
            let colour = (rgb[0] <= MAX_CHANNEL) & (rgb[1] <= MAX_CHANNEL) & (rgb[2] <= MAX_CHANNEL);
            let zero = m[0] * 0.0 + m[1] * 0.0 + m[2] * 0.0 + (s[0] + s[1] + s[2] + o + norm2) * 0.0;
            let shape = (zero == 0.0) & (norm2 > 1e-20) & (s[0] >= 0.0) & (s[1] >= 0.0) & (s[2] >= 0.0);
            let valid = shape & (o >= 0.0) & colour;
            self.valid[l] = u32::from(valid);
            let inv_norm = 1.0 / norm2.max(1e-30).sqrt();
            let rotation = rotation([q[0] * inv_norm, q[1] * inv_norm, q[2] * inv_norm, q[3] * inv_norm]);
            for k in 0..9 {
                self.rotation[k][l] = rotation[k];
            }
        }
    }
}

#[inline(always)]
fn transpose<const K: usize>(to: &mut [[f32; LANES]; K], from: &[f32]) {
    if from.len() == K * LANES {
        for lane in 0..LANES {
            for k in 0..K {
                to[k][lane] = from[lane * K + k];
            }
        }
    } else {
        for (lane, values) in from.chunks_exact(K).enumerate() {
            for k in 0..K {
                to[k][lane] = values[k];
            }
        }
    }
}

/// Outputs of sixteen Gaussians, component-major.
struct BlockOut {
    x: [f32; LANES],
    y: [f32; LANES],
    z: [f32; LANES],
    la: [f32; LANES],
    lb: [f32; LANES],
    lc: [f32; LANES],
    opacity: [f32; LANES],
    power_min: [f32; LANES],
    /// First and last tile column, first and last tile row.
    tiles: [[u32; LANES]; 4],
    valid: [u32; LANES],
    visible: [u32; LANES],
}

impl BlockOut {
    fn new() -> Self {
        let z = [0.0; LANES];
        Self {
            x: z,
            y: z,
            z,
            la: z,
            lb: z,
            lc: z,
            opacity: z,
            power_min: z,
            tiles: [[0; LANES]; 4],
            valid: [0; LANES],
            visible: [0; LANES],
        }
    }

    #[inline(always)]
    fn record(&self, lane: usize, index: usize, view: &View, gaussians: &Gaussians) -> Projected {
        Projected {
            x: self.x[lane],
            y: self.y[lane],
            la: self.la[lane],
            lb: self.lb[lane],
            lc: self.lc[lane],
            opacity: self.opacity[lane],
            rgb: colour(gaussians, index, view),
            z: self.z[lane],
            power_min: self.power_min[lane],
            gaussian: index as u32,
            pad: [0; 4],
        }
    }
}

/// Direction from the camera centre to a Gaussian's centre, and the distance.
#[inline(always)]
pub(crate) fn direction(mean: &[f32], view: &View) -> ([f32; 3], f32) {
    let d = [
        mean[0] - view.centre[0],
        mean[1] - view.centre[1],
        mean[2] - view.centre[2],
    ];
    let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
    if length > 0.0 {
        (d.map(|v| v / length), length)
    } else {
        ([0.0, 0.0, 1.0], 0.0)
    }
}

/// The composited colour of a Gaussian.
#[inline(always)]
fn colour(gaussians: &Gaussians, index: usize, view: &View) -> [f32; 3] {
    match &gaussians.colour {
        Colour::Rgb(rgb) => [rgb[3 * index], rgb[3 * index + 1], rgb[3 * index + 2]],
        Colour::Sh { degree, coefficients } => {
            let per = 3 * sh::coefficient_count(*degree);
            let (direction, _) = direction(&gaussians.means[3 * index..3 * index + 3], view);
            let raw = sh::evaluate(*degree, direction, &coefficients[per * index..per * (index + 1)]);
            raw.map(|c| c.max(0.0))
        }
    }
}

/// Upper bound of log2 of a positive normal number, at most 0.012 too high.
#[inline(always)]
fn log2_upper(x: f32) -> f32 {
    let bits = x.to_bits() as i32;
    let exponent = ((bits >> 23) - 127) as f32;
    let m = f32::from_bits(((bits & 0x007f_ffff) | 0x3f80_0000) as u32);
    exponent + ((-0.335_828_78 * m + 2.0) * m - 1.658_710) + 0.006
}

/// `docs/spec/rasteriser.md` sections 3 to 5 for sixteen Gaussians, without branches.
#[inline(always)]
fn project_lanes(block: &Block, view: &View, config: &RasterConfig, tile: f32, out: &mut BlockOut) {
    let View {
        fx,
        fy,
        cx,
        cy,
        r,
        t,
        limits,
        ..
    } = *view;
    let (width, height) = (view.width as f32, view.height as f32);
    let antialiased = config.mode == Mode::Antialiased;
    let floor2 = config.min_compensation * config.min_compensation;
    let inv_tile = 1.0 / tile;
    for l in 0..LANES {
        let m = [block.mean[0][l], block.mean[1][l], block.mean[2][l]];
        let s = [block.scale[0][l], block.scale[1][l], block.scale[2][l]];
        let o = block.opacity[l];
        let valid = block.valid[l] != 0;

        let x = r[0] * m[0] + r[1] * m[1] + r[2] * m[2] + t[0];
        let y = r[3] * m[0] + r[4] * m[1] + r[5] * m[2] + t[1];
        let z = r[6] * m[0] + r[7] * m[1] + r[8] * m[2] + t[2];
        let in_range = (z >= config.near) & (z <= config.far);
        let z_safe = if in_range { z } else { 1.0 };
        let inv_z = 1.0 / z_safe;
        let (xz, yz) = (x * inv_z, y * inv_z);
        let ux = xz.min(limits[1]).max(limits[0]);
        let uy = yz.min(limits[3]).max(limits[2]);

        // J R, 2x3, and its product with R_q diag(s).
        let (j0, j2) = (fx * inv_z, -fx * ux * inv_z);
        let (j4, j5) = (fy * inv_z, -fy * uy * inv_z);
        let a = [j0 * r[0] + j2 * r[6], j0 * r[1] + j2 * r[7], j0 * r[2] + j2 * r[8]];
        let b = [j4 * r[3] + j5 * r[6], j4 * r[4] + j5 * r[7], j4 * r[5] + j5 * r[8]];
        let rq = &block.rotation;
        let row = |a: &[f32; 3], k: usize| (a[0] * rq[k][l] + a[1] * rq[3 + k][l] + a[2] * rq[6 + k][l]) * s[k];
        let (u0, u1, u2) = (row(&a, 0), row(&a, 1), row(&a, 2));
        let (v0, v1, v2) = (row(&b, 0), row(&b, 1), row(&b, 2));
        let a0 = u0 * u0 + u1 * u1 + u2 * u2;
        let c0 = v0 * v0 + v1 * v1 + v2 * v2;
        let cov_b = u0 * v0 + u1 * v1 + u2 * v2;
        // Determinant before the low-pass as a sum of squares, which no needle cancels.
        let (n0, n1, n2) = (u0 * v1 - u1 * v0, u0 * v2 - u2 * v0, u1 * v2 - u2 * v1);
        let det0 = n0 * n0 + n1 * n1 + n2 * n2;
        let eps = config.eps2d;
        let (cov_a, cov_c) = (a0 + eps, c0 + eps);
        let det = det0 + eps * (a0 + c0) + eps * eps;
        let representable = (det > 1e-30) & (det < 3e38) & (cov_a < 1e30) & (cov_c > 1e-30) & (cov_c < 1e30);
        let inv_det = 1.0 / if representable { det } else { 1.0 };
        let inv_c = 1.0 / if representable { cov_c } else { 1.0 };
        let la = (FALLOFF * cov_c * inv_det).sqrt();
        let lb = -la * cov_b * inv_c;
        let rho = (det0 * inv_det).max(floor2).sqrt();
        let opacity = if antialiased { o * rho } else { o };

        let (px, py) = (fx * xz + cx, fy * yz + cy);
        let enough = (opacity >= ALPHA_CUT) & (o > config.min_opacity);
        let level = log2_upper((255.0 * opacity).max(1.0));
        // Half sizes of the box of the level set: sigma = level / log2(e) gives sqrt(2 sigma a).
        let reach = 2.0 / LOG2_E * (level + REACH_SLACK);
        let half_x = (reach * cov_a).sqrt() * 1.0001 + 0.002;
        let half_y = (reach * cov_c).sqrt() * 1.0001 + 0.002;
        // Pixel j is reached when |j + 0.5 - x| <= h; bounds are clamped to the image and cut to whole pixels.
        let x0 = (px - half_x - 0.5).ceil().max(0.0);
        let x1 = (px + half_x - 0.5).floor().min(width - 1.0);
        let y0 = (py - half_y - 0.5).ceil().max(0.0);
        let y1 = (py + half_y - 0.5).floor().min(height - 1.0);
        let inside = (x0 <= x1) & (y0 <= y1);
        let safe = |v: f32| if inside { v * inv_tile } else { 0.0 };

        out.x[l] = px;
        out.y[l] = py;
        out.z[l] = z;
        out.la[l] = la;
        out.lb[l] = lb;
        out.lc[l] = -FALLOFF * inv_c;
        out.opacity[l] = opacity;
        let rounding = REACH_ROUNDING * (la * half_x + lb.abs() * half_y) * level.sqrt();
        out.power_min[l] = -(level + REACH_SLACK + 2.0 * rounding);
        for (k, bound) in [x0, x1, y0, y1].into_iter().enumerate() {
            // Bounds lie in the image where they are used and are 0 elsewhere.
            out.tiles[k][l] = safe(bound) as i32 as u32;
        }
        // Finite inputs that overflow on the way count as invalid too, unless they are out of sight anyway.
        out.valid[l] = u32::from(valid & (representable | !in_range | !enough));
        out.visible[l] = u32::from(in_range & representable & enough & inside);
    }
}

/// Rotation matrix of a unit quaternion (w, x, y, z), row-major.
#[inline(always)]
pub(crate) fn rotation([w, x, y, z]: [f32; 4]) -> [f32; 9] {
    [
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log2_bound_is_above_and_close() {
        for k in 0..100_000 {
            let x = 1.0 + k as f32 * 0.01;
            let excess = f64::from(log2_upper(x)) - libm::log2(f64::from(x));
            assert!((0.0..0.012).contains(&excess), "{x}: {excess}");
        }
    }
}
