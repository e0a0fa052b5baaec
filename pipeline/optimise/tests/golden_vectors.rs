//! The tiny scene of Shape of Motion: parameter state, motion, losses, tracks, filters, at the tolerances of the reference.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

#[path = "../../../tests/support/tensors.rs"]
mod tensors;

use glam::{DMat3, DMat4, DVec3};
use rogs_geometry::{Base, Camera, Pinhole, Pose};
use rogs_needs::{needs, shared};
use rogs_optimise::bases::{MotionBases, mixed, move_gaussians, shares};
use rogs_optimise::clusters::point_weights;
use rogs_optimise::depth_maps::{median_filter, normals};
use rogs_optimise::losses::robust::{disparity_l1, gradient_l1, masked_l1, track_2d};
use rogs_optimise::losses::smoothness::{
    acceleration, bases_smoothness, ray_acceleration, scale_variance, track_smoothness,
};
use rogs_optimise::procrustes::rigid_motion;
use rogs_optimise::six;
use rogs_optimise::tracks::{Sight, TrackedFrame, lift_tracks};
use tensors::Tensors;

fn golden() -> Tensors {
    Tensors::read(&shared!("golden/baselines/som_tiny.safetensors"))
}

fn worst(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    found
        .iter()
        .zip(expected)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
}

/// Compares with a golden array; says how close it came.
fn close(golden: &Tensors, name: &str, found: &[f32], tolerance: f32) {
    let difference = worst(found, golden.values(name));
    println!("{name}: {difference:e}");
    assert!(difference <= tolerance, "{name}: {difference} > {tolerance}");
}

fn close_to(golden: &Tensors, name: &str, found: f64) {
    close(golden, &format!("scalar.{name}"), &[found as f32], 2e-6);
}

fn vectors(values: &[f32]) -> Vec<DVec3> {
    values
        .chunks_exact(3)
        .map(|v| DVec3::new(v[0].into(), v[1].into(), v[2].into()))
        .collect()
}

fn six_numbers(values: &[f32]) -> [f64; 6] {
    std::array::from_fn(|k| values[k].into())
}

/// Row-major, as the file has matrices.
fn rows(matrix: &DMat3) -> [f32; 9] {
    matrix.transpose().to_cols_array().map(|value| value as f32)
}

fn base_from_camera(w2c: &[f32]) -> Pose<Base, Camera> {
    let matrix = DMat4::from_cols_array(&std::array::from_fn(|k| w2c[k].into()))
        .transpose()
        .inverse();
    Pose::new(DMat3::from_mat4(matrix), matrix.w_axis.truncate())
}

fn pinhole(k: &[f32], width: u32, height: u32) -> Pinhole {
    let mut camera = Pinhole::centred(1.0, width, height);
    (camera.intrinsics.fx, camera.intrinsics.fy) = (k[0].into(), k[4].into());
    (camera.intrinsics.cx, camera.intrinsics.cy) = (k[2].into(), k[5].into());
    camera
}

fn bases(golden: &Tensors) -> MotionBases {
    MotionBases {
        frames: golden.shape("state.motion_bases.params.rots")[1],
        rotations: golden.values("state.motion_bases.params.rots").to_vec(),
        translations: golden.values("state.motion_bases.params.transls").to_vec(),
    }
}

#[needs(shared)]
#[test]
fn motion_is_that_of_the_reference() {
    let golden = golden();
    let bases = bases(&golden);
    let shares = shares(golden.values("state.fg.params.motion_coefs"), bases.len());
    close(&golden, "eval.coefs", &shares, 1e-6);
    let (means, quats) = (
        golden.values("state.fg.params.means"),
        golden.values("state.fg.params.quats"),
    );
    let count = means.len() / 3;
    let (mut at_means, mut at_quats, mut transforms) = (
        golden.values("eval.means_GT3").to_vec(),
        golden.values("eval.quats_wxyz_GT4").to_vec(),
        Vec::new(),
    );
    let frames = bases.frames;
    for frame in 0..frames {
        let moved = move_gaussians(&bases.at(frame).unwrap(), &shares, means, quats).unwrap();
        for g in 0..count {
            at_means[3 * (g * frames + frame)..][..3].copy_from_slice(&moved.means[3 * g..3 * g + 3]);
            let quat = &moved.quats[4 * g..4 * g + 4];
            let to = &mut at_quats[4 * (g * frames + frame)..][..4];
            let length = quat.iter().map(|v| v * v).sum::<f32>().sqrt();
            let sign = quat.iter().zip(&*to).map(|(a, b)| a * b).sum::<f32>().signum();
            to.iter_mut()
                .zip(quat)
                .for_each(|(to, value)| *to = sign * value / length);
        }
    }
    for g in 0..count {
        for frame in 0..frames {
            let own = &shares[g * bases.len()..(g + 1) * bases.len()];
            let (turn, shift) = mixed(&bases.at(frame).unwrap(), own);
            for row in 0..3 {
                transforms.extend(turn.row(row).to_array().map(|value| value as f32));
                transforms.push(shift[row] as f32);
            }
        }
    }
    close(&golden, "eval.means_GT3", &at_means, 2e-6);
    close(&golden, "eval.quats_wxyz_GT4", &at_quats, 2e-6);
    close(&golden, "eval.transforms_GT34", &transforms, 2e-6);
}

#[needs(shared)]
#[test]
fn six_numbers_are_those_of_the_reference() {
    let golden = golden();
    let (mut matrices, mut back) = (Vec::new(), Vec::new());
    for numbers in golden.values("r6.in").chunks_exact(6) {
        let rotation = six::rotation(six_numbers(numbers));
        matrices.extend(rows(&rotation));
        back.extend(six::six(&rotation).map(|value| value as f32));
    }
    close(&golden, "r6.rotmat", &matrices, 1e-6);
    close(&golden, "r6.back", &back, 1e-6);
}

#[needs(shared)]
#[test]
fn rigid_motions_and_weights_are_those_of_the_reference() {
    let golden = golden();
    let weights = |name: &str| -> Vec<f64> { golden.values(name).iter().map(|&v| v.into()).collect() };
    for (case, weights) in [("proc", weights("proc.weights")), ("proc2", vec![1.0; 50])] {
        let points = |part: &str| vectors(golden.values(&format!("{case}.{part}")));
        let (rotation, translation) = rigid_motion(&points("src"), &points("dst"), &weights).unwrap();
        assert!(rotation.determinant() > 0.0);
        let found = six::six(&rotation).map(|value| value as f32);
        close(&golden, &format!("{case}.rot6d"), &found, 2e-6);
        close(&golden, &format!("{case}.t"), &translation.as_vec3().to_array(), 2e-6);
    }
    let shape = golden.shape("procw.cluster_T_N_3")[1];
    let points: Vec<Vec<DVec3>> = golden
        .values("procw.cluster_T_N_3")
        .chunks_exact(3 * shape)
        .map(vectors)
        .collect();
    let visible: Vec<Vec<bool>> = golden
        .values("procw.visible_u8")
        .chunks_exact(shape)
        .map(|row| row.iter().map(|&v| v > 0.0).collect())
        .collect();
    let found: Vec<f32> = point_weights(&points, &visible)
        .concat()
        .iter()
        .map(|&v| v as f32)
        .collect();
    close(&golden, "procw.weights", &found, 2e-6);
}

#[needs(shared)]
#[test]
fn losses_are_those_of_the_reference() {
    let golden = golden();
    let get = |name: &str| golden.values(name);
    let bases = bases(&golden);
    close_to(
        &golden,
        "accel_rots",
        acceleration(&bases.rotations, bases.frames, 6).unwrap().value,
    );
    close_to(
        &golden,
        "accel_transls",
        acceleration(&bases.translations, bases.frames, 3).unwrap().value,
    );
    close_to(&golden, "se3_smooth", bases_smoothness(&bases).unwrap().0.value);
    let neighbours = get("loss.neighbour_means_G_3_B_3");
    let centres: Vec<DVec3> = get("loss.batch_ts")
        .iter()
        .map(|&frame| base_from_camera(&get("state.w2cs")[16 * frame as usize..][..16]).translation)
        .collect();
    close_to(
        &golden,
        "small_accel_tracks",
        track_smoothness(neighbours, centres.len()).unwrap().value,
    );
    close_to(
        &golden,
        "z_accel",
        ray_acceleration(neighbours, &centres).unwrap().value,
    );
    for part in ["fg", "bg"] {
        let found = scale_variance(get(&format!("state.{part}.params.scales")))
            .unwrap()
            .value;
        close_to(&golden, &format!("scale_var_{part}"), found);
    }
    let (prediction, target, mask) = (get("loss.pred"), get("loss.gt"), get("loss.mask"));
    close_to(
        &golden,
        "masked_l1_q1.0",
        masked_l1(prediction, target, mask, 1.0).unwrap().value,
    );
    close_to(
        &golden,
        "masked_l1_q0.98",
        masked_l1(prediction, target, mask, 0.98).unwrap().value,
    );
    let valid: Vec<bool> = mask.iter().map(|&value| value > 0.5).collect();
    let [_, height, width, _] = *golden.shape("loss.pred") else {
        panic!()
    };
    close_to(
        &golden,
        "gradient_q0.95",
        gradient_l1(prediction, target, &valid, height, width, 0.95)
            .unwrap()
            .value,
    );
    let visible: Vec<bool> = get("track.visible_u8").iter().map(|&value| value > 0.0).collect();
    let confidence = get("track.conf");
    let found = track_2d(get("track.pred"), get("track.gt"), &visible, confidence, 280.0, 0.98).unwrap();
    close_to(&golden, "track_2d_max280", found.value);
    let weights: Vec<f32> = confidence
        .iter()
        .zip(&visible)
        .map(|(&c, &v)| if v { c } else { 0.0 })
        .collect();
    let found = disparity_l1(get("track.pred_depth"), get("track.gt_depth"), &weights, 1.0).unwrap();
    close_to(&golden, "mapped_depth", found.value);
}

#[needs(shared)]
#[test]
fn filters_and_normals_are_those_of_the_reference() {
    let golden = golden();
    let [height, width] = *golden.shape("median.in") else {
        panic!()
    };
    let found = median_filter(golden.values("median.in"), height, width, 11).unwrap();
    close(&golden, "median.out11", &found, 0.0);
    let [height, width] = *golden.shape("normal.depth") else {
        panic!()
    };
    let camera = pinhole(golden.values("normal.K"), width as u32, height as u32);
    let pose = base_from_camera(golden.values("normal.w2c"));
    let found = normals(golden.values("normal.depth"), height, width, &camera, &pose.rotation).unwrap();
    let found: Vec<f32> = found.iter().flat_map(|normal| normal.as_vec3().to_array()).collect();
    close(&golden, "normal.out", &found, 1e-5);
}

#[needs(shared)]
#[test]
fn tracks_are_lifted_as_by_the_reference() {
    let golden = golden();
    let get = |name: &str| golden.values(name);
    for (k, (&occlusion, &distance)) in get("tapir.occ_logit").iter().zip(get("tapir.dist_logit")).enumerate() {
        let sight = Sight::from_logits(occlusion, distance);
        assert_eq!(sight.visible, get("tapir.visible_u8")[k] > 0.0, "{k}");
        assert_eq!(sight.invisible, get("tapir.invisible_u8")[k] > 0.0, "{k}");
        assert!((sight.confidence - get("tapir.confidence")[k]).abs() < 1e-6, "{k}");
    }
    let [t, height, width] = *golden.shape("t3d.depths") else {
        panic!()
    };
    let area = height * width;
    let camera = pinhole(get("t3d.K"), width as u32, height as u32);
    let poses: Vec<_> = get("t3d.w2c").chunks_exact(16).map(base_from_camera).collect();
    let frames: Vec<TrackedFrame<'_>> = (0..t)
        .map(|frame| TrackedFrame {
            camera: &camera,
            base_from_camera: &poses[frame],
            depth: &get("t3d.depths")[frame * area..][..area],
            mask: &get("t3d.masks")[frame * area..][..area],
        })
        .collect();
    let query = get("t3d.query_index")[0] as usize;
    let found = lift_tracks(
        get("t3d.tracks_N_T_4"),
        &frames,
        query,
        get("t3d.query_image"),
        height,
        width,
    )
    .unwrap();
    // The reference asks for a sample of exactly 1, which rounding denies some points inside the mask.
    let expected: Vec<&[f32]> = get("t3d.out_xyz").chunks_exact(3 * t).collect();
    assert!(found.kept.len() >= expected.len() && found.kept.len() <= expected.len() + 1);
    let (mut next, mut denied) = (0, 0);
    for own in 0..found.kept.len() {
        let positions: Vec<f32> = found.positions_m[own * t..(own + 1) * t]
            .iter()
            .flat_map(|p| p.as_vec3().to_array())
            .collect();
        if next == expected.len() || worst(&positions, expected[next]) > 2e-6 {
            continue;
        }
        let colour = worst(&found.colours[own], &get("t3d.out_colors")[3 * next..3 * next + 3]);
        assert!(colour < 1e-6, "{own}: {colour}");
        for (frame, sight) in found.sights[own * t..(own + 1) * t].iter().enumerate() {
            let at = next * t + frame;
            // The reference cleared it: outside the mask, or inside and denied by rounding.
            if get("t3d.out_conf")[at] == 0.0 {
                denied += usize::from(sight.confidence > 0.0);
                continue;
            }
            assert!(
                (sight.confidence - get("t3d.out_conf")[at]).abs() < 1e-6,
                "{own} {frame}"
            );
            assert_eq!(sight.visible, get("t3d.out_visible_u8")[at] > 0.0, "{own} {frame}");
            assert_eq!(sight.invisible, get("t3d.out_invisible_u8")[at] > 0.0, "{own} {frame}");
        }
        next += 1;
    }
    assert_eq!(next, expected.len(), "every track of the reference is among ours");
    println!(
        "t3d: {} tracks for {next}, {denied} sights denied by rounding",
        found.kept.len()
    );
    assert!(denied * 20 < next * t, "{denied} of {}", next * t);
}
