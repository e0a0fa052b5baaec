//! Outside fields against values of their own public code.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use rogs_field::polynomial;
use rogs_geometry::{Base, Camera, Pose, Similarity};
use rogs_needs::{needs, shared};
use rogs_schemas::RigidPose;
use rogs_schemas::records::motion_bases::BasisGaussians;
use rogs_schemas::records::polynomial::Polynomials;
use rogs_score::outside::{BasisField, OutsideError, merge, stereo_scale};
use rogs_splat::{Colour, Gaussians};
use safetensors::SafeTensors;

fn f32s(file: &SafeTensors<'_>, name: &str) -> Vec<f32> {
    file.tensor(name)
        .unwrap()
        .data()
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
        .collect()
}

fn worst(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    found
        .iter()
        .zip(expected)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
}

/// Worst difference of quaternions up to their sign.
fn worst_rotation(found: &[f32], expected: &[f32]) -> f32 {
    let one = |(a, b): (&[f32], &[f32])| {
        let sign = if a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>() < 0.0 {
            -1.0
        } else {
            1.0
        };
        a.iter().zip(b).map(|(a, b)| (sign * a - b).abs()).fold(0.0, f32::max)
    };
    assert_eq!(found.len(), expected.len());
    found
        .chunks_exact(4)
        .zip(expected.chunks_exact(4))
        .map(one)
        .fold(0.0, f32::max)
}

#[test]
fn shape_of_motion_moves_its_gaussians_as_published() {
    let file = SafeTensors::deserialize(include_bytes!("golden/som_tiny.safetensors")).unwrap();
    let both = |part: &str| {
        let mut values = f32s(&file, &format!("state.fg.params.{part}"));
        values.extend(f32s(&file, &format!("state.bg.params.{part}")));
        values
    };
    let field = BasisField::new(BasisGaussians {
        bases: 4,
        frames: 7,
        rotations: f32s(&file, "state.motion_bases.params.rots"),
        translations: f32s(&file, "state.motion_bases.params.transls"),
        coefficients: f32s(&file, "state.fg.params.motion_coefs"),
        means: both("means"),
        quats: both("quats"),
        scales: both("scales"),
        opacities: both("opacities"),
        colours: both("colors"),
    })
    .unwrap();
    assert_eq!((field.len(), field.foreground()), (35, 30));
    let (means, quats) = (f32s(&file, "eval.means_GT3"), f32s(&file, "eval.quats_wxyz_GT4"));
    let (mut mean_error, mut quat_error, mut rest) = (0.0f32, 0.0f32, 0.0f32);
    for frame in 0..7 {
        let state = field.at(frame).unwrap();
        let at = |values: &[f32], width: usize| -> Vec<f32> {
            (0..35)
                .flat_map(|g| values[(g * 7 + frame) * width..][..width].to_vec())
                .collect()
        };
        mean_error = mean_error.max(worst(&state.means, &at(&means, 3)));
        quat_error = quat_error.max(worst_rotation(&state.quats, &at(&quats, 4)));
        rest = rest.max(worst(&state.scales, &f32s(&file, "eval.scales")));
        rest = rest.max(worst(&state.opacities, &f32s(&file, "eval.opacities")));
        rest = rest.max(worst(state.colour.values(), &f32s(&file, "eval.colors")));
    }
    println!("motion bases: centres {mean_error:.1e} m, rotations {quat_error:.1e}, other {rest:.1e}");
    assert!(mean_error < 2e-6 && quat_error < 2e-6 && rest < 1e-6);
    assert_eq!(field.at(7).unwrap_err(), OutsideError::NoFrame { frame: 7, frames: 7 });
    assert!(
        BasisField::new(BasisGaussians {
            bases: 4,
            frames: 7,
            ..BasisGaussians::default()
        })
        .is_err()
    );
}

#[needs(shared)]
#[test]
fn polynomial_fields_are_as_published() {
    let bytes = std::fs::read(shared!("golden/baselines/4dgt_tiny.safetensors")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let features = f32s(&file, "gs.feature");
    let field = Polynomials {
        centre_m: f32s(&file, "gs.xyz"),
        time_s: f32s(&file, "gs.t"),
        variance_s2: f32s(&file, "gs.cov_t"),
        velocity: f32s(&file, "gs.ms3"),
        angular: f32s(&file, "gs.omega"),
        rotation: f32s(&file, "gs.rotation"),
        scale_m: f32s(&file, "gs.scaling"),
        opacity: f32s(&file, "gs.opacity"),
        rgb: features.chunks_exact(4).flat_map(|one| one[..3].to_vec()).collect(),
    };
    let (mut centres, mut quats, mut rest) = (0.0f32, 0.0f32, 0.0f32);
    for at in 0..4 {
        let name = |part: &str| format!("eval{at}.{part}");
        let time = f32s(&file, &name("time"))[0];
        centres = centres.max(worst(
            &polynomial::centres_m(&field, time),
            &f32s(&file, &name("all_means")),
        ));
        let state = polynomial::state_at(&field, time);
        let kept: Vec<u32> = file
            .tensor(&name("kept_index"))
            .unwrap()
            .data()
            .chunks_exact(8)
            .map(|b| u32::try_from(i64::from_le_bytes(b.try_into().unwrap())).unwrap())
            .collect();
        assert_eq!(state.kept, kept);
        centres = centres.max(worst(&state.gaussians.means, &f32s(&file, &name("means"))));
        quats = quats.max(worst(&state.gaussians.quats, &f32s(&file, &name("quats"))));
        rest = rest.max(worst(&state.gaussians.scales, &f32s(&file, &name("scales"))));
        rest = rest.max(worst(&state.gaussians.opacities, &f32s(&file, &name("opacities"))));
        rest = rest.max(worst(state.gaussians.colour.values(), &f32s(&file, &name("colors"))));
    }
    println!("polynomials: centres {centres:.1e} m, rotations {quats:.1e}, other {rest:.1e}");
    assert!(centres < 1e-6 && quats < 1e-6 && rest < 1e-6);
}

#[test]
fn fields_are_scaled_turned_and_joined() {
    let one = Gaussians {
        means: vec![1.0, 2.0, 3.0],
        quats: vec![1.0, 0.0, 0.0, 0.0],
        scales: vec![0.1, 0.2, 0.3],
        opacities: vec![0.5],
        colour: Colour::Rgb(vec![0.1, 0.2, 0.3]),
        extra: vec![],
        extra_channels: 0,
    };
    // A quarter turn about z.
    let turn = RigidPose {
        rotation: [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        translation: [10.0, 0.0, 0.0],
    };
    let base_from_camera: Similarity<Base, Camera> = Similarity {
        rigid: Pose::from_rigid(&turn).unwrap(),
        scale: 2.0,
    };
    let moved = one.clone().moved(&base_from_camera);
    assert_eq!(moved.means, [6.0, 2.0, 6.0]);
    assert!(worst(&moved.scales, &[0.2, 0.4, 0.6]) < 1e-7);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    assert!(worst(&moved.quats, &[half, 0.0, 0.0, half]) < 1e-6);
    let both = merge(&[one.clone(), moved]).unwrap();
    assert_eq!((both.len(), both.means[3]), (2, 6.0));
    both.validate().unwrap();
    let sh = Gaussians {
        colour: Colour::Sh {
            degree: 0,
            coefficients: vec![0.0; 3],
        },
        ..one.clone()
    };
    let mixed = merge(&[one, sh]).unwrap();
    let Colour::Sh {
        degree: 0,
        coefficients,
    } = &mixed.colour
    else {
        panic!("plain colours become harmonics beside harmonics");
    };
    assert!((coefficients[0] * 0.282_094_8 + 0.5 - 0.1).abs() < 1e-6 && coefficients[3] == 0.0);
}

#[test]
fn the_scale_of_a_camera_pools_its_images() {
    let all = [true; 3];
    let images: [(&[f32], &[f32], &[bool]); 2] = [
        (&[1.0, 1.0, 0.0], &[2.0, 3.0, 9.0], &all),
        (&[1.0, 2.0, f32::NAN], &[4.0, 2.0, 1.0], &all),
    ];
    assert_eq!(stereo_scale(&images), Some(2.5));
    assert_eq!(stereo_scale(&[]), None);
}
