//! Contribution sums on the device.

use crate::camera::{RasterCamera, RasterConfig};
use crate::contributions::Eligible;
use crate::error::{Result, SplatError};
use crate::render::Render;

use super::device::{Buffer, cube, grid};
use super::forward::{Pass, for_each_pass};
use super::kernels::{UNITS, WIDE, contribute};
use super::scene::GpuScene;

/// Most words of pooled features that are made at once.
const POOL_WORDS: usize = 1 << 24;

/// The sparse contribution matrix of one or several views in the memory of a device; see [`crate::Contributions`].
pub struct GpuContributions {
    /// Indices of the eligible Gaussians, ascending; row `r` of every result belongs to Gaussian `rows[r]`. `[R]`
    pub rows: Vec<u32>,
    /// Number of pixels of all views, the rows of the feature matrix: views in order, each `[H, W]`.
    pub pixels: usize,
    scene: GpuScene,
    parts: Vec<Part>,
    entries: usize,
}

/// The entries of one pass.
struct Part {
    pass: Pass,
    /// First entry of every pair, and the end.
    offsets: Buffer,
    touched: Buffer,
    weights: Buffer,
}

/// Renders views and records the contributions of the eligible Gaussians.
///
/// # Errors
/// As [`super::render_views`], and when the eligibility does not fit the scene.
pub fn render_views_with_contributions(
    scene: &GpuScene,
    cameras: &[RasterCamera],
    config: &RasterConfig,
    eligible: &Eligible,
) -> Result<(Vec<Render>, GpuContributions)> {
    let rows = eligible.indices(scene.count)?;
    let mut marks = vec![0_u32; scene.count];
    for &row in &rows {
        marks[row as usize] = 1;
    }
    let marks = scene.device.upload_u32(&marks);
    let mut renders = Vec::with_capacity(cameras.len());
    let mut parts = Vec::new();
    let mut entries = 0;
    for_each_pass(scene, cameras, config, 1, |pass| {
        renders.extend(pass.images(scene, config)?.0);
        let (part, count) = Part::new(scene, pass, &marks)?;
        entries += count;
        parts.push(part);
        Ok(())
    })?;
    let contributions = GpuContributions {
        rows,
        pixels: cameras.iter().map(RasterCamera::pixels).sum(),
        scene: scene.clone(),
        parts,
        entries,
    };
    Ok((renders, contributions))
}

impl Part {
    /// Counts the entries, makes room for exactly these, and records them.
    fn new(scene: &GpuScene, pass: Pass, marks: &Buffer) -> Result<(Self, usize)> {
        let device = &scene.device;
        let counts = device.zeros(pass.pairs);
        let nothing = device.zeros(1);
        let (none, no_weights) = (device.empty(1), device.empty(1));
        if pass.pairs > 0 {
            pass.touch(scene, marks, &counts, &nothing, &none, &no_weights, false);
        }
        let offsets = device.scan(&counts, pass.pairs);
        let count = device.pick(&offsets, pass.pairs)? as usize;
        device.check_words("the contributions", count)?;
        let (touched, weights) = (device.empty(count), device.empty(count));
        if count > 0 {
            pass.touch(scene, marks, &counts, &offsets, &touched, &weights, true);
        }
        let part = Self {
            pass,
            offsets,
            touched,
            weights,
        };
        Ok((part, count))
    }
}

impl Pass {
    fn touch(
        &self,
        scene: &GpuScene,
        marks: &Buffer,
        counts: &Buffer,
        offsets: &Buffer,
        touched: &Buffer,
        weights: &Buffer,
        write: bool,
    ) {
        contribute::touch::launch(
            &scene.device.client,
            grid(self.all_tiles()),
            cube(UNITS),
            self.records.arg(),
            self.pair_record.arg(),
            self.order.arg(),
            self.ranges.arg(),
            marks.arg(),
            counts.arg(),
            offsets.arg(),
            touched.arg(),
            weights.arg(),
            self.layout(scene, 0),
            write,
        );
    }
}

impl GpuContributions {
    /// Number of entries of the matrix.
    #[must_use]
    pub fn len(&self) -> usize {
        self.entries
    }

    /// True when no eligible Gaussian contributes to any pixel.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.entries == 0
    }

    /// Mass of every eligible Gaussian, `W^T 1`. `[R]`
    ///
    /// # Errors
    /// When the device fails.
    pub fn mass(&self) -> Result<Vec<f32>> {
        if self.rows.is_empty() {
            return Ok(Vec::new());
        }
        let device = &self.scene.device;
        let rows = device.upload_u32(&self.rows);
        let out = device.zeros(self.rows.len());
        for part in self.parts.iter().filter(|part| part.pass.pairs > 0) {
            contribute::mass::launch(
                &device.client,
                grid(self.rows.len().div_ceil(WIDE)),
                cube(WIDE),
                rows.arg(),
                part.pass.entries.arg(),
                part.pass.first_pair.arg(),
                part.offsets.arg(),
                part.weights.arg(),
                out.arg(),
                self.rows.len() as u32,
                self.scene.count as u32,
                part.pass.views as u32,
            );
        }
        Ok(device.read(&[&out])?.pop().unwrap_or_default())
    }

    /// Pooled pixel features of every eligible Gaussian, `W^T E`; `features` is `[pixels, channels]`, the result
    /// `[R, channels]`.
    ///
    /// # Errors
    /// When the features have another number of values, or the device fails.
    pub fn pool(&self, features: &[f32], channels: usize) -> Result<Vec<f32>> {
        let meaning = format!("{} pixels of {channels} channels", self.pixels);
        let expected = self.pixels.saturating_mul(channels);
        SplatError::check("pixel features", features.len(), expected, &meaning)?;
        let mut pooled = Vec::with_capacity(self.rows.len() * channels);
        if channels == 0 {
            return Ok(pooled);
        }
        let device = &self.scene.device;
        let mut views = Vec::new();
        let mut rest = features;
        for (index, part) in self.parts.iter().enumerate() {
            let own = part.pass.width * part.pass.height * channels;
            device.check_words("the features of a view", own)?;
            for view in 0..part.pass.views {
                let (head, tail) = rest.split_at(own);
                rest = tail;
                views.push((index, view, device.upload(head)));
            }
        }
        for rows in self.rows.chunks((POOL_WORDS / channels).max(1)) {
            let on_device = device.upload_u32(rows);
            let out = device.zeros(rows.len() * channels);
            for (part, view, features) in &views {
                let part = &self.parts[*part];
                if part.pass.pairs == 0 {
                    continue;
                }
                contribute::pool::launch(
                    &device.client,
                    grid(rows.len()),
                    cube(WIDE),
                    on_device.arg(),
                    part.pass.entries.arg(),
                    part.pass.first_pair.arg(),
                    part.offsets.arg(),
                    part.touched.arg(),
                    part.weights.arg(),
                    features.arg(),
                    out.arg(),
                    rows.len() as u32,
                    self.scene.count as u32,
                    *view as u32,
                    channels as u32,
                );
            }
            pooled.extend(device.read(&[&out])?.pop().unwrap_or_default());
        }
        Ok(pooled)
    }
}
