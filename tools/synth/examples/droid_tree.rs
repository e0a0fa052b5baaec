//! A raw-DROID tree of six procedural episodes, with its robot and published calibrations; needs ffmpeg with x264.
//! `cargo run -p rogs-synth --example droid_tree DIR [SEED [FRAMES]]`
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use rogs_synth::{droid_config, droid_robot, write_droid};

/// Height and width of one eye's images.
const SIZE: [u32; 2] = [180, 320];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or("which folder shall be filled?")?;
    let seed: u64 = arguments.next().map_or(Ok(0), |text| text.parse())?;
    let frames: u32 = arguments.next().map_or(Ok(33), |text| text.parse())?;
    let folder = std::path::Path::new(&folder);
    for episode in write_droid(folder, seed, &droid_config(frames, SIZE))? {
        println!("{} ({:?}): {}", episode.uuid, episode.peculiar, episode.place.display());
    }
    println!("robot: {}", droid_robot(folder).display());
    Ok(())
}
