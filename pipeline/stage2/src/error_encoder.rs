//! The frozen error encoder: what differs between a render and its observation, per pixel (`docs/spec/stage2.md` B.4).

use rayon::prelude::*;

use super::RefinerConfig;
use super::mv_attention::{FACTOR, MultiViewAttention};
use super::resnet::{FeatureMaps, ResNetFront, checked};
use crate::{Error, Result};
use rogs_kernels::{FeatureMap, LayerNorm, Linear, ROWS_PER_PIECE};
use rogs_tensors::parameters::Parameters;

/// Colour error `render - observed` in the layout of its projection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColourLayout {
    /// Three channels per pixel, features at image resolution. The layout of the paper's refiner.
    Pixels,
    /// 4x4 pixels per token, 48 channels `c * 16 + dy * 4 + dx`, features at a quarter of the resolution. The layout of
    /// the released models with one Gaussian per 16 pixels.
    Blocks,
}

impl ColourLayout {
    /// Input channels of the projection.
    #[must_use]
    pub fn channels(self) -> usize {
        3 * self.side() * self.side()
    }

    fn side(self) -> usize {
        match self {
            Self::Pixels => 1,
            Self::Blocks => FACTOR,
        }
    }
}

/// ResNet features, colour projection and multi-view attention.
#[derive(Debug, Clone)]
pub struct ErrorEncoder {
    layout: ColourLayout,
    features: usize,
    front: ResNetFront,
    colour: Linear,
    colour_norm: LayerNorm,
    attention: MultiViewAttention,
}

impl ErrorEncoder {
    /// Reads the frozen parameters of a configuration.
    ///
    /// # Errors
    /// When a parameter is missing or has another shape.
    pub fn load(parameters: &Parameters, config: &RefinerConfig) -> Result<Self> {
        Self::load_layout(parameters, config.feature_widths, ColourLayout::Pixels)
    }

    /// The same for either layout of the colour error.
    ///
    /// # Errors
    /// When a parameter is missing or has another shape.
    pub fn load_layout(parameters: &Parameters, widths: [usize; 2], layout: ColourLayout) -> Result<Self> {
        let features = 2 * widths[0] + widths[1];
        let get =
            |name: &str, shape: &[usize]| checked(parameters, &format!("encoder.update_rgb_error_proj.{name}"), shape);
        let inputs = layout.channels();
        let (weight, bias) = (get("0.weight", &[features, inputs])?, get("0.bias", &[features])?);
        Ok(Self {
            layout,
            features,
            front: ResNetFront::load(parameters, "encoder.update_feature", widths)?,
            colour: Linear::new(&weight, Some(bias), inputs, features),
            colour_norm: LayerNorm {
                weight: get("1.weight", &[features])?,
                bias: get("1.bias", &[features])?,
            },
            attention: MultiViewAttention::load(parameters, "encoder.update_error_attn.0", features)?,
        })
    }

    /// Channels F of the error features.
    #[must_use]
    pub fn features(&self) -> usize {
        self.features
    }

    /// The feature maps of an image; those of the observed images are computed once per clip.
    ///
    /// # Errors
    /// When it is not an RGB image.
    pub fn feature_maps(&self, image: &FeatureMap) -> Result<FeatureMaps> {
        self.front.forward(image)
    }

    /// Error features of the cameras of one source time.
    ///
    /// `renders` and `observed` are RGB images of one size, `observed_maps` the feature maps of `observed`. The result
    /// has one map of `F` channels a camera, at image resolution (a quarter of it in the block layout).
    ///
    /// # Errors
    /// When the images disagree in number or size.
    pub fn forward(
        &self,
        renders: &[FeatureMap],
        observed: &[FeatureMap],
        observed_maps: &[FeatureMaps],
    ) -> Result<Vec<FeatureMap>> {
        let mut views = self.before_attention(renders, observed, observed_maps)?;
        let (height, width) = (views[0].height, views[0].width);
        let padded = (height.next_multiple_of(FACTOR), width.next_multiple_of(FACTOR));
        if padded == (height, width) {
            self.attention.forward(&mut views)?;
            return Ok(views);
        }
        let mut views: Vec<FeatureMap> = views.into_iter().map(|view| with_size(view, padded)).collect();
        self.attention.forward(&mut views)?;
        Ok(views.into_iter().map(|view| with_size(view, (height, width))).collect())
    }

    /// Feature difference plus projected colour error: the error features before the attention between views.
    ///
    /// # Errors
    /// As [`Self::forward`].
    pub fn before_attention(
        &self,
        renders: &[FeatureMap],
        observed: &[FeatureMap],
        observed_maps: &[FeatureMaps],
    ) -> Result<Vec<FeatureMap>> {
        let side = self.layout.side();
        let size = |image: &FeatureMap| (image.height, image.width, image.channels, image.data.len());
        let Some(first) = renders.first().map(size) else {
            return Err(Error::BadInput("the error encoder needs at least one camera".into()));
        };
        let (height, width) = (first.0, first.1);
        let fits = renders
            .iter()
            .chain(observed)
            .all(|image| size(image) == (height, width, 3, height * width * 3));
        if !fits || renders.len() != observed.len() || renders.len() != observed_maps.len() {
            return Err(Error::BadInput(
                "renders and observed images must be RGB images of one size, one of each per camera".into(),
            ));
        }
        if !height.is_multiple_of(side) || !width.is_multiple_of(side) || height * width == 0 {
            return Err(Error::BadInput(format!(
                "this layout needs images with sides that are multiples of {side}: {height} x {width}"
            )));
        }
        let (rows, columns) = (height / side, width / side);
        let view = |((render, observed), maps): ((&FeatureMap, &FeatureMap), &FeatureMaps)| -> Result<FeatureMap> {
            let error = self.colour_error(render, observed);
            let mut out = FeatureMap::zeros(rows, columns, self.features);
            let pieces = out.data.par_chunks_mut(ROWS_PER_PIECE * self.features);
            pieces
                .zip(error.par_chunks(ROWS_PER_PIECE * self.layout.channels()))
                .for_each(|(out, error)| {
                    self.colour.apply(error, out);
                    self.colour_norm.apply(out);
                });
            // Resizing is linear: the difference is taken before it.
            self.front
                .forward(render)?
                .minus(maps)
                .add_concatenated(rows, columns, &mut out.data);
            Ok(out)
        };
        renders.iter().zip(observed).zip(observed_maps).map(view).collect()
    }

    /// Input of the colour projection. `[tokens, 3 * side^2]`
    #[must_use]
    pub fn colour_error(&self, render: &FeatureMap, observed: &FeatureMap) -> Vec<f32> {
        let mut difference = render.data.clone();
        difference
            .iter_mut()
            .zip(&observed.data)
            .for_each(|(render, observed)| *render -= observed);
        let side = self.layout.side();
        if side == 1 {
            return difference;
        }
        let width = render.width;
        let mut out = Vec::with_capacity(difference.len());
        for row in 0..render.height / side {
            for column in 0..width / side {
                for channel in 0..3 {
                    for cell in 0..side * side {
                        let (y, x) = (row * side + cell / side, column * side + cell % side);
                        out.push(difference[(y * width + x) * 3 + channel]);
                    }
                }
            }
        }
        out
    }
}

/// The map cut, or continued by its last row and column, at the bottom and right.
fn with_size(mut map: FeatureMap, (height, width): (usize, usize)) -> FeatureMap {
    if width == map.width {
        // Rows are contiguous: nothing moves.
        let line = width * map.channels;
        map.data.truncate(height * line);
        while map.data.len() < height * line {
            map.data.extend_from_within(map.data.len() - line..);
        }
        return FeatureMap { height, ..map };
    }
    let mut out = FeatureMap::zeros(height, width, map.channels);
    let c = map.channels;
    let copied = width.min(map.width) * c;
    out.data.par_chunks_mut(width * c).enumerate().for_each(|(row, line)| {
        let source = &map.data[row.min(map.height - 1) * map.width * c..][..map.width * c];
        line[..copied].copy_from_slice(&source[..copied]);
        for pixel in line[copied..].chunks_exact_mut(c) {
            pixel.copy_from_slice(&source[(map.width - 1) * c..]);
        }
    });
    out
}
