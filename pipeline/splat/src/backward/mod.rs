//! Gradients of a render with respect to everything that went in (`docs/spec/rasteriser.md` section 9), hand-written.
//!
//! The backward pass walks each tile's list from back to front. With `R` the colour behind a Gaussian, seen through the
//! gradient image and normalised by the transmittance there, `dL/dalpha = T (q - R)` and `R` moves by `alpha (q - R)`:
//! no division by `1 - alpha` except to recover `T`. Each tile sums into slots of its own; the slots of a Gaussian are
//! added in tile order, and cameras in index order, so that every number of threads gives the same bits.

mod chain;
mod tile;
mod views;

pub use views::{PoseGradient, backward_views, render_views_with_tape};

use crate::camera::{ALPHA_FLOOR, RasterCamera, RasterConfig, View};
use crate::error::{Result, SplatError};
use crate::gaussians::Gaussians;
use crate::project::{CHUNK, Projection};
use crate::render::{Render, TileOutput};
use crate::simd::{LANES, dispatch};
use crate::tile::{EXTRA, Extra};

/// What the backward pass needs of a forward pass.
pub struct Tape {
    view: View,
    projection: Projection,
    tiles: Vec<TileOutput>,
    gaussians: usize,
    extra_channels: usize,
}

/// Gradient of a loss with respect to the outputs of a render; an empty slice stands for zeros.
#[derive(Debug, Clone, Copy, Default)]
pub struct RenderGradient<'a> {
    /// `[H, W, 3]`
    pub rgb: &'a [f32],
    /// `[H, W]`
    pub alpha: &'a [f32],
    /// `[H, W]`
    pub depth_accumulated: &'a [f32],
    /// `[H, W]`
    pub depth_expected: &'a [f32],
    /// `[H, W, E]`
    pub extra_accumulated: &'a [f32],
    /// `[H, W, E]`, the normalised extra channels
    pub extra: &'a [f32],
}

/// Gradient of a loss with respect to the inputs of a render, laid out as these. Gaussians that were dropped have zeros.
#[derive(Debug, Clone, PartialEq)]
pub struct Gradients {
    /// `[N, 3]`
    pub means: Vec<f32>,
    /// `[N, 4]`, with respect to the quaternions as given (not normalised)
    pub quats: Vec<f32>,
    /// `[N, 3]`
    pub scales: Vec<f32>,
    /// `[N]`
    pub opacities: Vec<f32>,
    /// As the values of [`crate::Colour`].
    pub colour: Vec<f32>,
    /// `[N, E]`
    pub extra: Vec<f32>,
    /// With respect to the background colour.
    pub background: [f64; 3],
    /// With respect to the nine numbers of the camera's rotation matrix, as if they were free.
    pub camera_rotation: [f64; 9],
    /// With respect to the camera's translation.
    pub camera_translation: [f64; 3],
    /// Gaussians whose gradient left the range of f32 and was replaced by zeros.
    pub not_finite: usize,
    /// With respect to the centres in the image, pixels; empty unless [`backward_with_screen`] was asked. `[N, 2]`
    pub screen: Vec<f32>,
}

impl Gradients {
    /// Zeros for a scene.
    #[must_use]
    pub fn zeros(gaussians: &Gaussians) -> Self {
        Self {
            means: vec![0.0; gaussians.means.len()],
            quats: vec![0.0; gaussians.quats.len()],
            scales: vec![0.0; gaussians.scales.len()],
            opacities: vec![0.0; gaussians.opacities.len()],
            colour: vec![0.0; gaussians.colour.values().len()],
            extra: vec![0.0; gaussians.extra.len()],
            background: [0.0; 3],
            camera_rotation: [0.0; 9],
            camera_translation: [0.0; 3],
            not_finite: 0,
            screen: Vec::new(),
        }
    }
}

impl Tape {
    /// Indices of the Gaussians that reach the image, ascending.
    #[must_use]
    pub fn visible(&self) -> Vec<u32> {
        let chunks = self.projection.chunks.iter().enumerate();
        chunks
            .flat_map(|(chunk, bins)| &self.projection.records[chunk * CHUNK..chunk * CHUNK + bins.visible])
            .map(|record| record.gaussian)
            .collect()
    }

    /// Number of Gaussians that contribute to each pixel. `[H, W]`
    #[must_use]
    pub fn contributors(&self) -> Vec<u32> {
        let mut counts = vec![0; self.view.width * self.view.height];
        for tile in &self.tiles {
            tile.for_each_pixel(|row, column, index, _| {
                counts[row * self.view.width + column] = tile.contributors[index];
            });
        }
        counts
    }
}

/// Renders one view and keeps what [`backward`] needs. The image is that of [`crate::render()`], bit for bit.
///
/// # Errors
/// As [`crate::render()`].
pub fn render_with_tape(gaussians: &Gaussians, camera: &RasterCamera, config: &RasterConfig) -> Result<(Render, Tape)> {
    let (mut renders, mut tapes) = render_views_with_tape(gaussians, std::slice::from_ref(camera), config)?;
    match (renders.pop(), tapes.pop()) {
        (Some(render), Some(tape)) => Ok((render, tape)),
        _ => Err(SplatError::Setting {
            what: "one view was asked for, none was rendered",
            value: String::new(),
        }),
    }
}

/// Gradients of one view. `gaussians` and `config` must be those of the forward pass.
///
/// # Errors
/// When the gradient images or the scene do not fit the forward pass.
pub fn backward(
    gaussians: &Gaussians,
    config: &RasterConfig,
    tape: &Tape,
    gradient: &RenderGradient<'_>,
) -> Result<Gradients> {
    Ok(backward_views(gaussians, config, std::slice::from_ref(tape), &[*gradient])?.0)
}

/// As [`backward`], with the gradients with respect to the centres in the image ([`Gradients::screen`]).
///
/// # Errors
/// As [`backward`].
pub fn backward_with_screen(
    gaussians: &Gaussians,
    config: &RasterConfig,
    tape: &Tape,
    gradient: &RenderGradient<'_>,
) -> Result<Gradients> {
    let mut sum = Gradients {
        screen: vec![0.0; 2 * gaussians.len()],
        ..Gradients::zeros(gaussians)
    };
    views::add(
        gaussians,
        config,
        std::slice::from_ref(tape),
        &[*gradient],
        true,
        &mut sum,
    )?;
    Ok(sum)
}

/// As [`backward`], added to gradients that are there already (of other views). The camera gradients add up too: keep
/// one [`Gradients`] per camera where they are wanted, or use [`backward_views`].
///
/// # Errors
/// As [`backward`].
pub fn backward_into(
    gaussians: &Gaussians,
    config: &RasterConfig,
    tape: &Tape,
    gradient: &RenderGradient<'_>,
    into: &mut Gradients,
) -> Result<()> {
    views::add(gaussians, config, std::slice::from_ref(tape), &[*gradient], false, into)?;
    Ok(())
}

impl RenderGradient<'_> {
    pub(crate) fn validate(&self, pixels: usize, extra_channels: usize) -> Result<()> {
        let check = |array, values: &[f32], channels: usize| {
            if values.is_empty() {
                return Ok(());
            }
            SplatError::check(array, values.len(), channels * pixels, "the size of the rendered image")
        };
        check("gradient of rgb", self.rgb, 3)?;
        check("gradient of alpha", self.alpha, 1)?;
        check("gradient of the accumulated depth", self.depth_accumulated, 1)?;
        check("gradient of the expected depth", self.depth_expected, 1)?;
        check(
            "gradient of the accumulated extra channels",
            self.extra_accumulated,
            extra_channels,
        )?;
        check("gradient of the extra channels", self.extra, extra_channels)
    }
}

/// Moments per slot before the extra channels: `sum dp (1, l, dy, l l, l dy, dy dy)` with `dp = alpha dL/dalpha` and
/// `l = la dx + lb dy`, then the gradients of red, green, blue and z.
const MOMENTS: usize = 10;

struct Pass<'a> {
    gaussians: &'a Gaussians,
    config: &'a RasterConfig,
    tape: &'a Tape,
    gradient: &'a RenderGradient<'a>,
}

impl Pass<'_> {
    /// Moments and extra channels of one row.
    fn stride(&self) -> usize {
        MOMENTS + self.tape.extra_channels
    }

    /// Fills the rows of a tile; returns the gradient of the background.
    fn tile(&self, tile: &TileOutput, touched: &tile::Touched, rows: &mut [f32]) -> [f64; 3] {
        let channels = self.tape.extra_channels;
        let (pixels, background) = self.output_layer(tile);
        for first in (0..channels.max(1)).step_by(EXTRA) {
            let count = EXTRA.min(channels - first.min(channels));
            let extra = Extra {
                values: &self.gaussians.extra,
                channels,
                first,
                count,
            };
            if count > 0 {
                self.walk::<EXTRA>(tile, touched, extra, &pixels, rows);
            } else {
                self.walk::<0>(tile, touched, extra, &pixels, rows);
            }
        }
        background
    }

    fn walk<const X: usize>(
        &self,
        tile: &TileOutput,
        touched: &tile::Touched,
        extra: Extra<'_>,
        pixels: &PixelGradient,
        rows: &mut [f32],
    ) {
        let kernel = tile::Walk::<'_, X> {
            tile,
            touched,
            records: &self.tape.projection.records,
            extra,
            alpha_max: self.config.alpha_max,
            pixels,
            rows,
        };
        dispatch(self.config.simd, kernel);
    }

    /// Section 9.1: gradients with respect to the accumulated channels, and the start of the walk.
    fn output_layer(&self, tile: &TileOutput) -> (PixelGradient, [f64; 3]) {
        let Self {
            config, tape, gradient, ..
        } = self;
        let channels = tape.extra_channels;
        let length = tile.area.blocks() * LANES;
        let mut pixels = PixelGradient {
            channels: vec![0.0; (4 + channels) * length],
            behind: vec![0.0; length],
        };
        let mut background = [0.0; 3];
        let at = |values: &[f32], index: usize| if values.is_empty() { 0.0 } else { values[index] };
        tile.for_each_pixel(|row, column, index, stride| {
            let pixel = row * tape.view.width + column;
            let alpha = tile.sums[index];
            let floored = alpha.max(ALPHA_FLOOR);
            let inverse = 1.0 / floored;
            let above = if alpha > ALPHA_FLOOR { 1.0 } else { 0.0 };
            let mut g_alpha = at(gradient.alpha, pixel);
            let mut normalised = |plain: f32, expected: f32, sum: f32| {
                g_alpha -= above * expected * sum * inverse * inverse;
                plain + expected * inverse
            };
            let v = &mut pixels.channels;
            v[3 * stride + index] = normalised(
                at(gradient.depth_accumulated, pixel),
                at(gradient.depth_expected, pixel),
                tile.sums[4 * stride + index],
            );
            for k in 0..channels {
                v[(4 + k) * stride + index] = normalised(
                    at(gradient.extra_accumulated, pixel * channels + k),
                    at(gradient.extra, pixel * channels + k),
                    tile.sums[(5 + k) * stride + index],
                );
            }
            let mut behind = -g_alpha;
            for k in 0..3 {
                let g = at(gradient.rgb, 3 * pixel + k);
                v[k * stride + index] = g;
                behind += g * config.background[k];
                background[k] += f64::from(tile.transmittance[index]) * f64::from(g);
            }
            pixels.behind[index] = behind;
        });
        (pixels, background)
    }

    /// The tiles' rows of a chunk's records, added in tile order: `[records, MOMENTS + E]`.
    fn sums(&self, touched: &[tile::Touched], mut rows: &[f32], chunk: usize, sums: &mut Vec<f32>) {
        let stride = self.stride();
        sums.clear();
        sums.resize(self.tape.projection.chunks[chunk].visible * stride, 0.0);
        for tile in touched {
            let (own, others) = rows.split_at(tile.records.len() * stride);
            rows = others;
            let range = tile.chunks[chunk] as usize..tile.chunks[chunk + 1] as usize;
            let from = own[range.start * stride..range.end * stride].chunks_exact(stride);
            for (&record, from) in tile.records[range].iter().zip(from) {
                let local = record as usize - chunk * CHUNK;
                let to = &mut sums[local * stride..(local + 1) * stride];
                for (to, from) in to.iter_mut().zip(from) {
                    *to += from;
                }
            }
        }
    }
}

/// Gradient image of a tile.
struct PixelGradient {
    /// With respect to the accumulated red, green, blue, z and extra channels, each `[blocks * 16]`.
    channels: Vec<f32>,
    /// `R` behind the last Gaussian: the background seen through the gradient. `[blocks * 16]`
    behind: Vec<f32>,
}
