//! The network gives the same bits whatever vectors the processor has: this test runs itself once more on an emulated
//! processor that has AVX2 and no AVX-512.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)]

mod support;

use std::process::Command;

use burn::tensor::Device;
use rogs_geometry::Pose;
use rogs_needs::needs;
use rogs_stage1::{Attention, HeadKind, NetworkCamera, SourceFrames, Stage1Config, seeded};
use rogs_tensors::parameters::from_host;
use support::{host, tiny_config};

/// What a line of the child begins with.
const MARK: &str = "digest of the network: ";

/// A digest of what every head says of four frames of noise, by a transformer and by a convolutional stem with its sweep.
fn digest() -> String {
    let device = Device::flex();
    let compact = Stage1Config {
        stem_channels: [8, 72, 72, 16],
        sweep_depths: 8,
        ..tiny_config()
    };
    let mut digest = 0xcbf2_9ce4_8422_2325_u64;
    for config in [tiny_config(), compact] {
        let network = seeded::network(&config, 3, &device).unwrap();
        let (frames, height, width) = (4, 42, 70);
        let noise = (0..frames * 3 * height * width).map(|k| ((k * 7919 + 13) % 1009) as f32 / 1009.0);
        let camera = |index: usize| NetworkCamera {
            world_from_camera_iu: Pose::from_xyz_euler([0.4 * (index / 2) as f64, 0.0, 0.0], [0.0; 3]),
            focal_centre: [60.0, 60.0, 35.0, 21.0],
        };
        let input = SourceFrames {
            images: from_host(noise.collect(), [frames, 3, height, width], &device),
            cameras: (0..frames).map(camera).collect(),
            recon_from_base_iu: Pose::IDENTITY,
            times: vec![0.0, 1.0, 0.0, 1.0],
            attention: Attention::Joint,
        };
        let encoded = network.encode(&input).unwrap();
        for kind in [
            HeadKind::Depth,
            HeadKind::Splat,
            HeadKind::Motion,
            HeadKind::MotionSplat,
        ] {
            let head = network.head(kind).unwrap();
            let projections = head.projections(kind.timed().then_some(0.4));
            for value in host(head.forward(&projections, &encoded)) {
                assert!(value.is_finite());
                digest = (digest ^ u64::from(value.to_bits())).wrapping_mul(0x0100_0000_01b3);
            }
        }
    }
    format!("{digest:016x}")
}

#[needs(qemu)]
#[test]
fn processors_without_avx512_give_the_same_bits() {
    let own = digest();
    println!("{MARK}{own}");
    if std::env::var_os("ROGS_EMULATED").is_some() {
        return;
    }
    let child = Command::new("qemu-x86_64-static")
        .args(["-cpu", "Haswell"])
        .arg(std::env::current_exe().unwrap())
        .args(["--exact", "processors_without_avx512_give_the_same_bits", "--nocapture"])
        .env("ROGS_EMULATED", "1")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&child.stdout);
    let theirs = said.lines().find_map(|line| line.split_once(MARK)).expect("a digest").1;
    assert_eq!(theirs, own, "a processor with AVX2 alone gives other bits");
}
