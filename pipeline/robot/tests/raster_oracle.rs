//! The rasteriser against an independent ray caster (Moller-Trumbore in f64 through pixel centres).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common;

use glam::DVec3;
use rogs_geometry::{Base, Camera, Link, Pinhole, Pose};
use rogs_needs::needs;
use rogs_robot::raster::Renderer;
use rogs_robot::{Mesh, MeshImage, MeshScene, RenderOptions};
use rogs_schemas::Intrinsics;
use rogs_schemas::records::robot::{NO_LINK, RobotSpec};

/// A small generator of test numbers in [0, 1) (splitmix64).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

fn camera(width: u32, height: u32) -> Pinhole {
    let focal = 0.83 * f64::from(width);
    let intrinsics = Intrinsics {
        fx: focal,
        fy: 1.04 * focal,
        cx: 0.5 * f64::from(width) + 0.3,
        cy: 0.5 * f64::from(height) - 0.2,
    };
    Pinhole {
        intrinsics,
        width,
        height,
    }
}

/// Distance along a ray with unit z, which is camera z; `None` when the ray misses.
fn intersect(ray: DVec3, [a, b, c]: [DVec3; 3]) -> Option<f64> {
    let (edge1, edge2) = (b - a, c - a);
    let p = ray.cross(edge2);
    let determinant = edge1.dot(p);
    if determinant == 0.0 {
        return None;
    }
    let from_a = -a;
    let u = from_a.dot(p) / determinant;
    let q = from_a.cross(edge1);
    let v = ray.dot(q) / determinant;
    let t = edge2.dot(q) / determinant;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0).then_some(t)
}

/// The nearest hit of every pixel: depth and triangle, and the depth of the second nearest surface of another link.
struct Hits {
    depth: Vec<f64>,
    link: Vec<u8>,
    /// Nearest depth per link id, for telling real mistakes from ties. `[H, W]` of small lists.
    per_link: Vec<Vec<(u8, f64)>>,
}

fn cast(scene: &MeshScene, camera: &Pinhole, camera_from_link: &[Pose<Camera, Link>], near: f64) -> Hits {
    let area = (camera.width * camera.height) as usize;
    let mut hits = Hits {
        depth: vec![f64::INFINITY; area],
        link: vec![NO_LINK; area],
        per_link: vec![Vec::new(); area],
    };
    for index in 0..scene.triangle_count() {
        let (link, corners) = scene.triangle(index);
        let corners =
            corners.map(|corner| camera_from_link[link as usize].point(DVec3::from_array(corner.map(f64::from))));
        // Rays outside the grown image bounds of the triangle cannot hit it.
        let (mut low, mut high) = ([0i64; 2], [i64::from(camera.width) - 1, i64::from(camera.height) - 1]);
        if corners.iter().all(|corner| corner.z > near) {
            let points = corners.map(|corner| camera.project(corner).unwrap().0);
            for axis in 0..2 {
                let values = points.map(|point| point[axis]);
                low[axis] = low[axis].max(values.iter().copied().fold(f64::MAX, f64::min).floor().max(-9.0) as i64 - 2);
                high[axis] = high[axis].min(values.iter().copied().fold(f64::MIN, f64::max).ceil().min(1e5) as i64 + 2);
            }
        }
        for row in low[1]..=high[1] {
            for column in low[0]..=high[0] {
                let ray = camera.ray(column as u32, row as u32);
                let Some(depth) = intersect(ray, corners).filter(|depth| *depth >= near) else {
                    continue;
                };
                let pixel = row as usize * camera.width as usize + column as usize;
                if depth < hits.depth[pixel] {
                    (hits.depth[pixel], hits.link[pixel]) = (depth, link);
                }
                match hits.per_link[pixel].iter_mut().find(|(known, _)| *known == link) {
                    Some((_, nearest)) => *nearest = nearest.min(depth),
                    None => hits.per_link[pixel].push((link, depth)),
                }
            }
        }
    }
    hits
}

struct Comparison {
    covered: usize,
    mask_differences: usize,
    link_differences: usize,
    depth_p99: f64,
}

fn compare(image: &MeshImage, hits: &Hits) -> Comparison {
    let mut result = Comparison {
        covered: 0,
        mask_differences: 0,
        link_differences: 0,
        depth_p99: 0.0,
    };
    let mut errors = Vec::new();
    for pixel in 0..image.link.len() {
        let (ours, theirs) = (image.link[pixel] != NO_LINK, hits.link[pixel] != NO_LINK);
        result.covered += usize::from(theirs);
        result.mask_differences += usize::from(ours != theirs);
        if ours && theirs {
            // Two links at the same place (within a micrometre): either is right.
            let of_link = hits.per_link[pixel].iter().find(|(link, _)| *link == image.link[pixel]);
            let tied = of_link.is_some_and(|(_, depth)| depth - hits.depth[pixel] < 1e-6);
            result.link_differences += usize::from(image.link[pixel] != hits.link[pixel] && !tied);
            errors.push((f64::from(image.depth_m[pixel]) - hits.depth[pixel]).abs());
        }
    }
    errors.sort_by(f64::total_cmp);
    result.depth_p99 = errors.get(errors.len() * 99 / 100).copied().unwrap_or(0.0);
    result
}

fn random_scene(numbers: &mut Numbers, triangles: usize, size: f64) -> MeshScene {
    let mut scene = MeshScene::new();
    for link in 0..3u8 {
        let mut mesh = Mesh::default();
        for index in 0..triangles as u32 {
            let centre = [
                numbers.range(-0.9, 0.9),
                numbers.range(-0.6, 0.6),
                numbers.range(0.3, 2.5),
            ];
            for _ in 0..3 {
                mesh.positions
                    .push(centre.map(|value| (value + numbers.range(-size, size)) as f32));
            }
            mesh.triangles.push([3 * index, 3 * index + 1, 3 * index + 2]);
        }
        scene.add(link, &mesh);
    }
    scene
}

fn near_identity(numbers: &mut Numbers) -> Vec<Pose<Camera, Link>> {
    let mut small = |limit: f64| [0; 3].map(|_| numbers.range(-limit, limit));
    (0..3).map(|_| Pose::from_xyz_euler(small(0.1), small(0.2))).collect()
}

#[test]
fn random_triangles_agree_with_the_ray_caster() {
    let mut numbers = Numbers(1);
    for (triangles, size) in [(60, 0.5), (400, 0.08), (2000, 0.01), (40, 2.5)] {
        let scene = random_scene(&mut numbers, triangles, size);
        let poses = near_identity(&mut numbers);
        let camera = camera(96, 56);
        let options = RenderOptions::default();
        let image = scene.render(&camera, &poses, &options).unwrap();
        let result = compare(&image, &cast(&scene, &camera, &poses, options.near_m));
        println!(
            "{triangles} of {size}: {} covered, mask {}, links {}, p99 {:.2e} m",
            result.covered, result.mask_differences, result.link_differences, result.depth_p99
        );
        assert!(result.covered > 300);
        assert!(result.mask_differences <= 1 && result.link_differences == 0);
        assert!(result.depth_p99 < 2e-6, "{}", result.depth_p99);
    }
}

/// Camera on the side of the robot, or at the wrist looking along the gripper.
fn robot_views(base_from_link8: Pose<Base, Link>) -> [Pose<Base, Camera>; 2] {
    let (eye, target) = (DVec3::new(1.15, 0.75, 0.75), DVec3::new(0.25, 0.0, 0.4));
    let z = (target - eye).normalize();
    let x = z.cross(DVec3::Z).normalize();
    let external = Pose::new(glam::DMat3::from_cols(x, z.cross(x), z), eye);
    let hand_eye: Pose<Link, Camera> = Pose::from_xyz_euler([-0.0768, 0.0317, 0.0178], [-0.337, 0.0, -1.571]);
    [external, base_from_link8 * hand_eye]
}

#[needs(shared)]
#[test]
fn the_real_robot_agrees_with_the_ray_caster() {
    let model = common::panda();
    let scene = MeshScene::of_robot(&model, &RobotSpec::default()).unwrap();
    assert_eq!(scene.triangle_count(), 57_484);
    let angles = [0.0, -0.4, 0.0, -2.2, 0.0, 1.9, 0.7];
    let names: Vec<String> = (1..=7).map(|index| format!("panda_joint{index}")).collect();
    let state = model.robot_state(&RobotSpec::default(), &names, &angles, 0.4).unwrap();
    let links = model.fk(&state);
    let base_from_link8 = links[model.link_id("panda_link8").unwrap()];
    for (view, base_from_camera) in robot_views(base_from_link8).into_iter().enumerate() {
        let camera = camera(280, 154);
        let poses: Vec<Pose<Camera, Link>> = links.iter().map(|&pose| base_from_camera.inverse() * pose).collect();
        let image = scene.render(&camera, &poses, &RenderOptions::default()).unwrap();
        let result = compare(&image, &cast(&scene, &camera, &poses, RenderOptions::default().near_m));
        println!(
            "view {view}: {} covered, mask {}, links {}, p99 {:.2e} m",
            result.covered, result.mask_differences, result.link_differences, result.depth_p99
        );
        assert!(result.covered > 3000);
        assert!(result.mask_differences <= 2 && result.link_differences == 0);
        assert!(result.depth_p99 < 5e-6, "{}", result.depth_p99);
    }
}

#[test]
fn any_number_of_threads_gives_the_same_picture() {
    let mut numbers = Numbers(7);
    let scene = random_scene(&mut numbers, 500, 0.3);
    let poses = near_identity(&mut numbers);
    let mut renderer = Renderer::new(&scene);
    let mut draw = |threads| {
        renderer
            .render(&camera(128, 80), &poses, &RenderOptions::default(), threads)
            .unwrap()
    };
    let one = draw(1);
    for threads in [2, 3, 8, 1] {
        assert!(draw(threads) == one, "{threads} threads");
    }
}

/// A mesh that covers the whole image, with many vertices exactly on pixel centres and shared edges.
fn jittered_grid(numbers: &mut Numbers, camera: &Pinhole, on_centres: bool) -> Mesh {
    let (columns, rows) = (20u32, 14u32);
    let mut mesh = Mesh::default();
    for row in 0..=rows {
        for column in 0..=columns {
            let mut place = [
                f64::from(column) / f64::from(columns) * 100.0 - 2.0,
                f64::from(row) / f64::from(rows) * 60.0 - 2.0,
            ];
            if on_centres {
                place = place.map(|value| value.round() + 0.5);
            } else {
                place = place.map(|value| value + numbers.range(-1.5, 1.5));
            }
            mesh.positions
                .push(camera.unproject(place.into(), 1.0).as_vec3().to_array());
        }
    }
    let vertex = |column: u32, row: u32| row * (columns + 1) + column;
    for row in 0..rows {
        for column in 0..columns {
            let [a, b] = [vertex(column, row), vertex(column + 1, row)];
            let [c, d] = [vertex(column, row + 1), vertex(column + 1, row + 1)];
            mesh.triangles.extend(if (row + column) % 2 == 0 {
                [[a, b, d], [a, d, c]]
            } else {
                [[a, b, c], [b, c, d]]
            });
        }
    }
    mesh
}

#[test]
fn every_pixel_of_a_joined_surface_is_drawn_once() {
    let mut numbers = Numbers(3);
    // A power of two as focal length, so that pixel centres survive the projection exactly.
    let camera = Pinhole {
        intrinsics: Intrinsics {
            fx: 64.0,
            fy: 64.0,
            cx: 48.0,
            cy: 28.0,
        },
        width: 96,
        height: 56,
    };
    for on_centres in [true, false] {
        let mesh = jittered_grid(&mut numbers, &camera, on_centres);
        let mut drawn = vec![0u32; 96 * 56];
        for triangle in &mesh.triangles {
            let mut scene = MeshScene::new();
            scene.add(
                0,
                &Mesh {
                    positions: mesh.positions.clone(),
                    triangles: vec![*triangle],
                },
            );
            let image = scene
                .render(&camera, &[Pose::IDENTITY], &RenderOptions::default())
                .unwrap();
            drawn
                .iter_mut()
                .zip(&image.link)
                .for_each(|(count, &link)| *count += u32::from(link == 0));
        }
        assert!(drawn.iter().all(|&count| count == 1), "on centres: {on_centres}");
    }
}

#[test]
fn surfaces_through_the_near_plane_and_far_outside_the_image_are_cut() {
    // A floor 0.5 m below the camera that starts behind it and reaches 1 km away.
    let mut scene = MeshScene::new();
    let corner = |x: f32, z: f32| [x, 0.5, z];
    scene.add(
        0,
        &Mesh {
            positions: vec![
                corner(-1e3, -5.0),
                corner(1e3, -5.0),
                corner(1e3, 1e3),
                corner(-1e3, 1e3),
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        },
    );
    let camera = camera(64, 40);
    let image = scene
        .render(&camera, &[Pose::IDENTITY], &RenderOptions { near_m: 0.05 })
        .unwrap();
    let mut seen = 0;
    for pixel in 0..image.link.len() {
        let ray = camera.ray(pixel as u32 % 64, pixel as u32 / 64);
        let depth = 0.5 / ray.y;
        let visible = ray.y > 0.0 && depth < 1e3 - 1.0;
        seen += usize::from(visible);
        assert_eq!(image.link[pixel] == 0, visible, "pixel {pixel}");
        if visible {
            assert!((f64::from(image.depth_m[pixel]) / depth - 1.0).abs() < 1e-5);
        }
    }
    assert!(seen > 1000);
}

#[test]
fn the_order_of_drawing_does_not_matter_and_ties_go_to_the_lower_triangle() {
    let mut scene = MeshScene::new();
    let mesh = Mesh {
        positions: vec![[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [0.0, 1.0, 1.0]],
        triangles: vec![[0, 1, 2], [0, 2, 1]],
    };
    scene.add(4, &mesh);
    scene.add(2, &mesh);
    let image = scene
        .render(&camera(32, 24), &[Pose::IDENTITY; 5], &RenderOptions::default())
        .unwrap();
    assert!(image.link.contains(&4) && !image.link.contains(&2));
    assert!(
        image
            .triangle
            .iter()
            .all(|&triangle| triangle == 0 || triangle == rogs_robot::raster::NO_TRIANGLE)
    );
}

#[test]
fn wrong_cameras_and_missing_poses_are_errors() {
    let mut scene = MeshScene::new();
    scene.add(
        3,
        &Mesh {
            positions: vec![[0.0; 3]; 3],
            triangles: vec![[0, 1, 2]],
        },
    );
    let poses = [Pose::IDENTITY; 4];
    let options = RenderOptions::default();
    assert!(
        scene
            .render(&camera(32, 24), &poses[..3], &options)
            .unwrap_err()
            .to_string()
            .contains("link 3")
    );
    assert!(
        scene
            .render(&camera(5000, 24), &poses, &options)
            .unwrap_err()
            .to_string()
            .contains("5000")
    );
    let blind = Pinhole {
        intrinsics: Intrinsics {
            fx: 0.0,
            ..camera(8, 8).intrinsics
        },
        ..camera(8, 8)
    };
    assert!(
        scene
            .render(&blind, &poses, &options)
            .unwrap_err()
            .to_string()
            .contains("not valid")
    );
    assert!(
        scene
            .render(&camera(8, 8), &poses, &RenderOptions { near_m: 0.0 })
            .is_err()
    );
}
