//! Parts of the Stage-1 network beside PyTorch, float32 and bfloat16 products each, in one run, by CPU time.
//!
//! `ROGS_PEER_PYTHON=python cargo bench -p rogs-stage1 --bench stage1 -- [CONFIGURATION] [whole]`, where that Python has
//! `torch`; without the variable our times are printed alone. Both sides use as many threads as rayon does.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use std::io::Write as _;
use std::process::{Command, Stdio};

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
    let mut own = parts(&network, grid)?;
    if is_whole {
        own.push(("whole lifting", whole(&network)?));
        network.precision = Precision::Bf16;
        own.push(("whole lifting, bf16", whole(&network)?));
    }
    let peer = peer(&config, grid, is_whole)?;
    println!(
        "{name}, {FRAMES} frames of {} x {} pixels, processor seconds",
        SIZE[0], SIZE[1]
    );
    for (part, seconds) in own {
        match peer
            .as_ref()
            .and_then(|peer| peer.get(part))
            .and_then(serde_json::Value::as_f64)
        {
            Some(theirs) => println!(
                "{part:24} {seconds:8.3}  PyTorch {theirs:8.3}  {:.2} x as fast",
                theirs / seconds
            ),
            None => println!("{part:24} {seconds:8.3}"),
        }
    }
    Ok(())
}

/// A frame block, a global block, a dense head on one frame.
fn parts(network: &Stage1, grid: [usize; 2]) -> Result<Vec<(&'static str, f64)>, Box<dyn std::error::Error>> {
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
    let over = |block: &Block, input: &Tensor<3>| best(|| drop(block.forward(input.clone(), Some(&rotary)).to_data()));
    Ok(vec![
        ("frame block", over(&frame, &input)),
        ("frame block, bf16", over(&frame_bf16, &input)),
        ("global block", over(&global, &joined)),
        ("global block, bf16", over(&global_bf16, &joined)),
        (
            "dense head, one frame",
            best(|| drop(head.forward(&projections, &encoded).to_data())),
        ),
    ])
}

/// Image encoder, aggregator, depth and attribute heads, once.
fn whole(network: &Stage1) -> Result<f64, Box<dyn std::error::Error>> {
    let device = Device::flex();
    let pixels = FRAMES * 3 * SIZE[0] * SIZE[1];
    let images: Vec<f32> = (0..pixels).map(|k| ((k * 7919) % 256) as f32 / 255.0).collect();
    let camera = NetworkCamera {
        world_from_camera_iu: Pose::from_translation(DVec3::new(0.1, 0.2, 0.3)),
        focal_centre: [0.7, 1.2, 0.5, 0.5],
    };
    let frames = SourceFrames {
        images: from_host(images, [FRAMES, 3, SIZE[0], SIZE[1]], &device),
        cameras: vec![camera; FRAMES],
        recon_from_base_iu: Pose::IDENTITY,
        times: (0..FRAMES).map(|frame| (frame % 5) as f32 / 4.0).collect(),
        attention: Attention::Joint,
    };
    let heads = [network.head(HeadKind::Depth)?, network.head(HeadKind::Splat)?];
    let start = processor_seconds();
    let encoded = network.encode(&frames)?;
    for head in &heads {
        let projections = head.projections(None);
        for frame in 0..FRAMES {
            let one = encoded.frames_at(frame, 1);
            drop(head.forward(&projections, &one).to_data());
        }
    }
    Ok(processor_seconds() - start)
}

/// The same parts in PyTorch, if there is one.
fn peer(
    config: &Stage1Config,
    grid: [usize; 2],
    whole: bool,
) -> Result<Option<serde_json::Value>, Box<dyn std::error::Error>> {
    let Some(python) = std::env::var_os("ROGS_PEER_PYTHON") else {
        return Ok(None);
    };
    let mut job = serde_json::to_value(config)?;
    let more = serde_json::json!({
        "frames": FRAMES, "grid": grid, "size": SIZE, "threads": rayon::current_num_threads(), "repeats": REPEATS,
        "whole": whole,
    });
    if let (Some(job), Some(more)) = (job.as_object_mut(), more.as_object()) {
        job.extend(more.clone());
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/peers/stage1.py");
    let mut child = Command::new(python)
        .arg(script)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    if let Some(mut stdin) = child.stdin.take() {
        stdin.write_all(job.to_string().as_bytes())?;
    }
    let output = child.wait_with_output()?;
    if !output.status.success() {
        return Err("the PyTorch script failed; its message is above".into());
    }
    Ok(Some(serde_json::from_slice(&output.stdout)?))
}

/// Smallest CPU time of some repeats, after one run that warms up.
fn best(mut work: impl FnMut()) -> f64 {
    work();
    (0..REPEATS)
        .map(|_| {
            let start = processor_seconds();
            work();
            processor_seconds() - start
        })
        .fold(f64::INFINITY, f64::min)
}

/// Processor time of this process so far, from the scheduler's statistics of its threads where the system has them.
fn processor_seconds() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let nanoseconds: u64 = tasks
        .filter_map(|task| std::fs::read_to_string(task.path().join("schedstat")).ok())
        .filter_map(|text| text.split(' ').next()?.parse::<u64>().ok())
        .sum();
    nanoseconds as f64 * 1e-9
}
