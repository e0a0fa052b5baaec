//! `rogs-train`: trains the networks of rogs.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "the program's own file is the one place that prints")]

use std::path::PathBuf;
use std::process::ExitCode;

use burn::tensor::Device;
use clap::{Args, Parser, Subcommand, ValueEnum};
use rogs_synth::World;
use rogs_tensors::device;
use rogs_train::checkpoint::{RunFolder, export};
use rogs_train::run::{Trainer, run};
use rogs_train::{
    Error, LatentTrainer, LatentTraining, Result, Stage1Trainer, Stage1Training, Stage2Trainer, Stage2Training,
};
use rogs_weights::{ElementType, PROVENANCE};

/// Trains the networks of rogs on procedural clips with exact references.
#[derive(Parser)]
#[command(version, about)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Trains Stage 1, the lifting network; the same command resumes after a stop.
    Stage1 {
        /// TOML file of settings; without one, the paper's schedule for the compact network.
        settings: Option<PathBuf>,
        #[command(flatten)]
        trainer: CourseArguments,
    },
    /// Trains Stage 2, the refiner, on fields of a trained Stage 1; the same command resumes after a stop.
    Stage2 {
        /// TOML file of settings; `lift` names the weights of Stage 1.
        settings: PathBuf,
        #[command(flatten)]
        trainer: CourseArguments,
    },
    /// Trains the latent adapter on clips of a run and their latents; the same command resumes after a stop.
    Latent {
        /// TOML file of settings; `lift`, `run` and `latents` must be in it.
        settings: PathBuf,
        #[command(flatten)]
        trainer: CourseArguments,
    },
    /// Writes the Stage-1 network of a run as a weights file for `rogs`.
    Export {
        /// Folder of the run.
        folder: PathBuf,
        /// The file to write.
        #[arg(long)]
        out: PathBuf,
        /// Numbers of the file.
        #[arg(long, value_enum, default_value_t = NumberFormat::Bf16)]
        numbers: NumberFormat,
        /// Where the weights come from, for a person; by default a line made from the run.
        #[arg(long)]
        provenance: Option<String>,
    },
    /// Prints all settings with their defaults as TOML.
    Settings {
        /// With the table `[data.world]`, which makes procedural clips wide.
        #[arg(long)]
        world: bool,
    },
    /// Prints the JSON schema of the table `[data.world]`.
    Schema,
}

/// What every kind of training is told.
#[derive(Args)]
struct CourseArguments {
    /// Folder of the run.
    #[arg(long)]
    out: PathBuf,
    /// Stops once this many updates are done; the schedule stays that of all of them.
    #[arg(long)]
    stop_after: Option<u64>,
    /// Where networks run: `cpu`, or `gpu` where this program was built with the feature `gpu`. A run may change it; its
    /// updates then differ by rounding.
    #[arg(long, default_value_t)]
    device: rogs_schemas::Device,
}

impl CourseArguments {
    /// The device that is named.
    fn device(&self) -> Result<Device> {
        Ok(device::open(self.device)?)
    }

    /// Runs a trainer and says where its network lies.
    fn run(&self, trainer: &mut impl Trainer) -> Result<()> {
        run(trainer, &self.out, self.stop_after, &mut |line| eprintln!("{line}"))?;
        println!("{}", self.out.join("model.safetensors").display());
        Ok(())
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum NumberFormat {
    F32,
    F16,
    Bf16,
}

fn main() -> ExitCode {
    rogs_worker::keep_memory();
    match execute(Arguments::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn execute(command: Command) -> Result<()> {
    match command {
        Command::Stage1 { settings, trainer } => {
            let settings = match settings {
                Some(path) => Stage1Training::read(&path)?,
                None => Stage1Training::default(),
            };
            left_out(
                settings.lpips.is_none() && settings.losses.movies_lpips > 0.0,
                "movies_lpips",
            );
            trainer.run(&mut Stage1Trainer::new(settings, &trainer.device()?)?)
        }
        Command::Stage2 { settings, trainer } => {
            let settings = Stage2Training::read(&settings)?;
            left_out(
                settings.lpips.is_none() && settings.losses.perceptual > 0.0,
                "perceptual",
            );
            trainer.run(&mut Stage2Trainer::new(settings, &trainer.device()?)?)
        }
        Command::Latent { settings, trainer } => {
            let settings = LatentTraining::read(&settings)?;
            trainer.run(&mut LatentTrainer::new(settings, &trainer.device()?)?)
        }
        Command::Export {
            folder,
            out,
            numbers,
            provenance,
        } => {
            let settings = Stage1Training::read(&folder.join("settings.toml"))?;
            // A checkpoint that the run started from need not be there any more when the state holds every parameter.
            let start = settings.start.clone();
            let missing = start.filter(|start| !start.exists());
            let for_export = Stage1Training {
                start: settings.start.clone().filter(|_| missing.is_none()),
                ..settings.clone()
            };
            let mut trainer = Stage1Trainer::new(for_export, &Device::flex())?;
            let restored = RunFolder::open(&folder, &settings)?.resume(trainer.state())?;
            if let Some(path) = missing.filter(|_| restored < trainer.parameters().names().len()) {
                return Err(Error::Folder {
                    path,
                    reason: "is not there, and the state holds only the weights that were trained; bring back the \
                             checkpoint that the run started from"
                        .into(),
                });
            }
            trainer.settings = settings;
            let element = match numbers {
                NumberFormat::F32 => ElementType::F32,
                NumberFormat::F16 => ElementType::F16,
                NumberFormat::Bf16 => ElementType::BF16,
            };
            let mut metadata = trainer.metadata("");
            if let Some(provenance) = provenance {
                metadata.insert(PROVENANCE.to_owned(), provenance);
            }
            export(trainer.parameters(), &metadata, &out, element)?;
            println!("{}", out.display());
            Ok(())
        }
        Command::Settings { world } => {
            let mut settings = Stage1Training::default();
            settings.data.world = world.then(World::default);
            let text = toml::to_string(&settings).map_err(|error| Error::Configuration {
                path: "settings".into(),
                reason: error.to_string(),
            })?;
            print!("{text}");
            Ok(())
        }
        Command::Schema => {
            println!("{:#}", schemars::schema_for!(World).to_value());
            Ok(())
        }
    }
}

/// Says that a loss has a weight but no network.
fn left_out(is: bool, loss: &str) {
    if is {
        eprintln!("the loss `{loss}` is left out: `lpips` names no LPIPS weights in the settings");
    }
}
