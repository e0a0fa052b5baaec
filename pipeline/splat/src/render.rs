//! Rendering of a scene: projection, tiles, image.

use rayon::prelude::*;
use rogs_schemas::units::m_from_iu;

use crate::camera::{ALPHA_FLOOR, RasterCamera, RasterConfig, View};
use crate::error::{Result, SplatError};
use crate::gaussians::Gaussians;
use crate::order::TileList;
use crate::project::{Projection, for_each_view};
use crate::simd::{LANES, dispatch};
use crate::tile::{BLOCK, BlockState, Composite, EXTRA, Extra, MAX_BLOCKS, Recorded, TileArea};

/// A rendered view.
#[derive(Debug, Clone, PartialEq)]
pub struct Render {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Number of extra channels.
    pub extra_channels: usize,
    /// Colour over the background. `[H, W, 3]`
    pub rgb: Vec<f32>,
    /// Accumulated opacity. `[H, W]`
    pub alpha: Vec<f32>,
    /// Sum of weight times camera z, in the unit of the Gaussians. `[H, W]`
    pub depth_accumulated: Vec<f32>,
    /// Accumulated depth over accumulated opacity; 0 where nothing was hit. `[H, W]`
    pub depth_expected: Vec<f32>,
    /// Weighted sums of the extra channels. `[H, W, E]`
    pub extra_accumulated: Vec<f32>,
    /// Extra channels over accumulated opacity; 0 where nothing was hit. `[H, W, E]`
    pub extra: Vec<f32>,
    /// What became of the Gaussians.
    pub counts: Counts,
}

impl Render {
    /// The colours as 8-bit pixels, clipped to 0..1 and rounded. `[H, W, 3]`
    #[must_use]
    pub fn rgb_bytes(&self) -> Vec<u8> {
        let byte = |value: &f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
        self.rgb.iter().map(byte).collect()
    }

    /// Expected depth in metres of a render in internal units. `[H, W]`
    #[must_use]
    pub fn depth_expected_m(&self) -> Vec<f32> {
        self.depth_expected.iter().map(|&d| m_from_iu(d)).collect()
    }
}

/// What became of the Gaussians of a render.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Gaussians that reach a tile of the image. Of those that graze its pixels, smaller tiles leave out more.
    pub visible: usize,
    /// Gaussians dropped because a value is not a finite number, a scale or opacity is negative, the quaternion is
    /// zero, a colour or extra channel is beyond 1e30, or the projection left the range of f32.
    pub invalid: usize,
    /// Pairs of a Gaussian and a tile that it reaches.
    pub tile_entries: usize,
}

/// Renders one view.
///
/// # Errors
/// When arrays, camera or settings make no sense. Bad values of single Gaussians are not errors: these are dropped and
/// counted in [`Counts::invalid`].
pub fn render(gaussians: &Gaussians, camera: &RasterCamera, config: &RasterConfig) -> Result<Render> {
    match render_views(gaussians, std::slice::from_ref(camera), config)?.pop() {
        Some(render) => Ok(render),
        None => Err(SplatError::Setting {
            what: "one view was asked for, none was rendered",
            value: String::new(),
        }),
    }
}

/// Renders several views of one scene, in the order of the cameras. Views share the threads and, a few at a time, the
/// work on each Gaussian that does not depend on the camera. The images are those of [`render`], bit for bit.
///
/// # Errors
/// As [`render`]; the first view with an error.
pub fn render_views(gaussians: &Gaussians, cameras: &[RasterCamera], config: &RasterConfig) -> Result<Vec<Render>> {
    let views = check_views(gaussians, cameras, config)?;
    for_each_view(gaussians, &views, config, |_, view, projection| {
        let work = Work {
            gaussians,
            view,
            config,
            projection: &projection,
            eligible: &|_| false,
        };
        Ok(work.image(&work.tiles::<false, false>()))
    })
}

/// Checks all inputs of a render and prepares the cameras.
pub(crate) fn check_views(gaussians: &Gaussians, cameras: &[RasterCamera], config: &RasterConfig) -> Result<Vec<View>> {
    gaussians.validate()?;
    config.validate()?;
    cameras
        .iter()
        .map(|camera| camera.validate().map(|()| View::new(camera)))
        .collect()
}

/// One view being rendered.
pub(crate) struct Work<'a> {
    pub(crate) gaussians: &'a Gaussians,
    pub(crate) view: &'a View,
    pub(crate) config: &'a RasterConfig,
    pub(crate) projection: &'a Projection,
    pub(crate) eligible: &'a (dyn Fn(u32) -> bool + Sync),
}

/// A composited tile.
pub(crate) struct TileOutput {
    pub(crate) area: TileArea,
    /// Transmittance behind everything. `[blocks * 16]`
    pub(crate) transmittance: Vec<f32>,
    /// Weight sum, red, green, blue, z, extra channels, each `[blocks * 16]`.
    pub(crate) sums: Vec<f32>,
    /// Per pixel: place behind the last contributor, number of contributors; empty without trace. `[blocks * 16]`
    pub(crate) end: Vec<u32>,
    pub(crate) contributors: Vec<u32>,
    /// The list, kept with trace or contributions.
    pub(crate) list: TileList,
    pub(crate) recorded: Recorded,
}

impl Work<'_> {
    /// Composites all tiles, in tile order.
    pub(crate) fn tiles<const TRACE: bool, const CONTRIBUTE: bool>(&self) -> Vec<TileOutput> {
        let tiles = self.projection.grid.tiles();
        (0..tiles)
            .into_par_iter()
            .map_init(TileList::default, |list, tile| {
                self.tile::<TRACE, CONTRIBUTE>(list, tile)
            })
            .collect()
    }

    fn tile<const TRACE: bool, const CONTRIBUTE: bool>(&self, list: &mut TileList, tile: usize) -> TileOutput {
        let Self {
            gaussians,
            view,
            config,
            projection,
            eligible,
        } = *self;
        let grid = &projection.grid;
        let area = TileArea::new(tile, grid.columns, grid.tile, view.width, view.height);
        list.fill(projection, tile);
        let channels = gaussians.extra_channels;
        let pixels = area.blocks() * LANES;
        let mut output = TileOutput {
            area,
            transmittance: Vec::with_capacity(pixels),
            sums: vec![0.0; (5 + channels) * pixels],
            end: Vec::new(),
            contributors: Vec::new(),
            list: TileList::default(),
            recorded: Recorded::default(),
        };
        let mut blocks = [BlockState::new(crate::simd::Lanes::ZERO); MAX_BLOCKS];
        for first in (0..channels.max(1)).step_by(EXTRA) {
            let count = EXTRA.min(channels - first.min(channels));
            let extra = Extra {
                values: &gaussians.extra,
                channels,
                first,
                count,
            };
            let common = (
                list as &TileList,
                &projection.records as &[crate::project::Projected],
                config.alpha_max,
                eligible,
            );
            if first > 0 {
                // The same weights again for further channels; what is recorded is recorded once.
                let mut unused = Recorded::default();
                self.composite::<EXTRA, false, false>(common, extra, area, &mut blocks, &mut unused);
            } else if count == 0 {
                self.composite::<0, TRACE, CONTRIBUTE>(common, extra, area, &mut blocks, &mut output.recorded);
            } else {
                self.composite::<EXTRA, TRACE, CONTRIBUTE>(common, extra, area, &mut blocks, &mut output.recorded);
            }
            output.take(&blocks[..area.blocks()], first, count, TRACE);
        }
        if TRACE || CONTRIBUTE {
            output.list = list.take();
        }
        output
    }

    fn composite<const X: usize, const TRACE: bool, const CONTRIBUTE: bool>(
        &self,
        (list, records, alpha_max, eligible): Common<'_>,
        extra: Extra<'_>,
        area: TileArea,
        blocks: &mut [BlockState; MAX_BLOCKS],
        recorded: &mut Recorded,
    ) {
        let kernel = Composite::<'_, X, TRACE, CONTRIBUTE> {
            list,
            records,
            extra,
            area,
            alpha_max,
            eligible,
            blocks,
            recorded,
        };
        dispatch(self.config.simd, kernel);
    }

    /// Puts the tiles together.
    pub(crate) fn image(&self, tiles: &[TileOutput]) -> Render {
        let (width, height) = (self.view.width, self.view.height);
        let extra_channels = self.gaussians.extra_channels;
        let pixels = width * height;
        let mut render = Render {
            width,
            height,
            extra_channels,
            rgb: vec![0.0; 3 * pixels],
            alpha: vec![0.0; pixels],
            depth_accumulated: vec![0.0; pixels],
            depth_expected: vec![0.0; pixels],
            extra_accumulated: vec![0.0; extra_channels * pixels],
            extra: vec![0.0; extra_channels * pixels],
            counts: Counts {
                visible: self.projection.visible,
                invalid: self.projection.invalid,
                tile_entries: self.projection.chunks.iter().map(|c| c.keys.len()).sum(),
            },
        };
        let background = self.config.background;
        for tile in tiles {
            tile.for_each_pixel(|row, column, index, stride| {
                let pixel = row * width + column;
                let sum = |k: usize| tile.sums[k * stride + index];
                let alpha = sum(0);
                let scale = 1.0 / alpha.max(ALPHA_FLOOR);
                for k in 0..3 {
                    render.rgb[3 * pixel + k] = sum(1 + k) + tile.transmittance[index] * background[k];
                }
                render.alpha[pixel] = alpha;
                render.depth_accumulated[pixel] = sum(4);
                render.depth_expected[pixel] = sum(4) * scale;
                for k in 0..extra_channels {
                    render.extra_accumulated[extra_channels * pixel + k] = sum(5 + k);
                    render.extra[extra_channels * pixel + k] = sum(5 + k) * scale;
                }
            });
        }
        render
    }
}

type Common<'a> = (
    &'a TileList,
    &'a [crate::project::Projected],
    f32,
    &'a (dyn Fn(u32) -> bool + Sync),
);

impl TileOutput {
    fn take(&mut self, blocks: &[BlockState], first: usize, count: usize, trace: bool) {
        let pixels = blocks.len() * LANES;
        for (block, state) in blocks.iter().enumerate() {
            let at = block * LANES;
            if first == 0 {
                self.transmittance.extend_from_slice(&state.transmittance.0);
                self.sums[at..at + LANES].copy_from_slice(&state.opacity.0);
                for k in 0..4 {
                    let at = (1 + k) * pixels + at;
                    self.sums[at..at + LANES].copy_from_slice(&state.sums[k].0);
                }
                if trace {
                    self.end.extend_from_slice(&state.end);
                    self.contributors.extend_from_slice(&state.contributors);
                }
            }
            for k in 0..count {
                let at = (5 + first + k) * pixels + at;
                self.sums[at..at + LANES].copy_from_slice(&state.sums[4 + k].0);
            }
        }
    }

    /// Calls `f(row, column, index, stride)` for every pixel of the image in this tile; `index` is its place in the
    /// per-pixel arrays, `stride` the length of one channel.
    pub(crate) fn for_each_pixel(&self, mut f: impl FnMut(usize, usize, usize, usize)) {
        let area = &self.area;
        let stride = area.blocks() * LANES;
        for y in 0..area.height {
            for x in 0..area.width {
                let block = (y / BLOCK) * area.blocks_x + x / BLOCK;
                let lane = (y % BLOCK) * BLOCK + x % BLOCK;
                f(area.y + y, area.x + x, block * LANES + lane, stride);
            }
        }
    }
}
