//! Rooms of wide worlds: floor, walls and what hangs on them, the table, furniture, light.

use glam::{DVec2, DVec3, Vec3A};
use rogs_geometry::{Base, Pose};

use super::furniture::{Piece, draw_piece};
use super::surface::Surfaces;
use super::{Layout, Outline, count, within};
use crate::frame::BodyFrame;
use crate::math::{Draw, rot_axis, rot_z};
use crate::mesh::TriMesh;
use crate::render::{Material, ShadowRegion};
use crate::scene::{Builder, Lights, draw_lights};

/// What objects, furniture and clutter must know of a room.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WideRoom {
    /// The room's frame, turned about the height; its floor is z = 0.
    base_from_room: Pose<Base, BodyFrame>,
    /// Corners of the floor in the frame of the room.
    low: DVec2,
    high: DVec2,
    /// Table top at the pivot, and its unit normal.
    pivot: DVec3,
    normal: DVec3,
    /// From the middle of the table, in the base frame.
    table_low: DVec2,
    table_high: DVec2,
}

/// Height of the base below which it stands on the floor.
const ON_THE_FLOOR_M: f64 = 0.35;
/// What a robot that works needs around the middle of its workspace.
const WORKSPACE: DVec2 = DVec2::new(0.4, 0.0);
const WORKSPACE_RADIUS_M: f64 = 0.9;

impl WideRoom {
    /// Height of the table top at a place, base frame, metres.
    pub(crate) fn table_height(&self, x: f64, y: f64) -> f64 {
        let from_pivot = DVec3::new(x, y, 0.0) - self.pivot.with_z(0.0);
        self.pivot.z - (self.normal.x * from_pivot.x + self.normal.y * from_pivot.y) / self.normal.z
    }

    /// The tilt of the table: turns what stands upright into what stands on it.
    pub(crate) fn tilt(&self) -> glam::DMat3 {
        let axis = DVec3::Z.cross(self.normal);
        let sine = axis.length();
        if sine < 1e-9 {
            return glam::DMat3::IDENTITY;
        }
        rot_axis(axis / sine, libm::atan2(sine, self.normal.z))
    }

    /// Least and largest corner of the table top, base frame, metres.
    pub(crate) fn table(&self) -> [DVec2; 2] {
        [self.table_low, self.table_high]
    }
}

/// Floor, walls, ceiling, table and stand. `eyes` are the cameras that stand still, base frame; in rooms without a robot the
/// first of them looks along `ahead`. The table stands `table_z` over the base, the base `base_height` over the floor.
pub(crate) fn draw_wide_room(
    draw: &mut Draw,
    surfaces: &Surfaces<'_>,
    outline: Outline,
    (eyes, ahead): (&[DVec3], DVec3),
    (table_z, base_height): (f64, f64),
) -> (Builder, WideRoom) {
    let world = surfaces.world;
    let floor_z = -base_height;
    let turn = draw.range(-std::f64::consts::PI, std::f64::consts::PI);
    let base_from_room = Pose::new(rot_z(turn), DVec3::new(0.0, 0.0, floor_z));
    let mut inside: Vec<DVec3> = eyes.to_vec();
    if outline.layout == Layout::Room {
        inside.push(eyes[0] + ahead * (1.5 * outline.scale));
    } else {
        inside.extend([[-0.5, -0.7], [-0.5, 0.7], [1.2, -0.7], [1.2, 0.7]].map(|[x, y]| DVec3::new(x, y, 0.0)));
    }
    let inside: Vec<DVec3> = inside.iter().map(|p| base_from_room.inverse().point(*p)).collect();
    let mut low = inside.iter().fold(DVec2::INFINITY, |low, p| low.min(p.truncate()));
    let mut high = inside
        .iter()
        .fold(DVec2::NEG_INFINITY, |high, p| high.max(p.truncate()));
    for axis in 0..2 {
        let margin = 0.35 * outline.scale;
        let wanted = within(draw, world.room_m) * outline.scale;
        let spare = (wanted - (high[axis] - low[axis]) - 2.0 * margin).max(0.0);
        let before = spare * draw.unit();
        low[axis] -= margin + before;
        high[axis] += margin + spare - before;
    }
    let highest = inside.iter().map(|p| p.z).fold(0.0, f64::max);
    let top = (draw.range(2.3, 3.6) * outline.scale).max(highest + 0.3);
    let mut builder = Builder::default();
    let table = draw_table(draw, surfaces, &mut builder, (table_z, floor_z));
    shell(
        draw,
        surfaces,
        &mut builder,
        (&base_from_room, outline.scale),
        [low, high],
        top,
    );
    let room = WideRoom {
        base_from_room,
        low,
        high,
        ..table
    };
    (builder, room)
}

/// The table, which is the floor where the robot stands on it; the rest of the room is not settled.
fn draw_table(
    draw: &mut Draw,
    surfaces: &Surfaces<'_>,
    builder: &mut Builder,
    (table_z, floor_z): (f64, f64),
) -> WideRoom {
    let world = surfaces.world;
    let on_floor = -floor_z < ON_THE_FLOOR_M;
    let bolted = draw.chance(0.5);
    let (far, half_y) = (draw.range(0.75, 1.5), draw.range(0.4, 1.1));
    let near = if bolted {
        -draw.range(0.15, 0.6)
    } else {
        draw.range(0.17, 0.28)
    };
    let side = draw.range(-0.15, 0.15);
    let thickness = draw.range(0.015, 0.06);
    let angle = within(draw, world.table_tilt_deg).to_radians();
    let around = draw.range(0.0, std::f64::consts::TAU);
    let axis = DVec3::new(libm::cos(around), libm::sin(around), 0.0);
    let pivot = DVec3::new(0.5, 0.0, table_z);
    let tilt = rot_axis(axis, angle);
    let material = surfaces.plane(draw, [0.3, 1.6]);
    let metal = surfaces.plane(draw, [0.3, 0.8]);
    if table_z > floor_z + 0.004 {
        let solid = if on_floor { table_z - floor_z } else { thickness };
        let half = DVec3::new(0.5 * (far - near), half_y, 0.5 * solid);
        let middle = DVec3::new(0.5 * (far + near), side, table_z - 0.5 * solid);
        let pose = Pose::new(tilt, pivot + tilt * (middle - pivot));
        builder.add(TriMesh::cuboid(half.to_array()), pose, material, true);
    }
    if !on_floor {
        for (x, y) in [(near, -1.0), (near, 1.0), (far, -1.0), (far, 1.0)] {
            let x = x + if x == near { 0.05 } else { -0.05 };
            let y = side + y * (half_y - 0.05);
            // Short enough for the tilted top.
            let top = table_z - thickness - 0.02;
            builder.block([x - 0.02, y - 0.02, floor_z], [x + 0.02, y + 0.02, top], metal, true);
        }
        if !bolted {
            let stand = surfaces.plane(draw, [0.3, 0.8]);
            builder.block([-0.19, -0.16, floor_z], [0.11, 0.16, -0.001], stand, true);
        }
    }
    WideRoom {
        base_from_room: Pose::IDENTITY,
        low: DVec2::ZERO,
        high: DVec2::ZERO,
        pivot,
        normal: tilt.z_axis,
        table_low: DVec2::new(near, side - half_y),
        table_high: DVec2::new(far, side + half_y),
    }
}

/// Floor, ceiling and walls, with doors, windows, shelves and pictures on the walls.
fn shell(
    draw: &mut Draw,
    surfaces: &Surfaces<'_>,
    builder: &mut Builder,
    (base_from_room, scale): (&Pose<Base, BodyFrame>, f64),
    [low, high]: [DVec2; 2],
    top: f64,
) {
    let mut block = |low: [f64; 3], high: [f64; 3], material: Material| {
        let (low, high) = (DVec3::from_array(low), DVec3::from_array(high));
        let at = Pose::<BodyFrame, BodyFrame>::from_translation(0.5 * (low + high));
        let mesh = TriMesh::cuboid((0.5 * (high - low)).to_array());
        builder.add(mesh, *base_from_room * at, material, false);
    };
    let period = [0.4 * scale, 2.5 * scale];
    block(
        [low.x, low.y, -0.1],
        [high.x, high.y, 0.0],
        surfaces.plane(draw, period),
    );
    let white = Material {
        grain: 0.02,
        ..Material::plain([draw.range(0.6, 0.9) as f32; 3])
    };
    block([low.x, low.y, top], [high.x, high.y, top + 0.1], white);
    let same = surfaces.plane(draw, period);
    for wall in 0..4 {
        let own = surfaces.plane(draw, period);
        let material = if draw.chance(0.6) { same } else { own };
        // Along x at y = low and high, then along y.
        let (axis, place, outwards) = match wall {
            0 => (0, low.y, -1.0),
            1 => (0, high.y, 1.0),
            2 => (1, low.x, -1.0),
            _ => (1, high.x, 1.0),
        };
        let mut slab = |along: [f64; 2], height: [f64; 2], depth: [f64; 2], material: Material| {
            let (a, b) = (place - outwards * depth[1], place - outwards * depth[0]);
            let across = [a.min(b), a.max(b)];
            let (x, y) = if axis == 0 { (along, across) } else { (across, along) };
            block([x[0], y[0], height[0]], [x[1], y[1], height[1]], material);
        };
        let ends = [low[axis], high[axis]];
        slab(ends, [0.0, top], [-0.1, 0.0], material);
        for _ in 0..draw.index(4) {
            let size = draw.range(0.25, 1.4) * scale;
            let middle = draw.range(ends[0] + 0.5 * size, ends[1] - 0.5 * size);
            let along = [(middle - 0.5 * size).max(ends[0]), (middle + 0.5 * size).min(ends[1])];
            let door = draw.chance(0.2);
            let bottom = if door { 0.0 } else { draw.range(0.5, 1.6) * scale };
            let height = if door {
                draw.range(1.9, 2.2)
            } else {
                draw.range(0.2, 1.2)
            } * scale;
            let deep = draw.range(0.01, 0.08) * scale;
            let bright = draw.chance(0.2);
            let material = if bright {
                // A window.
                Material::plain([draw.range(1.0, 2.5) as f32; 3])
            } else {
                surfaces.thing(draw, size)
            };
            if along[1] > along[0] && bottom + 0.05 < top {
                slab(
                    along,
                    [bottom, (bottom + height).min(top - 0.01)],
                    [0.0, deep],
                    material,
                );
            }
        }
    }
}

/// Light of a wide world: as in the plain cell, or of a light probe.
pub(crate) fn draw_wide_lights(draw: &mut Draw, surfaces: &Surfaces<'_>, outline: Outline, middle: DVec3) -> Lights {
    let (world, props) = (surfaces.world, surfaces.props);
    let mut lights = draw_lights(draw);
    lights.key *= draw.range(0.25, 1.2) as f32;
    lights.sky *= draw.range(0.6, 1.4) as f32;
    lights.ground *= draw.range(0.6, 1.3) as f32;
    let (share, which, turn) = (
        draw.unit(),
        draw.index(props.skies.len().max(1)),
        draw.range(0.0, std::f64::consts::TAU),
    );
    if let Some(sky) = props.skies.get(which).filter(|_| share < world.probes) {
        let sky = sky.turned(turn);
        let from = sky.brightest();
        // Lamps and windows are above what stands in a room.
        lights.towards_key = from.with_z(from.z.max(0.5)).normalize();
        lights.around = Some(sky);
    }
    if outline.layout == Layout::Room {
        lights.shadows = ShadowRegion {
            half_width: (3.0 * outline.scale) as f32,
            middle: Vec3A::from(middle.as_vec3()),
        };
    }
    lights
}

/// What a piece of furniture must not stand in.
pub(crate) struct Keep<'a> {
    /// Cameras that stand still.
    pub(crate) eyes: &'a [DVec3],
    /// Sights that should be free, as segments.
    pub(crate) sights: &'a [[DVec3; 2]],
    /// Whether a robot works there.
    pub(crate) robot: bool,
    /// Where the first camera looks, for rooms without a robot.
    pub(crate) ahead: Option<(DVec3, DVec3)>,
}

/// Furniture along the walls and in the room.
pub(crate) fn furnish(
    draw: &mut Draw,
    surfaces: &Surfaces<'_>,
    builder: &mut Builder,
    (room, outline): (&WideRoom, Outline),
    keep: &Keep<'_>,
) {
    let mut discs: Vec<(DVec2, f64)> = Vec::new();
    for _ in 0..count(draw, surfaces.world.furniture) {
        let piece = draw_piece(draw, surfaces, outline.scale);
        let half = piece.half;
        let radius = half.truncate().length();
        let spot = (0..6).find_map(|_| {
            let (place, turn) = draw_spot(draw, room, outline, keep, half)?;
            let lift = if piece.hangs {
                draw.range(0.6, 1.5) * outline.scale
            } else {
                0.0
            };
            let room_from_piece = Pose::<BodyFrame, BodyFrame>::new(rot_z(turn), place.extend(lift));
            let crowded = discs
                .iter()
                .any(|(other, its)| other.distance(place) < 0.75 * (its + radius));
            let pose = room.base_from_room * room_from_piece;
            (!crowded && is_clear(draw, &piece, &pose, keep)).then_some((place, pose))
        });
        if let Some((place, pose)) = spot {
            discs.push((place, radius));
            builder.add_prepared(piece.mesh, pose, piece.materials, true);
        }
    }
}

/// A place on the floor for a piece of these half extents, in the frame of the room, and its turn.
fn draw_spot(draw: &mut Draw, room: &WideRoom, outline: Outline, keep: &Keep<'_>, half: DVec3) -> Option<(DVec2, f64)> {
    let quarter = std::f64::consts::FRAC_PI_2;
    let size = room.high - room.low;
    let (wall, share, wobble) = (draw.index(4), draw.unit(), draw.range(-0.06, 0.06));
    let kind = draw.unit();
    if kind < 0.45 {
        // The back, which is -y of a piece, to the wall.
        let (across, along) = (half.y + 0.02, half.x);
        let (axis, turn) = match wall {
            0 => (0, 0.0),
            1 => (0, 2.0),
            2 => (1, -1.0),
            _ => (1, 1.0),
        };
        let free = size[axis] - 2.0 * along;
        if free <= 0.0 || size[1 - axis] < 2.0 * across {
            return None;
        }
        let mut place = DVec2::ZERO;
        place[axis] = room.low[axis] + along + share * free;
        place[1 - axis] = if wall % 2 == 0 {
            room.low[1 - axis] + across
        } else {
            room.high[1 - axis] - across
        };
        return Some((place, turn * quarter + wobble * 0.3));
    }
    let turn = draw.range(-std::f64::consts::PI, std::f64::consts::PI);
    if let Some((eye, ahead)) = keep.ahead.filter(|_| kind < 0.8) {
        let room_from_base = room.base_from_room.inverse();
        let (eye, ahead) = (room_from_base.point(eye), room_from_base.direction(ahead));
        let heading = libm::atan2(ahead.y, ahead.x) + draw.range(-0.7, 0.7);
        let distance = draw.range(0.5, 4.5) * outline.scale + 0.5 * half.truncate().length();
        let place = eye.truncate() + DVec2::new(libm::cos(heading), libm::sin(heading)) * distance;
        let within = place.cmpgt(room.low + 0.1).all() && place.cmplt(room.high - 0.1).all();
        return within.then_some((place, turn));
    }
    let place = room.low + DVec2::new(share, draw.unit()) * size;
    Some((place, turn))
}

/// Whether cameras, sights and the robot are free of a piece.
fn is_clear(draw: &mut Draw, piece: &Piece, pose: &Pose<Base, BodyFrame>, keep: &Keep<'_>) -> bool {
    let piece_from_base = pose.inverse();
    let strict = draw.chance(0.85);
    // In the frame of the piece its box stands on z = 0.
    let inside = |point: DVec3, margin: f64| {
        let p = piece_from_base.point(point);
        p.x.abs() < piece.half.x + margin
            && p.y.abs() < piece.half.y + margin
            && (-margin..2.0 * piece.half.z + margin).contains(&p.z)
    };
    if keep.eyes.iter().any(|eye| inside(*eye, 0.15)) {
        return false;
    }
    let radius = piece.half.truncate().length();
    let place = pose.translation.truncate();
    if keep.robot && place.distance(WORKSPACE) < WORKSPACE_RADIUS_M + radius {
        return false;
    }
    let hidden = |[from, to]: &[DVec3; 2]| (0..=24).any(|k| inside(from.lerp(*to, f64::from(k) / 24.0), 0.03));
    !(strict && keep.sights.iter().any(hidden))
}
