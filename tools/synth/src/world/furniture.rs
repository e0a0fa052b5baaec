//! Furniture: things of a room as boxes, cylinders and balls, or models.

use std::sync::Arc;

use glam::DVec3;

use super::surface::Surfaces;
use crate::math::Draw;
use crate::mesh::TriMesh;
use crate::render::{Material, PreparedMesh};

/// A piece that stands on z = 0 with its middle over the origin and its back at -y.
pub(crate) struct Piece {
    pub(crate) mesh: Arc<PreparedMesh>,
    pub(crate) materials: Vec<Material>,
    /// Half extents, metres.
    pub(crate) half: DVec3,
    /// Whether it hangs above the floor.
    pub(crate) hangs: bool,
}

/// Parts of a piece, each of a material.
#[derive(Default)]
struct Parts {
    mesh: TriMesh,
}

impl Parts {
    /// A box between two corners.
    fn block(&mut self, low: [f64; 3], high: [f64; 3], material: u8) {
        let (low, high) = (DVec3::from_array(low), DVec3::from_array(high));
        let (half, middle) = (0.5 * (high - low), 0.5 * (low + high));
        self.add(
            TriMesh::cuboid(half.to_array()).at(middle.x, middle.y, middle.z),
            material,
        );
    }

    fn add(&mut self, mesh: TriMesh, material: u8) {
        self.mesh.join(mesh.of(material));
    }

    /// Legs under a top at this height.
    fn legs(&mut self, [x, y]: [f64; 2], height: f64, thickness: f64, material: u8) {
        let t = 0.5 * thickness;
        for (sx, sy) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
            let (cx, cy) = (sx * (x - t), sy * (y - t));
            self.block([cx - t, cy - t, 0.0], [cx + t, cy + t, height], material);
        }
    }
}

/// Draws a piece for a room of this scale.
pub(crate) fn draw_piece(draw: &mut Draw, surfaces: &Surfaces<'_>, scale: f64) -> Piece {
    let (share, which) = (draw.unit(), draw.index(surfaces.props.models.len().max(1)));
    if let Some(model) = surfaces
        .props
        .models
        .get(which)
        .filter(|_| share < surfaces.world.models)
    {
        let size = 2.0 * model.half.max_element();
        let materials = (0..model.parts).map(|_| surfaces.thing(draw, size * scale)).collect();
        let mesh = if (scale - 1.0).abs() < 1e-3 {
            model.mesh.clone()
        } else {
            Arc::new(PreparedMesh::new(model.mesh.mesh().clone().scaled(scale)))
        };
        return Piece {
            mesh,
            materials,
            half: model.half * scale,
            hangs: false,
        };
    }
    let mut parts = Parts::default();
    let mut hangs = false;
    match draw.index(10) {
        0 => hangs = cupboard(draw, &mut parts),
        1 => shelf(draw, &mut parts),
        2 => table(draw, &mut parts),
        3 => chair(draw, &mut parts),
        4 => seat(draw, &mut parts),
        5 => lamp(draw, &mut parts),
        6 => plant(draw, &mut parts),
        7 => screen(draw, &mut parts),
        8 => bin(draw, &mut parts),
        _ => crates(draw, &mut parts),
    }
    let mesh = parts.mesh.scaled(scale);
    let fold = |start: glam::Vec3, f: fn(glam::Vec3, glam::Vec3) -> glam::Vec3| {
        mesh.positions.iter().copied().fold(start, f).as_dvec3()
    };
    let reach = fold(glam::Vec3::NEG_INFINITY, |a, b| a.max(b.abs()));
    let half = DVec3::new(reach.x, reach.y, 0.5 * reach.z);
    let count = mesh.materials.iter().copied().max().unwrap_or(0) as usize + 1;
    let materials = (0..count).map(|_| surfaces.thing(draw, 0.6 * scale)).collect();
    Piece {
        mesh: Arc::new(PreparedMesh::new(mesh)),
        materials,
        half,
        hangs,
    }
}

/// Says whether it hangs.
fn cupboard(draw: &mut Draw, parts: &mut Parts) -> bool {
    let hangs = draw.chance(0.3);
    let [x, y] = [draw.range(0.2, 0.7), draw.range(0.12, 0.32)];
    let z = if hangs {
        draw.range(0.3, 0.8)
    } else {
        draw.range(0.4, 2.1)
    };
    parts.block([-x, -y, 0.0], [x, y, z], 0);
    let doors = 1 + draw.index(3);
    let rows = 1 + draw.index(4);
    let gap = 0.008;
    for row in 0..rows {
        for door in 0..doors {
            let left = -x + 2.0 * x * door as f64 / doors as f64;
            let right = -x + 2.0 * x * (door + 1) as f64 / doors as f64;
            let (low, high) = (z * row as f64 / rows as f64, z * (row + 1) as f64 / rows as f64);
            parts.block([left + gap, y, low + gap], [right - gap, y + 0.018, high - gap], 1);
            let knob = 0.5 * (low + high);
            parts.block(
                [right - 0.06, y + 0.018, knob - 0.04],
                [right - 0.045, y + 0.04, knob + 0.04],
                2,
            );
        }
    }
    hangs
}

fn shelf(draw: &mut Draw, parts: &mut Parts) {
    let [x, y, z] = [draw.range(0.25, 0.7), draw.range(0.12, 0.25), draw.range(0.7, 2.1)];
    let t = 0.02;
    parts.block([-x, -y, 0.0], [-x + t, y, z], 0);
    parts.block([x - t, -y, 0.0], [x, y, z], 0);
    parts.block([-x, -y, 0.0], [x, -y + 0.01, z], 1);
    let boards = 2 + draw.index(4);
    for board in 0..=boards {
        let at = (z - t) * board as f64 / boards as f64;
        parts.block([-x + t, -y, at], [x - t, y, at + t], 0);
        let room = (z - t) / boards as f64 - t;
        if board == boards || room < 0.08 {
            continue;
        }
        // Books and boxes.
        let mut left = -x + 0.03;
        while left < x - 0.08 {
            let wide = if draw.chance(0.6) {
                draw.range(0.015, 0.05)
            } else {
                draw.range(0.06, 0.25)
            };
            if draw.chance(0.75) && left + wide < x - 0.03 {
                let high = room * draw.range(0.35, 0.95);
                let deep = y * draw.range(0.2, 1.0);
                let material = 2 + draw.index(5) as u8;
                parts.block([left, -y + 0.012, at + t], [left + wide, deep, at + t + high], material);
            }
            left += wide + 0.004;
        }
    }
}

fn table(draw: &mut Draw, parts: &mut Parts) {
    let [x, y, z] = [draw.range(0.3, 0.95), draw.range(0.25, 0.5), draw.range(0.38, 1.0)];
    let t = draw.range(0.018, 0.05);
    parts.block([-x, -y, z - t], [x, y, z], 0);
    if draw.chance(0.75) {
        parts.legs([x, y], z - t, draw.range(0.03, 0.07), 1);
    } else {
        parts.block([-x + 0.05, -y + 0.05, 0.0], [-x + 0.4, y - 0.05, z - t], 1);
        parts.block([x - 0.4, -y + 0.05, 0.0], [x - 0.05, y - 0.05, z - t], 1);
    }
    for _ in 0..draw.index(6) {
        let (a, b, h) = (draw.range(0.02, 0.2), draw.range(0.02, 0.15), draw.range(0.01, 0.35));
        let (px, py) = (draw.range(-x + a, x - a), draw.range(-y + b.min(y), y - b.min(y)));
        let material = 2 + draw.index(3) as u8;
        if draw.chance(0.7) {
            parts.block([px - a, py - b, z], [px + a, py + b, z + h], material);
        } else {
            let r = a.min(0.08);
            parts.add(TriMesh::cylinder(r, 0.5 * h, 14).at(px, py, z + 0.5 * h), material);
        }
    }
}

fn chair(draw: &mut Draw, parts: &mut Parts) {
    let [x, y, z] = [draw.range(0.19, 0.26), draw.range(0.19, 0.26), draw.range(0.4, 0.5)];
    let top = z + draw.range(0.3, 0.6);
    parts.block([-x, -y, z - 0.05], [x, y, z], 0);
    parts.block([-x, -y, z], [x, -y + 0.04, top], 1);
    if draw.chance(0.6) {
        parts.legs([x, y], z - 0.05, 0.035, 2);
    } else {
        parts.add(TriMesh::cylinder(0.03, 0.5 * (z - 0.1), 12).at(0.0, 0.0, 0.5 * z), 2);
        parts.add(TriMesh::cylinder(0.24, 0.03, 16).at(0.0, 0.0, 0.03), 2);
    }
}

fn seat(draw: &mut Draw, parts: &mut Parts) {
    let [x, y] = [draw.range(0.4, 1.1), draw.range(0.35, 0.5)];
    let z = draw.range(0.32, 0.45);
    parts.block([-x, -y, 0.05], [x, y, z], 0);
    parts.block([-x, -y, z], [x, -y + 0.2, z + draw.range(0.3, 0.5)], 0);
    let arm = draw.range(0.1, 0.2);
    for side in [-1.0, 1.0] {
        let (a, b) = (side * x, side * (x - arm));
        parts.block([a.min(b), -y, z], [a.max(b), y, z + 0.2], 1);
    }
    let cushion = TriMesh::ellipsoid([0.2, 0.09, 0.18], 14).at(draw.range(-0.3, 0.3), -y + 0.28, z + 0.17);
    parts.add(cushion, 2);
}

fn lamp(draw: &mut Draw, parts: &mut Parts) {
    let z = draw.range(0.4, 1.8);
    let r = draw.range(0.1, 0.25);
    parts.add(TriMesh::cylinder(0.7 * r, 0.015, 20).at(0.0, 0.0, 0.015), 0);
    parts.add(TriMesh::cylinder(0.015, 0.5 * z, 8).at(0.0, 0.0, 0.5 * z), 0);
    let shade = TriMesh::lathe(&[[r, 0.0], [0.6 * r, 0.25]], 18).at(0.0, 0.0, z - 0.05);
    parts.add(shade, 1);
}

fn plant(draw: &mut Draw, parts: &mut Parts) {
    let (r, h) = (draw.range(0.08, 0.25), draw.range(0.12, 0.4));
    parts.add(TriMesh::lathe(&[[0.7 * r, 0.0], [r, h]], 16), 0);
    for _ in 0..3 + draw.index(5) {
        let half = [
            draw.range(0.5, 1.2) * r,
            draw.range(0.5, 1.2) * r,
            draw.range(0.08, 0.35),
        ];
        let (x, y) = (draw.range(-r, r), draw.range(-r, r));
        parts.add(
            TriMesh::ellipsoid(half, 10).at(x, y, h + half[2] * draw.range(0.5, 1.6)),
            1 + draw.index(2) as u8,
        );
    }
}

fn screen(draw: &mut Draw, parts: &mut Parts) {
    let (x, z) = (draw.range(0.2, 0.7), draw.range(0.15, 0.4));
    let foot = draw.range(0.05, 0.9);
    parts.block([-0.03, -0.03, 0.0], [0.03, 0.03, foot + z], 0);
    parts.block([-0.5 * x, -0.12, 0.0], [0.5 * x, 0.12, 0.02], 0);
    parts.block([-x, 0.02, foot], [x, 0.06, foot + 2.0 * z], 0);
    parts.block(
        [-x + 0.02, 0.06, foot + 0.02],
        [x - 0.02, 0.063, foot + 2.0 * z - 0.02],
        1,
    );
}

fn bin(draw: &mut Draw, parts: &mut Parts) {
    let (r, h) = (draw.range(0.1, 0.35), draw.range(0.15, 0.9));
    let profile = [[draw.range(0.7, 1.0) * r, 0.0], [r, h], [r - 0.01, h], [0.65 * r, 0.02]];
    parts.add(TriMesh::lathe(&profile, 22), 0);
}

fn crates(draw: &mut Draw, parts: &mut Parts) {
    let mut bottom = 0.0;
    let [mut x, mut y] = [draw.range(0.06, 0.35), draw.range(0.06, 0.35)];
    for level in 0..1 + draw.index(3) {
        let height = draw.range(0.08, 0.5);
        parts.block([-x, -y, bottom], [x, y, bottom + height], level as u8);
        bottom += height;
        x *= draw.range(0.6, 1.0);
        y *= draw.range(0.6, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Props, World};
    use super::*;

    #[test]
    fn pieces_stand_on_the_floor_within_their_box() {
        let (world, props) = (World::default(), Props::default());
        let surfaces = Surfaces {
            world: &world,
            props: &props,
        };
        for seed in 0..200 {
            let piece = draw_piece(&mut Draw::new(seed, 0), &surfaces, 0.5);
            let mesh = piece.mesh.mesh();
            assert!(
                mesh.triangles.len() > 10 && mesh.triangles.len() < 6000,
                "{}",
                mesh.triangles.len()
            );
            assert!(mesh.materials.iter().all(|&m| usize::from(m) < piece.materials.len()));
            for p in &mesh.positions {
                let p = p.as_dvec3();
                assert!(p.z > -1e-3 && p.z <= 2.0 * piece.half.z + 1e-6);
                assert!(p.x.abs() <= piece.half.x + 1e-6 && p.y.abs() <= piece.half.y + 1e-6);
            }
            assert!(piece.half.max_element() > 0.03 && piece.half.max_element() < 1.3);
        }
    }
}
