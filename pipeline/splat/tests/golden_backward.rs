//! Gradients against automatic differentiation in float64, at the tolerances of the golden files' README.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common;

use common::{Golden, goldens, more_goldens, worst};
use rogs_needs::needs;
use rogs_splat::{Gradients, RenderGradient, backward_into, render, render_with_tape};

#[test]
fn gradients_match_automatic_differentiation() {
    check_gradients(goldens());
}

#[needs(shared)]
#[test]
fn gradients_match_automatic_differentiation_in_every_reference_scene() {
    check_gradients(more_goldens());
}

fn check_gradients(goldens: Vec<Golden>) {
    for golden in goldens {
        let scene = golden.scene();
        let mut gradients = Gradients::zeros(&scene);
        for camera in 0..golden.cameras() {
            let config = golden.config(camera);
            let (image, tape) = render_with_tape(&scene, &golden.camera(camera), &config).unwrap();
            assert_eq!(image, render(&scene, &golden.camera(camera), &config).unwrap());
            let contributors: Vec<f32> = tape.contributors().iter().map(|&n| n as f32).collect();
            let stable = golden.view("out.stable", camera);
            let d = worst(&contributors, golden.view("out.n_contrib", camera), 1, |pixel| {
                stable[pixel] != 0.0
            });
            assert_eq!(d, 0.0, "{} camera {camera}: number of contributors", golden.name);
            let gradient = RenderGradient {
                rgb: golden.view("in.v_rgb", camera),
                alpha: golden.view("in.v_alpha", camera),
                depth_expected: golden.view("in.v_depth", camera),
                extra: golden.view("in.v_feat", camera),
                ..RenderGradient::default()
            };
            let before = gradients.background;
            backward_into(&scene, &config, &tape, &gradient, &mut gradients).unwrap();
            if golden.has("grad.backgrounds") {
                let ours: Vec<f32> = (0..3).map(|k| (gradients.background[k] - before[k]) as f32).collect();
                let d = relative(&ours, golden.view("grad.backgrounds", camera));
                assert!(d < 1e-5, "{} background: {d}", golden.name);
            }
        }
        let tolerance = if golden.stress { 1e-4 } else { 2e-5 };
        let colour = if golden.has("grad.sh") { "grad.sh" } else { "grad.rgb" };
        for (name, ours) in [
            ("grad.means", &gradients.means),
            ("grad.quats_wxyz", &gradients.quats),
            ("grad.scales", &gradients.scales),
            ("grad.opacities", &gradients.opacities),
            (colour, &gradients.colour),
            ("grad.features", &gradients.extra),
        ] {
            let d = relative(ours, golden.get(name));
            println!("{} {name}: {d:e}", golden.name);
            assert!(d < tolerance, "{} {name}: {d} > {tolerance}", golden.name);
        }
        assert_eq!(gradients.not_finite, 0);
    }
}

/// Norm of the difference over the norm of the reference.
fn relative(ours: &[f32], reference: &[f32]) -> f64 {
    assert_eq!(ours.len(), reference.len());
    let square = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    let difference = square(&mut ours.iter().zip(reference).map(|(a, b)| f64::from(*a) - f64::from(*b)));
    difference / square(&mut reference.iter().map(|v| f64::from(*v))).max(1e-30)
}
