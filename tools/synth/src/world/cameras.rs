//! Cameras of wide worlds.

use glam::DVec3;
use rogs_geometry::{Base, Camera, Pinhole, Pose};
use rogs_schemas::Intrinsics;

use super::{Layout, Outline, World, within};
use crate::cameras::{
    CAMERAS, EpisodeCamera, HAND_EYE_MEAN, HAND_EYE_TILT_DEG, Mount, Resolution, ZED_MINI_BASELINE, ZED2_BASELINE,
    hand_eye, looking_at, moved,
};
use crate::frame::BodyFrame;
use crate::math::{Draw, rot_axis, rot_rpy, rot_z};

/// The cameras of a wide world, and what the room must know of them.
pub(crate) struct WideCameras {
    pub(crate) cameras: [EpisodeCamera; CAMERAS],
    /// Where cameras stand that stand still, base frame.
    pub(crate) eyes: Vec<DVec3>,
    /// Where the first of them looks.
    pub(crate) ahead: DVec3,
    /// From cameras to what they should see.
    pub(crate) sights: Vec<[DVec3; 2]>,
}

/// Optical axes of a room's cameras differ by at most about this, radians.
const ROOM_TURN: f64 = 0.4;

/// Draws the cameras. The base stands `base_height` over the floor, the table `table_z` over the base.
pub(crate) fn draw_wide_cameras(
    draw: &mut Draw,
    (world, outline): (&World, Outline),
    resolution: Resolution,
    (table_z, base_height): (f64, f64),
) -> WideCameras {
    let lens_of_place = within(draw, world.field_of_view_deg);
    let of_wrist = within(draw, world.wrist_field_of_view_deg);
    let wrist_lens = lens(draw, resolution.wrist, of_wrist);
    let same_lens = draw.chance(0.7);
    let poses: Vec<(Mount, f64)>;
    let mut eyes = Vec::new();
    let mut sights = Vec::new();
    let mut ahead = DVec3::X;
    if outline.layout == Layout::Room {
        let views = room_views(draw, world, outline.scale, base_height);
        ahead = views[0].rotation.z_axis;
        eyes.extend(views.iter().map(|view| view.translation));
        sights.extend(eyes.iter().map(|eye| [*eye, *eye + ahead * (0.6 * outline.scale)]));
        let baseline = |draw: &mut Draw| ZED2_BASELINE[0] * outline.scale * draw.range(0.5, 2.0);
        poses = views.iter().map(|view| (Mount::Fixed(*view), baseline(draw))).collect();
    } else {
        let wrist = (
            Mount::Flange(wrist_mount(draw)),
            ZED_MINI_BASELINE[0] * draw.range(0.7, 1.6),
        );
        let pair = external_views(draw, world, outline.layout, table_z, -base_height);
        let away = draw.chance(world.look_away);
        let turned = pair[1].rotation
            * rot_axis(
                DVec3::Y,
                draw.range(0.9, 2.4) * if draw.chance(0.5) { 1.0 } else { -1.0 },
            );
        let second = if away {
            Pose::new(turned, pair[1].translation)
        } else {
            pair[1]
        };
        let workspace = DVec3::new(0.5, 0.0, table_z + 0.1);
        for (index, view) in [pair[0], second].iter().enumerate() {
            eyes.push(view.translation);
            if index == 0 || !away {
                sights.push([view.translation, workspace]);
            }
        }
        let baseline = |draw: &mut Draw| ZED2_BASELINE[0] * draw.range(0.5, 1.6);
        let (first, other) = (baseline(draw), baseline(draw));
        poses = vec![wrist, (Mount::Fixed(pair[0]), first), (Mount::Fixed(second), other)];
    }
    let lenses: Vec<Pinhole> = (0..3)
        .map(|index| {
            let own = within(draw, world.field_of_view_deg);
            let degrees = if same_lens { lens_of_place } else { own };
            let external = lens(draw, resolution.external, degrees);
            match outline.layout {
                Layout::Room if index == 0 => lens(draw, resolution.wrist, lens_of_place),
                _ if index == 0 => wrist_lens,
                _ => external,
            }
        })
        .collect();
    let errors = errors(draw, world);
    let cameras = std::array::from_fn(|index| {
        let ((mount, baseline), lens) = (poses[index % 3], lenses[index % 3]);
        let eye = Pose::from_translation(DVec3::X * if index < 3 { 0.0 } else { baseline });
        let (error, focal) = &errors[index % 3];
        let recorded_lens = Pinhole {
            intrinsics: Intrinsics {
                fx: lens.intrinsics.fx * focal,
                fy: lens.intrinsics.fy * focal,
                ..lens.intrinsics
            },
            ..lens
        };
        EpisodeCamera {
            lens,
            recorded_lens,
            mount: moved(mount, eye),
            recorded_mount: moved(mount, *error * eye),
        }
    });
    WideCameras {
        cameras,
        eyes,
        ahead,
        sights,
    }
}

/// What is recorded differs from what is true by these: a pose in the camera's frame, and a factor on the focal length.
fn errors(draw: &mut Draw, world: &World) -> Vec<(Pose<Camera, Camera>, f64)> {
    let ranges = &world.calibration;
    let wrong = draw.chance(ranges.share);
    let error = |index: usize| {
        let (most_m, most_deg) = if index == 0 {
            (ranges.wrist_m, ranges.wrist_deg)
        } else {
            (ranges.external_m, ranges.external_deg)
        };
        let (shift_m, turn) = (draw.range(0.0, most_m), draw.range(0.0, most_deg).to_radians());
        let (shift, turned) = (draw.normal3(shift_m), draw.normal3(turn));
        let focal = 1.0 + draw.normal() * draw.range(0.0, ranges.focal);
        if wrong {
            (Pose::new(rot_rpy(turned.to_array()), shift), focal)
        } else {
            (Pose::IDENTITY, 1.0)
        }
    };
    (0..3).map(error).collect()
}

/// A lens of a horizontal field of view, degrees, with its centre near that of the image and square pixels.
fn lens(draw: &mut Draw, [height, width]: [u32; 2], degrees: f64) -> Pinhole {
    let (w, h) = (f64::from(width), f64::from(height));
    let focal = 0.5 * w / libm::tan(0.5 * degrees.to_radians());
    Pinhole {
        intrinsics: Intrinsics {
            fx: focal,
            fy: focal * (1.0 + 0.006 * draw.normal()),
            cx: w * (0.5 + 0.008 * draw.normal()),
            cy: h * (0.5 + 0.012 * draw.normal()),
        },
        width,
        height,
    }
}

/// On the hand, as DROID has it and further: shifted, tilted, at times on another side of the hand.
fn wrist_mount(draw: &mut Draw) -> Pose<BodyFrame, Camera> {
    let translation = DVec3::from_array(HAND_EYE_MEAN) + draw.normal3(0.012);
    let tilt = (HAND_EYE_TILT_DEG[0] + 6.0 * draw.normal()).to_radians();
    let extra = rot_rpy(draw.normal3(0.04).to_array());
    let pose = hand_eye(translation, tilt, extra);
    let side = if draw.chance(0.25) { 1 + draw.index(3) } else { 0 };
    let about: Pose<BodyFrame, BodyFrame> = Pose::new(rot_z(side as f64 * std::f64::consts::FRAC_PI_2), DVec3::ZERO);
    about * pose
}

/// Two external cameras that see the workspace.
fn external_views(
    draw: &mut Draw,
    world: &World,
    layout: Layout,
    table_z: f64,
    floor_z: f64,
) -> [Pose<Base, Camera>; 2] {
    let workspace = DVec3::new(0.5, 0.0, table_z + 0.08);
    let around = |draw: &mut Draw| {
        let azimuth = draw.range(-std::f64::consts::PI, std::f64::consts::PI);
        let elevation = draw.range(0.1, 1.05);
        let level = libm::cos(elevation);
        let towards = DVec3::new(
            level * libm::cos(azimuth),
            level * libm::sin(azimuth),
            libm::sin(elevation),
        );
        let mut eye = workspace + towards * within(draw, world.distance_m);
        eye.z = eye.z.max(floor_z + 0.2).max(table_z + 0.12);
        eye
    };
    let eyes = match layout {
        Layout::Near => {
            let first = around(draw);
            let forward = (workspace - first).normalize();
            let right = forward.cross(DVec3::Z).normalize_or(DVec3::Y);
            let side = if draw.chance(0.5) { 1.0 } else { -1.0 };
            let lift = DVec3::Z * draw.range(-0.15, 0.15);
            let mut second =
                first + (right * side + lift) * within(draw, world.baseline_m) + forward * draw.range(-0.1, 0.1);
            second.z = second.z.max(floor_z + 0.2).max(table_z + 0.12);
            [first, second]
        }
        Layout::Ring => [around(draw), around(draw)],
        Layout::Cell | Layout::Room => [1.0, -1.0].map(|side| {
            DVec3::new(
                draw.range(-0.25, 0.65),
                side * draw.range(0.36, 1.1),
                table_z.max(-0.05) + draw.range(0.16, 0.85),
            )
        }),
    };
    eyes.map(|eye| {
        let target = DVec3::new(
            draw.range(0.25, 0.65),
            draw.range(-0.2, 0.2),
            table_z + draw.range(-0.05, 0.35),
        );
        looking_at(eye, target, 0.05 * draw.normal())
    })
}

/// Three cameras that see a room from about one place, with the robot behind them.
fn room_views(draw: &mut Draw, world: &World, scale: f64, base_height: f64) -> [Pose<Base, Camera>; 3] {
    let azimuth = draw.range(-std::f64::consts::PI, std::f64::consts::PI);
    let outwards = DVec3::new(libm::cos(azimuth), libm::sin(azimuth), 0.0);
    let heading = azimuth + 0.45 * draw.normal();
    let height = draw.range(0.7, 1.9) * scale - base_height;
    let eye = outwards * within(draw, world.base_distance_m) + DVec3::Z * height;
    let pitch = draw.range(-0.75, 0.12);
    let level = libm::cos(pitch);
    let forward = DVec3::new(level * libm::cos(heading), level * libm::sin(heading), libm::sin(pitch));
    let first = looking_at(eye, eye + forward, 0.06 * draw.normal());
    let middle = eye + forward * (draw.range(1.0, 4.0) * scale);
    let other = |draw: &mut Draw| {
        let turn = draw.range(0.0, std::f64::consts::TAU);
        let across = first.direction(DVec3::new(libm::cos(turn), 0.45 * libm::sin(turn), 0.3 * draw.normal()));
        let mut place = eye + across.normalize() * (within(draw, world.baseline_m) * scale);
        place.z = place.z.max(0.15 * scale - base_height);
        // Between looking at the same point and looking the same way.
        let same_way = place + forward;
        let at = (middle - place).normalize().lerp(same_way - place, draw.unit());
        let view = looking_at(place, place + at, 0.05 * draw.normal());
        let error = draw.normal3(0.35 * ROOM_TURN * 0.5);
        Pose::new(view.rotation * rot_rpy([error.x, error.y, 0.3 * error.z]), place)
    };
    let (second, third) = (other(draw), other(draw));
    [first, second, third]
}

#[cfg(test)]
mod tests {
    use glam::DMat3;

    use super::*;

    fn is_rotation(rotation: &DMat3) -> bool {
        let square = *rotation * rotation.transpose();
        (rotation.determinant() - 1.0).abs() < 1e-9 && square.abs_diff_eq(DMat3::IDENTITY, 1e-9)
    }

    fn of(seed: u64, layout: Layout) -> WideCameras {
        let outline = Outline { layout, scale: 0.5 };
        let world = World::default();
        let mut draw = Draw::new(seed, 0);
        draw_wide_cameras(&mut draw, (&world, outline), Resolution::EVALUATION, (0.0, 0.4))
    }

    fn fixed(camera: &EpisodeCamera) -> Pose<Base, Camera> {
        match camera.mount {
            Mount::Fixed(pose) => pose,
            Mount::Flange(_) => panic!("a fixed camera"),
        }
    }

    #[test]
    fn rooms_are_seen_by_cameras_that_stand_together_and_turn_their_backs_to_the_robot() {
        let mut behind = 0;
        for seed in 0..60 {
            let made = of(seed, Layout::Room);
            let views = [0, 1, 2].map(|index| fixed(&made.cameras[index]));
            assert!(views.iter().all(|view| is_rotation(&view.rotation)));
            let distance = views[0].translation.truncate().length();
            assert!((1.0..=6.0).contains(&distance), "{distance}");
            for other in &views[1..] {
                let apart = other.translation.distance(views[0].translation);
                assert!((0.02..0.4).contains(&apart), "{apart}");
                assert!(other.rotation.z_axis.dot(views[0].rotation.z_axis) > 0.6);
            }
            behind += usize::from(views[0].rotation.z_axis.dot(views[0].translation) > 0.0);
        }
        assert!(behind > 50, "{behind}");
    }

    #[test]
    fn external_cameras_see_the_workspace_unless_they_look_away() {
        for layout in [Layout::Cell, Layout::Near, Layout::Ring] {
            for seed in 0..40 {
                let made = of(seed, layout);
                assert!(matches!(made.cameras[0].mount, Mount::Flange(_)));
                let seeing = [1, 2].map(|index| {
                    let view = fixed(&made.cameras[index]);
                    let to = (DVec3::new(0.5, 0.0, 0.1) - view.translation).normalize();
                    to.dot(view.rotation.z_axis) > 0.7
                });
                assert!(seeing[0], "{layout:?} {seed}");
                assert_eq!(made.sights.len(), 1 + usize::from(seeing[1]));
            }
        }
    }

    #[test]
    fn what_is_recorded_is_off_by_what_is_allowed_and_the_same_for_both_eyes() {
        let mut wrong = 0;
        for seed in 0..40 {
            let made = of(seed, Layout::Ring);
            let off = made.cameras[1].mount != made.cameras[1].recorded_mount;
            wrong += usize::from(off);
            for index in 0..3 {
                let (left, right) = (&made.cameras[index], &made.cameras[index + 3]);
                assert_eq!(left.recorded_lens, right.recorded_lens);
                let ratio = left.recorded_lens.intrinsics.fx / left.lens.intrinsics.fx;
                assert!((ratio - 1.0).abs() <= 0.02 && (off || ratio == 1.0));
            }
            let (Mount::Fixed(is), Mount::Fixed(said)) = (made.cameras[2].mount, made.cameras[2].recorded_mount) else {
                panic!("a fixed camera")
            };
            assert!((is.translation - said.translation).length() < 0.036);
        }
        assert!((8..32).contains(&wrong), "{wrong}");
    }
}
