//! Wide worlds: exact as plain cells are, the same for the same seed, and nothing of them where they are not asked for.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use rogs_synth::{
    Episode, FIRST_OBJECT_ID, FIRST_SCENERY_ID, Layouts, Photo, Props, Resolution, SynthConfig, World,
    generate_episode, generate_episode_with,
};

const NO_LAYOUT: Layouts = Layouts {
    cell: 0.0,
    near: 0.0,
    ring: 0.0,
    room: 0.0,
};

fn config(world: Option<World>) -> SynthConfig {
    SynthConfig {
        resolution: Resolution {
            wrist: [42, 70],
            external: [42, 70],
        },
        world,
        ..SynthConfig::default()
    }
}

fn wide(seed: u64, layouts: Layouts) -> Episode {
    let world = World {
        share: 1.0,
        layouts,
        ..World::default()
    };
    generate_episode(&config(Some(world)), seed).unwrap()
}

#[test]
fn without_a_share_the_plain_cell_is_what_it_was() {
    let none = World {
        share: 0.0,
        ..World::default()
    };
    for seed in [1, 2] {
        let plain = generate_episode(&config(None), seed).unwrap();
        let asked = generate_episode(&config(Some(none.clone())), seed).unwrap();
        assert_eq!(plain.render_frame(9), asked.render_frame(9));
        assert_eq!(plain.states, asked.states);
    }
}

#[test]
fn wide_worlds_are_the_same_for_the_same_seed_and_others_for_another() {
    let layouts = Layouts::default();
    let (a, b, other) = (wide(5, layouts), wide(5, layouts), wide(6, layouts));
    assert_eq!(a.render_frame(3), b.render_frame(3));
    assert_ne!(a.render_frame(3).views[1].rgb, other.render_frame(3).views[1].rgb);
}

#[test]
fn rooms_show_no_robot_and_depths_of_a_room() {
    let room = Layouts { room: 1.0, ..NO_LAYOUT };
    let (mut robot, mut all, mut near, mut far, mut open) = (0, 0, 0, 0, 0);
    for seed in 0..12 {
        for view in wide(seed, room).render_cameras(0, &[0, 1, 2]) {
            for (&id, &depth) in view.id.iter().zip(&view.depth_m) {
                all += 1;
                robot += usize::from(id < FIRST_SCENERY_ID);
                open += usize::from(id == u8::MAX);
                near += usize::from(depth < 1.0);
                far += usize::from(depth > 2.0);
            }
        }
    }
    assert!(robot * 20 < all, "{robot} of {all} pixels show robot or objects");
    assert!(open * 100 < all, "{open} of {all} pixels show nothing");
    assert!(near * 20 > all && far * 20 > all, "{near} near and {far} far of {all}");
}

#[test]
fn cells_show_robot_and_objects_from_everywhere() {
    for layouts in [
        Layouts { cell: 1.0, ..NO_LAYOUT },
        Layouts { near: 1.0, ..NO_LAYOUT },
        Layouts { ring: 1.0, ..NO_LAYOUT },
    ] {
        let mut seen = [0; 3];
        for seed in 20..28 {
            let views = wide(seed, layouts).render_cameras(10, &[0, 1, 2]);
            for (count, view) in seen.iter_mut().zip(&views) {
                let moving = view.id.iter().filter(|&&id| id < FIRST_SCENERY_ID).count();
                let robot = view.id.iter().any(|&id| id < FIRST_OBJECT_ID);
                *count += usize::from(robot && moving > 30);
            }
        }
        assert!(seen[0] >= 5 && seen[1] >= 6, "{layouts:?}: {seen:?}");
    }
}

/// Points of the scenery that one camera sees are seen by another at the same depth, or hidden behind something.
#[test]
fn depths_of_two_cameras_agree() {
    let near = Layouts { near: 1.0, ..NO_LAYOUT };
    let (mut same, mut through) = (0, 0);
    for seed in 40..46 {
        let episode = wide(seed, near);
        let views = episode.render_cameras(4, &[1, 4]);
        let (from, to) = (episode.base_from_camera(1, 4), episode.base_from_camera(4, 4).inverse());
        let lens = [episode.cameras[1].lens, episode.cameras[4].lens];
        for (pixel, &depth) in views[0].depth_m.iter().enumerate() {
            let ray = lens[0].ray((pixel % 70) as u32, (pixel / 70) as u32);
            let point = to.point(from.point(ray * f64::from(depth)));
            let Some((place, there)) = lens[1].project(point) else {
                continue;
            };
            if !(0.0..70.0).contains(&place.x) || !(0.0..42.0).contains(&place.y) {
                continue;
            }
            let seen = f64::from(views[1].depth_m[place.y as usize * 70 + place.x as usize]);
            same += usize::from((seen / there - 1.0).abs() < 0.03);
            through += usize::from(seen > there * 1.1);
        }
    }
    assert!(same > 5000 && through * 30 < same, "{same} {through}");
}

#[test]
fn photographs_are_seen_where_there_are_any() {
    // Pure red, which no pattern and no light makes of itself over a whole picture.
    let photo = Photo::new(32, 32, &[230, 10, 10].repeat(32 * 32)).unwrap();
    let props = Props {
        photos: vec![photo].into(),
        ..Props::default()
    };
    let world = World {
        share: 1.0,
        photos: 1.0,
        ..World::default()
    };
    let red = |props: &Props| {
        let episode = generate_episode_with(&config(Some(world.clone())), 3, props).unwrap();
        let views = episode.render_cameras(0, &[1, 2]);
        let pixels = views.iter().flat_map(|view| view.rgb.chunks_exact(3));
        pixels
            .filter(|rgb| i32::from(rgb[0]) > 2 * i32::from(rgb[1]) + 20)
            .count()
    };
    let (with, without) = (red(&props), red(&Props::default()));
    assert!(with > 42 * 70 && with > 3 * without, "{with} {without}");
}
