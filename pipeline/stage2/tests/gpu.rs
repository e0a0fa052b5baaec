//! The refiner on a GPU against the reference vectors. Mesa's software Vulkan counts as a GPU; without any the tests fail.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![cfg(feature = "gpu")]

#[allow(dead_code)]
mod support;

use burn::tensor::{Device, FloatDType};
use rogs_needs::needs;
use rogs_stage2::error_encoder::ColourLayout;
use rogs_stage2::{Refiner, RefinerConfig, TokenGrid, TokenSet, seeded_parameters};
use rogs_tensors::device;
use support::updates;

fn device() -> Device {
    let device = device::open(rogs_schemas::Device::Gpu).unwrap();
    println!(
        "on {}; bf16 {}",
        rogs_splat::GpuDevice::open().unwrap().name(),
        device.supports_dtype(FloatDType::BF16)
    );
    assert!(!device::is_cpu(&device));
    device
}

#[test]
fn neighbour_attention() {
    let device = device();
    let golden = support::golden("point_transformer");
    updates::neighbour_blocks(&golden, &device);
}

#[needs(shared)]
#[test]
fn released_loops() {
    let device = device();
    for (name, layout, size) in [
        ("update_loop_quarter", ColourLayout::Blocks, (8, 12)),
        ("update_loop_full", ColourLayout::Pixels, (16, 24)),
    ] {
        updates::released_loop(&support::golden(name), layout, size, &device);
    }
}

#[test]
fn adapted_updates() {
    let device = device();
    let golden = support::golden("adapted_two_updates");
    updates::adapted_updates(&golden, &device);
}

/// The refiner as the stage runs it: kernels on the CPU, framework operations on the device.
#[test]
fn refiner_updates_as_on_the_processor() {
    let device = device();
    let config = RefinerConfig::preset("ci").unwrap();
    let grid = TokenGrid::new(vec![0], 12, 20, &config).unwrap();
    let noise = |count: usize, seed: usize| -> Vec<f32> {
        (0..count)
            .map(|k| ((k * 7919 + seed * 104_729) % 1009) as f32 / 504.5 - 1.0)
            .collect()
    };
    let n = grid.len();
    let set = || TokenSet {
        tokens: (0..n as u32).collect(),
        attributes: noise(59 * n, 1),
        positions: noise(3 * n, 2).chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect(),
        feedback: noise(config.features() * n, 3),
    };
    let run = |device: &Device| {
        let mut weights = seeded_parameters(&config, 5, device).unwrap();
        // The last layer is zero at the start.
        let name = "encoder.update_head.6.weight";
        let shape = weights.shape(name).unwrap().to_vec();
        weights
            .insert(
                name,
                &shape,
                noise(shape.iter().product(), 4).iter().map(|v| 0.1 * v).collect(),
            )
            .unwrap();
        let refiner = Refiner::load(&weights, &config).unwrap();
        let mut state = noise(config.state * n, 6);
        let residual = refiner.update(&grid, set(), &mut state).unwrap();
        (residual, state)
    };
    let (found, expected) = (run(&device), run(&Device::flex()));
    assert!(expected.0.iter().any(|value| value.abs() > 1e-3));
    let worst = |a: &[f32], b: &[f32]| a.iter().zip(b).fold(0.0f32, |worst, (a, b)| worst.max((a - b).abs()));
    // As the golden tests of the network allow.
    let close = |found: &[f32], expected: &[f32]| {
        let largest = expected.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
        assert!(
            worst(found, expected) <= 1e-5 * (1.0 + largest),
            "{}",
            worst(found, expected)
        );
    };
    close(&found.0, &expected.0);
    close(&found.1, &expected.1);
    assert!(worst(&found.1, &noise(config.state * n, 6)) > 1e-3, "the state moves");
}
