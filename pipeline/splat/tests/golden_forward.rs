//! Forward results against the golden files, at the tolerances of their README.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common;

use common::{Golden, goldens, more_goldens, worst};
use rogs_needs::needs;
use rogs_splat::{Eligible, render, render_with_contributions};

#[test]
fn images_match_the_float64_reference() {
    check_images(goldens());
}

#[needs(shared)]
#[test]
fn images_match_the_float64_reference_in_every_reference_scene() {
    check_images(more_goldens());
}

fn check_images(goldens: Vec<Golden>) {
    for golden in goldens {
        let scene = golden.scene();
        for camera in 0..golden.cameras() {
            let render = render(&scene, &golden.camera(camera), &golden.config(camera)).unwrap();
            let stable = golden.view("out.stable", camera);
            let is_stable = |pixel: usize| stable[pixel] != 0.0;
            assert!(stable.iter().filter(|&&s| s != 0.0).count() > golden.pixels() / 2);
            // Relative to the largest value of the image, or to 1 where that is less.
            let check = |what: &str, ours: &[f32], key: &str, channels: usize| {
                let reference = golden.view(key, camera);
                let tolerance = 1e-5 * reference.iter().fold(1.0, |most: f32, v| most.max(v.abs()));
                let d = worst(ours, reference, channels, is_stable);
                println!("{} camera {camera} {what}: {d:e}", golden.name);
                assert!(
                    d <= tolerance,
                    "{} camera {camera} {what}: {d} > {tolerance}",
                    golden.name
                );
            };
            check("rgb", &render.rgb, "out.rgb", 3);
            check("alpha", &render.alpha, "out.alpha", 1);
            check("expected depth", &render.depth_expected, "out.depth", 1);
            check("accumulated depth", &render.depth_accumulated, "out.depth_acc", 1);
            check("features", &render.extra, "out.feat", 3);
            let everywhere = worst(&render.rgb, golden.view("out.rgb", camera), 3, |_| true);
            assert!(
                everywhere <= 1e-2,
                "{} camera {camera} unstable pixels: {everywhere}",
                golden.name
            );
            assert_eq!(render.counts.invalid, 0);
        }
    }
}

#[test]
fn contribution_sums_match_the_float64_reference() {
    check_contributions(goldens());
}

#[needs(shared)]
#[test]
fn contribution_sums_match_the_float64_reference_in_every_reference_scene() {
    check_contributions(more_goldens());
}

fn check_contributions(goldens: Vec<Golden>) {
    for golden in goldens {
        let scene = golden.scene();
        for camera in 0..golden.cameras() {
            let (_, contributions) =
                render_with_contributions(&scene, &golden.camera(camera), &golden.config(camera), &Eligible::All)
                    .unwrap();
            let stable = golden.view("out.stable", camera);
            // Zero rows for unstable pixels; a fifth channel of ones gives the mass over the stable ones.
            let mut features = Vec::new();
            for (e, &s) in golden.view("in.E", camera).chunks_exact(4).zip(stable) {
                features.extend(e.iter().chain([&1.0]).map(|v| v * s));
            }
            let pooled = contributions.pool(&features, 5).unwrap();
            let mass = contributions.mass();
            let (relative, sums) = if golden.stress { (1e-4, 2e-3) } else { (1e-5, 2e-4) };
            for gaussian in 0..scene.len() {
                let reference = golden.view("out.mass_stable", camera)[gaussian];
                let ours = pooled[5 * gaussian + 4];
                assert!(
                    (ours - reference).abs() <= relative * reference + 1e-3,
                    "{} mass",
                    golden.name
                );
                for k in 0..4 {
                    let reference = golden.view("out.WtE_stable", camera)[4 * gaussian + k];
                    assert!(
                        (pooled[5 * gaussian + k] - reference).abs() <= sums,
                        "{} W^T E",
                        golden.name
                    );
                }
                // Unstable pixels may flip a weight of about the alpha cut.
                let all = golden.view("out.mass", camera)[gaussian];
                let unstable = (all - reference).abs();
                assert!(
                    (mass[gaussian] - all).abs() <= relative * all + 1e-3 + 0.2 * unstable,
                    "{}",
                    golden.name
                );
            }
        }
    }
}
