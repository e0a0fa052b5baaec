//! Rendering of any Gaussians from any camera: no panic, nothing that is not a number, bad Gaussians dropped and counted.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rogs_splat::{
    Colour, Eligible, Gaussians, Mode, RasterCamera, RasterConfig, RenderGradient, SimdLevel, backward, render,
    render_with_contributions, render_with_tape,
};

/// Most Gaussians of a scene and pixels of a side: many small scenes find more than few large ones.
const MOST: usize = 48;
const SIDE: u32 = 40;

/// Reads numbers from the input; zeros when it is used up.
struct Input<'a>(&'a [u8]);

impl Input<'_> {
    fn byte(&mut self) -> u8 {
        match self.0.split_first() {
            Some((first, rest)) => {
                self.0 = rest;
                *first
            }
            None => 0,
        }
    }

    /// Any bit pattern, or (by far more often) a number of ordinary size around `centre`.
    fn number(&mut self, centre: f32, spread: f32) -> f32 {
        let kind = self.byte();
        match kind {
            0 => f32::from_bits(u32::from_le_bytes([self.byte(), self.byte(), self.byte(), self.byte()])),
            1 => [0.0, -0.0, 1e-45, 1e-38, 1e-20, 1e20, 3e38, f32::MAX][usize::from(self.byte() % 8)],
            _ => centre + spread * (f32::from(kind) / 128.0 - 1.0 + f32::from(self.byte()) / 32_768.0),
        }
    }

    fn numbers(&mut self, count: usize, centre: f32, spread: f32) -> Vec<f32> {
        (0..count).map(|_| self.number(centre, spread)).collect()
    }
}

/// Whether the rules say at once that a Gaussian cannot be drawn from anywhere.
fn senseless(scene: &Gaussians, index: usize) -> bool {
    let part = |values: &[f32], per: usize| values[per * index..per * (index + 1)].to_vec();
    let colours = part(scene.colour.values(), scene.colour.values_per_gaussian());
    let extra = part(&scene.extra, scene.extra_channels);
    let scales = part(&scene.scales, 3);
    let shape = [
        part(&scene.means, 3),
        part(&scene.quats, 4),
        scales.clone(),
        part(&scene.opacities, 1),
    ]
    .concat();
    shape.iter().chain(&colours).chain(&extra).any(|v| !v.is_finite())
        || scales.iter().any(|s| *s < 0.0)
        || scene.opacities[index] < 0.0
        || part(&scene.quats, 4).iter().all(|q| *q == 0.0)
}

fuzz_target!(|bytes: &[u8]| {
    let mut input = Input(bytes);
    let flags = input.byte();
    let count = usize::from(input.byte()) % (MOST + 1);
    let degree = usize::from(flags & 7).checked_sub(1).filter(|degree| *degree < 4);
    let extra_channels = [0, 1, 3, 6][usize::from(flags >> 3 & 3)];
    let colours = count * degree.map_or(3, |degree| 3 * (degree + 1) * (degree + 1));
    let camera = RasterCamera {
        width: u32::from(input.byte()) % SIDE,
        height: u32::from(input.byte()) % SIDE,
        fx: f64::from(input.number(30.0, 29.0)),
        fy: f64::from(input.number(30.0, 29.0)),
        cx: f64::from(input.number(16.0, 16.0)),
        cy: f64::from(input.number(16.0, 16.0)),
        rotation: if flags & 32 == 0 {
            [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
        } else {
            std::array::from_fn(|_| f64::from(input.number(0.0, 1.0)))
        },
        translation: std::array::from_fn(|_| f64::from(input.number(0.0, 1.0))),
    };
    let config = RasterConfig {
        mode: if flags & 64 == 0 {
            Mode::Classic
        } else {
            Mode::Antialiased
        },
        eps2d: if flags & 128 == 0 { 0.3 } else { input.number(0.3, 0.3) },
        background: std::array::from_fn(|_| input.number(0.5, 0.5)),
        near: if flags & 128 == 0 {
            0.001
        } else {
            input.number(0.5, 0.5)
        },
        ..RasterConfig::default()
    };
    let scene = Gaussians {
        means: input.numbers(3 * count, 1.0, 3.0),
        quats: input.numbers(4 * count, 0.0, 1.0),
        scales: input.numbers(3 * count, 0.2, 0.21),
        opacities: input.numbers(count, 0.5, 0.5),
        colour: match degree {
            Some(degree) => Colour::Sh {
                degree,
                coefficients: input.numbers(colours, 0.0, 1.0),
            },
            None => Colour::Rgb(input.numbers(colours, 0.5, 0.5)),
        },
        extra: input.numbers(count * extra_channels, 0.0, 1.0),
        extra_channels,
    };

    let image = match render(&scene, &camera, &config) {
        Ok(image) => image,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return;
        }
    };
    let finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
    assert!(finite(&image.rgb) && finite(&image.alpha) && finite(&image.depth_expected));
    assert!(finite(&image.depth_accumulated) && finite(&image.extra) && finite(&image.extra_accumulated));
    assert!(image.alpha.iter().all(|a| (0.0..=1.0).contains(a)));
    let bad = (0..count).filter(|&index| senseless(&scene, index)).count();
    assert!(
        image.counts.invalid >= bad,
        "{} counted, {bad} bad",
        image.counts.invalid
    );
    assert!(image.counts.invalid + image.counts.visible <= count);

    // Neither tiles nor instructions show.
    let other = RasterConfig {
        tile_size: 4,
        simd: SimdLevel::Portable,
        ..config
    };
    let mut same = render(&scene, &camera, &other).expect("the same scene");
    // Who reaches a tile depends on the tiles; the image does not.
    same.counts.visible = image.counts.visible;
    same.counts.tile_entries = image.counts.tile_entries;
    assert_eq!(image, same);

    let (taped, tape) = render_with_tape(&scene, &camera, &config).expect("the same scene");
    assert_eq!(image, taped);
    let ones = vec![1.0; camera.pixels() * extra_channels.max(3)];
    let gradient = RenderGradient {
        rgb: &ones[..3 * camera.pixels()],
        alpha: &ones[..camera.pixels()],
        depth_expected: &ones[..camera.pixels()],
        extra: &ones[..camera.pixels() * extra_channels],
        ..RenderGradient::default()
    };
    let gradients = backward(&scene, &config, &tape, &gradient).expect("gradients");
    for part in [
        &gradients.means,
        &gradients.quats,
        &gradients.scales,
        &gradients.opacities,
        &gradients.colour,
        &gradients.extra,
    ] {
        assert!(finite(part));
    }
    let pose = gradients
        .camera_rotation
        .iter()
        .chain(&gradients.camera_translation)
        .chain(&gradients.background);
    assert!(pose.clone().all(|v| v.is_finite()));

    let (_, sums) = render_with_contributions(&scene, &camera, &config, &Eligible::All).expect("contributions");
    let mass: f64 = sums.mass().iter().map(|m| f64::from(*m)).sum();
    let opacity: f64 = image.alpha.iter().map(|a| f64::from(*a)).sum();
    assert!((mass - opacity).abs() <= 1e-4 * (1.0 + opacity), "{mass} and {opacity}");
});
