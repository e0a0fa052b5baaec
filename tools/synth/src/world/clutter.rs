//! Clutter: things on the table that nobody touches.

use std::sync::Arc;

use glam::DVec3;
use rogs_geometry::Pose;

use super::count;
use super::room::WideRoom;
use super::surface::Surfaces;
use crate::math::{Draw, rot_x, rot_z};
use crate::mesh::TriMesh;
use crate::render::PreparedMesh;
use crate::scene::Builder;

/// Clutter keeps this far from everything that the hand passes, metres.
const CLEAR_M: f64 = 0.13;
/// A tool this high above the clutter does not touch it, metres.
const HIGH_M: f64 = 0.3;
/// Largest side of a model that lies on a table, metres.
const SMALL_M: f64 = 0.45;

/// Puts clutter on the table: nowhere near `tools`, the places of the hand, and off the `discs` of objects (centre, radius).
pub(crate) fn draw_clutter(
    draw: &mut Draw,
    surfaces: &Surfaces<'_>,
    builder: &mut Builder,
    room: &WideRoom,
    (tools, discs): (&[DVec3], &[(DVec3, f64)]),
) {
    let [low, high] = room.table();
    let tilt = room.tilt();
    let mut taken: Vec<(DVec3, f64)> = discs.to_vec();
    for _ in 0..count(draw, surfaces.world.clutter) {
        let small = |model: &&super::Model| 2.0 * model.half.max_element() < SMALL_M;
        let models: Vec<&super::Model> = surfaces.props.models.iter().filter(small).collect();
        let (share, which) = (draw.unit(), draw.index(models.len().max(1)));
        let size = draw.range(0.02, 0.14);
        let (mesh, parts) = match models.get(which).filter(|_| share < surfaces.world.models) {
            Some(model) => (model.mesh.clone(), model.parts),
            None => (Arc::new(PreparedMesh::new(shape(draw, size))), 2),
        };
        let (centre, sphere) = mesh.sphere;
        let radius = f64::from(centre.truncate().length() + sphere).min(0.5 * SMALL_M);
        let materials: Vec<_> = (0..parts).map(|_| surfaces.thing(draw, 2.0 * radius)).collect();
        let turn = draw.range(-std::f64::consts::PI, std::f64::consts::PI);
        let place = (0..8).find_map(|_| {
            let (x, y) = (draw.range(low.x, high.x), draw.range(low.y, high.y));
            let place = DVec3::new(x, y, room.table_height(x, y));
            let apart = |other: DVec3| (other - place).truncate().length();
            let free = taken.iter().all(|&(other, its)| apart(other) > its + radius);
            let base = place.truncate().length() > 0.25 + radius;
            let hand = tools
                .iter()
                .all(|&tool| tool.z > place.z + HIGH_M || apart(tool) > CLEAR_M + radius);
            (free && base && hand).then_some(place)
        });
        if let Some(place) = place {
            taken.push((place, radius));
            builder.add_prepared(mesh, Pose::new(tilt * rot_z(turn), place), materials, true);
        }
    }
}

/// A thing of about this half size that stands on z = 0.
fn shape(draw: &mut Draw, size: f64) -> TriMesh {
    let flat = size * draw.range(0.05, 0.5);
    let wide = size * draw.range(0.4, 1.2);
    match draw.index(7) {
        // A book or a tray, a carton, a can, a ball.
        0 => TriMesh::cuboid([size, wide, flat]).at(0.0, 0.0, flat),
        1 => TriMesh::chamfered([wide, 0.6 * size, size], 0.004).at(0.0, 0.0, size),
        2 => TriMesh::cylinder(0.5 * size, size, 18).at(0.0, 0.0, size),
        3 => TriMesh::ellipsoid([0.6 * size; 3], 16).at(0.0, 0.0, 0.6 * size),
        // A lying tube, a coil of cable, a heap of cloth.
        4 => {
            let r = 0.25 * size;
            let lying = Pose::new(rot_x(std::f64::consts::FRAC_PI_2), DVec3::new(0.0, 0.0, r));
            TriMesh::cylinder(r, size, 14).placed(lying)
        }
        5 => {
            let r = 0.006;
            let lying = Pose::new(rot_x(std::f64::consts::FRAC_PI_2), DVec3::new(0.0, 0.0, r));
            TriMesh::handle(0.7 * size, r, 0.0, draw.range(0.5, 0.95), 22).placed(lying)
        }
        _ => {
            let mut heap = TriMesh::ellipsoid([size, wide, 0.4 * flat + 0.01], 16);
            let bump = TriMesh::ellipsoid([0.6 * size, 0.5 * wide, flat + 0.01], 14);
            heap.join(bump.at(0.3 * size, 0.2 * wide, 0.0).of(1));
            heap.at(0.0, 0.0, 0.3 * flat)
        }
    }
}
