//! Seconds of a pair at 154x280 (a clip's images, 144 disparities) and at 1280x720 (128 disparities), by wall clock and by
//! CPU time: `cargo bench -p rogs-stereo`. Goals on two cores: well under 50 ms and under 1.5 s.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use std::time::Instant;

use rayon::ThreadPoolBuilder;
use rogs_stereo::{Grey, MatcherParams, Rig, match_pair};

/// Seconds of CPU time of this process; `None` where `/proc` does not tell.
fn cpu_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    let after_name = text.rsplit(')').next()?;
    let mut fields = after_name.split_whitespace().skip(11);
    let ticks: f64 = fields.next()?.parse::<f64>().ok()? + fields.next()?.parse::<f64>().ok()?;
    Some(ticks / 100.0)
}

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

fn main() {
    for (width, height, focal_px, near_m) in [(280, 154, 115.9, 0.1), (1280, 720, 530.0, 0.52)] {
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
        for threads in [1, 2] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let (mut best, mut rounds) = (f64::INFINITY, 0);
            let (start, cpu) = (Instant::now(), cpu_seconds());
            while rounds < 3 || start.elapsed().as_secs_f64() < 2.0 {
                let start = Instant::now();
                let found = pool.install(|| match_pair(&left, &right, &rig, &params)).unwrap();
                best = best.min(start.elapsed().as_secs_f64());
                rounds += 1;
                std::hint::black_box(found);
            }
            let of_cpu = cpu
                .zip(cpu_seconds())
                .map_or(f64::NAN, |(before, after)| (after - before) / f64::from(rounds));
            println!(
                "{width}x{height}, {threads} threads: best {:.1} ms a pair, CPU {:.1} ms, {rounds} rounds",
                1000.0 * best,
                1000.0 * of_cpu
            );
        }
    }
}
