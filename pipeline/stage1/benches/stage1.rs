//! Parts of the Stage-1 network beside PyTorch, float32 and bfloat16 products each, in turns: wall and processor seconds, the
//! smallest of the repeats.
//!
//! `ROGS_PEER_PYTHON=python cargo bench -p rogs-stage1 --bench stage1 -- [CONFIGURATION] [whole]`, where that Python has
//! `torch`; without the variable our times are printed alone. Both sides use as many threads as rayon does.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

#[path = "../../../tests/support/bench.rs"]
mod bench;

use bench::{Peer, processor, timed};
use burn::tensor::{Device, Tensor};
use glam::DVec3;
use rogs_geometry::Pose;
use rogs_kernels::RotaryTable;
use rogs_stage1::{Attention, Encoded, HeadKind, NetworkCamera, Precision, SourceFrames, Stage1, Stage1Config, seeded};
use rogs_tensors::ops::Rotary;
use rogs_tensors::parameters::from_host;
use rogs_vit::{Block, BlockKind};

const FRAMES: usize = 15;
const SIZE: [usize; 2] = [154, 280];
const REPEATS: usize = 3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args()
        .skip(1)
        .filter(|text| !text.starts_with("--"))
        .collect();
    let name = arguments.first().map_or("compact", String::as_str);
    let is_whole = arguments.iter().any(|text| text == "whole");
    let mut config = Stage1Config::by_name(name)?;
    if !is_whole {
        // One block of each kind is timed; the others would only be weights.
        (config.encoder_blocks, config.pairs, config.taps) = (1, 4, [0, 1, 2, 3]);
    }
    let mut network = seeded::network(&config, 1, &Device::flex())?;
    let grid = config.grid(SIZE[0], SIZE[1])?;
    println!("{}, {} threads", processor(), rayon::current_num_threads());
    println!("{name}, {FRAMES} frames of {} x {} pixels", SIZE[0], SIZE[1]);
    let mut peer = Peer::start("stage1.py", &job(&config, grid)?);
    println!(
        "{:24} {:>8} {:>8}    PyTorch {:>8} {:>8}    times as fast",
        "", "wall, s", "CPU, s", "wall, s", "CPU, s"
    );
    let parts = parts(&network, grid)?;
    for (part, work) in &parts {
        beside(part, REPEATS, work, &mut peer);
    }
    drop(parts);
    if is_whole {
        for (part, precision) in [
            ("whole lifting", Precision::F32),
            ("whole lifting, bf16", Precision::Bf16),
        ] {
            network.precision = precision;
            let frames = whole_frames();
            beside(part, 1, &|| whole(&network, &frames).unwrap(), &mut peer);
        }
    }
    Ok(())
}

/// Least seconds of ours and of the peer's, one run of each in turn after one that warms up.
fn beside(part: &str, repeats: usize, work: &dyn Fn(), peer: &mut Option<Peer>) {
    let least = |least: [f64; 2], seconds: [f64; 2]| [0, 1].map(|side| f64::min(least[side], seconds[side]));
    let (mut own, mut theirs) = ([f64::INFINITY; 2], [f64::INFINITY; 2]);
    for repeat in 0..=repeats {
        let ((), seconds) = timed(work);
        let answer = peer.as_mut().and_then(|peer| peer.turn(part));
        let answer = answer.and_then(|line| serde_json::from_str(&line).ok());
        // What runs once only is not warmed up.
        if repeat > 0 || repeats == 1 {
            own = least(own, seconds);
            theirs = answer.map_or(theirs, |seconds| least(theirs, seconds));
        }
        if repeats == 1 {
            break;
        }
    }
    print!("{part:24} {:8.3} {:8.3}", own[0], own[1]);
    if theirs[0].is_finite() {
        let ratio = [0, 1].map(|side| theirs[side] / own[side]);
        print!(
            "            {:8.3} {:8.3}    {:.2} {:.2}",
            theirs[0], theirs[1], ratio[0], ratio[1]
        );
    }
    println!();
}

/// A piece of work by the name that the peer knows.
type Part<'a> = (&'static str, Box<dyn Fn() + 'a>);

/// A frame block, a global block, a dense head on one frame.
fn parts(network: &Stage1, grid: [usize; 2]) -> Result<Vec<Part<'_>>, Box<dyn std::error::Error>> {
    let (config, device) = (&network.config, Device::flex());
    let special = config.patch_start();
    let patch = (0..grid[0] * grid[1]).map(|token| [token / grid[1] + 1, token % grid[1] + 1]);
    let positions: Vec<[usize; 2]> = std::iter::repeat_n([0, 0], special).chain(patch).collect();
    let tokens = positions.len();
    let rotary = Rotary::new(RotaryTable::new(&positions, config.head_size()), &device);
    let block = |name: &str, precision: Precision| {
        let scope = network.parameters.scope(&format!("backbone.backbone.{name}_blocks.0"));
        Block::load(
            &scope,
            BlockKind::AGGREGATOR.with(precision),
            config.width,
            config.heads,
        )
    };
    let (frame, global) = (block("frame", Precision::F32)?, block("global", Precision::F32)?);
    let (frame_bf16, global_bf16) = (block("frame", Precision::Bf16)?, block("global", Precision::Bf16)?);
    let noise = |count: usize| {
        (0..count)
            .map(|k| ((k * 7919) % 1009) as f32 / 504.5 - 1.0)
            .collect::<Vec<f32>>()
    };
    let input: Tensor<3> = from_host(
        noise(FRAMES * tokens * config.width),
        [FRAMES, tokens, config.width],
        &device,
    );
    let joined = input.clone().reshape([1, FRAMES * tokens, config.width]);
    let patches = grid[0] * grid[1];
    let tap = || {
        from_host::<3>(
            noise(patches * 2 * config.width),
            [1, patches, 2 * config.width],
            &device,
        )
    };
    let encoded = Encoded {
        taps: [tap(), tap(), tap(), tap()],
        local: None,
        grid,
        size: SIZE,
    };
    let head = network.head(HeadKind::Depth)?;
    let projections = head.projections(None);
    let over = |block: Block, input: &Tensor<3>| -> Box<dyn Fn()> {
        let (input, rotary) = (input.clone(), rotary.clone());
        Box::new(move || drop(block.forward(input.clone(), Some(&rotary)).to_data()))
    };
    Ok(vec![
        ("frame block", over(frame, &input)),
        ("frame block, bf16", over(frame_bf16, &input)),
        ("global block", over(global, &joined)),
        ("global block, bf16", over(global_bf16, &joined)),
        (
            "dense head, one frame",
            Box::new(move || drop(head.forward(&projections, &encoded).to_data())),
        ),
    ])
}

/// Noise that a whole lifting sees.
fn whole_frames() -> SourceFrames {
    let pixels = FRAMES * 3 * SIZE[0] * SIZE[1];
    let images: Vec<f32> = (0..pixels).map(|k| ((k * 7919) % 256) as f32 / 255.0).collect();
    let camera = NetworkCamera {
        world_from_camera_iu: Pose::from_translation(DVec3::new(0.1, 0.2, 0.3)),
        focal_centre: [0.7, 1.2, 0.5, 0.5],
    };
    SourceFrames {
        images: from_host(images, [FRAMES, 3, SIZE[0], SIZE[1]], &Device::flex()),
        cameras: vec![camera; FRAMES],
        recon_from_base_iu: Pose::IDENTITY,
        times: (0..FRAMES).map(|frame| (frame % 5) as f32 / 4.0).collect(),
        attention: Attention::Joint,
    }
}

/// Image encoder, aggregator, depth and attribute heads, once.
fn whole(network: &Stage1, frames: &SourceFrames) -> Result<(), Box<dyn std::error::Error>> {
    let encoded = network.encode(frames)?;
    for head in [network.head(HeadKind::Depth)?, network.head(HeadKind::Splat)?] {
        let projections = head.projections(None);
        for frame in 0..FRAMES {
            let one = encoded.frames_at(frame, 1);
            drop(head.forward(&projections, &one).to_data());
        }
    }
    Ok(())
}

/// What the peer is told.
fn job(config: &Stage1Config, grid: [usize; 2]) -> Result<String, Box<dyn std::error::Error>> {
    let mut job = serde_json::to_value(config)?;
    let more = serde_json::json!({
        "frames": FRAMES, "grid": grid, "size": SIZE, "threads": rayon::current_num_threads(),
    });
    if let (Some(job), Some(more)) = (job.as_object_mut(), more.as_object()) {
        job.extend(more.clone());
    }
    Ok(job.to_string())
}
