//! Gradients of renders on the device.

use crate::backward::{Gradients, PoseGradient, RenderGradient};
use crate::camera::{Mode, RasterCamera, RasterConfig};
use crate::error::{Result, SplatError};
use crate::render::Render;

use super::device::{Buffer, cube, grid};
use super::forward::{Pass, for_each_pass};
use super::kernels::chain::CHAIN_UNITS;
use super::kernels::walk::BackgroundLaunch;
use super::kernels::{EXTRA, MOMENTS, POSE, SHAPE, UNITS, WIDE, chain, walk};
use super::scene::GpuScene;

/// What [`backward_views`] needs of a forward pass. It holds the scene as it was then.
pub struct GpuTape {
    scene: GpuScene,
    config: RasterConfig,
    passes: Vec<(Pass, Vec<f32>)>,
    colour_words: usize,
}

/// Renders views and keeps what [`backward_views`] needs. The images are those of [`super::render_views`].
///
/// # Errors
/// As [`super::render_views`].
pub fn render_views_with_tape(
    scene: &GpuScene,
    cameras: &[RasterCamera],
    config: &RasterConfig,
) -> Result<(Vec<Render>, GpuTape)> {
    let mut renders = Vec::with_capacity(cameras.len());
    let mut passes = Vec::new();
    for_each_pass(scene, cameras, config, MOMENTS + scene.extra_channels, |pass| {
        let (images, transmittance) = pass.images(scene, config)?;
        renders.extend(images);
        passes.push((pass, transmittance));
        Ok(())
    })?;
    let tape = GpuTape {
        scene: scene.clone(),
        config: *config,
        passes,
        colour_words: scene.colour_words,
    };
    Ok((renders, tape))
}

/// Gradients of a loss on the views of a tape, summed over the views; the poses' each for itself. Sums run in fixed order:
/// the same call on the same device gives the same bits.
///
/// # Errors
/// When there is not one gradient image per view or its size is wrong, and when the device fails.
pub fn backward_views(tape: &GpuTape, gradients: &[RenderGradient<'_>]) -> Result<(Gradients, Vec<PoseGradient>)> {
    let views: usize = tape.passes.iter().map(|(pass, _)| pass.views).sum();
    SplatError::check("gradient images", gradients.len(), views, "one per view")?;
    let GpuTape { scene, config, .. } = tape;
    let device = &scene.device;
    let geometry = device.zeros(SHAPE * scene.count);
    let colours = device.zeros(tape.colour_words);
    let extra = device.zeros(scene.extra_channels * scene.count);
    let tally = device.zeros(1);
    let mut background = [0.0_f64; 3];
    let mut poses = Vec::with_capacity(views);
    let mut rest = gradients;
    for (pass, transmittance) in &tape.passes {
        let (own, others) = rest.split_at(pass.views);
        rest = others;
        let pixels = pass.width * pass.height;
        for (gradient, behind) in own.iter().zip(transmittance.chunks(pixels)) {
            gradient.validate(pixels, scene.extra_channels)?;
            for (rgb, behind) in gradient.rgb.chunks_exact(3).zip(behind) {
                for k in 0..3 {
                    background[k] += f64::from(*behind) * f64::from(rgb[k]);
                }
            }
        }
        if pass.pairs == 0 {
            poses.resize(poses.len() + pass.views, PoseGradient::default());
            continue;
        }
        let sums = pass.walk(scene, config, own)?;
        let cubes = scene.count.div_ceil(CHAIN_UNITS);
        let partial = device.empty(POSE * cubes * pass.views);
        chain::chain::launch(
            &device.client,
            grid(cubes),
            cube(CHAIN_UNITS),
            scene.shapes.arg(),
            scene.colours.arg(),
            pass.view_words.arg(),
            pass.records.arg(),
            pass.entries.arg(),
            sums.arg(),
            geometry.arg(),
            colours.arg(),
            extra.arg(),
            partial.arg(),
            tally.arg(),
            scene.count as u32,
            pass.views as u32,
            cubes as u32,
            scene.extra_channels as u32,
            scene.degree,
            config.mode == Mode::Antialiased,
        );
        let partial = device.read(&[&partial])?.pop().unwrap_or_default();
        poses.extend(partial.chunks_exact(POSE * cubes).map(pose));
    }
    let read = device.read(&[&geometry, &colours, &extra])?;
    let not_finite = device.read_u32(&tally)?.first().copied().unwrap_or(0) as usize;
    let [geometry, colours, extra] = read.as_slice() else {
        return Err(SplatError::gpu("the device returned no gradients"));
    };
    let columns = |first: usize, width: usize| -> Vec<f32> {
        let rows = geometry.chunks_exact(SHAPE).take(scene.count);
        rows.flat_map(|row| &row[first..first + width]).copied().collect()
    };
    let mut result = Gradients {
        means: columns(0, 3),
        quats: columns(3, 4),
        scales: columns(7, 3),
        opacities: columns(10, 1),
        colour: colours[..tape.colour_words].to_vec(),
        extra: extra[..scene.extra_channels * scene.count].to_vec(),
        background,
        camera_rotation: [0.0; 9],
        camera_translation: [0.0; 3],
        not_finite,
        screen: Vec::new(),
    };
    for pose in &poses {
        for k in 0..9 {
            result.camera_rotation[k] += pose.rotation[k];
        }
        for k in 0..3 {
            result.camera_translation[k] += pose.translation[k];
        }
    }
    Ok((result, poses))
}

/// Adds the cubes' parts, in their order.
fn pose(parts: &[f32]) -> PoseGradient {
    let mut sum = PoseGradient::default();
    for part in parts.chunks_exact(POSE) {
        for k in 0..9 {
            sum.rotation[k] += f64::from(part[k]);
        }
        for k in 0..3 {
            sum.translation[k] += f64::from(part[9 + k]);
        }
    }
    sum
}

impl Pass {
    /// Sums of every entry over its pixels. `[views N, MOMENTS + E]`
    fn walk(&self, scene: &GpuScene, config: &RasterConfig, gradients: &[RenderGradient<'_>]) -> Result<Buffer> {
        let device = &scene.device;
        let client = &device.client;
        let channels = scene.extra_channels;
        let stride = MOMENTS + channels;
        let entries = self.views * scene.count;
        device.check_words("the sums of the pairs of Gaussian and tile", self.pairs * stride)?;
        device.check_words("the sums of the projected Gaussians", entries * stride)?;
        let pixels = self.width * self.height;
        let count = self.views * pixels;
        let mut image = vec![0.0; 6 * count];
        let mut more = vec![0.0; 2 * channels * count];
        for (view, gradient) in gradients.iter().enumerate() {
            let planes = &mut image[view * 6 * pixels..(view + 1) * 6 * pixels];
            transpose(gradient.rgb, 3, &mut planes[..3 * pixels]);
            transpose(gradient.alpha, 1, &mut planes[3 * pixels..4 * pixels]);
            transpose(gradient.depth_accumulated, 1, &mut planes[4 * pixels..5 * pixels]);
            transpose(gradient.depth_expected, 1, &mut planes[5 * pixels..]);
            let planes = &mut more[view * 2 * channels * pixels..(view + 1) * 2 * channels * pixels];
            let (plain, normalised) = planes.split_at_mut(channels * pixels);
            transpose(gradient.extra_accumulated, channels, plain);
            transpose(gradient.extra, channels, normalised);
        }
        let (image, more) = (device.upload(&image), device.upload(&more));
        let by_channel = device.empty((4 + channels) * count);
        let behind = device.empty(count);
        walk::output_layer::launch(
            client,
            grid(count.div_ceil(WIDE)),
            cube(WIDE),
            self.image.arg(),
            self.more.arg(),
            image.arg(),
            more.arg(),
            by_channel.arg(),
            behind.arg(),
            count as u32,
            pixels as u32,
            channels as u32,
            BackgroundLaunch::new(config.background[0], config.background[1], config.background[2]),
        );
        let sums = device.empty(self.pairs * stride);
        for first in (0..channels.max(1)).step_by(EXTRA) {
            walk::walk::launch(
                client,
                grid(self.all_tiles()),
                cube(UNITS),
                self.records.arg(),
                scene.extra.arg(),
                self.pair_record.arg(),
                self.order.arg(),
                self.ranges.arg(),
                self.image.arg(),
                self.ends.arg(),
                by_channel.arg(),
                behind.arg(),
                sums.arg(),
                self.layout(scene, first),
                first == 0,
                channels > 0,
            );
        }
        let by_entry = device.empty(entries * stride);
        chain::gather::launch(
            client,
            grid(entries.div_ceil(WIDE)),
            cube(WIDE),
            self.entries.arg(),
            self.first_pair.arg(),
            self.pair_record.arg(),
            sums.arg(),
            by_entry.arg(),
            entries as u32,
            stride as u32,
        );
        Ok(by_entry)
    }
}

/// `[pixels, channels]` to planes; an empty slice stands for zeros.
fn transpose(values: &[f32], channels: usize, planes: &mut [f32]) {
    if values.is_empty() {
        return;
    }
    let pixels = values.len() / channels;
    for (pixel, values) in values.chunks_exact(channels).enumerate() {
        for (k, value) in values.iter().enumerate() {
            planes[k * pixels + pixel] = *value;
        }
    }
}
