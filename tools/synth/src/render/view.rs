//! One camera at one time.

use std::cell::RefCell;

use glam::{DVec2, DVec3, Vec3, Vec3A};
use rayon::prelude::*;
use rogs_geometry::{Base, Camera, Pose};
use rogs_schemas::Intrinsics;

use super::photo::Photo;
use super::raster::{Layer, NOBODY, Polygon};
use super::seen::Seen;
use super::sensor::Sensor;
use super::shade::{BodyView, Shader};
use super::shadow::LightMap;
use crate::frame::BodyFrame;
use crate::math::single;
use crate::scene::{Body, Lights};

/// Nearest depth that is drawn, metres.
pub(crate) const NEAR: f64 = 0.01;

const KEY_MAP: usize = 720;
const SKY_MAP: usize = 288;

/// Samples: the centre for depth and ids, then a rotated grid for colour.
const OFFSETS: [[f64; 2]; 5] = [
    [0.0, 0.0],
    [-0.125, -0.375],
    [0.375, -0.125],
    [0.125, 0.375],
    [-0.375, 0.125],
];

/// The bodies at one time with the light on them.
pub(crate) struct LitScene<'a> {
    pub bodies: &'a [Body],
    /// Body-to-base, one a body.
    pub poses: &'a [Pose<Base, BodyFrame>],
    pub lights: &'a Lights,
    photos: &'a [Photo],
    key: LightMap,
    sky: LightMap,
}

impl<'a> LitScene<'a> {
    /// Draws the maps of the lights.
    pub(crate) fn new(
        bodies: &'a [Body],
        poses: &'a [Pose<Base, BodyFrame>],
        lights: &'a Lights,
        photos: &'a [Photo],
    ) -> Self {
        let draw = |(towards, size): (Vec3, usize)| {
            let mut map = LightMap::new(towards, size, lights.shadows);
            let mut corners = Vec::new();
            for (body, pose) in bodies.iter().zip(poses).filter(|(body, _)| body.shadow) {
                let map_from_body = map.map_from_base * single(pose);
                if !map.reaches(
                    map_from_body.transform_point3a(body.mesh.sphere.0.into()),
                    body.mesh.sphere.1,
                ) {
                    continue;
                }
                let mesh = body.mesh.mesh();
                corners.clear();
                corners.extend(
                    mesh.positions
                        .iter()
                        .map(|&p| map_from_body.transform_point3a(Vec3A::from(p))),
                );
                map.draw(&corners, &mesh.triangles);
            }
            map
        };
        let mut maps: Vec<LightMap> = [(lights.towards_key, KEY_MAP), (Vec3::Z, SKY_MAP)]
            .into_par_iter()
            .map(draw)
            .collect();
        let mut sky = maps.remove(1);
        sky.finish();
        let key = maps.remove(0);
        Self {
            bodies,
            poses,
            lights,
            photos,
            key,
            sky,
        }
    }
}

/// Image, depth and ids of one camera at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// sRGB, 8 bit. `[H, W, 3]`
    pub rgb: Vec<u8>,
    /// Camera-z depth at pixel centres, metres; exact for the triangles drawn. `[H, W]`
    pub depth_m: Vec<f32>,
    /// Link, object or scenery id at pixel centres; 255 where nothing is seen. `[H, W]`
    pub id: Vec<u8>,
}

#[derive(Default)]
struct Scratch {
    layers: [Layer; 5],
    seen: Vec<Seen>,
    corners: Vec<DVec3>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Draws one camera. `noise_key` seeds the sensor noise of this image.
pub(crate) fn render_view(
    scene: &LitScene<'_>,
    base_from_camera: &Pose<Base, Camera>,
    intrinsics: &Intrinsics,
    [height, width]: [usize; 2],
    sensor: &Sensor,
    noise_key: u32,
) -> View {
    SCRATCH.with_borrow_mut(|scratch| {
        let camera_from_base = base_from_camera.inverse();
        for (layer, offset) in scratch.layers.iter_mut().zip(OFFSETS) {
            layer.reset(width, height, offset, 0.0);
        }
        scratch.seen.clear();
        let body_views: Vec<BodyView> = scene
            .poses
            .iter()
            .map(|pose| BodyView::new(pose, base_from_camera, scene.lights))
            .collect();
        for (index, (body, pose)) in scene.bodies.iter().zip(scene.poses).enumerate() {
            let camera_from_body = camera_from_base * *pose;
            if in_sight(&camera_from_body, body.mesh.sphere, intrinsics, [height, width]) {
                draw_body(scratch, OFFSETS.len(), (index, body), &camera_from_body, intrinsics);
            }
        }
        let shader = Shader {
            bodies: scene.bodies,
            views: &body_views,
            lights: scene.lights,
            photos: scene.photos,
            key: &scene.key,
            sky: &scene.sky,
            base_from_camera: single(base_from_camera),
            intrinsics: *intrinsics,
            size: [height, width],
        };
        let (depth_m, id) = depth_and_ids(scratch, scene.bodies, intrinsics, [height, width]);
        let rgb = shader.image(
            &scratch.layers.each_ref().map(|layer| layer.owner.as_slice()),
            &scratch.seen,
            &sensor.before_finish(),
            noise_key,
        );
        let rgb = sensor.finished(rgb, [height, width], noise_key);
        View { rgb, depth_m, id }
    })
}

/// Whether a sphere may be in the picture.
fn in_sight(
    camera_from_body: &Pose<Camera, BodyFrame>,
    sphere: (Vec3, f32),
    k: &Intrinsics,
    [height, width]: [usize; 2],
) -> bool {
    let centre = camera_from_body.point(sphere.0.as_dvec3());
    let radius = f64::from(sphere.1) * 1.0001 + 1e-6;
    if centre.z < -radius {
        return false;
    }
    // Signed distance to the four side planes through the camera centre.
    let side = |direction: DVec3| direction.dot(centre) >= -radius * direction.length();
    side(DVec3::new(k.fx, 0.0, k.cx))
        && side(DVec3::new(-k.fx, 0.0, width as f64 - k.cx))
        && side(DVec3::new(0.0, k.fy, k.cy))
        && side(DVec3::new(0.0, -k.fy, height as f64 - k.cy))
}

/// Depth and ids of bodies in front of one camera, as [`View`] has them, without a picture.
pub(crate) fn render_geometry(
    bodies: &[Body],
    poses: &[Pose<Base, BodyFrame>],
    base_from_camera: &Pose<Base, Camera>,
    intrinsics: &Intrinsics,
    [height, width]: [usize; 2],
) -> (Vec<f32>, Vec<u8>) {
    SCRATCH.with_borrow_mut(|scratch| {
        let camera_from_base = base_from_camera.inverse();
        scratch.layers[0].reset(width, height, OFFSETS[0], 0.0);
        scratch.seen.clear();
        for (index, (body, pose)) in bodies.iter().zip(poses).enumerate() {
            let camera_from_body = camera_from_base * *pose;
            if in_sight(&camera_from_body, body.mesh.sphere, intrinsics, [height, width]) {
                draw_body(scratch, 1, (index, body), &camera_from_body, intrinsics);
            }
        }
        depth_and_ids(scratch, bodies, intrinsics, [height, width])
    })
}

/// Draws a body into the first `samples` layers.
fn draw_body(
    scratch: &mut Scratch,
    samples: usize,
    (index, body): (usize, &Body),
    camera_from_body: &Pose<Camera, BodyFrame>,
    k: &Intrinsics,
) {
    let mesh = body.mesh.mesh();
    let Scratch { layers, seen, corners } = scratch;
    corners.clear();
    corners.extend(mesh.positions.iter().map(|p| camera_from_body.point(p.as_dvec3())));
    for (face, triangle) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = triangle.map(|v| corners[v as usize]);
        let normal = (b - a).cross(c - a);
        let distance = normal.dot(a);
        // The camera is at the origin: faces that look away have a plane in front of it.
        if distance >= -1e-15 {
            continue;
        }
        let (cut, count) = cut_near([a, b, c]);
        if count < 3 {
            continue;
        }
        let project = |p: DVec3| DVec2::new(p.x / p.z * k.fx + k.cx, p.y / p.z * k.fy + k.cy);
        let mut points = [DVec2::ZERO; 4];
        let mut limit = 0.0f64;
        for (point, corner) in points.iter_mut().zip(&cut[..count]) {
            *point = project(*corner);
            limit = limit.max(1.0 / corner.z);
        }
        let Some(polygon) = Polygon::new(&points[..count], layers[0].width, layers[0].height) else {
            continue;
        };
        let (nx, ny) = (normal.x / k.fx, normal.y / k.fy);
        let key = [
            nx / distance,
            ny / distance,
            (normal.z - nx * k.cx - ny * k.cy) / distance,
        ];
        let owner = seen.len() as u32;
        let surface = ((index as u32) << 16) | u32::from(body.mesh.faces[face].surface);
        seen.push(Seen {
            normal,
            distance,
            body: index as u16,
            face: face as u32,
            surface,
        });
        for layer in &mut layers[..samples] {
            layer.draw(&polygon, key, limit as f32, owner);
        }
    }
}

/// The part of a triangle beyond the near plane, and its number of corners.
fn cut_near(corners: [DVec3; 3]) -> ([DVec3; 4], usize) {
    let mut cut = [DVec3::ZERO; 4];
    let mut count = 0;
    for k in 0..3 {
        let (p, q) = (corners[k], corners[(k + 1) % 3]);
        let mut keep = |point: DVec3| {
            cut[count] = point;
            count += 1;
        };
        if p.z >= NEAR {
            keep(p);
        }
        if (p.z >= NEAR) != (q.z >= NEAR) {
            keep(p + (q - p) * ((NEAR - p.z) / (q.z - p.z)));
        }
    }
    (cut, count)
}

fn depth_and_ids(
    scratch: &Scratch,
    bodies: &[Body],
    k: &Intrinsics,
    [height, width]: [usize; 2],
) -> (Vec<f32>, Vec<u8>) {
    let mut depth_m = Vec::with_capacity(width * height);
    let mut id = Vec::with_capacity(width * height);
    for row in 0..height {
        let y = (row as f64 + 0.5 - k.cy) / k.fy;
        for column in 0..width {
            let owner = scratch.layers[0].owner[row * width + column];
            if owner == NOBODY {
                depth_m.push(f32::NAN);
                id.push(u8::MAX);
                continue;
            }
            let seen = &scratch.seen[owner as usize];
            let ray = DVec3::new((column as f64 + 0.5 - k.cx) / k.fx, y, 1.0);
            depth_m.push((seen.distance / seen.normal.dot(ray)) as f32);
            id.push(bodies[seen.body as usize].id);
        }
    }
    (depth_m, id)
}
