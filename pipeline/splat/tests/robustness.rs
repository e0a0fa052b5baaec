//! No input makes the rasteriser panic or return a value that is not a number; what is dropped is counted.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common {
    pub(crate) mod random;
    pub(crate) mod room;
}

use common::{random, room};
use proptest::prelude::*;
use rogs_splat::{
    Colour, Eligible, Gaussians, Gradients, Mode, RasterCamera, RasterConfig, Render, RenderGradient, SimdLevel,
    backward, render, render_with_contributions, render_with_tape,
};

fn finite(render: &Render) -> bool {
    [
        &render.rgb,
        &render.alpha,
        &render.depth_expected,
        &render.depth_accumulated,
        &render.extra,
    ]
    .iter()
    .all(|v| v.iter().all(|x| x.is_finite()))
}

fn finite_gradients(g: &Gradients) -> bool {
    [&g.means, &g.quats, &g.scales, &g.opacities, &g.colour, &g.extra]
        .iter()
        .all(|v| v.iter().all(|x| x.is_finite()))
        && g.camera_rotation
            .iter()
            .chain(&g.camera_translation)
            .all(|x| x.is_finite())
}

/// Renders, differentiates, pools; everything must be finite.
fn exercise(scene: &Gaussians, camera: &RasterCamera, config: &RasterConfig) -> Render {
    let image = render(scene, camera, config).unwrap();
    assert!(finite(&image), "image");
    let pixels = camera.pixels();
    let (rgb, depth) = (room::normals(3 * pixels, 1), room::normals(pixels, 2));
    let (taped, tape) = render_with_tape(scene, camera, config).unwrap();
    assert_eq!(image, taped);
    let gradient = RenderGradient {
        rgb: &rgb,
        alpha: &depth,
        depth_expected: &depth,
        ..Default::default()
    };
    assert!(
        finite_gradients(&backward(scene, config, &tape, &gradient).unwrap()),
        "gradients"
    );
    let (_, sums) = render_with_contributions(scene, camera, config, &Eligible::All).unwrap();
    assert!(
        sums.mass()
            .iter()
            .chain(&sums.pool(&rgb, 3).unwrap())
            .all(|v| v.is_finite()),
        "sums"
    );
    image
}

#[test]
fn values_that_are_not_numbers_are_dropped_and_counted() {
    let clean = random::scene(300, 1, None, 2);
    let camera = random::camera(40, 30);
    let config = RasterConfig::default();
    let mut bad = clean.clone();
    let specials = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    for (k, &special) in specials.iter().enumerate() {
        bad.means[3 * (10 + k) + k] = special;
        bad.quats[4 * (20 + k) + k] = special;
        bad.scales[3 * (30 + k) + k] = special;
        bad.opacities[40 + k] = special;
        bad.extra[2 * (60 + k)] = special;
        if let Colour::Rgb(rgb) = &mut bad.colour {
            rgb[3 * (50 + k) + k] = special;
        }
    }
    bad.quats[4 * 70..4 * 71].fill(0.0);
    bad.scales[3 * 71] = -0.5;
    bad.opacities[72] = -0.1;
    bad.quats[4 * 73..4 * 74].fill(1e-30);
    bad.scales[3 * 74..3 * 75].fill(3e38);
    bad.means[3 * 74..3 * 75].copy_from_slice(&[0.0, 0.0, 2.0]);
    bad.opacities[74] = 0.5;
    let image = exercise(&bad, &camera, &config);
    assert_eq!(image.counts.invalid, 18 + 5);
    // The others are rendered as if the bad ones were not there.
    let keep: Vec<usize> = (0..300)
        .filter(|i| !matches!(i, 10..=12 | 20..=22 | 30..=32 | 40..=42 | 50..=52 | 60..=62 | 70..=74))
        .collect();
    let pick = |values: &[f32], per: usize| {
        keep.iter()
            .flat_map(|&i| values[per * i..per * (i + 1)].to_vec())
            .collect()
    };
    let rest = Gaussians {
        means: pick(&clean.means, 3),
        quats: pick(&clean.quats, 4),
        scales: pick(&clean.scales, 3),
        opacities: pick(&clean.opacities, 1),
        colour: Colour::Rgb(pick(clean.colour.values(), 3)),
        extra: pick(&clean.extra, 2),
        extra_channels: 2,
    };
    assert_eq!(render(&rest, &camera, &config).unwrap().rgb, image.rgb);
}

#[test]
fn harmonics_that_are_not_numbers_are_dropped_and_counted() {
    let mut scene = random::scene(50, 2, Some(2), 0);
    if let Colour::Sh { coefficients, .. } = &mut scene.colour {
        coefficients[27 * 7 + 20] = f32::NAN;
    }
    assert_eq!(
        exercise(&scene, &random::camera(30, 20), &RasterConfig::default())
            .counts
            .invalid,
        1
    );
}

#[test]
fn extreme_but_finite_scenes_stay_finite() {
    let identity = RasterCamera {
        rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        translation: [0.0; 3],
        ..random::camera(30, 20)
    };
    let values = [0.0, 1e-38, 1e-20, 1e-6, 1.0, 1e4, 1e9, 1e20, 3e38];
    let mut scene = Gaussians::empty();
    let mut rgb = Vec::new();
    for &scale in &values {
        for &other in &values {
            for z in [-1.0, 0.0, 1e-3, 0.00100001, 0.5, 99.0, 1e20] {
                for x in [0.0, 0.3, 1e6, 1e30] {
                    scene.means.extend([x, -x, z]);
                    scene.scales.extend([scale, other, 1e-3]);
                    scene.quats.extend([0.3, scale.min(1e15), -other.min(1e15), 0.1]);
                    scene.opacities.push(if x == 0.0 { 1.0 } else { 0.6 });
                    rgb.extend([0.5, 1e6, -3.0]);
                }
            }
        }
    }
    scene.colour = Colour::Rgb(rgb);
    for config in [
        RasterConfig::default(),
        RasterConfig {
            mode: Mode::Antialiased,
            eps2d: 0.0,
            near: 1e-6,
            far: 1e30,
            ..RasterConfig::default()
        },
    ] {
        exercise(&scene, &identity, &config);
    }
}

/// Sums of colours that are numbers may not be: such colours are left out too.
#[test]
fn colours_whose_sums_would_leave_the_range_are_dropped_and_counted() {
    for (degree, channels) in [(None, 0), (Some(0), 0), (Some(3), 0), (None, 3)] {
        let mut scene = random::scene(200, 5, degree, channels);
        let huge = |values: &mut [f32]| values.iter_mut().for_each(|v| *v = 3e38);
        if channels > 0 {
            huge(&mut scene.extra[..channels * 100]);
        } else {
            match &mut scene.colour {
                Colour::Rgb(values)
                | Colour::Sh {
                    coefficients: values, ..
                } => {
                    let half = values.len() / 2;
                    huge(&mut values[..half]);
                }
            }
        }
        let image = exercise(&scene, &random::camera(40, 30), &RasterConfig::default());
        assert_eq!(image.counts.invalid, 100);
    }
}

/// Gaussians on and around the camera plane, with the near plane as close as it can be.
#[test]
fn gaussians_on_the_camera_plane_are_not_drawn() {
    let camera = RasterCamera {
        rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        translation: [0.0; 3],
        ..random::camera(20, 20)
    };
    let config = RasterConfig {
        near: f32::MIN_POSITIVE,
        ..RasterConfig::default()
    };
    let depths = [0.0, -0.0, 1e-45, -1e-45, 1e-40, 1e-37, 1e-30, 1e-12, -1e-12];
    let n = depths.len();
    let scene = Gaussians {
        means: depths.iter().flat_map(|&z| [0.0, 0.0, z]).collect(),
        quats: [1.0, 0.0, 0.0, 0.0].repeat(n),
        scales: vec![0.1; 3 * n],
        opacities: vec![0.9; n],
        colour: Colour::Rgb(vec![0.5; 3 * n]),
        extra: Vec::new(),
        extra_channels: 0,
    };
    let image = exercise(&scene, &camera, &config);
    let (hidden, counts) = (render(&scene, &camera, &RasterConfig::default()).unwrap(), image.counts);
    assert!(counts.visible + counts.invalid <= 4, "{counts:?}");
    assert_eq!(hidden.counts.visible, 0);
}

#[test]
fn empty_scenes_and_one_pixel_images_render() {
    let config = RasterConfig {
        background: [0.25, 0.5, 0.75],
        ..RasterConfig::default()
    };
    let empty = exercise(&Gaussians::empty(), &random::camera(37, 21), &config);
    assert!(empty.rgb.chunks(3).all(|p| p == [0.25, 0.5, 0.75]) && empty.alpha.iter().all(|&a| a == 0.0));
    let one = exercise(&random::scene(500, 3, None, 1), &random::camera(1, 1), &config);
    assert_eq!(one.rgb.len(), 3);
    let behind = Gaussians {
        means: vec![0.0, 0.0, -4.0],
        quats: vec![1.0, 0.0, 0.0, 0.0],
        scales: vec![0.1; 3],
        opacities: vec![1.0],
        colour: Colour::Rgb(vec![1.0; 3]),
        extra: Vec::new(),
        extra_channels: 0,
    };
    let image = exercise(&behind, &random::camera(20, 20), &config);
    assert_eq!((image.counts.visible, image.counts.invalid), (0, 0));
}

#[test]
fn a_million_gaussians_on_one_pixel_render() {
    let n = 1_000_000;
    let scene = Gaussians {
        means: (0..n)
            .flat_map(|i| [0.0, 0.0, 2.0 + (i % 1000) as f32 * 1e-3])
            .collect(),
        quats: (0..n).flat_map(|_| [1.0, 0.0, 0.0, 0.0]).collect(),
        scales: vec![1e-4; 3 * n],
        opacities: vec![0.005; n],
        colour: Colour::Rgb(vec![0.5; 3 * n]),
        extra: Vec::new(),
        extra_channels: 0,
    };
    let camera = RasterCamera {
        rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        translation: [0.0; 3],
        cx: 10.5,
        cy: 10.5,
        ..random::camera(21, 21)
    };
    let image = exercise(&scene, &camera, &RasterConfig::default());
    let centre = 10 * 21 + 10;
    assert!(image.alpha[centre] > 0.9998, "{}", image.alpha[centre]);
    assert!((image.rgb[3 * centre] / image.alpha[centre] - 0.5).abs() < 1e-3);
}

#[test]
fn senseless_calls_are_errors() {
    let scene = random::scene(10, 4, None, 0);
    let camera = random::camera(20, 20);
    let config = RasterConfig::default();
    let fails = |scene: &Gaussians, camera: &RasterCamera, config: &RasterConfig| {
        render(scene, camera, config).unwrap_err().to_string()
    };
    let short = Gaussians {
        scales: vec![1.0; 29],
        ..scene.clone()
    };
    assert!(fails(&short, &camera, &config).contains("scales has 29 values, expected 30"));
    let high = Gaussians {
        colour: Colour::Sh {
            degree: 4,
            coefficients: Vec::new(),
        },
        ..scene.clone()
    };
    assert!(fails(&high, &camera, &config).contains("degree"));
    assert!(fails(&scene, &RasterCamera { width: 0, ..camera }, &config).contains("image sides"));
    assert!(fails(&scene, &RasterCamera { fx: f64::NAN, ..camera }, &config).contains("focal"));
    assert!(
        fails(
            &scene,
            &RasterCamera {
                translation: [f64::INFINITY, 0.0, 0.0],
                ..camera
            },
            &config
        )
        .contains("finite")
    );
    assert!(
        fails(
            &scene,
            &camera,
            &RasterConfig {
                tile_size: 12,
                ..config
            }
        )
        .contains("tile_size")
    );
    assert!(
        fails(
            &scene,
            &camera,
            &RasterConfig {
                eps2d: f32::NAN,
                ..config
            }
        )
        .contains("eps2d")
    );
    let (_, tape) = render_with_tape(&scene, &camera, &config).unwrap();
    let wrong = RenderGradient {
        rgb: &[1.0; 5],
        ..Default::default()
    };
    assert!(
        backward(&scene, &config, &tape, &wrong)
            .unwrap_err()
            .to_string()
            .contains("gradient of rgb has 5 values")
    );
    assert!(backward(&short, &config, &tape, &RenderGradient::default()).is_err());
}

/// Any f64 bit pattern, ordinary numbers more often.
fn wide_number() -> impl Strategy<Value = f64> {
    prop_oneof![6 => -4.0_f64..4.0, 3 => 1.0_f64..100.0, 1 => any::<u64>().prop_map(f64::from_bits)]
}

/// Any f32 bit pattern, ordinary numbers more often.
fn number() -> impl Strategy<Value = f32> {
    prop_oneof![3 => -4.0_f32..4.0, 1 => any::<u32>().prop_map(f32::from_bits)]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(200) })]

    /// Whatever the bits are, and on every instruction set the same: comparisons with numbers that are none must not
    /// depend on the vector instructions.
    #[test]
    fn arbitrary_gaussians_never_panic_nor_poison_the_image(
        values in proptest::collection::vec(number(), 12 * 12),
        colours in proptest::collection::vec(number(), 48 * 12),
        size in (1_u32..40, 1_u32..40),
        degree in proptest::option::of(0_usize..4),
        antialiased in any::<bool>(),
        tile_size in prop_oneof![Just(4_u32), Just(8), Just(16)],
    ) {
        let n = 12;
        let take = |from: usize, per: usize| values[from * n..(from + per) * n].to_vec();
        let colours = colours[..n * degree.map_or(3, |d| 3 * (d + 1) * (d + 1))].to_vec();
        let scene = Gaussians {
            means: take(0, 3),
            quats: take(3, 4),
            scales: take(7, 3).iter().map(|s| s.abs()).collect(),
            opacities: take(10, 1).iter().map(|o| o.abs() / 4.0).collect(),
            colour: match degree {
                Some(degree) => Colour::Sh { degree, coefficients: colours },
                None => Colour::Rgb(colours),
            },
            extra: take(11, 1),
            extra_channels: 1,
        };
        let camera = random::camera(size.0, size.1);
        let config = |simd| RasterConfig {
            mode: if antialiased { Mode::Antialiased } else { Mode::Classic },
            tile_size,
            simd,
            ..RasterConfig::default()
        };
        let portable = exercise(&scene, &camera, &config(SimdLevel::Portable));
        for level in SimdLevel::available() {
            prop_assert_eq!(&exercise(&scene, &camera, &config(level)), &portable, "{:?}", level);
        }
    }

    /// A camera is refused, or what it sees is finite.
    #[test]
    fn arbitrary_cameras_are_refused_or_see_numbers(
        values in proptest::collection::vec(wide_number(), 16),
        size in (0_u32..40, 0_u32..40),
        seed in 0_u64..1000,
    ) {
        let camera = RasterCamera {
            width: size.0,
            height: size.1,
            fx: values[0],
            fy: values[1],
            cx: values[2],
            cy: values[3],
            rotation: std::array::from_fn(|k| values[4 + k]),
            translation: std::array::from_fn(|k| values[13 + k]),
        };
        let scene = random::scene(30, seed, Some(1), 2);
        match render(&scene, &camera, &RasterConfig::default()) {
            Ok(image) => {
                prop_assert!(finite(&image));
                exercise(&scene, &camera, &RasterConfig::default());
            }
            Err(error) => prop_assert!(!error.to_string().is_empty()),
        }
    }
}
