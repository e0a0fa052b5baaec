//! The networks on a GPU against the reference vectors. Mesa's software Vulkan counts as a GPU; without any the tests fail.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![cfg(feature = "gpu")]

mod support;

use burn::tensor::{Device, FloatDType, Tensor};
use rogs_field::MotionGates;
use rogs_needs::needs;
use rogs_stage1::decode::gate_attributes;
use rogs_stage1::head::FkBranch;
use rogs_tensors::device;
use support::network::{ATTRIBUTES, frames, run};
use support::{Golden, close, host, scaled_tolerance, tiny, worst};

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

/// Every output of the tiny Stage-1 network, at the tolerances of the CPU.
#[needs(shared)]
#[test]
fn stage1_full_forward() {
    let device = device();
    let golden = Golden::open("full_forward");
    let network = tiny(&device);
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
#[needs(shared)]
#[test]
fn stage1_branches() {
    let device = device();
    let flex = Device::flex();
    let forward = Golden::open("full_forward");
    let on_cpu = tiny(&flex);
    let on_device = tiny(&device);
    let encode = |network: &rogs_stage1::Stage1, device: &Device| {
        let mut input = frames(&forward, device);
        input.attention = rogs_stage1::Attention::WithinCamera(vec![0, 0, 1, 1]);
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

    let golden = Golden::open("project_fk_conditioning");
    let branch = FkBranch::load(&golden.parameters("fk_branch", &device).scope("fk_branch"), 32).unwrap();
    let found = host(branch.forward(golden.tensor("kappa", [4, 7, 28, 42], &device)));
    close("branch_out", &found, golden.values("branch_out"), 1e-5);
}
