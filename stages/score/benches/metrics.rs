//! Times PSNR and SSIM per 154x280 pair, beside the Python peers in the same run when `ROGS_PEER_PYTHON` names an
//! interpreter that has numpy, OpenCV and scikit-image.
//!
//! `ROGS_PEER_PYTHON=python cargo bench -p rogs-score --bench metrics`

use std::process::Command;
use std::time::Instant;

use rogs_score::metrics::{Pixels, RgbView, SsimVariant, psnr, ssim};

const PAIRS: usize = 48;
const HEIGHT: usize = 154;
const WIDTH: usize = 280;

const PEERS: &str = r#"
import time, statistics, numpy as np
rng = np.random.default_rng(0)
a = rng.random((48, 154, 280, 3), np.float32)
b = np.clip(a + rng.normal(0, .05, a.shape), 0, 1).astype(np.float32)
def bench(name, f, n, reps):
    f(); ts = []; c = time.process_time()
    for _ in range(reps):
        t = time.perf_counter(); f(); ts.append(time.perf_counter() - t)
    c = (time.process_time() - c) / reps
    print(f"{name}: median {statistics.median(ts) / n * 1e3:.3f} ms a pair, best {min(ts) / n * 1e3:.3f}, CPU {c / n * 1e3:.3f}", flush=True)
bench("PSNR numpy f32", lambda: [10 * np.log10(1 / np.mean((x - y) ** 2)) for x, y in zip(a, b)], 48, 9)
try:
    import cv2; cv2.setNumThreads(2)
    def cvssim(x, y):
        G = lambda z: cv2.GaussianBlur(z, (11, 11), 1.5)
        m, n = G(x), G(y); sx, sy, sxy = G(x * x) - m * m, G(y * y) - n * n, G(x * y) - m * n
        return (((2 * m * n + 1e-4) * (2 * sxy + 9e-4)) / ((m * m + n * n + 1e-4) * (sx + sy + 9e-4))).mean()
    bench("SSIM OpenCV GaussianBlur f32, 2 threads", lambda: [cvssim(x, y) for x, y in zip(a, b)], 48, 7)
except ImportError as e: print("no OpenCV:", e)
try:
    from skimage.metrics import structural_similarity as S
    bench("SSIM scikit-image f32", lambda: [S(x, y, channel_axis=2, data_range=1., gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False) for x, y in zip(a[:12], b[:12])], 12, 5)
except ImportError as e: print("no scikit-image:", e)
"#;

fn main() {
    // `cargo test --benches` passes no `--bench`; there is nothing to check then.
    if !std::env::args().any(|argument| argument == "--bench") {
        return;
    }
    let (a, b) = pairs();
    let views = |index: usize| {
        let range = index * HEIGHT * WIDTH * 3..(index + 1) * HEIGHT * WIDTH * 3;
        let view = |values| RgbView::new(HEIGHT, WIDTH, Pixels::Unit(values)).expect("sizes agree");
        (view(&a[range.clone()]), view(&b[range]))
    };
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("thread pool");
        pool.install(|| {
            time(&format!("PSNR rogs f64, {threads} thread(s)"), |index| {
                let (a, b) = views(index);
                psnr(&a, &b).expect("comparable")
            });
            for variant in [SsimVariant::Skimage, SsimVariant::Torchmetrics] {
                time(
                    &format!("SSIM rogs f64 ({}), {threads} thread(s)", variant.name()),
                    |index| {
                        let (a, b) = views(index);
                        ssim(&a, &b, variant).expect("comparable")
                    },
                );
            }
        });
    }
    match std::env::var_os("ROGS_PEER_PYTHON") {
        None => println!("ROGS_PEER_PYTHON is not set: no peers timed"),
        Some(python) => match Command::new(&python).args(["-c", PEERS]).status() {
            Ok(status) if status.success() => {}
            outcome => println!("the peers did not run: {outcome:?}"),
        },
    }
}

/// Noise and noisier noise, as the peers use it.
fn pairs() -> (Vec<f32>, Vec<f32>) {
    let mut rng = rogs_random::Pcg64::from_seed(0);
    let a: Vec<f32> = (0..PAIRS * HEIGHT * WIDTH * 3)
        .map(|_| rng.next_double() as f32)
        .collect();
    let b = a
        .iter()
        .map(|value| (value + 0.1 * (rng.next_double() as f32 - 0.5)).clamp(0.0, 1.0))
        .collect();
    (a, b)
}

fn time(name: &str, mut metric: impl FnMut(usize) -> f64) {
    let mut seconds = Vec::new();
    let mut sum = 0.0;
    let before = cpu_seconds();
    for _ in 0..10 {
        let start = Instant::now();
        sum += (0..PAIRS).map(&mut metric).sum::<f64>();
        seconds.push(start.elapsed().as_secs_f64() / PAIRS as f64 * 1e3);
    }
    let cpu = cpu_seconds()
        .zip(before)
        .map_or(f64::NAN, |(after, before)| (after - before) / (10 * PAIRS) as f64 * 1e3);
    seconds.remove(0);
    seconds.sort_by(f64::total_cmp);
    let (median, best) = (seconds[4], seconds[0]);
    println!(
        "{name}: median {median:.3} ms a pair, best {best:.3}, CPU {cpu:.3} (mean value {:.4})",
        sum / (10 * PAIRS) as f64
    );
}

/// Processor time of this process in hundredths of a second's resolution, where the system tells it.
fn cpu_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    let fields: Vec<&str> = text.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |index: usize| fields.get(index)?.parse::<f64>().ok();
    Some((ticks(11)? + ticks(12)?) / 100.0)
}
