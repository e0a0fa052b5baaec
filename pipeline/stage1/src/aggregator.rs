//! Camera and time conditioning, and the alternating frame and global blocks (`docs/spec/stage1.md` sections 4 and 5).

use burn::tensor::Tensor;

use super::config::{POSE_NUMBERS, Stage1Config};
use super::frames::Attention;
use super::geometry::{NetworkCamera, encode_time, ray_maps};
use super::positions::token_positions;
use crate::{Error, Result};
use rogs_kernels::{Precision, RotaryTable};
use rogs_tensors::ops::{self, Linear, Rotary};
use rogs_tensors::parameters::{Parameters, from_host};
use rogs_vit::{Block, BlockKind, patch_projection};

/// What the blocks of a clip need to know about its tokens.
pub struct TokenLayout {
    rotary: Rotary,
    groups: Vec<Vec<usize>>,
}

/// Group norm epsilon of the ray embedding.
const RAY_EPSILON: f64 = 1e-5;

/// The aggregator over the parameters of a network. Blocks are read when they run.
pub struct Aggregator<'a> {
    parameters: &'a Parameters,
    config: &'a Stage1Config,
    precision: Precision,
}

impl<'a> Aggregator<'a> {
    /// The aggregator of a network.
    #[must_use]
    pub fn new(parameters: &'a Parameters, config: &'a Stage1Config) -> Self {
        Self {
            parameters,
            config,
            precision: Precision::F32,
        }
    }

    /// The same with matrix products of other numbers.
    #[must_use]
    pub fn with_precision(self, precision: Precision) -> Self {
        Self { precision, ..self }
    }

    /// Patch projection of the cameras' ray maps. `[S, N, C]`
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn ray_embedding(&self, cameras: &[NetworkCamera], [height, width]: [usize; 2]) -> Result<Tensor<3>> {
        let maps = ray_maps(cameras, [height, width], self.parameters.device());
        let (channels, patch) = (self.config.width, self.config.patch);
        let scope = self.parameters.scope("backbone.plucker_embed.net");
        let weight = scope
            .get("weight", [channels, 6, 1, patch, patch])?
            .reshape([channels, 6, patch, patch]);
        Ok(patch_projection(maps, weight, scope.get("bias", [channels])?))
    }

    /// Group norm with one group over all frames, patches and channels of the clip. `[S, N, C] -> [S, N, C]`
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn normalise_rays(&self, rays: Tensor<3>) -> Result<Tensor<3>> {
        let width = self.config.width;
        let scope = self.parameters.scope("backbone.plucker_ln");
        let (weight, bias) = (scope.get("weight", [width])?, scope.get("bias", [width])?);
        let count = rays.dims().iter().product::<usize>();
        let mean = |values: Tensor<3>| ops::row_means(values.reshape([1, count])).reshape([1, 1, 1]);
        let centred = rays.clone() - mean(rays);
        let variance: Tensor<3> = mean(centred.clone().powf_scalar(2.0));
        Ok(centred / (variance + RAY_EPSILON).sqrt() * weight.unsqueeze() + bias.unsqueeze())
    }

    /// Tokens entering the first frame block: time, pose, camera, registers, patches. `[S, N, C] -> [S, T, C]`
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn tokens(&self, patches: Tensor<3>, cameras: &[NetworkCamera], times: &[f32]) -> Result<Tensor<3>> {
        let Stage1Config { width, registers, .. } = *self.config;
        let (scope, device, frames) = (
            self.parameters.scope("backbone.backbone"),
            self.parameters.device(),
            cameras.len(),
        );
        let encodings: Vec<f32> = times
            .iter()
            .flat_map(|&time| encode_time(time, self.config.time_frequencies))
            .collect();
        let encodings = from_host(encodings, [frames, self.config.time_numbers()], device);
        let time = Linear::load(&scope.child("time_embed"), width, self.config.time_numbers())?.forward(encodings);
        let numbers = cameras.iter().flat_map(NetworkCamera::pose_numbers).collect();
        let numbers = from_host(numbers, [frames, POSE_NUMBERS], device);
        let pose = Linear::load(&scope.child("extra_embed"), width, POSE_NUMBERS)?.forward(numbers);
        let camera = scope.get("camera_token", [1, 2, 1, width])?.squeeze_dim::<3>(0);
        let register = scope
            .get("register_token", [1, 2, registers, width])?
            .squeeze_dim::<3>(0);
        let slotted = Tensor::cat(vec![camera, register], 1);
        let mut slots = vec![slotted.clone().narrow(0, 0, 1)];
        if frames > 1 {
            slots.push(slotted.narrow(0, 1, 1).repeat(&[frames - 1, 1, 1]));
        }
        Ok(Tensor::cat(
            vec![
                time.unsqueeze_dim(1),
                pose.unsqueeze_dim(1),
                Tensor::cat(slots, 0),
                patches,
            ],
            1,
        ))
    }

    /// Runs all pairs and returns the outputs of the tapped ones, concatenated (frame, global). `[S, T, C] -> 4 x [S, T, 2C]`
    ///
    /// # Errors
    /// When a tensor is missing or has another shape, or the blocking does not name every frame's camera.
    pub fn forward(&self, tokens: Tensor<3>, grid: [usize; 2], attention: &Attention) -> Result<[Tensor<3>; 4]> {
        let layout = self.layout(tokens.dims()[0], grid, attention)?;
        let mut tokens = tokens;
        let mut taps = Vec::with_capacity(4);
        for pair in 0..=self.config.taps[3] {
            let [frame, global] = self.pair(pair, tokens, &layout)?;
            if self.config.taps.contains(&pair) {
                taps.push(Tensor::cat(vec![frame, global.clone()], 2));
            }
            tokens = global;
        }
        let short = |_| Error::BadConfiguration("fewer than four taps".into());
        taps.try_into().map_err(short)
    }

    /// Where the tokens of a clip stand, and which frames attend to each other.
    ///
    /// # Errors
    /// When the blocking does not name every frame's camera.
    pub fn layout(&self, frames: usize, grid: [usize; 2], attention: &Attention) -> Result<TokenLayout> {
        Ok(TokenLayout {
            rotary: self.rotary(grid),
            groups: self.groups(frames, attention)?,
        })
    }

    /// Runs one pair: the outputs of its frame block and of its global block. `[S, T, C] -> 2 x [S, T, C]`
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn pair(&self, index: usize, tokens: Tensor<3>, layout: &TokenLayout) -> Result<[Tensor<3>; 2]> {
        let frame = self.block("frame_blocks", index)?.forward(tokens, Some(&layout.rotary));
        let global = self.global(index, frame.clone(), &layout.rotary, &layout.groups)?;
        Ok([frame, global])
    }

    /// Rotary table of one frame's tokens.
    #[must_use]
    pub fn rotary(&self, grid: [usize; 2]) -> Rotary {
        let positions = token_positions(self.config.patch_start(), grid);
        Rotary::new(
            RotaryTable::new(&positions, self.config.head_size()),
            self.parameters.device(),
        )
    }

    /// Block `index` of `frame_blocks` or `global_blocks`.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn block(&self, list: &str, index: usize) -> Result<Block> {
        let scope = self.parameters.scope(&format!("backbone.backbone.{list}.{index}"));
        let kind = BlockKind::AGGREGATOR.with(self.precision);
        Block::load(&scope, kind, self.config.width, self.config.heads)
    }

    /// Global block `pair` within each group of frames. `[S, T, C] -> [S, T, C]`
    fn global(&self, pair: usize, tokens: Tensor<3>, rotary: &Rotary, groups: &[Vec<usize>]) -> Result<Tensor<3>> {
        let [frames, count, width] = tokens.dims();
        let block = self.block("global_blocks", pair)?;
        if let [_] = groups {
            let joint = tokens.reshape([1, frames * count, width]);
            return Ok(block
                .forward(joint, Some(&rotary.repeated(frames)))
                .reshape([frames, count, width]));
        }
        let mut outputs: Vec<Option<Tensor<3>>> = vec![None; frames];
        for group in groups {
            let members = group.iter().map(|&frame| tokens.clone().narrow(0, frame, 1)).collect();
            let joint = Tensor::cat(members, 0).reshape([1, group.len() * count, width]);
            let mixed = block
                .forward(joint, Some(&rotary.repeated(group.len())))
                .reshape([group.len(), count, width]);
            for (member, &frame) in group.iter().enumerate() {
                outputs[frame] = Some(mixed.clone().narrow(0, member, 1));
            }
        }
        Ok(Tensor::cat(outputs.into_iter().flatten().collect(), 0))
    }

    /// Frames that attend to each other, in order of first appearance.
    fn groups(&self, frames: usize, attention: &Attention) -> Result<Vec<Vec<usize>>> {
        let Attention::WithinCamera(cameras) = attention else {
            return Ok(vec![(0..frames).collect()]);
        };
        if cameras.len() != frames {
            let given = cameras.len();
            return Err(Error::BadInput(format!(
                "cross-camera blocking names the cameras of {given} frames, the clip has {frames}"
            )));
        }
        let mut groups: Vec<(u32, Vec<usize>)> = Vec::new();
        for (frame, &camera) in cameras.iter().enumerate() {
            match groups.iter_mut().find(|(known, _)| *known == camera) {
                Some((_, members)) => members.push(frame),
                None => groups.push((camera, vec![frame])),
            }
        }
        Ok(groups.into_iter().map(|(_, members)| members).collect())
    }
}
