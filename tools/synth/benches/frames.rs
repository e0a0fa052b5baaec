//! Six-camera frames per second at 154 x 280: `cargo bench -p rogs-synth`.
//!
//! On a machine that does other work too, the rate per second of CPU time says more than the clock.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use std::time::Instant;

use rogs_synth::{SynthConfig, generate_episode};

fn main() -> rogs_synth::Result<()> {
    let config = SynthConfig::default();
    let start = Instant::now();
    let episodes = (1..=4)
        .map(|seed| generate_episode(&config, seed))
        .collect::<rogs_synth::Result<Vec<_>>>()?;
    println!(
        "episode without pictures: {:.1} ms",
        start.elapsed().as_secs_f64() * 1000.0 / 4.0
    );
    let threads = rayon::current_num_threads();
    for round in 0..2 {
        let (start, cpu) = (Instant::now(), cpu_seconds());
        let frames = (0..config.frames as usize).step_by(4).flat_map(|frame| {
            let draw = move |episode: &rogs_synth::Episode| episode.render_frame(frame).views.len() / 6;
            episodes.iter().map(draw).collect::<Vec<_>>()
        });
        let frames = frames.sum::<usize>() as f64;
        let rate = frames / start.elapsed().as_secs_f64();
        println!("round {round}: {rate:.1} six-camera frames/s on {threads} threads");
        if let (Some(before), Some(after)) = (cpu, cpu_seconds()) {
            println!(
                "round {round}: {:.1} six-camera frames per CPU second",
                frames / (after - before).max(0.01)
            );
        }
    }
    Ok(())
}

/// CPU seconds of this process so far, where the system has a `/proc` (ticks of 10 ms).
fn cpu_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let after_name = stat.rsplit_once(')')?.1;
    let ticks: Vec<f64> = after_name
        .split_whitespace()
        .skip(11)
        .take(2)
        .filter_map(|word| word.parse().ok())
        .collect();
    Some(ticks.iter().sum::<f64>() / 100.0)
}
