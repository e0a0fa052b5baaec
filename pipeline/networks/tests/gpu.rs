//! The networks on a graphics processor against the reference vectors. Mesa's software Vulkan counts as a device; without
//! any the tests print why they are skipped.
#![cfg(feature = "gpu")]

#[allow(dead_code)]
mod stage2_support;
mod support;

use burn::tensor::{Device, FloatDType, Tensor};
use rogs_networks::device;
use rogs_networks::stage1::decode::{MotionGates, gate_attributes};
use rogs_networks::stage1::head::FkBranch;
use rogs_networks::stage2::error_encoder::ColourLayout;
use rogs_networks::stage2::{Refiner, RefinerConfig, TokenGrid, TokenSet, seeded_parameters};
use stage2_support::updates;
use support::network::{ATTRIBUTES, frames, run};
use support::{Golden, close, host, scaled_tolerance, tiny, worst};

/// The device, unless there is none.
fn device() -> Option<Device> {
    match device::open("gpu") {
        Ok(device) => {
            println!(
                "on {}; bf16 {}",
                rogs_splat::GpuDevice::open().unwrap().name(),
                device.supports_dtype(FloatDType::BF16)
            );
            assert!(!device::is_cpu(&device));
            Some(device)
        }
        Err(error) => {
            println!("skipped: {error}");
            None
        }
    }
}

/// Every output of the tiny Stage-1 network, at the tolerances of the processor.
#[test]
fn stage1_full_forward() {
    let Some(device) = device() else { return };
    let (Some(golden), Some(network)) = (Golden::open("full_forward"), tiny(&device)) else {
        return;
    };
    let check =
        |name: &str, found: &[f32]| close(name, found, golden.values(name), scaled_tolerance(golden.values(name)));
    let input = frames(&golden, &device);
    check(
        "mid.dino.x_norm_patchtokens",
        &host(network.encoder().forward(input.images.clone()).unwrap()),
    );
    let encoded = network.encode(&input).unwrap();
    let outputs = run(
        &network,
        &encoded,
        input.images.clone(),
        golden.values("in.output_timesteps"),
    );
    check("out.depth", &host(outputs.depth.clone().narrow(1, 0, 1)));
    check("out.depth_conf", &host(outputs.depth.narrow(1, 1, 1)));
    let confident = |name: &str, mut values: Vec<f32>| {
        if name == "conf" {
            values.iter_mut().for_each(|value| *value = 1.0 + value.exp());
        }
        values
    };
    for (name, first, count) in ATTRIBUTES {
        let found = host(outputs.base.clone().narrow(1, first, count));
        check(&format!("out.{name}"), &confident(name, found));
    }
    let reference = golden.tensor::<5>("out.motion", [3, 4, 4, 28, 42], &device);
    let displacement = host(Tensor::stack::<5>(outputs.motion, 0).narrow(2, 0, 3));
    close(
        "out.motion",
        &displacement,
        &host(reference.clone().narrow(2, 0, 3)),
        1e-7,
    );
    for (query, timed) in outputs.timed.iter().enumerate() {
        // The reference's displacement, so that the same pixels pass the gate.
        let motion = reference.clone().narrow(0, query, 1).squeeze_dim::<4>(0);
        let gated = gate_attributes(
            motion.narrow(1, 0, 3),
            outputs.base.clone(),
            timed.clone(),
            MotionGates::default(),
        );
        for (name, first, count) in ATTRIBUTES {
            let found = host(gated.clone().narrow(1, first, count));
            check(&format!("out.motion_{name}.t{query}"), &confident(name, found));
        }
    }
}

/// The FK branch, and attention within cameras, which cuts the global blocks into groups.
#[test]
fn stage1_branches() {
    let Some(device) = device() else { return };
    let flex = Device::flex();
    let (Some(forward), Some(on_cpu), Some(on_device)) = (Golden::open("full_forward"), tiny(&flex), tiny(&device))
    else {
        return;
    };
    let encode = |network: &rogs_networks::stage1::Stage1, device: &Device| {
        let mut input = frames(&forward, device);
        input.attention = rogs_networks::stage1::Attention::WithinCamera(vec![0, 0, 1, 1]);
        network.encode(&input).unwrap().taps.map(host)
    };
    let (found, expected) = (encode(&on_device, &device), encode(&on_cpu, &flex));
    for (level, (found, expected)) in found.iter().zip(&expected).enumerate() {
        close(
            &format!("tap{level} within cameras"),
            found,
            expected,
            2.0 * scaled_tolerance(expected),
        );
    }

    let Some(golden) = Golden::open("project_fk_conditioning") else {
        return;
    };
    let branch = FkBranch::load(&golden.parameters("fk_branch", &device).scope("fk_branch"), 32).unwrap();
    let found = host(branch.forward(golden.tensor("kappa", [4, 7, 28, 42], &device)));
    close("branch_out", &found, golden.values("branch_out"), 1e-5);
}

#[test]
fn stage2_neighbour_attention() {
    let (Some(device), Some(golden)) = (device(), stage2_support::golden("point_transformer")) else {
        return;
    };
    updates::neighbour_blocks(&golden, &device);
}

#[test]
fn stage2_released_loops() {
    let Some(device) = device() else { return };
    for (name, layout, size) in [
        ("update_loop_quarter", ColourLayout::Blocks, (8, 12)),
        ("update_loop_full", ColourLayout::Pixels, (16, 24)),
    ] {
        if let Some(golden) = stage2_support::golden(name) {
            updates::released_loop(&golden, layout, size, &device);
        }
    }
}

#[test]
fn stage2_adapted_updates() {
    let (Some(device), Some(golden)) = (device(), stage2_support::golden("adapted_two_updates")) else {
        return;
    };
    updates::adapted_updates(&golden, &device);
}

/// The refiner as the stage runs it: kernels on the processor, framework operations on the device.
#[test]
fn stage2_refiner_updates_as_on_the_processor() {
    let Some(device) = device() else { return };
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
    close("residual", &found.0, &expected.0, scaled_tolerance(&expected.0));
    close("state", &found.1, &expected.1, scaled_tolerance(&expected.1));
    assert!(worst(&found.1, &noise(config.state * n, 6)) > 1e-3, "the state moves");
}
