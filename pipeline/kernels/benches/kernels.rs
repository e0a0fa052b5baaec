//! Kernels beside the crate `gemm`, on one thread, in one run: medians of processor time, one call of ours
//! and one of theirs in turn.
//!
//! `cargo bench -p rogs-kernels --bench kernels`
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

#[path = "../../../tests/support/bench.rs"]
mod bench;

use std::hint::black_box;

use bench::{processor, processor_seconds};
use gemm::Parallelism;
use rogs_kernels::{
    Conv3x3, Maps, Matrix, PackedAttention, PackedWeight, Precision, TileSize, Winograd, weight_gradient,
};

const REPEATS: usize = 31;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("{}, one thread, processor time", processor());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| {
        products();
        gradients();
        convolutions();
        others();
    });
    Ok(())
}

fn noise(count: usize, seed: usize) -> Vec<f32> {
    (0..count)
        .map(|k| ((k * 7919 + seed * 104_729) % 10_009) as f32 / 5004.5 - 1.0)
        .collect()
}

/// x W^T with weights as PyTorch stores them, packed before.
fn products() {
    for [rows, inputs, outputs] in [[3375, 384, 1152], [225, 768, 3072], [256, 59, 64], [1, 256, 1024]] {
        let (x, weight) = (noise(rows * inputs, 1), noise(outputs * inputs, 2));
        let packed = PackedWeight::new(&weight, inputs, Precision::F32);
        let mut result = vec![0.0; rows * outputs];
        let sizes = [rows, outputs, inputs];
        beside(
            &format!("product {rows} x {inputs} x {outputs}"),
            || packed.rows(&x, &mut result, outputs, |_, _, _| {}),
            || by_peer(sizes, (&x, [inputs, 1]), (&weight, [1, inputs])),
        );
    }
}

/// The gradient of the weights of a linear layer: both operands turned round, and packed on the way.
fn gradients() {
    for [rows, inputs, outputs] in [[3375, 384, 1152], [2048, 256, 64]] {
        let (x, slopes) = (noise(rows * inputs, 1), noise(rows * outputs, 2));
        let turned = Matrix::new(&slopes, outputs).transposed();
        beside(
            &format!("gradient {outputs} x {rows} x {inputs}"),
            || {
                let packed = PackedWeight::of(Matrix::new(&x, inputs).transposed(), Precision::F32);
                black_box(packed.apply_to(turned, |_, _, _| {}));
            },
            || by_peer([outputs, inputs, rows], (&slopes, [1, outputs]), (&x, [inputs, 1])),
        );
    }
}

/// 3x3 convolutions of the compact network in training: 6 images, forward and the gradient of the weights.
fn convolutions() {
    for (inputs, outputs, height, width) in [
        (16, 16, 84, 154),
        (32, 32, 48, 88),
        (32, 32, 24, 44),
        (64, 64, 21, 39),
        (236, 64, 21, 39),
    ] {
        let area = height * width;
        let (map, weight) = (noise(6 * inputs * area, 1), noise(outputs * inputs * 9, 2));
        let (slopes, products) = (noise(6 * outputs * area, 3), (6 * outputs * inputs * 9 * area) as f64);
        let conv = Conv3x3::new(&weight, &[], outputs, inputs, Precision::F32);
        let name = |what: &str| format!("{what} 6 x {inputs} -> {outputs} [{height}, {width}]");
        rate(&name("convolution"), products, || {
            black_box(conv.run(&map, [height, width], true, None));
        });
        let maps = Maps {
            inputs,
            outputs,
            height,
            width,
            rectify: true,
            products: Precision::F32,
        };
        rate(&name("weight gradient"), products, || {
            black_box(weight_gradient(&slopes, &map, maps));
        });
    }
}

/// Kernels that have no peer.
fn others() {
    let (tokens, heads, size) = (3375, 6, 64);
    let (packed, bias) = (noise(tokens * 3 * heads * size, 1), vec![0.0; 3 * heads * size]);
    alone("attention 3375 x 6 x 64", || {
        let attention = PackedAttention {
            packed: &packed,
            bias: &bias,
            tokens,
            heads,
            size,
            norms: None,
            rotary: None,
            precision: Precision::F32,
        };
        black_box(attention.run());
    });
    for (channels, size) in [(64, [154, 280]), (256, [38, 70])] {
        let (map, weight) = (
            noise(channels * size[0] * size[1], 1),
            noise(channels * channels * 9, 2),
        );
        let mut out = vec![0.0; map.len()];
        for tiles in [TileSize::Two, TileSize::Four] {
            let conv = Winograd::new(&weight, &noise(channels, 3), channels, channels, tiles);
            alone(&format!("Winograd {tiles:?} {channels} channels {size:?}"), || {
                conv.rectified(&map, size, &mut out);
            });
        }
    }
}

/// `lhs [m, k] rhs [k, n]` by the crate, operands with the distances of their rows and columns.
// The crate takes pointers.
#[allow(unsafe_code)]
fn by_peer([m, n, k]: [usize; 3], lhs: (&[f32], [usize; 2]), rhs: (&[f32], [usize; 2])) {
    let mut out = vec![0.0f32; m * n];
    for ((values, strides), [rows, columns]) in [(lhs, [m, k]), (rhs, [k, n])] {
        assert!((rows - 1) * strides[0] + (columns - 1) * strides[1] < values.len());
    }
    let [(lhs, lhs_strides), (rhs, rhs_strides)] = [lhs, rhs];
    // SAFETY: the last number of each operand lies in its slice (asserted above), and `out` is `[m, n]` and borrowed by
    // nobody else.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            out.as_mut_ptr(),
            1,
            n as isize,
            false,
            lhs.as_ptr(),
            lhs_strides[1] as isize,
            lhs_strides[0] as isize,
            rhs.as_ptr(),
            rhs_strides[1] as isize,
            rhs_strides[0] as isize,
            0.0f32,
            1.0f32,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
    black_box(out);
}

fn beside(name: &str, mut ours: impl FnMut(), mut theirs: impl FnMut()) {
    let pairs: Vec<[f64; 2]> = (0..REPEATS)
        .map(|_| [seconds(&mut ours), seconds(&mut theirs)])
        .collect();
    let [own, peer] = [0, 1].map(|side| median(pairs.iter().map(|pair| pair[side]).collect()));
    println!(
        "{name:44} {:9.3} ms  gemm {:9.3} ms  {:.2} x as fast",
        own * 1e3,
        peer * 1e3,
        peer / own
    );
}

/// Time, and how many products a second that is.
fn rate(name: &str, products: f64, mut work: impl FnMut()) {
    let own = median((0..REPEATS).map(|_| seconds(&mut work)).collect());
    println!("{name:44} {:9.3} ms  {:.1} Gflop/s", own * 1e3, 2e-9 * products / own);
}

fn alone(name: &str, mut work: impl FnMut()) {
    let own = median((0..REPEATS).map(|_| seconds(&mut work)).collect());
    println!("{name:44} {:9.3} ms", own * 1e3);
}

fn seconds(work: &mut impl FnMut()) -> f64 {
    let start = processor_seconds();
    work();
    processor_seconds() - start
}

fn median(mut seconds: Vec<f64>) -> f64 {
    seconds.sort_by(f64::total_cmp);
    seconds[seconds.len() / 2]
}
