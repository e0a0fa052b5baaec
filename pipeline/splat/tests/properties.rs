//! What must hold for every scene (`docs/spec/rasteriser.md` sections 10 and 12): neither tiles, instruction sets, threads
//! nor the order of the input show in the result, and the sums obey their identities.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common {
    pub(crate) mod random;
    pub(crate) mod room;
}

use common::{random, room};
use glam::DMat3;
use rogs_geometry::{Base, Camera, Pose, Recon};
use rogs_splat::{
    Colour, Eligible, Gaussians, Gradients, Mode, RasterCamera, RasterConfig, Render, RenderGradient, SimdLevel,
    backward, render, render_views, render_views_with_contributions, render_with_contributions, render_with_tape,
};

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|v| v.to_bits()).collect()
}

fn assert_same_image(a: &Render, b: &Render, what: &str) {
    for (x, y) in [
        (&a.rgb, &b.rgb),
        (&a.alpha, &b.alpha),
        (&a.depth_expected, &b.depth_expected),
        (&a.depth_accumulated, &b.depth_accumulated),
        (&a.extra, &b.extra),
    ] {
        assert!(bits(x) == bits(y), "{what}");
    }
}

fn assert_same_gradients(a: &Gradients, b: &Gradients, what: &str) {
    for (x, y) in [
        (&a.means, &b.means),
        (&a.quats, &b.quats),
        (&a.scales, &b.scales),
        (&a.opacities, &b.opacities),
        (&a.colour, &b.colour),
        (&a.extra, &b.extra),
    ] {
        assert!(bits(x) == bits(y), "{what}");
    }
    assert_eq!(
        a.camera_rotation.map(f64::to_bits),
        b.camera_rotation.map(f64::to_bits),
        "{what}"
    );
    assert_eq!(
        a.camera_translation.map(f64::to_bits),
        b.camera_translation.map(f64::to_bits),
        "{what}"
    );
}

/// Forward and backward with a fixed random loss on all outputs.
fn gradients(scene: &Gaussians, camera: &RasterCamera, config: &RasterConfig) -> Gradients {
    let pixels = camera.pixels();
    let (rgb, alpha) = (room::normals(3 * pixels, 1), room::normals(pixels, 2));
    let (depth, extra) = (
        room::normals(pixels, 3),
        room::normals(scene.extra_channels * pixels, 4),
    );
    let gradient = RenderGradient {
        rgb: &rgb,
        alpha: &alpha,
        depth_expected: &depth,
        extra: &extra,
        ..Default::default()
    };
    let (_, tape) = render_with_tape(scene, camera, config).unwrap();
    backward(scene, config, &tape, &gradient).unwrap()
}

#[test]
fn tiles_do_not_show() {
    for (seed, size) in [(1, (70, 50)), (2, (33, 61)), (3, (16, 16)), (4, (5, 3))] {
        let scene = random::scene(3000, seed, None, 3);
        let camera = random::camera(size.0, size.1);
        for mode in [Mode::Classic, Mode::Antialiased] {
            let config = |tile_size| RasterConfig {
                tile_size,
                mode,
                ..RasterConfig::default()
            };
            let reference = render(&scene, &camera, &config(16)).unwrap();
            assert!(reference.counts.visible > 100);
            for tile in [4, 8] {
                assert_same_image(
                    &reference,
                    &render(&scene, &camera, &config(tile)).unwrap(),
                    "tile size",
                );
            }
        }
    }
}

#[test]
fn instruction_sets_do_not_show() {
    let scene = random::scene(2500, 5, Some(3), 6);
    let camera = random::camera(70, 50);
    let config = |simd| RasterConfig {
        simd,
        ..RasterConfig::default()
    };
    let image = render(&scene, &camera, &config(SimdLevel::Portable)).unwrap();
    let slow = gradients(&scene, &camera, &config(SimdLevel::Portable));
    let features = room::normals(camera.pixels() * 37, 9);
    let pooled = |simd| {
        let (_, c) = render_with_contributions(&scene, &camera, &config(simd), &Eligible::All).unwrap();
        c.pool(&features, 37).unwrap()
    };
    let sums = pooled(SimdLevel::Portable);
    for level in SimdLevel::available() {
        assert_same_image(&image, &render(&scene, &camera, &config(level)).unwrap(), "image");
        assert_same_gradients(&slow, &gradients(&scene, &camera, &config(level)), "gradients");
        assert!(bits(&sums) == bits(&pooled(level)), "pooled features on {level:?}");
    }
}

#[test]
fn threads_do_not_show() {
    let scene = random::scene(20_000, 6, None, 3);
    let cameras = [random::camera(70, 50), random::camera(90, 40)];
    let config = RasterConfig::default();
    let features = room::normals((70 * 50 + 90 * 40) * 19, 9);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let images = render_views(&scene, &cameras, &config).unwrap();
            let gradients = gradients(&scene, &cameras[0], &config);
            let eligible = Eligible::Ranges(vec![0..4000, 9000..15_000]);
            let (_, sums) = render_views_with_contributions(&scene, &cameras, &config, &eligible).unwrap();
            (images, gradients, sums.mass(), sums.pool(&features, 19).unwrap())
        })
    };
    let one = run(1);
    for threads in [2, 8] {
        let many = run(threads);
        for (a, b) in one.0.iter().zip(&many.0) {
            assert_same_image(a, b, "image");
        }
        assert_same_gradients(&one.1, &many.1, "gradients");
        assert!(bits(&one.2) == bits(&many.2) && bits(&one.3) == bits(&many.3));
    }
}

#[test]
fn extra_channels_of_every_count_are_those_rendered_alone() {
    let all = random::scene(800, 7, None, 11);
    let camera = random::camera(40, 30);
    let config = RasterConfig::default();
    let together = render(&all, &camera, &config).unwrap();
    for channel in 0..11 {
        let extra = all.extra.chunks(11).map(|e| e[channel]).collect();
        let alone = render(
            &Gaussians {
                extra,
                extra_channels: 1,
                ..all.clone()
            },
            &camera,
            &config,
        )
        .unwrap();
        let ours: Vec<f32> = together.extra.chunks(11).map(|e| e[channel]).collect();
        assert!(bits(&ours) == bits(&alone.extra), "channel {channel}");
        assert!(bits(&together.rgb) == bits(&alone.rgb));
    }
}

#[test]
fn rows_of_the_contribution_matrix_sum_to_the_opacity() {
    let scene = random::scene(3000, 8, None, 0);
    let camera = random::camera(70, 50);
    let (image, sums) = render_with_contributions(&scene, &camera, &RasterConfig::default(), &Eligible::All).unwrap();
    let mut rows = vec![0.0_f64; camera.pixels()];
    let mut total = 0.0;
    sums.for_each(|_, pixel, weight| {
        assert!(weight > 0.0);
        rows[pixel] += f64::from(weight);
        total += f64::from(weight);
    });
    for (row, alpha) in rows.iter().zip(&image.alpha) {
        assert!((row - f64::from(*alpha)).abs() < 1e-5);
    }
    let mass: f64 = sums.mass().iter().map(|&m| f64::from(m)).sum();
    assert!((mass - total).abs() < 1e-6 * total && total > 100.0);
}

#[test]
fn pooling_is_the_colour_gradient() {
    let scene = random::scene(2000, 9, None, 0);
    let camera = random::camera(70, 50);
    let config = RasterConfig::default();
    let v = room::normals(3 * camera.pixels(), 5);
    let (_, tape) = render_with_tape(&scene, &camera, &config).unwrap();
    let gradient = backward(
        &scene,
        &config,
        &tape,
        &RenderGradient {
            rgb: &v,
            ..Default::default()
        },
    )
    .unwrap();
    let (_, sums) = render_with_contributions(&scene, &camera, &config, &Eligible::All).unwrap();
    let pooled = sums.pool(&v, 3).unwrap();
    let scale = pooled.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
    for (a, b) in pooled.iter().zip(&gradient.colour) {
        assert!((a - b).abs() < 1e-5 * scale, "{a} {b}");
    }
}

#[test]
fn eligibility_selects_rows_and_parts_change_nothing() {
    let scene = random::scene(12_000, 10, None, 0);
    let cameras = [random::camera(70, 50), random::camera(50, 40)];
    let config = RasterConfig::default();
    let pixels = 70 * 50 + 50 * 40;
    let features = room::normals(pixels * 21, 6);
    let (_, all) = render_views_with_contributions(&scene, &cameras, &config, &Eligible::All).unwrap();
    let (all_mass, all_pooled) = (all.mass(), all.pool(&features, 21).unwrap());
    let ranges = Eligible::Ranges(vec![100..300, 8000..9000]);
    let (_, some) = render_views_with_contributions(&scene, &cameras, &config, &ranges).unwrap();
    assert_eq!(some.rows.len(), 1200);
    let pooled = some.pool(&features, 21).unwrap();
    for (row, &gaussian) in some.rows.iter().enumerate() {
        let gaussian = gaussian as usize;
        assert_eq!(some.mass()[row].to_bits(), all_mass[gaussian].to_bits());
        assert_eq!(
            bits(&pooled[21 * row..21 * (row + 1)]),
            bits(&all_pooled[21 * gaussian..21 * (gaussian + 1)])
        );
    }
    assert!(some.pool(&features[1..], 21).is_err());
    assert!(render_views_with_contributions(&scene, &cameras, &config, &Eligible::Ranges(vec![5..9, 8..10])).is_err());
}

#[test]
fn permuting_the_input_permutes_nothing_but_the_output() {
    let scene = random::scene(2000, 11, None, 3);
    let n = scene.len();
    let camera = random::camera(70, 50);
    let config = RasterConfig::default();
    // A fixed permutation without structure.
    let order: Vec<usize> = (0..n).map(|i| (i * 1237 + 311) % n).collect();
    let pick = |values: &[f32], per: usize| {
        order
            .iter()
            .flat_map(|&i| values[per * i..per * (i + 1)].to_vec())
            .collect()
    };
    let permuted = Gaussians {
        means: pick(&scene.means, 3),
        quats: pick(&scene.quats, 4),
        scales: pick(&scene.scales, 3),
        opacities: pick(&scene.opacities, 1),
        colour: Colour::Rgb(pick(scene.colour.values(), 3)),
        extra: pick(&scene.extra, 3),
        extra_channels: 3,
    };
    assert_same_image(
        &render(&scene, &camera, &config).unwrap(),
        &render(&permuted, &camera, &config).unwrap(),
        "image",
    );
    let (a, b) = (
        gradients(&scene, &camera, &config),
        gradients(&permuted, &camera, &config),
    );
    assert_eq!(bits(&pick(&a.means, 3)), bits(&b.means));
    assert_eq!(bits(&pick(&a.colour, 3)), bits(&b.colour));
}

#[test]
fn moving_scene_and_camera_together_changes_nothing() {
    let scene = random::scene(1500, 12, None, 0);
    let mut camera = random::camera(70, 50);
    let config = RasterConfig::default();
    let before = render(&scene, &camera, &config).unwrap();
    let base_from_recon: Pose<Base, Recon> = Pose::from_xyz_euler([0.5, -0.25, 1.0], [0.7, -2.0, 0.3]);
    let scene = scene.moved(&base_from_recon.into());
    let camera_from_recon: Pose<Camera, Recon> = Pose::new(
        DMat3::from_cols_array(&camera.rotation).transpose(),
        camera.translation.into(),
    );
    let camera_from_base = camera_from_recon * base_from_recon.inverse();
    camera.rotation = camera_from_base.rotation.transpose().to_cols_array();
    camera.translation = camera_from_base.translation.to_array();
    let after = render(&scene, &camera, &config).unwrap();
    // A weight at the alpha cut may appear or vanish by rounding; everything else agrees to f32.
    let off = before
        .rgb
        .iter()
        .zip(&after.rgb)
        .filter(|(a, b)| (*a - *b).abs() > 2e-5)
        .count();
    assert!(off < before.rgb.len() / 200, "{off} values differ");
    assert!(before.rgb.iter().zip(&after.rgb).all(|(a, b)| (a - b).abs() < 1e-2));
}

#[test]
fn a_gaussian_behind_an_opaque_stack_changes_nothing() {
    let n = 8;
    let wall = |count: usize, last_z: f32| {
        let z = |i: usize| if i + 1 == count { last_z } else { 1.0 + 0.01 * i as f32 };
        Gaussians {
            means: (0..count).flat_map(|i| [0.0, 0.0, z(i)]).collect(),
            quats: (0..count).flat_map(|_| [1.0, 0.0, 0.0, 0.0]).collect(),
            scales: vec![3.0; 3 * count],
            opacities: vec![1.0; count],
            colour: Colour::Rgb((0..3 * count).map(|i| (i % 7) as f32 / 7.0).collect()),
            extra: Vec::new(),
            extra_channels: 0,
        }
    };
    let camera = RasterCamera {
        rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        translation: [0.0; 3],
        ..random::camera(40, 30)
    };
    let config = RasterConfig::default();
    let without = render(&wall(n, 1.5), &camera, &config).unwrap();
    let with = render(&wall(n + 1, 5.0), &camera, &config).unwrap();
    let same = render(&wall(n + 1, 1.5), &camera, &config).unwrap();
    assert_same_image(&without, &without.clone(), "itself");
    assert!(bits(&with.rgb) == bits(&same.rgb), "the last one is never seen");
    assert!(with.alpha.iter().all(|&a| a > 0.98 && a < 1.0));
}

#[test]
fn many_views_are_the_single_views() {
    let scene = random::scene(2000, 13, Some(1), 3);
    let cameras = [random::camera(70, 50), random::camera(20, 90), random::camera(64, 64)];
    let config = RasterConfig {
        background: [0.2, 0.4, 0.6],
        ..RasterConfig::default()
    };
    let together = render_views(&scene, &cameras, &config).unwrap();
    for (camera, image) in cameras.iter().zip(&together) {
        assert_same_image(image, &render(&scene, camera, &config).unwrap(), "view");
    }
}
