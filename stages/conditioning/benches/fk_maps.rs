//! FK conditioning maps of 15 source views and 8 query times at 280x154 beside numpy in the same run (goal G-FKMAP: dense
//! at least 6 times the best peer, 10 times is the target; sparse at least 20 times).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of benchmarks may be left half-written")]

#[path = "../../../tests/support/bench.rs"]
mod bench;

use std::path::Path;
use std::time::Instant;

use bench::{processor_seconds, run_peer};
use rayon::ThreadPoolBuilder;
use rayon::prelude::*;
use rogs_conditioning::fk_maps::{LinkDisplacement, SourcePoints, fill_dense_batch, link_displacement};
use rogs_geometry::{Camera, Link, Pinhole, Pose, PosedCamera, Recon};
use rogs_schemas::Intrinsics;

const VIEWS: usize = 15;
const QUERIES: usize = 8;
const W: u32 = 280;
const H: u32 = 154;
const LINKS: usize = 18;
const AREA: usize = (W * H) as usize;
const NO_LINK: u8 = 255;

/// The data both sides compute from.
struct Workload {
    camera: Pinhole,
    ids: Vec<u8>,
    depth: Vec<f32>,
    recon_from_camera: Vec<Pose<Recon, Camera>>,
    source: Vec<Pose<Recon, Link>>,
    query: Vec<Pose<Recon, Link>>,
}

fn main() {
    for cover in [0.13, 0.6] {
        println!("{:.0} % of the pixels show the robot", cover * 100.0);
        measure(&workload(cover));
    }
    println!("peak memory {} MiB", rogs_worker::peak_rss_bytes() >> 20);
}

/// A compact robot on the left of the image, its links in bands.
fn workload(cover: f64) -> Workload {
    let mut state = 7u64;
    let mut next = move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1u32 << 24)
    };
    let focal = 0.83 * f64::from(W);
    let intrinsics = Intrinsics {
        fx: focal,
        fy: focal,
        cx: f64::from(W) / 2.0,
        cy: f64::from(H) / 2.0,
    };
    let mut poses = |count: usize| -> Vec<[[f64; 3]; 2]> {
        (0..count)
            .map(|_| [[0; 3].map(|_| next() - 0.5), [0; 3].map(|_| next() * 3.0)])
            .collect()
    };
    let (cameras, source, query) = (poses(VIEWS), poses(VIEWS * LINKS), poses(QUERIES * LINKS));
    let columns = (f64::from(W) * cover) as u32;
    let link_of = |pixel: u32| {
        if pixel % W < columns {
            (pixel / W * LINKS as u32 / H) as u8
        } else {
            NO_LINK
        }
    };
    let ids: Vec<u8> = (0..VIEWS).flat_map(|_| (0..AREA as u32).map(link_of)).collect();
    let depth = ids
        .iter()
        .map(|&id| {
            if id == NO_LINK {
                0.0
            } else {
                (0.4 + 1.1 * next()) as f32
            }
        })
        .collect();
    let link_pose = |numbers: &[[f64; 3]; 2]| Pose::<Recon, Link>::from_xyz_euler(numbers[0], numbers[1]);
    Workload {
        camera: Pinhole {
            intrinsics,
            width: W,
            height: H,
        },
        ids,
        depth,
        recon_from_camera: cameras
            .iter()
            .map(|numbers| Pose::from_xyz_euler(numbers[0], numbers[1]))
            .collect(),
        source: source.iter().map(link_pose).collect(),
        query: query.iter().map(link_pose).collect(),
    }
}

impl Workload {
    fn points(&self, view: usize) -> SourcePoints {
        let range = view * AREA..(view + 1) * AREA;
        let support: Vec<u8> = self.ids[range.clone()]
            .iter()
            .map(|&id| u8::from(id != NO_LINK))
            .collect();
        SourcePoints::new(
            &PosedCamera::new(self.camera, self.recon_from_camera[view]),
            &self.depth[range.clone()],
            &self.ids[range],
            &support,
        )
    }

    fn links(&self, map: usize) -> Vec<LinkDisplacement> {
        let (view, query) = (map / QUERIES, map % QUERIES);
        let pair =
            |link: usize| link_displacement(&self.source[view * LINKS + link], &self.query[query * LINKS + link]);
        (0..LINKS).map(pair).collect()
    }

    /// Everything from poses and depth to displacements on supported pixels. `[S][Q, M, 3]`
    fn sparse(&self, out: &mut [Vec<f32>]) {
        let view = |(view, out): (usize, &mut Vec<f32>)| {
            let points = self.points(view);
            let size = 3 * points.pixels.len();
            out.resize(QUERIES * size, 0.0);
            for (query, out) in out.chunks_exact_mut(size).enumerate() {
                points.displace(&self.links(view * QUERIES + query), out);
            }
        };
        out.par_iter_mut().enumerate().for_each(view);
    }

    /// The same into dense maps, `[S, Q, 5, H, W]`.
    fn dense(&self, out: &mut [f32]) {
        let points: Vec<SourcePoints> = (0..VIEWS).into_par_iter().map(|view| self.points(view)).collect();
        let links: Vec<Vec<LinkDisplacement>> = (0..VIEWS * QUERIES).map(|map| self.links(map)).collect();
        fill_dense_batch(&points, &links, QUERIES, AREA, out);
    }
}

fn measure(workload: &Workload) {
    let size = VIEWS * QUERIES * 5 * AREA;
    let mut out = vec![0.0f32; size];
    let mut ours = [[0.0; 3]; 3];
    for threads in [1usize, 2] {
        let pool = ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a thread pool");
        let mut kept = vec![Vec::new(); VIEWS];
        let sparse = milliseconds(25, || pool.install(|| workload.sparse(&mut kept)));
        let dense = milliseconds(15, || pool.install(|| workload.dense(&mut out)));
        let fresh = milliseconds(9, || {
            let mut out = vec![0.0f32; size];
            pool.install(|| workload.dense(&mut out));
            std::hint::black_box(out);
        });
        let fill = milliseconds(9, || {
            pool.install(|| {
                out.par_chunks_mut(5 * AREA)
                    .for_each(|map| map.fill(std::hint::black_box(0.0)))
            })
        });
        println!(
            "  {threads} thread(s), ms by median, best and processor time: sparse {}, dense into a kept buffer {}, into a new one {}, bare fill {}",
            shown(sparse),
            shown(dense),
            shown(fresh),
            shown(fill)
        );
        ours = [sparse, dense, fresh];
        pool.install(|| workload.dense(&mut out));
    }
    report_peer(workload, &out[(QUERIES + 2) * 5 * AREA..][..5 * AREA], ours);
}

/// Median, least and mean CPU milliseconds (all threads) of several runs after a warm-up.
fn milliseconds(runs: usize, mut work: impl FnMut()) -> [f64; 3] {
    work();
    let before = processor_seconds();
    let mut times: Vec<f64> = (0..runs)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    let processor = (processor_seconds() - before) * 1e3 / runs as f64;
    times.sort_by(f64::total_cmp);
    [times[times.len() / 2], times[0], processor]
}

fn shown(times: [f64; 3]) -> String {
    format!("{:.2} / {:.2} / {:.2}", times[0], times[1], times[2])
}

fn report_peer(workload: &Workload, map: &[f32], ours: [[f64; 3]; 3]) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    write_workload(workload, folder.path());
    let Some(output) = run_peer("fk_maps.py", &[folder.path().as_os_str()]) else {
        return;
    };
    for line in output.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [name, median, least, processor, memory] = words.as_slice() else {
            continue;
        };
        let number = |text: &str| text.parse::<f64>().unwrap_or(f64::NAN);
        let times = |ours: [f64; 3]| {
            let [median, least, processor] = [median, least, processor].map(|text| number(text));
            format!(
                "{:.1} / {:.1} / {:.1}",
                median / ours[0],
                least / ours[1],
                processor / ours[2]
            )
        };
        let theirs = std::fs::read(folder.path().join(format!("{name}.map"))).unwrap_or_default();
        let (theirs, _) = theirs.as_chunks::<4>();
        let worst = theirs
            .iter()
            .zip(map)
            .map(|(a, b)| (f32::from_le_bytes(*a) - b).abs())
            .fold(0.0, f32::max);
        println!(
            "  {name}: {median} / {least} / {processor} ms, {memory} MiB; times as fast: sparse {}, dense {}, dense new {}; differs by {worst:.1e}",
            times(ours[0]),
            times(ours[1]),
            times(ours[2])
        );
    }
}

fn write_workload(workload: &Workload, folder: &Path) {
    let write =
        |name: &str, bytes: Vec<u8>| std::fs::write(folder.join(name), bytes).expect("the workload can be written");
    let floats = |values: &mut dyn Iterator<Item = f32>| values.flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
    let sizes = [VIEWS, QUERIES, H as usize, W as usize, LINKS];
    write(
        "sizes.i64",
        sizes.iter().flat_map(|&size| (size as i64).to_le_bytes()).collect(),
    );
    write("ids.u8", workload.ids.clone());
    write("depth.f32", floats(&mut workload.depth.iter().copied()));
    write(
        "focal.f32",
        floats(&mut [workload.camera.intrinsics.fx as f32].into_iter()),
    );
    let matrix = |matrix: [f64; 16]| matrix.map(|value| value as f32);
    write(
        "camera.f32",
        floats(
            &mut workload
                .recon_from_camera
                .iter()
                .flat_map(|pose| matrix(pose.to_matrix4())),
        ),
    );
    write(
        "source.f32",
        floats(&mut workload.source.iter().flat_map(|pose| matrix(pose.to_matrix4()))),
    );
    write(
        "query.f32",
        floats(&mut workload.query.iter().flat_map(|pose| matrix(pose.to_matrix4()))),
    );
}
