//! Times the parts of the Stage-1 network on random frames: `cargo run --release -p rogs-stage1 --example stage1_time`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
use burn::tensor::{Device, Tensor};
use glam::DVec3;
use rogs_geometry::Pose;
use rogs_stage1::{Attention, HeadKind, NetworkCamera, SourceFrames, Stage1Config, seeded};
use rogs_tensors::parameters::{from_host, to_host};
use std::time::Instant;

fn main() {
    let device = Device::flex();
    let name = std::env::args().nth(1).unwrap_or_else(|| "compact".into());
    let config = Stage1Config::by_name(&name).unwrap();
    let start = Instant::now();
    let network = seeded::network(&config, 1, &device).unwrap();
    println!("weights {:?}", start.elapsed());
    let (frames, height, width) = (15usize, 154usize, 280usize);
    let images: Vec<f32> = (0..frames * 3 * height * width)
        .map(|k| ((k * 7919) % 256) as f32 / 255.0)
        .collect();
    let images: Tensor<4> = from_host(images, [frames, 3, height, width], &device);
    let camera = NetworkCamera {
        world_from_camera_iu: Pose::from_translation(DVec3::new(0.1, 0.2, 0.3)),
        focal_centre: [0.7, 1.2, 0.5, 0.5],
    };
    let input = SourceFrames {
        images: images.clone(),
        cameras: vec![camera; frames],
        recon_from_base_iu: Pose::IDENTITY,
        times: (0..frames).map(|f| (f % 5) as f32 / 4.0).collect(),
        attention: Attention::Joint,
    };
    let start = Instant::now();
    let tokens = network.encoder().forward(images.clone()).unwrap();
    println!("encoder {:?}", start.elapsed());
    let start = Instant::now();
    let encoded = network.encode_tokens(&input, tokens).unwrap();
    println!("aggregator {:?}", start.elapsed());
    let mut sum = 0.0f64;
    for kind in HeadKind::ALL {
        let head = network.head(kind).unwrap();
        let start = Instant::now();
        let projections = head.projections(kind.timed().then_some(0.3));
        for frame in 0..frames {
            let one = encoded.frames_at(frame, 1);
            let output = head.forward(&projections, &one);
            sum += to_host(output).unwrap().iter().map(|&v| f64::from(v)).sum::<f64>();
        }
        println!("{} {:?}", kind.name(), start.elapsed());
    }
    println!("checksum {sum:.17e}");
}
