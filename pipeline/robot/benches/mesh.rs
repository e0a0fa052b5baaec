//! Mesh depth and link ids of one view, a new pose every frame, beside other renderers in the same run (goal G-MESH: at
//! least 3 times the better of moderngl and pyrender at 280x154, 6 times is the target; at 640x352 also faster than
//! Open3D with its tree already built).
//!
//! The peers draw exactly the scene that this program writes, see `peers/mesh.py`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of benchmarks may be left half-written")]

mod common;

use std::path::Path;

use common::{panda, peak_memory_mib, processor_seconds, run_peer, seconds};
use glam::{DMat3, DVec3};
use rayon::ThreadPoolBuilder;
use rogs_geometry::{Base, Camera, Link, Pinhole, Pose};
use rogs_robot::raster::Renderer;
use rogs_robot::{MeshImage, MeshScene, RenderOptions, RobotModel};
use rogs_schemas::Intrinsics;
use rogs_schemas::records::robot::{NO_LINK, RobotSpec};

const SIZES: [(u32, u32); 2] = [(280, 154), (640, 352)];
const RUNS: usize = 60;

fn main() {
    let Some(urdf) = panda() else { return };
    let model = RobotModel::load(&urdf).expect("the reference robot loads");
    let paper = RobotSpec {
        exclude_links: vec!["*_sc".into()],
        ..RobotSpec::default()
    };
    let visual = RobotSpec {
        collision_links: Vec::new(),
        ..paper.clone()
    };
    for (name, spec) in [("paper", &paper), ("visual", &visual)] {
        let scene = MeshScene::of_robot(&model, spec).expect("the meshes load");
        println!(
            "{name}: {} triangles, {} vertices after welding",
            scene.triangle_count(),
            scene.vertex_count()
        );
        for (width, height) in SIZES {
            compare(name, &model, &scene, width, height);
        }
    }
    println!("peak memory {:.0} MiB", peak_memory_mib());
}

fn compare(name: &str, model: &RobotModel, scene: &MeshScene, width: u32, height: u32) {
    let focal = 0.83 * f64::from(width);
    let intrinsics = Intrinsics {
        fx: focal,
        fy: focal,
        cx: f64::from(width) / 2.0,
        cy: f64::from(height) / 2.0,
    };
    let camera = Pinhole {
        intrinsics,
        width,
        height,
    };
    let poses: Vec<Vec<Pose<Camera, Link>>> = (0..16).map(|step| poses(model, f64::from(step) * 0.002)).collect();
    let mut ours = [0.0; 3];
    for threads in [1usize, 2] {
        let pool = ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a thread pool");
        let mut renderer = Renderer::new(scene);
        let mut frame = 0;
        let mut processor = 0.0;
        let (median, least) = pool.install(|| {
            let times = seconds(RUNS, || {
                if frame == 1 {
                    // After the warm-up.
                    processor = processor_seconds();
                }
                frame += 1;
                let image = renderer.render(&camera, &poses[frame % poses.len()], &RenderOptions::default(), threads);
                std::hint::black_box(image.expect("the scene renders"));
            });
            processor = processor_seconds() - processor;
            times
        });
        ours = [median * 1e3, least * 1e3, processor * 1e3 / RUNS as f64];
        println!(
            "  {width}x{height}, {threads} thread(s): {:.3} ms a frame (best {:.3}), {:.3} ms of processor time",
            ours[0], ours[1], ours[2]
        );
    }
    let image = scene
        .render(&camera, &poses[0], &RenderOptions::default())
        .expect("the scene renders");
    report_peers(name, scene, &camera, &poses[0], &image, ours);
}

fn poses(model: &RobotModel, turn: f64) -> Vec<Pose<Camera, Link>> {
    let angles = [turn, -0.4, 0.0, -2.2, 0.0, 1.9, 0.7];
    let names: Vec<String> = (1..=7).map(|index| format!("panda_joint{index}")).collect();
    let state = model
        .robot_state(&RobotSpec::default(), &names, &angles, 0.3 / 0.725)
        .expect("a state of the robot");
    let (eye, target) = (DVec3::new(1.15, 0.75, 0.75), DVec3::new(0.25, 0.0, 0.4));
    let z = (target - eye).normalize();
    let x = z.cross(DVec3::Z).normalize();
    let base_from_camera: Pose<Base, Camera> = Pose::new(DMat3::from_cols(x, z.cross(x), z), eye);
    model
        .fk(&state)
        .iter()
        .map(|&pose| base_from_camera.inverse() * pose)
        .collect()
}

/// Writes the posed scene for the peers, runs them and compares times and pictures.
fn report_peers(
    name: &str,
    scene: &MeshScene,
    camera: &Pinhole,
    poses: &[Pose<Camera, Link>],
    image: &MeshImage,
    ours: [f64; 3],
) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (mut corners, mut links) = (Vec::new(), Vec::new());
    for index in 0..scene.triangle_count() {
        let (link, triangle) = scene.triangle(index);
        for corner in triangle {
            let point = poses[link as usize]
                .point(DVec3::from_array(corner.map(f64::from)))
                .as_vec3();
            corners.extend(point.to_array().iter().flat_map(|value| value.to_le_bytes()));
        }
        links.push(link);
    }
    std::fs::write(folder.path().join("corners.f32"), corners).expect("the scene can be written");
    std::fs::write(folder.path().join("links.u8"), links).expect("the scene can be written");
    let numbers =
        [f64::from(camera.width), f64::from(camera.height), camera.intrinsics.fx].map(|value| value.to_string());
    let mut arguments = vec![folder.path().as_os_str()];
    arguments.extend(numbers.iter().map(std::ffi::OsStr::new));
    let Some(output) = run_peer("mesh.py", &arguments) else {
        return;
    };
    for line in output.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [peer, median, least, processor, memory] = words.as_slice() else {
            continue;
        };
        let parse = |text: &str| text.parse::<f64>().unwrap_or(f64::NAN);
        println!(
            "  {name} {}x{} {peer}: {median} ms (best {least}, processor {processor}), {memory} MiB: ours is {:.1} times as fast (best against best {:.1}, processor time {:.1}); {}",
            camera.width,
            camera.height,
            parse(median) / ours[0],
            parse(least) / ours[1],
            parse(processor) / ours[2],
            difference(folder.path(), peer, image)
        );
    }
}

fn difference(folder: &Path, peer: &str, image: &MeshImage) -> String {
    let read = |kind: &str| std::fs::read(folder.join(format!("{peer}.{kind}"))).ok();
    let (Some(depth), Some(link)) = (read("depth"), read("link")) else {
        return "no picture".into();
    };
    let (depth, _) = depth.as_chunks::<4>();
    let mut errors = Vec::new();
    let (mut mask, mut ids) = (0, 0);
    for (pixel, (&theirs, depth)) in link.iter().zip(depth).enumerate() {
        let ours = image.link[pixel];
        mask += usize::from((ours == NO_LINK) != (theirs == NO_LINK));
        if ours != NO_LINK && theirs != NO_LINK {
            ids += usize::from(ours != theirs);
            errors.push((f64::from(f32::from_le_bytes(*depth)) - f64::from(image.depth_m[pixel])).abs() * 1e6);
        }
    }
    errors.sort_by(f64::total_cmp);
    let p99 = errors.get(errors.len() * 99 / 100).copied().unwrap_or(f64::NAN);
    format!(
        "mask differs at {mask} pixels, ids at {ids} of {}, depth p99 {p99:.2} um",
        errors.len()
    )
}
