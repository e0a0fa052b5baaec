//! Renders the synthetic room of the benchmark from its third camera: `cargo run -p rogs-splat --example room -- FOLDER`
//! writes `room.ppm` (colour), `depth.pgm` (expected depth, near is dark) and `alpha.pgm`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of examples may be left half-written")]

use std::path::PathBuf;

use rogs_splat::{RasterConfig, render};

#[path = "../tests/common/room.rs"]
mod room;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).ok_or("give the folder to write to")?);
    let scene = room::scene(3, 5, 280, 154);
    let camera = room::camera_from([0.75, 0.55, 0.75], 640, 352);
    let image = render(
        &scene,
        &camera,
        &RasterConfig {
            background: [0.0, 0.0, 0.2],
            ..RasterConfig::default()
        },
    )?;
    println!("{:?}", image.counts);
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    let write = |name: &str, kind: &str, values: Vec<u8>| {
        let header = format!("{kind}\n{} {}\n255\n", image.width, image.height);
        std::fs::write(folder.join(name), [header.into_bytes(), values].concat())
    };
    write("room.ppm", "P6", image.rgb.iter().map(|&v| byte(v)).collect())?;
    let farthest = image.depth_expected.iter().copied().fold(0.0, f32::max);
    write(
        "depth.pgm",
        "P5",
        image.depth_expected.iter().map(|&d| byte(d / farthest)).collect(),
    )?;
    write("alpha.pgm", "P5", image.alpha.iter().map(|&a| byte(a)).collect())?;
    Ok(())
}
