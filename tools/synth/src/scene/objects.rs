//! Objects on the table: boxes, cans, balls, cones, prisms, bottles, mugs and bowls.

use std::sync::Arc;

use glam::DVec3;
use rogs_geometry::{Base, Pose};

use super::{Body, FIRST_OBJECT_ID, draw_material};
use crate::frame::BodyFrame;
use crate::math::{Draw, rot_x, rot_z};
use crate::mesh::{Section, TriMesh};
use crate::render::{Material, PreparedMesh};

/// An object as it stands on the table at the start.
#[derive(Debug, Clone)]
pub(crate) struct Object {
    pub body: Body,
    /// Object-to-base at the start; the origin is the centre of the object's box.
    pub start: Pose<Base, BodyFrame>,
    /// Half extents in its own frame, metres.
    pub half: DVec3,
    /// Radius of a disc around it, metres.
    pub radius: f64,
    /// Height of its top above the table, metres.
    pub height: f64,
    /// Distance of the flanks a gripper takes hold of, across x of its own frame.
    pub grip_width: f64,
    /// Height above the table at which the gripper takes hold, metres.
    pub grip_height: f64,
    pub name: &'static str,
}

/// `count` objects that stand apart from each other; the first one can be grasped.
pub(crate) fn draw_objects(draw: &mut Draw, count: usize, table_z: f64) -> Vec<Object> {
    let mut objects: Vec<Object> = Vec::with_capacity(count);
    for index in 0..count {
        let Shape {
            name,
            mesh,
            grip_width,
            grip_depth,
        } = draw_shape(draw, index == 0);
        let low = mesh
            .positions
            .iter()
            .copied()
            .fold(glam::Vec3::INFINITY, glam::Vec3::min)
            .as_dvec3();
        let high = mesh
            .positions
            .iter()
            .copied()
            .fold(glam::Vec3::NEG_INFINITY, glam::Vec3::max)
            .as_dvec3();
        let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
        let mesh = mesh.at(-middle.x, -middle.y, -middle.z);
        let radius = mesh
            .positions
            .iter()
            .map(|p| f64::from(p.truncate().length()))
            .fold(0.0, f64::max);
        let Some(place) = free_place(draw, &objects, radius, index == 0) else {
            continue;
        };
        let parts = mesh.materials.iter().copied().max().unwrap_or(0) as usize + 1;
        let size = 0.5 * half.max_element();
        let materials: Vec<Material> = (0..parts).map(|_| draw_material(draw, size, 0.95)).collect();
        let height = 2.0 * half.z;
        let start = Pose::new(
            rot_z(draw.range(-3.1, 3.1)),
            DVec3::new(place.x, place.y, table_z + half.z),
        );
        objects.push(Object {
            body: Body {
                id: FIRST_OBJECT_ID + index as u8,
                mesh: Arc::new(PreparedMesh::new(mesh)),
                materials,
                fixed: None,
                shadow: true,
            },
            start,
            half,
            radius,
            height,
            grip_width,
            // The finger tips stay clear of the table.
            grip_height: (height - grip_depth).max(0.024),
            name,
        });
    }
    objects
}

/// A spot where a disc of this radius touches no other object; the first object comes where the arm works well.
fn free_place(draw: &mut Draw, others: &[Object], radius: f64, first: bool) -> Option<DVec3> {
    for _ in 0..60 {
        let place = if first {
            DVec3::new(draw.range(0.42, 0.60), draw.range(-0.16, 0.16), 0.0)
        } else {
            DVec3::new(draw.range(0.32, 0.80), draw.range(-0.40, 0.40), 0.0)
        };
        let clear = |(index, other): (usize, &Object)| {
            let apart = (other.start.translation - place).truncate().length();
            // The first object needs room for fingers around it.
            apart > other.radius + radius + if index == 0 { 0.07 } else { 0.012 }
        };
        if others.iter().enumerate().all(clear) {
            return Some(place);
        }
    }
    None
}

/// A shape as it is drawn: its mesh stands on some plane of constant z.
struct Shape {
    name: &'static str,
    mesh: TriMesh,
    /// Distance of the flanks across x, metres.
    grip_width: f64,
    /// How far below its top the gripper takes hold, metres.
    grip_depth: f64,
}

fn draw_shape(draw: &mut Draw, graspable: bool) -> Shape {
    let size = if graspable {
        draw.range(0.018, 0.032)
    } else {
        draw.range(0.02, 0.06)
    };
    let kind = draw.index(if graspable { 7 } else { 10 });
    let tall = draw.range(0.022, 0.07);
    let wide = size * draw.range(0.8, if graspable { 1.6 } else { 2.6 });
    let about_z = |angle: f64| Pose::new(rot_z(angle), DVec3::ZERO);
    let (name, mesh, grip_width, grip_depth) = match kind {
        0 => ("box", TriMesh::chamfered([size, wide, tall], 0.003), 2.0 * size, 0.028),
        1 => ("can", TriMesh::cylinder(size, tall, 24), 2.0 * size, 0.028),
        2 => ("cube", TriMesh::cuboid([size; 3]), 2.0 * size, size),
        3 => (
            "mug",
            mug(size.max(0.024), tall.max(0.03)),
            2.0 * size.max(0.024),
            0.022,
        ),
        4 => {
            let flats = 2.0 * size * libm::cos(std::f64::consts::FRAC_PI_6);
            (
                "hexagonal block",
                TriMesh::prism(size, tall, 6).placed(about_z(std::f64::consts::FRAC_PI_6)),
                flats,
                0.028,
            )
        }
        5 => ("bottle", bottle(size, 1.3 * tall), 2.0 * size, 0.060),
        6 => ("ball", TriMesh::ellipsoid([size; 3], 24), 2.0 * size, size),
        7 => (
            "cone",
            TriMesh::lathe(&[[size, 0.0], [0.12 * size, 2.4 * size], [0.0, 2.45 * size]], 24),
            size,
            size,
        ),
        8 => ("bowl", bowl(1.3 * size, size), size, size),
        _ => {
            let lying = Pose::new(rot_x(std::f64::consts::FRAC_PI_2), DVec3::ZERO);
            let wedge = TriMesh::prism(size, 1.5 * size, 3).placed(about_z(std::f64::consts::FRAC_PI_6));
            ("wedge", wedge.placed(lying), size, size)
        }
    };
    Shape {
        name,
        mesh,
        grip_width,
        grip_depth,
    }
}

/// A cup with a floor, a wall and a handle; inside another material than outside.
fn mug(radius: f64, half: f64) -> TriMesh {
    let wall = 0.0035;
    let (r, h) = (radius, half);
    let mut mug = TriMesh::lathe(
        &[
            [r - 0.003, -h],
            [r, -h + 0.004],
            [r, h - 0.002],
            [r - 0.5 * wall, h],
            [r - wall, h - 0.002],
            [r - wall, -h + wall],
        ],
        24,
    );
    let inner = (r - 0.75 * wall) as f32;
    for (triangle, material) in mug.triangles.iter().zip(&mut mug.materials) {
        let inside = |v: &u32| mug.positions[*v as usize].truncate().length() < inner;
        *material = u8::from(triangle.iter().all(inside) && mug.positions[triangle[0] as usize].z > -h as f32);
    }
    // The handle stands on y, out of the way of fingers that close along x.
    let ring = TriMesh::handle(0.55 * half, 0.0045, -0.25, 0.25, 10);
    mug.join(ring.placed(Pose::new(
        rot_z(std::f64::consts::FRAC_PI_2),
        DVec3::new(0.0, r - 0.003, 0.0),
    )));
    mug
}

fn bowl(radius: f64, height: f64) -> TriMesh {
    let r = radius;
    TriMesh::lathe(
        &[
            [0.45 * r, 0.0],
            [0.75 * r, 0.25 * height],
            [0.94 * r, 0.6 * height],
            [r, height],
            [r - 0.004, height],
            [0.9 * r, 0.6 * height],
            [0.70 * r, 0.3 * height],
            [0.4 * r, 0.1 * height],
        ],
        28,
    )
}

fn bottle(radius: f64, half: f64) -> TriMesh {
    let body = TriMesh::loft(
        &[
            Section::circle(-half, 0.92 * radius),
            Section::circle(-half + 0.004, radius),
            Section::circle(0.35 * half, radius),
            Section::circle(0.60 * half, 0.75 * radius),
            Section::circle(0.72 * half, 0.42 * radius),
            Section::circle(0.90 * half, 0.40 * radius),
        ],
        20,
    );
    let mut bottle = body;
    bottle.join(
        TriMesh::cylinder(0.46 * radius, 0.07 * half, 16)
            .at(0.0, 0.0, 0.93 * half)
            .of(1),
    );
    bottle
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_stand_on_the_table_and_apart() {
        for seed in 0..12 {
            let objects = draw_objects(&mut Draw::new(seed, 0), 10, 0.05);
            assert!(objects.len() >= 3);
            for (index, object) in objects.iter().enumerate() {
                let mesh = object.body.mesh.mesh();
                let lowest = mesh.positions.iter().map(|p| object.start.point(p.as_dvec3()).z);
                assert!(
                    (lowest.fold(f64::INFINITY, f64::min) - 0.05).abs() < 1e-6,
                    "{}",
                    object.name
                );
                assert!(mesh.volume() > 0.0, "{}", object.name);
                for other in &objects[..index] {
                    let apart = (object.start.translation - other.start.translation).truncate().length();
                    assert!(apart > object.radius + other.radius);
                }
            }
        }
    }
}
