//! G-IO: one clip's products through the container, beside common containers in the same run.
//!
//! `ROGS_PEER_PYTHON=PYTHON cargo bench -p rogs-r4c --bench io` (a Python with numpy, h5py, hdf5plugin, blosc2, zarr,
//! pyarrow); without it only our own figures are printed. Files lie in `ROGS_BENCH_DIR`, else /dev/shm where there is
//! one, so that formats are measured and not the disk. The best of several repetitions counts on both sides, in wall time
//! and in CPU time of all threads; the second is what a busy machine can measure.
//!
//! Floors: write 1.5 times and read 1.0 times the best peer, for f32 at a ratio within 2 % of the best peer's.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of benchmarks may be left half-written")]
#![allow(missing_docs, reason = "a program")]

#[path = "../../../tests/support/bench.rs"]
mod bench;

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::time::Instant;

use bench::{processor_seconds, run_peer};
use rogs_r4c::{Chunk, Codec, Dtype, Element, Frame, Reader, StreamSpec, Unit, Writer};
use rogs_schemas::{KeyMaterial, Provenance, SchemaId};

const WIDTH: usize = 280;
const HEIGHT: usize = 154;
const VIEWS: usize = 3;
const TIMES: usize = 5;
const CHANNELS: usize = 14;
const REPEATS: usize = 7;

fn main() {
    let folder = Folder::new();
    let gaussians = gaussians();
    let (depth, links) = robot();
    let peers = peers(&folder.0, &gaussians, &depth, &links);
    let ours = [
        measure(
            &folder.0,
            "gauss",
            Dtype::F32,
            Codec::PlanesZstd,
            &[CHANNELS as u32],
            &gaussians,
        ),
        measure(&folder.0, "depth", Dtype::F32, Codec::PlanesZstd, &[], &depth),
        measure(&folder.0, "ids", Dtype::U8, Codec::Zstd, &[], &links),
    ];
    println!(
        "{:<38} {:<6} {:>7} {:>12} {:>12} {:>14} {:>14}",
        "container", "data", "ratio", "write MB/s", "read MB/s", "write MB/cpu s", "read MB/cpu s"
    );
    for line in peers.iter().chain(&ours) {
        let rate = |seconds: f64| line.bytes as f64 / 1e6 / seconds;
        println!(
            "{:<38} {:<6} {:>7.2} {:>12.0} {:>12.0} {:>14.0} {:>14.0}",
            line.name,
            line.data,
            line.ratio,
            rate(line.write.wall),
            rate(line.read.wall),
            rate(line.write.processor),
            rate(line.read.processor),
        );
    }
    for our in &ours {
        let rivals: Vec<&Line> = peers.iter().filter(|peer| peer.data == our.data).collect();
        if rivals.is_empty() {
            continue;
        }
        let times = |of: fn(&Line) -> f64| rivals.iter().map(|peer| of(peer)).fold(f64::INFINITY, f64::min) / of(our);
        let ratio = rivals.iter().map(|peer| peer.ratio).fold(0.0, f64::max);
        println!(
            "{}: write {:.2}x wall, {:.2}x processor time; read {:.2}x wall, {:.2}x processor time; ratio {:.3} of the best",
            our.data,
            times(|line| line.write.wall),
            times(|line| line.write.processor),
            times(|line| line.read.wall),
            times(|line| line.read.processor),
            our.ratio / ratio,
        );
    }
}

/// Best seconds of several repetitions.
#[derive(Clone, Copy)]
struct Seconds {
    wall: f64,
    /// Of all threads together.
    processor: f64,
}

struct Line {
    name: String,
    data: String,
    bytes: usize,
    ratio: f64,
    write: Seconds,
    read: Seconds,
}

/// A folder for the files, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        let memory = PathBuf::from("/dev/shm");
        let root = std::env::var_os("ROGS_BENCH_DIR").map(PathBuf::from);
        let root = root.unwrap_or_else(|| if memory.is_dir() { memory } else { std::env::temp_dir() });
        let path = root.join(format!("rogs-bench-io-{}", std::process::id()));
        std::fs::create_dir_all(&path).expect("the folder for the files can be made");
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Our container: one chunk per view and time.
fn measure<T: Element + std::fmt::Debug>(
    folder: &Path,
    data: &'static str,
    dtype: Dtype,
    codec: Codec,
    shape: &[u32],
    values: &[T],
) -> Line {
    let spec = StreamSpec {
        name: data,
        dtype,
        unit: Unit::One,
        frame: Frame::None,
        codec,
        fill: "",
    };
    let path = folder.join(format!("{data}.r4c"));
    let material = KeyMaterial {
        stage: "bench".into(),
        stage_version: 1,
        schema: "bench 1.0".into(),
        params: "{}".into(),
        inputs: BTreeMap::new(),
    };
    let provenance = Provenance {
        material,
        input_content: BTreeMap::new(),
    };
    let write = || {
        let mut writer = Writer::new(
            SchemaId {
                name: "bench",
                major: 1,
                minor: 0,
            },
            &provenance,
        );
        let chunks: Vec<Chunk<'_, T>> = values
            .chunks_exact(values.len() / (VIEWS * TIMES))
            .zip(0..)
            .map(|(part, at)| ([at, 0, 0, 0], part))
            .collect();
        writer.stream(&spec, shape, &chunks).expect("the stream is well formed");
        writer.commit(&path).expect("the file can be written");
    };
    let read = || {
        Reader::open(&path)
            .and_then(|reader| reader.stream::<T>(&spec, shape))
            .expect("the file can be read")
    };
    let write_seconds = best(write);
    let read_seconds = best(|| drop(read()));
    assert!(read() == values, "what was read is what was written");
    let stored = std::fs::metadata(&path).expect("the file is there").len();
    let bytes = size_of_val(values);
    Line {
        name: "r4c (checksums, atomic write)".into(),
        data: data.into(),
        bytes,
        ratio: bytes as f64 / stored as f64,
        write: write_seconds,
        read: read_seconds,
    }
}

fn best(mut run: impl FnMut()) -> Seconds {
    run();
    let mut best = Seconds {
        wall: f64::INFINITY,
        processor: f64::INFINITY,
    };
    for _ in 0..REPEATS {
        let (start, before) = (Instant::now(), processor_seconds());
        run();
        best.wall = best.wall.min(start.elapsed().as_secs_f64());
        best.processor = best.processor.min(processor_seconds() - before);
    }
    best
}

/// The peers on the same arrays, where a Python for them is named.
fn peers(folder: &Path, gaussians: &[f32], depth: &[f32], links: &[u8]) -> Vec<Line> {
    let dump = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).expect("a dump can be written");
    dump("gauss.bin", bytemuck::cast_slice(gaussians));
    dump("depth.bin", bytemuck::cast_slice(depth));
    dump("ids.bin", links);
    let maps = VIEWS * TIMES;
    let shapes = [
        format!("{maps}x{HEIGHT}x{WIDTH}x{CHANNELS}"),
        format!("{maps}x{HEIGHT}x{WIDTH}"),
    ];
    let words = [
        ["gauss", "<f4", &shapes[0]],
        ["depth", "<f4", &shapes[1]],
        ["ids", "u1", &shapes[1]],
    ];
    let mut arguments = vec![folder.as_os_str()];
    arguments.extend(words.as_flattened().iter().map(OsStr::new));
    let text = run_peer("io_peers.py", &arguments).unwrap_or_default();
    let line = |text: &str| -> Option<Line> {
        let value: serde_json::Value = serde_json::from_str(text).ok()?;
        let data = value["data"].as_str()?.to_owned();
        let bytes = match data.as_str() {
            "gauss" => size_of_val(gaussians),
            "depth" => size_of_val(depth),
            _ => links.len(),
        };
        let seconds = |key: &str| {
            Some(Seconds {
                wall: value[key][0].as_f64()?,
                processor: value[key][1].as_f64()?,
            })
        };
        let name = value["peer"].as_str()?.to_owned();
        Some(Line {
            name,
            data,
            bytes,
            ratio: value["ratio"].as_f64()?,
            write: seconds("write")?,
            read: seconds("read")?,
        })
    };
    text.lines().filter_map(line).collect()
}

/// A repeatable source of uniform and normal numbers.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

type Vec3 = [f64; 3];

fn along(origin: Vec3, direction: Vec3, distance: f64) -> Vec3 {
    std::array::from_fn(|axis| origin[axis] + distance * direction[axis])
}

fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn unit(a: Vec3) -> Vec3 {
    let length = dot(a, a).sqrt();
    a.map(|value| value / length)
}

fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Rays of a camera at `eye` looking at `at`, with unit depth along the optical axis.
fn rays(eye: Vec3, at: Vec3) -> Vec<Vec3> {
    let forward = unit(std::array::from_fn(|axis| at[axis] - eye[axis]));
    let right = unit(cross(forward, [0.0, 0.0, 1.0]));
    let down = cross(forward, right);
    let focal = 0.83 * WIDTH as f64;
    let ray = |row: usize, column: usize| {
        let x = (column as f64 + 0.5 - WIDTH as f64 / 2.0) / focal;
        let y = (row as f64 + 0.5 - HEIGHT as f64 / 2.0) / focal;
        std::array::from_fn(|axis| x * right[axis] + y * down[axis] + forward[axis])
    };
    (0..HEIGHT)
        .flat_map(|row| (0..WIDTH).map(move |column| (row, column)))
        .map(|(row, column)| ray(row, column))
        .collect()
}

/// One Gaussian per pixel of three cameras at five times over a table with balls: position, scale, rotation, opacity and
/// colour with noise in every pixel, so that the ratio is a lower bound. `[15, H, W, 14]`
fn gaussians() -> Vec<f32> {
    const BALLS: [(Vec3, f64); 3] = [
        ([0.45, 0.1, 0.1], 0.1),
        ([0.3, -0.2, 0.07], 0.07),
        ([0.1, 0.0, 0.35], 0.12),
    ];
    const EYES: [Vec3; VIEWS] = [[0.9, 0.9, 0.8], [0.9, -0.9, 0.8], [0.35, 0.05, 0.65]];
    let mut noise = Noise(1);
    let mut values = Vec::with_capacity(TIMES * VIEWS * HEIGHT * WIDTH * CHANNELS);
    for time in 0..TIMES {
        for (view, base) in EYES.iter().enumerate() {
            let moved = if view == 2 { time as f64 } else { 0.0 };
            let eye = [base[0] + 0.01 * moved, base[1] + 0.02 * moved, base[2]];
            for ray in rays(eye, [0.35, 0.0, 0.15]) {
                let mut depth: f64 = 4.0;
                for (axis, wall) in [(2, 0.0), (0, -0.6), (1, 1.6), (1, -1.6), (2, 2.2)] {
                    let hit = (wall - eye[axis]) / ray[axis];
                    if hit > 0.05 && hit < depth {
                        depth = hit;
                    }
                }
                for (centre, radius) in BALLS {
                    let from = std::array::from_fn(|axis| eye[axis] - centre[axis]);
                    let (a, b) = (dot(ray, ray), dot(ray, from));
                    let inside = b * b - a * (dot(from, from) - radius * radius);
                    let hit = (-b - inside.max(0.0).sqrt()) / a;
                    if inside > 0.0 && hit > 0.02 && hit < depth {
                        depth = hit;
                    }
                }
                depth *= 1.0 + 0.004 * noise.normal();
                let position = along(eye, ray, depth);
                values.extend(position.map(|value| value as f32));
                let size = depth / (0.83 * WIDTH as f64);
                values.extend([0; 3].map(|_| (size * (0.35 * noise.normal() - 0.25).exp()) as f32));
                let turn = [0; 4].map(|_| noise.normal());
                let length = turn.iter().map(|value| value * value).sum::<f64>().sqrt();
                values.extend(turn.map(|value| (value / length) as f32));
                values.push((1.0 / (1.0 + (0.5 - 1.2 * noise.normal()).exp())) as f32);
                let mut colour =
                    |axis: usize| 0.5 + 0.35 * (9.0 * position[axis] + axis as f64).sin() + 0.03 * noise.normal();
                values.extend([colour(0), colour(1), colour(2)].map(|value| value.clamp(0.0, 1.0) as f32));
            }
        }
    }
    values
}

/// Depth and link id of an arm of capsules in three cameras at five poses, 0 and 255 where it is not. `[15, H, W]`
fn robot() -> (Vec<f32>, Vec<u8>) {
    let mut depths = Vec::new();
    let mut links = Vec::new();
    for time in 0..TIMES {
        let bend = 0.07 * time as f64;
        let joints: [Vec3; 7] = [
            [0.0, 0.0, 0.0],
            [0.0, 0.0, 0.33],
            [0.12 + bend, 0.03 * bend, 0.6],
            [0.35 + bend, 0.1 * bend, 0.62],
            [0.45 + bend, 0.2 * bend, 0.45],
            [0.46 + bend, 0.04 + 0.2 * bend, 0.3],
            [0.47 + bend, -0.04 + 0.2 * bend, 0.3],
        ];
        let distance = |point: Vec3| {
            let mut nearest = (f64::INFINITY, 255);
            for (link, pair) in joints.windows(2).enumerate() {
                let axis: Vec3 = std::array::from_fn(|i| pair[1][i] - pair[0][i]);
                let from: Vec3 = std::array::from_fn(|i| point[i] - pair[0][i]);
                let share = (dot(from, axis) / dot(axis, axis)).clamp(0.0, 1.0);
                let off: Vec3 = std::array::from_fn(|i| from[i] - share * axis[i]);
                let to_surface = dot(off, off).sqrt() - (0.07 - 0.008 * link as f64);
                if to_surface < nearest.0 {
                    nearest = (to_surface, link as u8);
                }
            }
            nearest
        };
        for eye in [[1.15, 0.75, 0.75], [1.0, -0.9, 0.7], [0.4 + bend, 0.0, 0.75]] {
            for ray in rays(eye, [0.3, 0.01, 0.35]) {
                let length = dot(ray, ray).sqrt();
                let (mut depth, mut hit) = (0.02, None);
                for _ in 0..60 {
                    let (to_surface, link) = distance(along(eye, ray, depth));
                    if to_surface < 1e-5 {
                        hit = Some(link);
                        break;
                    }
                    depth += to_surface / length;
                    if depth > 3.0 {
                        break;
                    }
                }
                depths.push(if hit.is_some() { depth as f32 } else { 0.0 });
                links.push(hit.unwrap_or(255));
            }
        }
    }
    (depths, links)
}
