//! Depth, ids, tracks, cameras and motion of an episode agree with each other and with independent computations.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use glam::DVec3;
use rogs_geometry::Pose;
use rogs_synth::{
    Action, CAMERAS, Episode, FIRST_OBJECT_ID, FIRST_SCENERY_ID, FLANGE_LINK, Mount, Resolution, SynthConfig,
    generate_episode,
};

fn small(action: Action) -> SynthConfig {
    SynthConfig {
        resolution: Resolution {
            wrist: [77, 140],
            external: [77, 140],
        },
        action: Some(action),
        tracks_per_camera: [60, 40],
        ..SynthConfig::default()
    }
}

fn episode(action: Action, seed: u64) -> Episode {
    generate_episode(&small(action), seed).unwrap()
}

fn close<A, B>(a: &Pose<A, B>, b: &Pose<A, B>, tolerance: f64) -> bool {
    a.rotation.abs_diff_eq(b.rotation, tolerance) && a.translation.abs_diff_eq(b.translation, tolerance)
}

/// The point of the base frame behind the centre of a pixel.
fn unproject(episode: &Episode, camera: usize, frame: usize, column: usize, row: usize, depth: f32) -> DVec3 {
    let k = episode.cameras[camera].lens.intrinsics;
    let ray = DVec3::new(
        (column as f64 + 0.5 - k.cx) / k.fx,
        (row as f64 + 0.5 - k.cy) / k.fy,
        1.0,
    );
    episode.base_from_camera(camera, frame).point(ray * f64::from(depth))
}

#[test]
fn points_of_the_table_top_lie_in_one_plane() {
    let episode = episode(Action::Reach, 3);
    let views = episode.render_frame(0).views;
    // The table is the first piece of scenery; its top is its highest face.
    let mut heights = Vec::new();
    for (camera, view) in views.iter().enumerate() {
        for (pixel, (&id, &depth)) in view.id.iter().zip(&view.depth_m).enumerate() {
            if id == FIRST_SCENERY_ID {
                heights.push(unproject(&episode, camera, 0, pixel % 140, pixel / 140, depth).z);
            }
        }
    }
    let top = heights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let on_top = heights.iter().filter(|z| (*z - top).abs() < 2e-6).count();
    assert!(heights.len() > 2000, "{} pixels", heights.len());
    // The rest are the sides of the slab.
    assert!(
        on_top as f64 > 0.9 * heights.len() as f64,
        "{on_top} of {}",
        heights.len()
    );
}

#[test]
fn a_visible_track_lands_on_its_pixel_at_the_depth_of_the_map() {
    let episode = episode(Action::Grasp, 5);
    let anchor = episode.config.anchor() as usize;
    let views = episode.render_cameras(anchor, &[0, 1, 2]);
    let tracks = episode.tracks(&views);
    let frames = episode.frame_count();
    assert!(tracks.camera.len() > 100);
    assert!(tracks.id.iter().any(|&id| id < FIRST_OBJECT_ID) && tracks.id.iter().any(|&id| id >= FIRST_OBJECT_ID));
    for track in 0..tracks.camera.len() {
        let camera = tracks.camera[track] as usize;
        let at = 3 * (track * frames + anchor);
        let point = DVec3::from_array(std::array::from_fn(|k| f64::from(tracks.position_m[at + k])));
        let p = episode.base_from_camera(camera, anchor).inverse().point(point);
        let k = episode.cameras[camera].lens.intrinsics;
        let [column, row] = tracks.pixel[track];
        assert!((p.x / p.z * k.fx + k.cx - f64::from(column) - 0.5).abs() < 0.01);
        assert!((p.y / p.z * k.fy + k.cy - f64::from(row) - 0.5).abs() < 0.01);
        let depth = views[camera].depth_m[(row * 140 + column) as usize];
        assert!((p.z - f64::from(depth)).abs() < 1e-4);
        assert_eq!(tracks.visible[track * frames + anchor], 1);
    }
}

#[test]
fn a_track_counts_as_visible_where_the_picture_shows_its_body_at_its_depth() {
    let episode = episode(Action::Carry, 6);
    let anchor = episode.config.anchor() as usize;
    let tracks = episode.tracks(&episode.render_cameras(anchor, &[0, 1, 2]));
    let frames = episode.frame_count();
    let (mut agree, mut differ, mut hidden) = (0, 0, 0);
    for frame in [0, 12, 20, 32] {
        let views = episode.render_cameras(frame, &[0, 1, 2]);
        for track in 0..tracks.camera.len() {
            let camera = tracks.camera[track] as usize;
            let at = 3 * (track * frames + frame);
            let point = DVec3::from_array(std::array::from_fn(|k| f64::from(tracks.position_m[at + k])));
            let p = episode.base_from_camera(camera, frame).inverse().point(point);
            let k = episode.cameras[camera].lens.intrinsics;
            let (u, v) = ((p.x / p.z * k.fx + k.cx).floor(), (p.y / p.z * k.fy + k.cy).floor());
            let visible = tracks.visible[track * frames + frame] == 1;
            let inside = (0.0..140.0).contains(&u) && (0.0..77.0).contains(&v);
            assert!(inside || !visible);
            if !inside {
                continue;
            }
            let pixel = v as usize * 140 + u as usize;
            let shown =
                views[camera].id[pixel] == tracks.id[track] && f64::from(views[camera].depth_m[pixel]) > p.z - 0.02;
            hidden += usize::from(!visible);
            if shown == visible { agree += 1 } else { differ += 1 }
        }
    }
    // Points near outlines and on slanted faces fall on a neighbour's pixel.
    assert!(agree > 12 * differ, "{agree} agree, {differ} differ");
    assert!(hidden > 10, "{hidden}");
}

#[test]
fn what_is_grasped_is_rigid_to_the_flange_and_the_rest_stands_still() {
    for (action, seed) in [(Action::Grasp, 8), (Action::Carry, 9)] {
        let episode = episode(action, seed);
        let [from, to] = episode.held.unwrap();
        assert!(to > from + 5);
        let in_hand =
            |frame| episode.base_from_flange(frame).inverse() * episode.body_pose(FIRST_OBJECT_ID, frame).unwrap();
        let first = in_hand(from);
        for frame in from..to {
            assert!(close(&in_hand(frame), &first, 1e-9), "{action:?} frame {frame}");
        }
        let moved = |id: u8| {
            let (a, b) = (episode.body_pose(id, 0).unwrap(), episode.body_pose(id, 32).unwrap());
            (a.translation - b.translation).length()
        };
        assert!(moved(FIRST_OBJECT_ID) > 0.03);
        assert_eq!(moved(FIRST_OBJECT_ID + 1), 0.0);
        assert_eq!(moved(FIRST_SCENERY_ID), 0.0);
    }
}

#[test]
fn a_push_moves_the_object_along_the_table() {
    let episode = episode(Action::Push, 4);
    let place = |frame| episode.body_pose(FIRST_OBJECT_ID, frame).unwrap().translation;
    let way = place(32) - place(0);
    assert!(way.z.abs() < 1e-12 && way.length() > 0.01, "{way}");
    assert_eq!(place(2), place(0));
}

#[test]
fn cameras_move_with_the_flange_or_not_at_all_and_right_eyes_stand_to_the_right() {
    let episode = episode(Action::Reach, 11);
    for camera in 0..CAMERAS {
        let (a, b) = (
            episode.base_from_camera(camera, 0),
            episode.base_from_camera(camera, 20),
        );
        match episode.cameras[camera].mount {
            Mount::Fixed(pose) => assert!(a == pose && b == pose),
            Mount::Flange(hand_eye) => {
                let expected = episode.body_pose(FLANGE_LINK as u8, 20).unwrap() * hand_eye;
                assert!(close(&b, &expected, 1e-12));
                assert!((a.translation - b.translation).length() > 0.02);
            }
        }
    }
    for left in 0..3 {
        let offset = episode.base_from_camera(left, 9).inverse() * episode.base_from_camera(left + 3, 9);
        let baseline = if left == 0 { 0.0629 } else { 0.12 };
        assert!((offset.translation - DVec3::X * baseline).length() < 5e-4);
        assert!(offset.rotation.abs_diff_eq(glam::DMat3::IDENTITY, 1e-12));
    }
}

#[test]
fn left_and_right_eyes_see_the_same_points() {
    let episode = episode(Action::Grasp, 2);
    let views = episode.render_frame(10).views;
    let (mut same, mut all) = (0, 0);
    for left in 0..3 {
        let k = episode.cameras[left].lens.intrinsics;
        let right_from_base = episode.base_from_camera(left + 3, 10).inverse();
        for pixel in (0..140 * 77).step_by(7) {
            let point = unproject(&episode, left, 10, pixel % 140, pixel / 140, views[left].depth_m[pixel]);
            let p = right_from_base.point(point);
            let (u, v) = ((p.x / p.z * k.fx + k.cx).floor(), (p.y / p.z * k.fy + k.cy).floor());
            if p.z > 0.0 && (0.0..140.0).contains(&u) && (0.0..77.0).contains(&v) {
                // The row is the same up to rounding: the pair is rectified.
                assert!((v - (pixel / 140) as f64).abs() <= 1.0);
                let other = v as usize * 140 + u as usize;
                all += 1;
                same += usize::from(views[left + 3].id[other] == views[left].id[pixel]);
            }
        }
    }
    assert!(same as f64 > 0.85 * all as f64, "{same} of {all}");
}

#[test]
fn every_pixel_sees_something_and_the_robot_is_in_every_camera() {
    for seed in 20..26 {
        let episode = generate_episode(
            &SynthConfig {
                action: None,
                ..small(Action::Reach)
            },
            seed,
        )
        .unwrap();
        for frame in [0, 16, 32] {
            for (camera, view) in episode.render_frame(frame).views.iter().enumerate() {
                assert!(
                    view.depth_m.iter().all(|d| d.is_finite() && *d > 0.0),
                    "seed {seed} camera {camera}"
                );
                let robot = view.id.iter().filter(|&&id| id < FIRST_OBJECT_ID).count();
                assert!(
                    robot > 50,
                    "seed {seed} frame {frame} camera {camera}: {robot} robot pixels"
                );
                assert!(
                    robot < 140 * 77 * 3 / 4,
                    "seed {seed} frame {frame} camera {camera}: {robot} robot pixels"
                );
                let mean = view.rgb.iter().map(|&v| u64::from(v)).sum::<u64>() / view.rgb.len() as u64;
                assert!((25..235).contains(&mean), "seed {seed} camera {camera}: mean {mean}");
            }
        }
    }
}

#[test]
fn calibration_noise_moves_what_is_recorded_and_nothing_else() {
    let exact = episode(Action::Reach, 13);
    let config = SynthConfig {
        calibration_noise: Some([0.004, 0.005]),
        ..small(Action::Reach)
    };
    let noisy = generate_episode(&config, 13).unwrap();
    assert_eq!(exact.render_frame(5), noisy.render_frame(5));
    for camera in 0..CAMERAS {
        assert_eq!(exact.cameras[camera].recorded_mount, exact.cameras[camera].mount);
        assert_ne!(noisy.cameras[camera].recorded_mount, noisy.cameras[camera].mount);
    }
}
