//! The measure on procedural pictures, whose true offset is known.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common;

use common::{Machine, camera, episode};
use glam::{DVec2, DVec3};
use rogs_agreement::{Agreement, Settings, Surface, View, Why, agreement, measure};
use rogs_geometry::{Base, Pose, PosedCamera};

/// Measures frame `frame` of a camera that is believed to stand at `moved`.
fn measured(
    machine: &Machine,
    seed: u64,
    index: usize,
    moved: impl Fn(PosedCamera<Base>) -> PosedCamera<Base>,
) -> Agreement {
    let episode = episode(seed);
    let frame = 16;
    let believed = moved(camera(&episode, index, frame));
    let links = machine.links(&episode.states[frame]);
    let drawn = machine.draw(&believed.lens, &believed.world_from_camera, &links);
    let picture = &episode.render_frame(frame).views[index];
    let view = View {
        rgb: &picture.rgb,
        camera: believed,
        surface: Surface::from(&drawn),
        base_from_link: &links,
        sensor_depth_m: Some(&picture.depth_m),
    };
    agreement(&view, &Settings::default()).unwrap()
}

#[test]
fn true_cameras_agree_and_moved_ones_are_off_by_what_they_were_moved() {
    let machine = Machine::new();
    let (mut right, mut off) = (Vec::new(), Vec::new());
    for seed in 0..6 {
        for index in [1, 2] {
            let Agreement::Measured(found) = measured(&machine, seed, index, |camera| camera) else {
                panic!("seed {seed}, camera {index}: cannot tell");
            };
            right.push(found.offset_px[0]);
            assert!(found.depth.unwrap().offset_m.abs() < 2e-3);
            // The principal point 5 px off to the right and 3 px up shifts the drawing so.
            let Agreement::Measured(found) = measured(&machine, seed, index, |mut camera| {
                camera.lens.intrinsics.cx += 5.0;
                camera.lens.intrinsics.cy -= 3.0;
                camera
            }) else {
                panic!("seed {seed}, camera {index}: cannot tell when shifted");
            };
            off.push((found.shift.px - DVec2::new(-5.0, 3.0)).length());
        }
    }
    right.sort_by(f64::total_cmp);
    off.sort_by(f64::total_cmp);
    assert!(right[6] < 0.4 && right[10] < 0.8, "{right:?}");
    assert!(off[6] < 0.4 && off[10] < 1.2, "{off:?}");
}

#[test]
fn what_cannot_be_told_is_said() {
    let machine = Machine::new();
    let unseen = measured(&machine, 3, 1, |mut camera| {
        camera.world_from_camera = camera.world_from_camera * Pose::from_xyz_euler([0.0; 3], [0.0, 3.1, 0.0]);
        camera
    });
    assert_eq!(
        unseen,
        Agreement::CannotTell {
            why: Why::HardlyVisible
        }
    );
    let episode = episode(3);
    let believed = camera(&episode, 1, 0);
    let links = machine.links(&episode.states[0]);
    let drawn = machine.draw(&believed.lens, &believed.world_from_camera, &links);
    let blank = vec![127; drawn.link.len() * 3];
    let view = View {
        rgb: &blank,
        camera: believed,
        surface: Surface::from(&drawn),
        base_from_link: &links,
        sensor_depth_m: None,
    };
    assert_eq!(
        agreement(&view, &Settings::default()).unwrap(),
        Agreement::CannotTell { why: Why::BlankImage }
    );
    assert!(
        agreement(
            &View {
                rgb: &blank[3..],
                ..view
            },
            &Settings::default()
        )
        .is_err()
    );
    assert!(
        agreement(
            &View {
                base_from_link: &links[..1],
                ..view
            },
            &Settings::default()
        )
        .is_err()
    );
}

#[test]
fn samples_are_points_of_the_surface() {
    let machine = Machine::new();
    let episode = episode(5);
    let believed = camera(&episode, 2, 8);
    let links = machine.links(&episode.states[8]);
    let drawn = machine.draw(&believed.lens, &believed.world_from_camera, &links);
    let picture = &episode.render_frame(8).views[2];
    let view = View {
        rgb: &picture.rgb,
        camera: believed,
        surface: Surface::from(&drawn),
        base_from_link: &links,
        sensor_depth_m: None,
    };
    let found = measure(&view, &Settings::of_range(6.0)).unwrap();
    assert!(found.samples.len() > 150, "{}", found.samples.len());
    for sample in &found.samples {
        let in_camera = believed.world_from_camera.inverse().point(sample.base_point);
        let (pixel, _) = believed.lens.project(in_camera).unwrap();
        assert!(pixel.distance(sample.pixel) < 1e-6);
        let in_base: DVec3 = links[usize::from(sample.link)].point(sample.link_point);
        assert!(in_base.distance(sample.base_point) < 1e-9);
        assert!(sample.offset_px.abs() <= 6.0 && (0.0..=1.0).contains(&sample.weight) && sample.sigma_px > 0.0);
    }
}
