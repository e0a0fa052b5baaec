//! `rogs-synth`: writes a dataset of procedural episodes.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "the program's own file is the one place that prints")]

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, ValueEnum};
use rogs_synth::{Resolution, SynthConfig, write_dataset_with};

/// Writes procedural robot episodes with exact depth, tracks and calibration.
#[derive(Parser)]
#[command(name = "rogs-synth", version)]
struct Arguments {
    /// Folder of the dataset; episodes that are in it already are kept
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Number of episodes
    #[arg(long, default_value_t = 4)]
    episodes: u32,
    /// Seed of the first episode; the others follow
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Frames of an episode
    #[arg(long, default_value_t = 33)]
    frames: u32,
    /// Image sizes
    #[arg(long, value_enum, default_value_t = Size::Evaluation)]
    resolution: Size,
    /// Errors of the recorded extrinsics: standard deviations in metres and radians
    #[arg(long, value_names = ["M", "RAD"], num_args = 2)]
    calibration_noise: Option<Vec<f64>>,
    /// Print the summary as JSON on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Size {
    /// 154 x 280 for all cameras
    Evaluation,
    /// 352 x 640 for the wrist, 176 x 320 for the external cameras
    Stored,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let config = SynthConfig {
        frames: arguments.frames,
        resolution: match arguments.resolution {
            Size::Evaluation => Resolution::EVALUATION,
            Size::Stored => Resolution::STORED,
        },
        calibration_noise: arguments
            .calibration_noise
            .as_deref()
            .map(|values| [values[0], values[1]]),
        ..SynthConfig::default()
    };
    let progress = |path: &std::path::Path| eprintln!("episode: {}", path.display());
    match write_dataset_with(&arguments.out, arguments.episodes, arguments.seed, &config, &progress) {
        Ok(summary) if arguments.json => match serde_json::to_string(&summary) {
            Ok(text) => {
                println!("{text}");
                ExitCode::SUCCESS
            }
            Err(error) => fail(&error),
        },
        Ok(summary) => {
            println!(
                "{} episodes of {} frames, {} new",
                summary.episodes.len(),
                summary.frames,
                summary.written
            );
            println!("robot: {}", summary.robot.display());
            ExitCode::SUCCESS
        }
        Err(error) => fail(&error),
    }
}

fn fail(error: &dyn std::error::Error) -> ExitCode {
    eprintln!("error: {error}");
    let mut cause = error.source();
    while let Some(inner) = cause {
        eprintln!("  caused by: {inner}");
        cause = inner.source();
    }
    ExitCode::FAILURE
}
