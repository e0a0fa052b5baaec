//! The room: table, stand of the robot, floor, walls and things along the walls.

use std::sync::Arc;

use glam::{DVec3, Vec3};
use rogs_geometry::{Base, Pose};

use super::{Body, FIRST_SCENERY_ID, draw_material};
use crate::frame::BodyFrame;
use crate::math::{Draw, hsv, rot_z};
use crate::mesh::TriMesh;
use crate::render::{Material, Pattern, PreparedMesh};

/// The scenery of an episode.
#[derive(Debug, Clone)]
pub(crate) struct Room {
    pub bodies: Vec<Body>,
    /// Height of the table top in the base frame, metres.
    pub table_z: f64,
}

/// Collects scenery.
#[derive(Debug, Default)]
pub(crate) struct Builder {
    pub(crate) bodies: Vec<Body>,
}

impl Builder {
    pub(crate) fn add(&mut self, mesh: TriMesh, pose: Pose<Base, BodyFrame>, material: Material, shadow: bool) {
        self.add_prepared(Arc::new(PreparedMesh::new(mesh)), pose, vec![material], shadow);
    }

    pub(crate) fn add_prepared(
        &mut self,
        mesh: Arc<PreparedMesh>,
        pose: Pose<Base, BodyFrame>,
        materials: Vec<Material>,
        shadow: bool,
    ) {
        // The last number says that nothing is seen; what comes after the one before it shares its id.
        let id = FIRST_SCENERY_ID
            .saturating_add(self.bodies.len() as u8)
            .min(u8::MAX - 1);
        self.bodies.push(Body {
            id,
            mesh,
            materials,
            fixed: Some(pose),
            shadow,
        });
    }

    /// A box between two corners.
    pub(crate) fn block(&mut self, low: [f64; 3], high: [f64; 3], material: Material, shadow: bool) {
        let (low, high) = (DVec3::from_array(low), DVec3::from_array(high));
        let pose = Pose::from_translation(0.5 * (low + high));
        self.add(TriMesh::cuboid((0.5 * (high - low)).to_array()), pose, material, shadow);
    }
}

pub(crate) fn draw_room(draw: &mut Draw) -> Room {
    let mut room = Builder::default();
    // Either the robot is bolted to the table, or the table stands in front of the robot's own stand.
    let bolted = draw.chance(0.5);
    let table_z = if bolted { 0.0 } else { draw.range(-0.14, 0.03) };
    let floor_z = table_z - draw.range(0.62, 0.85);
    let table = table_material(draw);
    let (far, half_y) = (draw.range(0.82, 1.25), draw.range(0.48, 0.95));
    let near = if bolted {
        -draw.range(0.20, 0.45)
    } else {
        draw.range(0.20, 0.27)
    };
    let side = draw.range(-0.08, 0.08);
    let thickness = draw.range(0.018, 0.05);
    room.block(
        [near, side - half_y, table_z - thickness],
        [far, side + half_y, table_z],
        table,
        true,
    );
    let metal = Material {
        gloss: 0.2,
        ..Material::plain(hsv(draw.unit(), 0.1, draw.range(0.15, 0.75)))
    };
    for (x, y) in [(near, -1.0), (near, 1.0), (far, -1.0), (far, 1.0)] {
        let x = x + if x == near { 0.05 } else { -0.05 };
        let y = side + y * (half_y - 0.05);
        room.block(
            [x - 0.02, y - 0.02, floor_z],
            [x + 0.02, y + 0.02, table_z - thickness],
            metal,
            true,
        );
    }
    if !bolted {
        let stand = Material::plain(hsv(draw.unit(), 0.15, draw.range(0.12, 0.7)));
        room.block([-0.19, -0.16, floor_z], [0.11, 0.16, -0.001], stand, true);
    }
    shell(draw, &mut room, floor_z);
    Room {
        bodies: room.bodies,
        table_z,
    }
}

fn table_material(draw: &mut Draw) -> Material {
    let hue = draw.range(0.04, 0.12);
    let wood = [
        hsv(hue, draw.range(0.3, 0.7), draw.range(0.4, 0.95)),
        hsv(hue, 0.65, draw.range(0.2, 0.55)),
    ];
    let plain = hsv(draw.unit(), draw.range(0.0, 0.35), draw.range(0.3, 1.0));
    let offset = Vec3::new(draw.range(0.0, 5.0) as f32, draw.range(0.0, 5.0) as f32, 0.37);
    let base = Material {
        offset,
        grain: draw.range(0.02, 0.10) as f32,
        gloss: draw.range(0.0, 0.15) as f32,
        scale: draw.range(0.07, 0.22) as f32,
        ..Material::plain(plain)
    };
    let second = Vec3::from_array(hsv(draw.unit(), 0.4, draw.range(0.2, 1.0)));
    match draw.index(10) {
        0..=3 => Material {
            pattern: Pattern::Wood,
            colours: wood.map(Vec3::from_array),
            ..base
        },
        4 => Material {
            pattern: Pattern::Checker,
            colours: [base.colours[0], second],
            ..base
        },
        5 => Material {
            pattern: Pattern::Cloud,
            colours: [base.colours[0], base.colours[0].lerp(second, 0.5)],
            ..base
        },
        6 => Material {
            pattern: Pattern::Stripes(draw.index(2)),
            colours: [base.colours[0], second],
            ..base
        },
        _ => base,
    }
}

/// Floor, walls, ceiling, and furniture along the walls.
fn shell(draw: &mut Draw, room: &mut Builder, floor_z: f64) {
    let hue = draw.unit();
    let floor_colour = hsv(draw.range(0.0, 0.7), draw.range(0.0, 0.3), draw.range(0.25, 0.85));
    let joint = Vec3::from_array(floor_colour) * 0.5;
    let floor = Material {
        pattern: [Pattern::Tiles, Pattern::Wood, Pattern::Cloud][draw.index(3)],
        colours: [Vec3::from_array(floor_colour), joint],
        scale: draw.range(0.25, 0.6) as f32,
        grain: 0.05,
        ..Material::plain(floor_colour)
    };
    let (x0, x1) = (-draw.range(1.3, 2.6), draw.range(1.85, 3.4));
    let (y0, y1) = (-draw.range(1.6, 3.2), draw.range(1.6, 3.2));
    let top = floor_z + draw.range(2.5, 3.0);
    room.block([x0, y0, floor_z - 0.1], [x1, y1, floor_z], floor, false);
    room.block(
        [x0, y0, top],
        [x1, y1, top + 0.1],
        Material::plain([0.8, 0.8, 0.78]),
        false,
    );
    let walls = [
        ([x0 - 0.1, y0, floor_z], [x0, y1, top]),
        ([x1, y0, floor_z], [x1 + 0.1, y1, top]),
        ([x0, y0 - 0.1, floor_z], [x1, y0, top]),
        ([x0, y1, floor_z], [x1, y1 + 0.1, top]),
    ];
    for (low, high) in walls {
        let colour = hsv(
            hue + draw.range(-0.05, 0.05),
            draw.range(0.0, 0.35),
            draw.range(0.55, 1.0),
        );
        let shade = Vec3::from_array(colour) * draw.range(0.75, 0.98) as f32;
        let pattern = [Pattern::Plain, Pattern::Cloud, Pattern::Cloud, Pattern::Stripes(2)][draw.index(4)];
        let material = Material {
            pattern,
            colours: [Vec3::from_array(colour), shade],
            scale: draw.range(0.2, 0.9) as f32,
            grain: 0.03,
            ..Material::plain(colour)
        };
        room.block(low, high, material, false);
    }
    for _ in 0..4 + draw.index(7) {
        furniture(draw, room, [x0, x1], [y0, y1], floor_z);
    }
}

/// A cupboard, shelf, box or panel beside a wall, clear of robot, table and cameras.
fn furniture(draw: &mut Draw, room: &mut Builder, [x0, x1]: [f64; 2], [y0, y1]: [f64; 2], floor_z: f64) {
    let tall = draw.range(0.4, 2.0);
    let (along, deep) = (draw.range(0.2, 0.7), draw.range(0.08, 0.2));
    let mut material = draw_material(draw, 0.25, 0.6);
    if draw.chance(0.4) {
        material.pattern = Pattern::Patches;
        material.scale = draw.range(0.12, 0.35) as f32;
    }
    let gap = deep + 0.02;
    let (centre, turn) = match draw.index(4) {
        0 => (DVec3::new(x1 - gap, draw.range(y0 + 0.7, y1 - 0.7), 0.0), 0.0),
        1 => (DVec3::new(x0 + gap, draw.range(y0 + 0.7, y1 - 0.7), 0.0), 0.0),
        2 => (DVec3::new(draw.range(x0 + 0.7, x1 - 0.7), y0 + gap, 0.0), 1.0),
        _ => (DVec3::new(draw.range(x0 + 0.7, x1 - 0.7), y1 - gap, 0.0), 1.0),
    };
    let lift = if draw.chance(0.3) { draw.range(0.3, 0.9) } else { 0.0 };
    let pose = Pose::new(
        rot_z(turn * std::f64::consts::FRAC_PI_2 + draw.range(-0.12, 0.12)),
        DVec3::new(centre.x, centre.y, floor_z + lift + 0.5 * tall),
    );
    room.add(TriMesh::cuboid([deep, along, 0.5 * tall]), pose, material, false);
}
