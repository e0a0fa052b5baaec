//! Training clips are consistent with the geometry they come from.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use rogs_random::Pcg64;
use rogs_schemas::units::UNITS_PER_METRE;
use rogs_train::config::DataSettings;
use rogs_train::plan::ClipPlan;
use rogs_train::sample::Sample;

fn settings() -> DataSettings {
    DataSettings {
        size: [56, 98],
        queries: 3,
        ..DataSettings::default()
    }
}

fn clip(seed: u64) -> Sample {
    let mut random = Pcg64::from_seed(seed);
    ClipPlan::draw(seed, 3, &settings(), &mut random)
        .sample(&settings(), true)
        .unwrap()
}

/// The point of a source pixel, internal units.
fn point(sample: &Sample, view: usize, pixel: usize) -> [f64; 3] {
    let [height, width] = sample.size;
    let area = height * width;
    let depth = &sample.depth_iu[view * area..][..area];
    let points = sample.cameras[view].unproject(depth, height, width);
    std::array::from_fn(|axis| f64::from(points[3 * pixel + axis]))
}

/// A source pixel moved by its displacement must be where a camera at the query time sees the same surface, unless
/// something hides it: most points agree with the reference depth there, and none is seen through.
#[test]
fn displaced_points_lie_on_the_surfaces_seen_at_the_query_time() {
    let (mut on, mut hidden, mut through) = (0, 0, 0);
    for seed in [11, 12, 13] {
        let sample = clip(seed);
        let [height, width] = sample.size;
        let area = height * width;
        for query in &sample.queries {
            for view in 0..sample.views.len() {
                for pixel in (0..area).step_by(7) {
                    if sample.valid[view * area + pixel] == 0.0 {
                        continue;
                    }
                    let p = point(&sample, view, pixel);
                    let moved: [f64; 3] = std::array::from_fn(|axis| {
                        p[axis] + f64::from(query.displacement_iu[(3 * view + axis) * area + pixel])
                    });
                    for target in &query.targets {
                        let camera = &target.camera;
                        let r = &camera.rotation;
                        let q: [f64; 3] = std::array::from_fn(|row| {
                            (0..3).map(|k| r[3 * row + k] * moved[k]).sum::<f64>() + camera.translation[row]
                        });
                        if q[2] < 0.1 {
                            continue;
                        }
                        let (u, v) = (q[0] / q[2] * camera.fx + camera.cx, q[1] / q[2] * camera.fy + camera.cy);
                        if !(1.0..width as f64 - 1.0).contains(&u) || !(1.0..height as f64 - 1.0).contains(&v) {
                            continue;
                        }
                        // The nearest and farthest surface within a pixel: edges are not a matter of this test.
                        let (mut near, mut far) = (f64::INFINITY, 0.0f64);
                        for (dy, dx) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dy, dx))) {
                            let (y, x) = ((v as isize + dy) as usize, (u as isize + dx) as usize);
                            let pixel = y.min(height - 1) * width + x.min(width - 1);
                            let depth = if target.valid[pixel] > 0.0 {
                                f64::from(target.depth_iu[pixel])
                            } else {
                                50.0
                            };
                            (near, far) = (near.min(depth), far.max(depth));
                        }
                        if q[2] > far * 1.02 + 0.02 {
                            hidden += 1;
                        } else if q[2] < near * 0.98 - 0.02 {
                            through += 1;
                        } else {
                            on += 1;
                        }
                    }
                }
            }
        }
    }
    assert!(on > 10_000 && hidden < on, "{on} on a surface, {hidden} hidden");
    assert!(
        through * 500 < on,
        "{through} of {on} points float in front of what is seen"
    );
}

#[test]
fn conditioning_maps_carry_the_mesh_and_its_motion() {
    let sample = clip(21);
    let area = sample.size[0] * sample.size[1];
    let mut supported = 0;
    for query in &sample.queries {
        for view in 0..sample.views.len() {
            let map = |channel: usize| &query.kappa[(7 * view + channel) * area..][..area];
            for pixel in 0..area {
                let robot = sample.support[view * area + pixel];
                assert!(robot <= sample.robot[view * area + pixel]);
                assert_eq!(map(0)[pixel], robot);
                assert_eq!(map(5)[pixel], 1.0);
                assert!((0.0..=1.0).contains(&map(6)[pixel]));
                for axis in 0..3 {
                    let moved = query.displacement_iu[(3 * view + axis) * area + pixel];
                    assert_eq!(map(2 + axis)[pixel], moved * robot);
                }
                if robot > 0.0 {
                    supported += 1;
                    let metres = sample.mesh_depth_iu[view * area + pixel] / UNITS_PER_METRE as f32;
                    assert!((map(1)[pixel] - metres).abs() < 1e-6);
                }
            }
            if sample.views[view].1 == query.time {
                let moved = &query.displacement_iu[3 * view * area..][..3 * area];
                assert!(
                    moved.iter().all(|value| value.abs() < 1e-6),
                    "nothing moves at the source's own time"
                );
            }
        }
    }
    assert!(supported > 1000);
}

#[test]
fn the_first_wrist_camera_is_the_reconstruction_frame() {
    let sample = clip(31);
    let first = sample.cameras[0].world_from_camera_iu;
    assert!(first.rotation.abs_diff_eq(glam::DMat3::IDENTITY, 1e-9));
    assert!(first.translation.abs_diff_eq(glam::DVec3::ZERO, 1e-9));
    assert_eq!(sample.views.len(), 9);
    assert!(sample.views.windows(2).all(|pair| pair[0].0 <= pair[1].0));
}
