//! Rendering: projection, sorting and compositing of a group of views at once.

use rayon::prelude::*;

use crate::camera::{ALPHA_FLOOR, RasterCamera, RasterConfig, View};
use crate::error::{Result, SplatError};
use crate::render::{Counts, Render};

use super::device::{Buffer, GpuDevice, cube, grid};
use super::kernels::composite::LayoutLaunch;
use super::kernels::{ENTRY, EXTRA, MOMENTS, PLANES, RECORD, TILE, UNITS, WIDE, composite, project};
use super::scene::{GpuScene, view_words};

/// Most Gaussians of all views of a group together, unless a single view has more.
const GROUP_ENTRIES: usize = 1 << 22;
/// Most pairs of tile and Gaussian of a group.
const MOST_PAIRS: u64 = 1 << 30;

/// What a group of views of equal size leaves on the device.
pub(crate) struct Pass {
    pub(crate) views: usize,
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) view_words: Buffer,
    pub(crate) records: Buffer,
    pub(crate) entries: Buffer,
    pub(crate) first_pair: Buffer,
    pub(crate) pair_record: Buffer,
    /// Pairs by tile and depth.
    pub(crate) order: Buffer,
    pub(crate) ranges: Buffer,
    pub(crate) pairs: usize,
    pub(crate) image: Buffer,
    pub(crate) more: Buffer,
    pub(crate) ends: Buffer,
    tally: Buffer,
    alpha_max: f32,
}

/// Renders views of a scene. The images are those of [`crate::render_views`] up to rounding: a Gaussian whose alpha at a
/// pixel lies within rounding of the cut of 1/255, or whose transmittance does of the stop, may be in one and not in the
/// other. The same call on the same device gives the same bits.
///
/// # Errors
/// When cameras or settings make no sense, when the device cannot hold a view, and when it fails.
pub fn render_views(scene: &GpuScene, cameras: &[RasterCamera], config: &RasterConfig) -> Result<Vec<Render>> {
    let mut renders = Vec::with_capacity(cameras.len());
    for_each_pass(scene, cameras, config, 1, |pass| {
        renders.extend(pass.images(scene, config)?.0);
        Ok(())
    })?;
    Ok(renders)
}

/// Runs passes over groups of consecutive views of equal size, as many at once as fit: records and images of a group, and
/// `words` words for each of its pairs, must fit into one buffer each.
pub(crate) fn for_each_pass(
    scene: &GpuScene,
    cameras: &[RasterCamera],
    config: &RasterConfig,
    words: usize,
    mut take: impl FnMut(Pass) -> Result<()>,
) -> Result<()> {
    config.validate()?;
    let mut views = Vec::with_capacity(cameras.len());
    for camera in cameras {
        camera.validate()?;
        views.push(View::new(camera));
    }
    let buffer = scene.device.most_words();
    let per_entry = RECORD.max(MOMENTS + scene.extra_channels);
    let per_pixel = PLANES.max(2 * scene.extra_channels).max(4 + scene.extra_channels);
    let mut rest = views.as_slice();
    // Learnt from groups with too many pairs.
    let mut most = usize::MAX;
    while let Some(first) = rest.first() {
        let pixels = first.width * first.height;
        let same = |view: &&View| (view.width, view.height) == (first.width, first.height);
        let fits = (GROUP_ENTRIES.min(buffer / per_entry) / scene.count.max(1)).min(buffer / per_pixel / pixels);
        let count = rest.iter().take(most.min(fits).max(1)).take_while(same).count();
        let (group, others) = rest.split_at(count);
        match Pass::run(scene, group, config, words)? {
            Some(pass) => {
                take(pass)?;
                rest = others;
            }
            None => most = count / 2,
        }
    }
    Ok(())
}

impl Pass {
    /// Projects, sorts and composites; `None` when several views have too many pairs together.
    fn run(scene: &GpuScene, views: &[View], config: &RasterConfig, words: usize) -> Result<Option<Self>> {
        let device = &scene.device;
        let (width, height) = (views[0].width, views[0].height);
        let tiles = width.div_ceil(TILE) * height.div_ceil(TILE);
        let entries = scene.count * views.len();
        let pixels = views.len() * width * height;
        device.check_words("the projected Gaussians", entries * RECORD)?;
        let channels = scene.extra_channels;
        device.check_words("the images", pixels * PLANES.max(2 * channels).max(4 + channels))?;
        let packed: Vec<f32> = views.iter().flat_map(|view| view_words(view, config)).collect();
        let mut pass = Self {
            views: views.len(),
            width,
            height,
            view_words: device.upload(&packed),
            records: device.empty(entries * RECORD),
            entries: device.empty(entries * ENTRY),
            first_pair: device.empty(entries),
            pair_record: device.empty(1),
            order: device.empty(1),
            ranges: device.zeros(2 * tiles * views.len()),
            pairs: 0,
            image: device.empty(pixels * PLANES),
            more: device.empty(pixels * scene.extra_channels),
            ends: device.empty(pixels),
            tally: device.zeros(project::TALLY * views.len()),
            alpha_max: config.alpha_max,
        };
        if entries > 0 {
            pass.project(scene, config);
            let by_depth = pass.by_depth(scene, entries);
            let offsets = pass.offsets(scene, &by_depth, entries);
            let pairs = pass.count_pairs(scene, &offsets, entries)?;
            if pairs * words > device.most_words() {
                if views.len() > 1 {
                    return Ok(None);
                }
                device.check_words("the pairs of Gaussian and tile", pairs * words)?;
            }
            pass.file(scene, &by_depth, &offsets, pairs);
        }
        pass.composite(scene);
        Ok(Some(pass))
    }

    fn project(&self, scene: &GpuScene, config: &RasterConfig) {
        let cubes = scene.count.div_ceil(WIDE) as u32;
        project::project::launch(
            &scene.device.client,
            cubecl::prelude::CubeCount::Static(cubes, self.views as u32, 1),
            cube(WIDE),
            scene.shapes.arg(),
            scene.colours.arg(),
            scene.extra.arg(),
            self.view_words.arg(),
            self.records.arg(),
            self.entries.arg(),
            self.tally.arg(),
            scene.count as u32,
            scene.extra_channels as u32,
            scene.degree,
            config.mode == crate::camera::Mode::Antialiased,
        );
    }

    /// The entries of all views in order of depth.
    fn by_depth(&self, scene: &GpuScene, entries: usize) -> Buffer {
        let device = &scene.device;
        let (keys, values) = (device.empty(entries), device.empty(entries));
        project::depths::launch(
            &device.client,
            grid(entries.div_ceil(WIDE)),
            cube(WIDE),
            self.entries.arg(),
            keys.arg(),
            values.arg(),
            entries as u32,
        );
        device.sort(keys, values, entries, 32).1
    }

    /// First pair of every entry in order of depth, and the number of pairs.
    fn offsets(&self, scene: &GpuScene, by_depth: &Buffer, entries: usize) -> Buffer {
        let device = &scene.device;
        let counts = device.empty(entries);
        project::counts::launch(
            &device.client,
            grid(entries.div_ceil(WIDE)),
            cube(WIDE),
            self.entries.arg(),
            by_depth.arg(),
            counts.arg(),
            entries as u32,
        );
        device.scan(&counts, entries)
    }

    fn count_pairs(&self, scene: &GpuScene, offsets: &Buffer, entries: usize) -> Result<usize> {
        let tally = scene.device.read_u32(&self.tally)?;
        let coarse: u64 = tally.chunks_exact(project::TALLY).map(|view| u64::from(view[3])).sum();
        if coarse <= MOST_PAIRS / 256 {
            return Ok(scene.device.pick(offsets, entries)? as usize);
        }
        // The sums are of 32 bits and may have overflowed; this many do not fit anyway.
        Ok(256 * coarse as usize)
    }

    /// Lays the pairs out in order of depth and sorts them by tile.
    fn file(&mut self, scene: &GpuScene, by_depth: &Buffer, offsets: &Buffer, pairs: usize) {
        if pairs == 0 {
            return;
        }
        let device = &scene.device;
        let client = &device.client;
        let over = |count: usize| grid(count.div_ceil(WIDE));
        let entries = self.views * scene.count;
        let columns = self.width.div_ceil(TILE);
        let tiles = columns * self.height.div_ceil(TILE);
        let (keys, values) = (device.empty(pairs), device.empty(pairs));
        self.pairs = pairs;
        self.pair_record = device.empty(pairs);
        let last_key = (tiles * self.views) as u32;
        project::file::launch(
            client,
            over(entries),
            cube(WIDE),
            self.records.arg(),
            self.entries.arg(),
            by_depth.arg(),
            offsets.arg(),
            keys.arg(),
            values.arg(),
            self.pair_record.arg(),
            self.first_pair.arg(),
            entries as u32,
            scene.count as u32,
            columns as u32,
            tiles as u32,
            last_key,
        );
        let (keys, order) = device.sort(keys, values, pairs, 32 - last_key.leading_zeros());
        self.order = order;
        project::ranges::launch(
            client,
            over(pairs),
            cube(WIDE),
            keys.arg(),
            self.ranges.arg(),
            pairs as u32,
            last_key,
        );
    }

    fn composite(&self, scene: &GpuScene) {
        for first in (0..scene.extra_channels.max(1)).step_by(EXTRA) {
            composite::composite::launch(
                &scene.device.client,
                grid(self.all_tiles()),
                cube(UNITS),
                self.records.arg(),
                scene.extra.arg(),
                self.pair_record.arg(),
                self.order.arg(),
                self.ranges.arg(),
                self.image.arg(),
                self.more.arg(),
                self.ends.arg(),
                self.layout(scene, first),
                first == 0,
                scene.extra_channels > 0,
            );
        }
    }

    pub(crate) fn all_tiles(&self) -> usize {
        self.views * self.width.div_ceil(TILE) * self.height.div_ceil(TILE)
    }

    /// The layout of a pass over extra channels from `first` on.
    pub(crate) fn layout(&self, scene: &GpuScene, first: usize) -> LayoutLaunch {
        let columns = self.width.div_ceil(TILE);
        LayoutLaunch::new(
            columns as u32,
            (columns * self.height.div_ceil(TILE)) as u32,
            self.all_tiles() as u32,
            self.width as u32,
            self.height as u32,
            scene.count as u32,
            scene.extra_channels as u32,
            first as u32,
            EXTRA.min(scene.extra_channels - first.min(scene.extra_channels)) as u32,
            self.alpha_max,
        )
    }

    /// Waits for the images; and the transmittance behind everything, `[views, H, W]`.
    pub(crate) fn images(&self, scene: &GpuScene, config: &RasterConfig) -> Result<(Vec<Render>, Vec<f32>)> {
        let device: &GpuDevice = &scene.device;
        let read = device.read(&[&self.image, &self.more])?;
        let [image, more] = read.as_slice() else {
            return Err(SplatError::gpu("the device returned no image"));
        };
        let tally = device.read_u32(&self.tally)?;
        let channels = scene.extra_channels;
        let pixels = self.width * self.height;
        let renders = (0..self.views)
            .into_par_iter()
            .map(|view| {
                let tally = &tally[project::TALLY * view..];
                let counts = Counts {
                    visible: tally[0] as usize,
                    invalid: tally[1] as usize,
                    tile_entries: tally[2] as usize,
                };
                let image = &image[view * PLANES * pixels..(view + 1) * PLANES * pixels];
                self.render(image, &more[view * channels * pixels..], channels, config, counts)
            })
            .collect();
        let behind = image.chunks_exact(PLANES * pixels).take(self.views);
        let transmittance = behind.flat_map(|planes| &planes[5 * pixels..]).copied().collect();
        Ok((renders, transmittance))
    }

    /// One view's image from its planes.
    fn render(&self, image: &[f32], more: &[f32], channels: usize, config: &RasterConfig, counts: Counts) -> Render {
        let pixels = self.width * self.height;
        let plane = |k: usize| &image[k * pixels..(k + 1) * pixels];
        let (alpha, depth) = (plane(0), plane(4));
        let scales: Vec<f32> = alpha.iter().map(|a| 1.0 / a.max(ALPHA_FLOOR)).collect();
        let mut rgb = vec![0.0; 3 * pixels];
        for k in 0..3 {
            for ((to, from), behind) in rgb[k..].iter_mut().step_by(3).zip(plane(1 + k)).zip(plane(5)) {
                *to = from + behind * config.background[k];
            }
        }
        let (mut sums, mut normalised) = (vec![0.0; channels * pixels], vec![0.0; channels * pixels]);
        for k in 0..channels {
            for pixel in 0..pixels {
                let value = more[k * pixels + pixel];
                sums[channels * pixel + k] = value;
                normalised[channels * pixel + k] = value * scales[pixel];
            }
        }
        Render {
            width: self.width,
            height: self.height,
            extra_channels: channels,
            rgb,
            alpha: alpha.to_vec(),
            depth_accumulated: depth.to_vec(),
            depth_expected: depth.iter().zip(&scales).map(|(d, s)| d * s).collect(),
            extra_accumulated: sums,
            extra: normalised,
            counts,
        }
    }
}
