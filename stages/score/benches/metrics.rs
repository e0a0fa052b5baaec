//! Times PSNR, SSIM and LPIPS per 154x280 pair, beside the Python peers in the same run when `ROGS_PEER_PYTHON` names an
//! interpreter that has numpy, OpenCV, scikit-image, torch and lpips. LPIPS runs on random weights of VGG16's size.
//!
//! `ROGS_PEER_PYTHON=python cargo bench -p rogs-score --bench metrics`
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use std::collections::BTreeMap;
use std::process::Command;
use std::time::Instant;

use rogs_lpips::{Lpips, LpipsFeatures, LpipsWeights};
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
try:
    import torch, lpips, warnings; warnings.simplefilter("ignore")
    net = lpips.LPIPS(net="vgg", pnet_rand=True, verbose=False).eval()
    def t(x): return torch.from_numpy(x).permute(2, 0, 1)[None] * 2 - 1
    def run(k):
        with torch.no_grad():
            for x, y in zip(a[:k], b[:k]): net(t(x), t(y))
    for threads in (1, 2):
        torch.set_num_threads(threads)
        bench(f"LPIPS lpips + torch, {threads} thread(s)", lambda: run(2), 2, 9)
except ImportError as e: print("no lpips:", e)
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
    let network = random_vgg();
    let other = |index: usize| &b[index * HEIGHT * WIDTH * 3..(index + 1) * HEIGHT * WIDTH * 3];
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("thread pool");
        pool.install(|| {
            let of = |rgb: &[f32]| network.features(rgb, HEIGHT, WIDTH).expect("sizes agree");
            let image = |index: usize| &a[index * HEIGHT * WIDTH * 3..(index + 1) * HEIGHT * WIDTH * 3];
            let distance = |rgb: &[f32], kept: &LpipsFeatures| {
                network.distance_from(rgb, HEIGHT, WIDTH, kept).expect("sizes agree")
            };
            let name = |what: &str| format!("LPIPS rogs f32, {what}, {threads} thread(s)");
            time_some(&name("both images"), 2, |index| {
                let reference = of(other(index));
                distance(image(index), &reference)
            });
            let references: Vec<_> = (0..2).map(|index| of(other(index))).collect();
            time_some(&name("reference kept"), 2, |index| {
                distance(image(index), &references[index])
            });
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

/// LPIPS with random weights of VGG16's widths.
fn random_vgg() -> Lpips {
    let mut rng = rogs_random::Pcg64::from_seed(1);
    let mut values = |count: usize, scale: f64| -> Vec<f32> {
        (0..count).map(|_| (scale * (rng.next_double() - 0.5)) as f32).collect()
    };
    let widths = [64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512];
    let places = [0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28];
    let mut tensors = BTreeMap::new();
    let mut inputs = 3;
    for (place, width) in places.into_iter().zip(widths) {
        let scale = (24.0 / (9 * inputs) as f64).sqrt();
        let weight = values(width * inputs * 9, scale);
        tensors.insert(format!("features.{place}.weight"), (vec![width, inputs, 3, 3], weight));
        tensors.insert(format!("features.{place}.bias"), (vec![width], vec![0.0; width]));
        inputs = width;
    }
    for (layer, width) in [64, 128, 256, 512, 512].into_iter().enumerate() {
        let head: Vec<f32> = values(width, 1.0).into_iter().map(f32::abs).collect();
        tensors.insert(format!("lin{layer}.model.1.weight"), (vec![1, width, 1, 1], head));
    }
    let lookup = |name: &str| Ok(tensors.get(name).cloned());
    Lpips::new(LpipsWeights::from_lookup("random".to_owned(), lookup).expect("complete"))
}

fn time(name: &str, metric: impl FnMut(usize) -> f64) {
    time_some(name, PAIRS, metric);
}

fn time_some(name: &str, pairs: usize, mut metric: impl FnMut(usize) -> f64) {
    let mut seconds = Vec::new();
    let mut sum = 0.0;
    let before = cpu_seconds();
    for _ in 0..10 {
        let start = Instant::now();
        sum += (0..pairs).map(&mut metric).sum::<f64>();
        seconds.push(start.elapsed().as_secs_f64() / pairs as f64 * 1e3);
    }
    let cpu = cpu_seconds()
        .zip(before)
        .map_or(f64::NAN, |(after, before)| (after - before) / (10 * pairs) as f64 * 1e3);
    seconds.remove(0);
    seconds.sort_by(f64::total_cmp);
    let (median, best) = (seconds[4], seconds[0]);
    println!(
        "{name}: median {median:.3} ms a pair, best {best:.3}, CPU {cpu:.3} (mean value {:.4})",
        sum / (10 * pairs) as f64
    );
}

/// Processor time of this process in hundredths of a second's resolution, where the system tells it.
fn cpu_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    let fields: Vec<&str> = text.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |index: usize| fields.get(index)?.parse::<f64>().ok();
    Some((ticks(11)? + ticks(12)?) / 100.0)
}
