//! The network: tokens, transformer and heads (`docs/spec/baseline-4dgt.md` sections 3 to 5).

use burn::tensor::Tensor;
use rayon::prelude::*;
use rogs_kernels::Precision;
use rogs_schemas::records::polynomial::Polynomials;
use rogs_tensors::ops::{LayerNorm, Linear};
use rogs_tensors::parameters::{Parameters, Scope, from_host, to_host};
use rogs_vit::{Block, BlockKind, EncoderSizes, ImageEncoder};

use crate::config::{FourDgtConfig, HEADS, INPUTS, PATCH};
use crate::decode::{RawFrame, RawHeads, decode};
use crate::rays::{RayCamera, Rays, patch_numbers};
use crate::{Error, Result};

/// Epsilon of the layer norms outside of blocks.
const EPSILON: f64 = 1e-5;

/// What the network sees of one camera: images of whole patches, all of one size.
pub struct Stream {
    /// RGB in 0 to 1, planar, one frame after the other. `[T, 3, H, W]`
    pub images: Vec<f32>,
    /// Seconds since the first clip frame. `[T]`
    pub times_s: Vec<f32>,
    /// Cameras in their mean frame. `[T]`
    pub cameras: Vec<RayCamera>,
}

/// The network: sizes, and the parameters it runs with.
pub struct FourDgt {
    /// Sizes.
    pub config: FourDgtConfig,
    /// Weights.
    pub parameters: Parameters,
    /// Sizes of the image encoder.
    pub encoder: EncoderSizes,
    /// Weights of the image encoder.
    pub encoder_parameters: Parameters,
    /// Numbers of the matrix products; f32 unless set.
    pub precision: Precision,
}

impl FourDgt {
    /// A network over parameters.
    ///
    /// # Errors
    /// When the configuration is not possible, or the encoder is not the one that it takes tokens of.
    pub fn new(
        config: FourDgtConfig,
        parameters: Parameters,
        encoder: EncoderSizes,
        encoder_parameters: Parameters,
    ) -> Result<Self> {
        config.validate()?;
        if encoder.width != config.encoder_width || encoder.patch != PATCH {
            return Err(Error::BadConfiguration(format!(
                "the image encoder has {} channels for patches of {} pixels; 4DGT needs {} and {PATCH}",
                encoder.width, encoder.patch, config.encoder_width
            )));
        }
        Ok(Self {
            config,
            parameters,
            encoder,
            encoder_parameters,
            precision: Precision::F32,
        })
    }

    /// One Gaussian of every pixel, in the mean frame of the cameras. Row `(t * H + row) * W + column`
    ///
    /// # Errors
    /// When a tensor is missing or has another shape, or the stream does not fit together.
    pub fn lift(&self, stream: &Stream) -> Result<Polynomials> {
        let size = stream.check()?;
        let heads = {
            let tokens = self.tokens(stream, self.features(stream)?)?;
            self.heads(self.transform(tokens)?)?
        };
        let frame = |(index, camera): (usize, &RayCamera)| {
            let raw = RawFrame::new(&heads, index, size);
            decode(&raw, &Rays::new(camera), stream.times_s[index])
        };
        let frames: Vec<Polynomials> = stream.cameras.par_iter().enumerate().map(frame).collect();
        let mut field = Polynomials::default();
        frames.into_iter().for_each(|frame| field.append(frame));
        Ok(field)
    }

    /// What the image encoder says of the patches, before its last norm. Images go in as they are, in -1 to 1.
    /// `[T, N, encoder width]`
    ///
    /// # Errors
    /// As [`Self::lift`].
    pub fn features(&self, stream: &Stream) -> Result<Tensor<3>> {
        let [height, width] = stream.check()?;
        let scope = self.encoder_parameters.scope("");
        let encoder = ImageEncoder::new(scope, self.encoder).with_precision(self.precision);
        let images = stream.images.iter().map(|value| value * 2.0 - 1.0).collect();
        let shape = [stream.cameras.len(), 3, height, width];
        encoder.before_norm(from_host(images, shape, self.encoder_parameters.device()))
    }

    /// What enters the first block, without the class token. `features [T, N, encoder width] -> [1, T * N, C]`
    ///
    /// # Errors
    /// As [`Self::lift`].
    pub fn tokens(&self, stream: &Stream, features: Tensor<3>) -> Result<Tensor<3>> {
        let tokens = self.projected(stream, features)?;
        let norm = LayerNorm::scaling(&self.scope("concat_norm"), self.config.width, EPSILON)?;
        Ok(norm.forward(tokens))
    }

    /// The projection of patches and features. `[1, T * N, C]`
    ///
    /// # Errors
    /// As [`Self::lift`].
    pub fn projected(&self, stream: &Stream, features: Tensor<3>) -> Result<Tensor<3>> {
        let size = stream.check()?;
        let area = size[0] * size[1];
        let mut numbers = Vec::with_capacity(stream.cameras.len() * INPUTS * area);
        for (index, camera) in stream.cameras.iter().enumerate() {
            let image = &stream.images[index * 3 * area..][..3 * area];
            let plucker = Rays::new(camera).plucker(size[1]);
            numbers.extend(patch_numbers(image, stream.times_s[index], &plucker, size));
        }
        let tokens = stream.cameras.len() * area / (PATCH * PATCH);
        let numbers = from_host(numbers, [1, tokens, INPUTS * PATCH * PATCH], self.parameters.device());
        let features = features.reshape([1, tokens, self.config.encoder_width]);
        let weight = self
            .scope("input_linear")
            .get("weight", [self.config.width, self.config.patch_numbers()])?;
        // Channel by channel, then the features: a sum of all numbers in a row loses digits that the heads make visible.
        let channel = PATCH * PATCH;
        let part = |input: Tensor<3>, first: usize| {
            let columns = weight.clone().narrow(1, first, input.dims()[2]);
            Linear::new(columns, None).with_precision(self.precision).forward(input)
        };
        let sum = |sum: Tensor<3>, index: usize| {
            let first = index * channel;
            sum + part(numbers.clone().narrow(2, first, channel), first)
        };
        Ok((0..INPUTS).fold(part(features, INPUTS * channel), sum))
    }

    /// The class token behind the others, and all blocks. `[1, T * N, C] -> [1, T * N, C]`, after the last norm
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn transform(&self, tokens: Tensor<3>) -> Result<Tensor<3>> {
        let count = tokens.dims()[1];
        let mut tokens = self.with_class(tokens)?;
        for index in 0..self.config.blocks {
            tokens = self.block(index)?.forward(tokens, None);
        }
        let norm = LayerNorm::load(&self.scope("norm"), self.config.width, EPSILON)?;
        Ok(norm.forward(tokens).narrow(1, 0, count))
    }

    /// The class token behind the others. `[1, T * N, C] -> [1, T * N + 1, C]`
    ///
    /// # Errors
    /// When it is missing or has another shape.
    pub fn with_class(&self, tokens: Tensor<3>) -> Result<Tensor<3>> {
        let class = self.parameters.get("cls_token", [1, 1, self.config.width])?;
        Ok(Tensor::cat(vec![tokens, class], 1))
    }

    /// Block `index`.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn block(&self, index: usize) -> Result<Block> {
        let kind = BlockKind::FOUR_DGT.with(self.precision);
        Block::load(
            &self.scope(&format!("blocks.{index}")),
            kind,
            self.config.width,
            self.config.heads,
        )
    }

    /// What the heads say of every patch. `[1, T * N, C]`
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn heads(&self, tokens: Tensor<3>) -> Result<RawHeads> {
        let mut raw: RawHeads = Default::default();
        for ((name, channels), raw) in HEADS.into_iter().zip(&mut raw) {
            let hidden = channels * self.config.head_hidden;
            let layer = |index: usize, outputs: usize, inputs: usize| -> Result<Linear> {
                let scope = self.scope(&format!("linear_heads.{name}.{index}"));
                Ok(Linear::load_unbiased(&scope, outputs, inputs)?.with_precision(self.precision))
            };
            let first = layer(0, hidden, self.config.width)?.forward_gelu(tokens.clone());
            let second = layer(2, hidden, hidden)?.forward_gelu(first);
            *raw = to_host(layer(4, channels * PATCH * PATCH, hidden)?.forward(second))?;
        }
        Ok(raw)
    }

    fn scope(&self, name: &str) -> Scope<'_> {
        self.parameters.scope(name)
    }
}

impl Stream {
    /// Height and width of the images.
    ///
    /// # Errors
    /// When arrays do not fit together, or images are not whole patches.
    pub fn check(&self) -> Result<[usize; 2]> {
        let first = self
            .cameras
            .first()
            .ok_or_else(|| Error::BadInput("no images: expected at least one".into()))?;
        let size = [first.lens.height as usize, first.lens.width as usize];
        let same = |camera: &RayCamera| [camera.lens.height as usize, camera.lens.width as usize] == size;
        let frames = self.cameras.len();
        let fits = self.images.len() == frames * 3 * size[0] * size[1] && self.times_s.len() == frames;
        if !fits || !self.cameras.iter().all(same) {
            return Err(Error::BadInput(format!(
                "{frames} cameras of {}x{} pixels come with {} numbers of images and {} times",
                size[0],
                size[1],
                self.images.len(),
                self.times_s.len()
            )));
        }
        if size.iter().any(|&side| side == 0 || !side.is_multiple_of(PATCH)) {
            return Err(Error::BadInput(format!(
                "images of {}x{} pixels are not a whole number of {PATCH}-pixel patches",
                size[0], size[1]
            )));
        }
        Ok(size)
    }
}
