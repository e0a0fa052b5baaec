//! Seconds of a pair at 280x154 (a clip's images, 144 disparities) and at 1280x720 (128 disparities), by wall clock and by
//! CPU time, beside OpenCV's SGBM in the same run. Goals on two cores: well under 50 ms and under 1.5 s.
//!
//! `ROGS_PEER_PYTHON=PYTHON cargo bench -p rogs-stereo`, where PYTHON has `opencv-python-headless`; without it our times are
//! printed alone.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of benchmarks may be left half-written")]

#[path = "../../../tests/support/bench.rs"]
mod bench;

use std::ffi::OsString;
use std::time::Instant;

use bench::{processor_seconds, run_peer};
use rayon::ThreadPoolBuilder;
use rogs_stereo::{Grey, MatcherParams, Rig, match_pair};

/// A textured room corner: disparity grows down the image.
fn eye(width: usize, height: usize, steepness: f64) -> Grey {
    let noise = |x: i64, y: i64| {
        let mut value = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
        value ^= value >> 29;
        value = value.wrapping_mul(0xbf58_476d_1ce4_e5b9);
        ((value ^ value >> 32) % 200) as f64
    };
    let pixel = |at: usize| {
        let (x, y) = ((at % width) as f64, at / width);
        let place = x + steepness * y as f64;
        let (whole, part) = (place.floor(), place - place.floor());
        let at = |step: i64| noise(whole as i64 + step, y as i64);
        (at(0) * (1.0 - part) + at(1) * part) as u8 + 20
    };
    Grey::new(width, height, (0..width * height).map(pixel).collect()).unwrap()
}

/// Least seconds of a round and seconds of CPU time a round, by OpenCV.
fn peer(eyes: [&Grey; 2], disparities: usize, rounds: usize) -> Option<[f64; 2]> {
    let folder = tempfile::tempdir().unwrap();
    let mut arguments: Vec<OsString> = Vec::new();
    for (name, eye) in ["left", "right"].iter().zip(eyes) {
        let path = folder.path().join(name);
        std::fs::write(&path, eye.pixels()).unwrap();
        arguments.push(path.into());
    }
    let numbers = [eyes[0].width(), eyes[0].height(), disparities, rounds];
    arguments.extend(numbers.map(|number| number.to_string().into()));
    let arguments: Vec<_> = arguments.iter().map(OsString::as_os_str).collect();
    let said = run_peer("sgbm_times.py", &arguments)?;
    let mut numbers = said.split_whitespace().map(|word| word.parse::<f64>().unwrap());
    Some([numbers.next()?, numbers.next()?])
}

fn main() {
    // `cargo test --benches` passes no `--bench`; there is nothing to check then.
    if !std::env::args().any(|argument| argument == "--bench") {
        return;
    }
    for (width, height, focal_px, near_m, disparities) in [(280, 154, 115.9, 0.1, 144), (1280, 720, 530.0, 0.52, 128)] {
        let rig = Rig {
            focal_px,
            baseline_m: 0.12,
            shift_px: 0.0,
        };
        let params = MatcherParams {
            near_m,
            ..MatcherParams::default()
        };
        let (left, right) = (eye(width, height, 0.0), eye(width, height, 0.2));
        let told = |who: &str, [best, cpu]: [f64; 2], rounds: usize| {
            println!(
                "{width}x{height}, {disparities} disparities, {who}: best {:.1} ms a pair, CPU {:.1} ms, {rounds} rounds",
                1000.0 * best,
                1000.0 * cpu
            );
        };
        let mut most = 0;
        for threads in [1, 2] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let work = || pool.install(|| match_pair(&left, &right, &rig, &params)).unwrap();
            std::hint::black_box(work());
            let (mut best, mut rounds) = (f64::INFINITY, 0);
            let (start, cpu) = (Instant::now(), processor_seconds());
            while rounds < 3 || start.elapsed().as_secs_f64() < 2.0 {
                let start = Instant::now();
                std::hint::black_box(work());
                best = best.min(start.elapsed().as_secs_f64());
                rounds += 1;
            }
            let of_cpu = (processor_seconds() - cpu) / rounds as f64;
            told(&format!("rogs, {threads} threads"), [best, of_cpu], rounds);
            most = most.max(rounds);
        }
        if let Some(times) = peer([&left, &right], disparities, most) {
            told("SGBM of OpenCV, eight paths, one thread", times, most);
        }
    }
}
