//! The operation against the rasteriser itself, against differences, and in an optimisation.

use burn::tensor::{Device, Tensor, TensorData};
use rogs_splat::{
    Colour, Gaussians, RasterCamera, RasterConfig, RenderGradient, backward_views, render_views_with_tape,
};

use super::*;

/// Small generator of uniform numbers (SplitMix64).
struct Rng(u64);

impl Rng {
    fn uniform(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1_u64 << 24) as f32
    }

    fn between(&mut self, count: usize, low: f32, high: f32) -> Vec<f32> {
        (0..count).map(|_| low + (high - low) * self.uniform()).collect()
    }
}

fn scene(count: usize, degree: Option<usize>, extra_channels: usize, seed: u64) -> Gaussians {
    let mut rng = Rng(seed);
    let mut means = rng.between(3 * count, -0.9, 0.9);
    means.iter_mut().skip(2).step_by(3).for_each(|z| *z += 3.0);
    let colour = match degree {
        None => Colour::Rgb(rng.between(3 * count, 0.0, 1.0)),
        Some(degree) => Colour::Sh {
            degree,
            coefficients: rng.between(3 * count * (degree + 1) * (degree + 1), -0.4, 0.6),
        },
    };
    Gaussians {
        means,
        quats: rng.between(4 * count, -1.0, 1.0),
        scales: rng.between(3 * count, 0.08, 0.3),
        opacities: rng.between(count, 0.2, 0.8),
        colour,
        extra: rng.between(extra_channels * count, -1.0, 1.0),
        extra_channels,
    }
}

fn cameras() -> [RasterCamera; 2] {
    let camera = RasterCamera {
        width: 30,
        height: 22,
        fx: 28.0,
        fy: 27.0,
        cx: 15.5,
        cy: 10.5,
        rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        translation: [0.0; 3],
    };
    // Turned about the vertical axis by an angle whose sine and cosine f32 holds exactly enough.
    let (c, s) = (f64::from(0.96_f32), f64::from(0.28_f32));
    [
        camera,
        RasterCamera {
            rotation: [c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c],
            translation: [-0.75, 0.125, 0.25],
            ..camera
        },
    ]
}

/// A tensor of values; with gradients on a device that records them.
fn tensor<const D: usize>(values: &[f32], shape: [usize; D], device: &Device) -> Tensor<D> {
    let tensor = Tensor::from_data(TensorData::new(values.to_vec(), shape), device);
    if device.is_autodiff() {
        tensor.require_grad()
    } else {
        tensor
    }
}

fn tensors(scene: &Gaussians, device: &Device) -> GaussianTensors {
    let count = scene.len();
    GaussianTensors {
        means: tensor(&scene.means, [count, 3], device),
        rotations: tensor(&scene.quats, [count, 4], device),
        scales: tensor(&scene.scales, [count, 3], device),
        opacities: tensor(&scene.opacities, [count], device),
        colours: match &scene.colour {
            Colour::Rgb(rgb) => ColourTensor::Rgb(tensor(rgb, [count, 3], device)),
            Colour::Sh { degree, coefficients } => {
                ColourTensor::Sh(tensor(coefficients, [count, (degree + 1) * (degree + 1), 3], device))
            }
        },
        extra: (scene.extra_channels > 0).then(|| tensor(&scene.extra, [count, scene.extra_channels], device)),
    }
}

fn poses(cameras: &[RasterCamera], device: &Device) -> Tensor<3> {
    let numbers: Vec<f32> = cameras
        .iter()
        .flat_map(|camera| {
            (0..12).map(|k| match k % 4 {
                3 => camera.translation[k / 4],
                column => camera.rotation[3 * (k / 4) + column],
            } as f32)
        })
        .collect();
    tensor(&numbers, [cameras.len(), 3, 4], device)
}

fn values<const D: usize>(tensor: &Tensor<D>) -> Vec<f32> {
    tensor.clone().into_data().try_into_vec::<f32>().unwrap()
}

fn gradient<const D: usize>(tensor: &Tensor<D>, graph: &burn::tensor::Gradients) -> Vec<f32> {
    values(&tensor.grad(graph).unwrap())
}

/// Weights of a linear loss: colour, opacity, depth, extra channels of two views.
struct Weights([Vec<f32>; 4]);

impl Weights {
    fn new(pixels: usize, extra_channels: usize, seed: u64) -> Self {
        let mut rng = Rng(seed);
        Self([3, 1, 1, extra_channels].map(|channels| rng.between(2 * pixels * channels, -1.0, 1.0)))
    }

    fn loss(&self, views: &RenderedViews, device: &Device) -> Tensor<1> {
        let [rgb, alpha, depth, extra] = &self.0;
        let constant =
            |values: &[f32]| Tensor::<1>::from_data(TensorData::new(values.to_vec(), [values.len()]), device);
        let mut loss = (views.rgb.clone().reshape([rgb.len()]) * constant(rgb)).sum()
            + (views.alpha.clone().reshape([alpha.len()]) * constant(alpha)).sum()
            + (views.depth.clone().reshape([depth.len()]) * constant(depth)).sum();
        if let Some(channels) = &views.extra {
            loss = loss + (channels.clone().reshape([extra.len()]) * constant(extra)).sum();
        }
        loss
    }

    /// The loss in float64 from plain renders.
    fn plain(&self, scene: &Gaussians, cameras: &[RasterCamera]) -> f64 {
        let renders = rogs_splat::render_views(scene, cameras, &config()).unwrap();
        let all = |part: fn(&rogs_splat::Render) -> &[f32]| renders.iter().flat_map(move |r| part(r).iter());
        let dot = |weights: &[f32], values: &mut dyn Iterator<Item = &f32>| -> f64 {
            weights
                .iter()
                .zip(values)
                .map(|(w, v)| f64::from(*w) * f64::from(*v))
                .sum()
        };
        dot(&self.0[0], &mut all(|r| &r.rgb))
            + dot(&self.0[1], &mut all(|r| &r.alpha))
            + dot(&self.0[2], &mut all(|r| &r.depth_expected))
            + dot(&self.0[3], &mut all(|r| &r.extra))
    }
}

fn config() -> RasterConfig {
    RasterConfig {
        background: [0.25, 0.5, 0.125],
        ..RasterConfig::default()
    }
}

#[test]
fn gradients_are_the_hand_written_ones() {
    for (degree, extra_channels) in [(None, 3), (Some(2), 0), (Some(0), 5)] {
        let scene = scene(40, degree, extra_channels, 3);
        let cameras = cameras();
        let device = Device::flex().autodiff();
        let inputs = tensors(&scene, &device);
        let poses = poses(&cameras, &device);
        let views = render_views(&inputs, &cameras, Some(&poses), &config()).unwrap();
        let pixels = cameras[0].pixels();
        let weights = Weights::new(pixels, extra_channels, 5);
        let graph = weights.loss(&views, &device).backward();

        let (renders, tapes) = render_views_with_tape(&scene, &cameras, &config()).unwrap();
        let rendered: Vec<f32> = renders.iter().flat_map(|r| r.rgb.iter().copied()).collect();
        assert_eq!(values(&views.rgb), rendered);
        assert_eq!(views.counts, renders.iter().map(|r| r.counts).collect::<Vec<_>>());
        assert!(views.counts.iter().all(|counts| counts.visible > 20));
        let images: Vec<RenderGradient<'_>> = (0..2)
            .map(|view| {
                let of = |part: usize, channels: usize| {
                    &weights.0[part][view * pixels * channels..(view + 1) * pixels * channels]
                };
                RenderGradient {
                    rgb: of(0, 3),
                    alpha: of(1, 1),
                    depth_expected: of(2, 1),
                    extra: of(3, extra_channels),
                    ..RenderGradient::default()
                }
            })
            .collect();
        let (direct, pose_gradients) = backward_views(&scene, &config(), &tapes, &images).unwrap();
        assert_eq!(gradient(&inputs.means, &graph), direct.means);
        assert_eq!(gradient(&inputs.rotations, &graph), direct.quats);
        assert_eq!(gradient(&inputs.scales, &graph), direct.scales);
        assert_eq!(gradient(&inputs.opacities, &graph), direct.opacities);
        assert!(direct.means.iter().any(|g| *g != 0.0));
        let colours = match &inputs.colours {
            ColourTensor::Rgb(rgb) => gradient(rgb, &graph),
            ColourTensor::Sh(coefficients) => gradient(coefficients, &graph),
        };
        assert_eq!(colours, direct.colour);
        if let Some(extra) = &inputs.extra {
            assert_eq!(gradient(extra, &graph), direct.extra);
        }
        for (got, want) in gradient(&poses, &graph).chunks_exact(12).zip(&pose_gradients) {
            for k in 0..3 {
                assert_eq!(got[4 * k + 3], want.translation[k] as f32);
                for column in 0..3 {
                    assert_eq!(got[4 * k + column], want.rotation[3 * k + column] as f32);
                }
            }
        }
    }
}

#[test]
fn gradients_agree_with_differences_along_random_directions() {
    // The alpha cut and the depth order make steps in the loss: wide Gaussians, one behind the other.
    let mut base = scene(12, None, 2, 17);
    let mut rng = Rng(29);
    base.scales = rng.between(36, 1.3, 2.5);
    base.opacities = rng.between(12, 0.1, 0.4);
    for (index, mean) in base.means.chunks_exact_mut(3).enumerate() {
        (mean[0], mean[1], mean[2]) = (0.3 * mean[0], 0.3 * mean[1], 2.0 + 0.2 * index as f32);
    }
    let cameras = cameras();
    let device = Device::flex().autodiff();
    let inputs = tensors(&base, &device);
    let poses = poses(&cameras, &device);
    let weights = Weights::new(cameras[0].pixels(), 2, 19);
    let views = render_views(&inputs, &cameras, Some(&poses), &config()).unwrap();
    let graph = weights.loss(&views, &device).backward();
    let ColourTensor::Rgb(colours) = &inputs.colours else {
        panic!("a scene of plain colours")
    };
    let gradients = [
        gradient(&inputs.means, &graph),
        gradient(&inputs.rotations, &graph),
        gradient(&inputs.scales, &graph),
        gradient(&inputs.opacities, &graph),
        gradient(colours, &graph),
        gradient(inputs.extra.as_ref().unwrap(), &graph),
        gradient(&poses, &graph),
    ];
    for (part, gradients) in gradients.iter().enumerate() {
        let direction = rng.between(gradients.len(), -1.0, 1.0);
        // Partly along the gradient, so that the slope is far above the rounding of the renders.
        let direction: Vec<f32> = direction.iter().zip(gradients).map(|(d, g)| d + g.signum()).collect();
        let slope: f64 = direction
            .iter()
            .zip(gradients)
            .map(|(d, g)| f64::from(*d) * f64::from(*g))
            .sum();
        let step = 2e-3_f32;
        let moved = |sign: f32| {
            let (mut scene, mut cameras) = (base.clone(), cameras);
            let add = |values: &mut [f32]| {
                values
                    .iter_mut()
                    .zip(&direction)
                    .for_each(|(v, d)| *v += sign * step * d);
            };
            match part {
                0 => add(&mut scene.means),
                1 => add(&mut scene.quats),
                2 => add(&mut scene.scales),
                3 => add(&mut scene.opacities),
                4 => match &mut scene.colour {
                    Colour::Rgb(values)
                    | Colour::Sh {
                        coefficients: values, ..
                    } => add(values),
                },
                5 => add(&mut scene.extra),
                _ => {
                    for (camera, direction) in cameras.iter_mut().zip(direction.chunks_exact(12)) {
                        for k in 0..12 {
                            let delta = f64::from(sign * step * direction[k]);
                            match k % 4 {
                                3 => camera.translation[k / 4] += delta,
                                column => camera.rotation[3 * (k / 4) + column] += delta,
                            }
                        }
                    }
                }
            }
            weights.plain(&scene, &cameras)
        };
        let numeric = (moved(1.0) - moved(-1.0)) / (2.0 * f64::from(step));
        println!("input {part}: {slope} and {numeric}");
        assert!(
            (slope - numeric).abs() < 0.02 * slope.abs(),
            "input {part}: gradient {slope}, difference {numeric}"
        );
    }
}

#[test]
fn an_optimisation_finds_colours_and_places() {
    let target = scene(50, None, 0, 31);
    let cameras = cameras();
    let device = Device::flex().autodiff();
    let plain = Device::flex();
    let wanted = render_views(&tensors(&target, &plain), &cameras, None, &config()).unwrap();
    let wanted: Tensor<4> = Tensor::from_data(wanted.rgb.into_data(), &device);
    let mut rng = Rng(37);
    let shifts = rng.between(target.means.len(), -0.1, 0.1);
    let mut means: Vec<f32> = target.means.iter().zip(shifts).map(|(m, d)| m + d).collect();
    let mut colours = vec![0.5_f32; target.means.len()];
    let mut losses = Vec::new();
    for _ in 0..60 {
        let mut inputs = tensors(&target, &device);
        inputs.means = tensor(&means, [50, 3], &device);
        let rgb = tensor(&colours, [50, 3], &device);
        inputs.colours = ColourTensor::Rgb(rgb.clone());
        let views = render_views(&inputs, &cameras, None, &config()).unwrap();
        let loss = (views.rgb - wanted.clone()).powi_scalar(2).mean();
        losses.push(values(&loss)[0]);
        let graph = loss.backward();
        for (value, g) in means.iter_mut().zip(gradient(&inputs.means, &graph)) {
            *value -= 2.0 * g;
        }
        for (value, g) in colours.iter_mut().zip(gradient(&rgb, &graph)) {
            *value -= 40.0 * g;
        }
    }
    let (first, last) = (losses[0], losses[losses.len() - 1]);
    println!("loss {first} -> {last}");
    assert!(last < 0.1 * first, "loss {first} -> {last}");
}

#[test]
fn bytes_do_not_depend_on_threads_or_on_what_is_tracked() {
    let scene = scene(3000, Some(1), 3, 41);
    let cameras = cameras();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let device = Device::flex().autodiff();
            let inputs = tensors(&scene, &device);
            let views = render_views(&inputs, &cameras, None, &config()).unwrap();
            let graph = Weights::new(cameras[0].pixels(), 3, 43)
                .loss(&views, &device)
                .backward();
            let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect::<Vec<_>>();
            [
                bits(values(&views.rgb)),
                bits(values(&views.extra.unwrap())),
                bits(gradient(&inputs.means, &graph)),
                bits(gradient(&inputs.rotations, &graph)),
                bits(gradient(&inputs.opacities, &graph)),
            ]
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(8), "threads show");
    let untracked = render_views(&tensors(&scene, &Device::flex()), &cameras, None, &config()).unwrap();
    let bits: Vec<u32> = values(&untracked.rgb).into_iter().map(f32::to_bits).collect();
    assert!(bits == one[0], "recording gradients shows in the image");
    // Only the opacities are learned: constants on a plain device mix with them.
    let mut mixed = tensors(&scene, &Device::flex());
    mixed.opacities = tensor(&scene.opacities, [3000], &Device::flex().autodiff());
    let views = render_views(&mixed, &cameras, None, &config()).unwrap();
    let graph = Weights::new(cameras[0].pixels(), 3, 43)
        .loss(&views, &Device::flex().autodiff())
        .backward();
    let bits: Vec<u32> = gradient(&mixed.opacities, &graph)
        .into_iter()
        .map(f32::to_bits)
        .collect();
    assert!(bits == one[4], "constants change a gradient");
}

#[test]
fn an_empty_scene_is_background() {
    let empty = scene(0, None, 2, 1);
    let device = Device::flex().autodiff();
    let inputs = tensors(&empty, &device);
    let views = render_views(&inputs, &cameras(), None, &config()).unwrap();
    assert!(
        values(&views.rgb)
            .chunks_exact(3)
            .all(|pixel| pixel == [0.25, 0.5, 0.125])
    );
    let graph = views.rgb.sum().backward();
    assert!(gradient(&inputs.means, &graph).is_empty());
}

#[test]
fn what_does_not_fit_is_refused_with_a_reason() {
    let scene = scene(5, None, 0, 1);
    let device = Device::flex();
    let good = tensors(&scene, &device);
    let message = |gaussians: &GaussianTensors, cameras: &[RasterCamera], config: &RasterConfig| {
        render_views(gaussians, cameras, None, config).unwrap_err().to_string()
    };
    let mut bad = good.clone();
    bad.scales = Tensor::zeros([5, 2], &device);
    assert!(message(&bad, &cameras(), &config()).contains("scales"));
    let mut bad = good.clone();
    bad.colours = ColourTensor::Sh(Tensor::zeros([5, 5, 3], &device));
    assert!(message(&bad, &cameras(), &config()).contains("1, 4, 9 or 16"));
    assert!(message(&good, &[], &config()).contains("at least one camera"));
    let mut sizes = cameras();
    sizes[1].width += 1;
    assert!(message(&good, &sizes, &config()).contains("each size"));
    let mut sizes = cameras();
    sizes[0].fx = f64::NAN;
    assert!(message(&good, &sizes, &config()).contains("focal"));
    let wrong = RasterConfig { near: -1.0, ..config() };
    assert!(message(&good, &cameras(), &wrong).contains("near"));
    // Values that no camera has can come in by the poses.
    let nan = Tensor::<3>::full([2, 3, 4], f32::NAN, &device);
    let error = render_views(&good, &cameras(), Some(&nan), &config()).unwrap_err();
    assert!(error.to_string().contains("finite"), "{error}");
}
