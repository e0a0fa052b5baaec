//! An update of the compact network with a plane sweep (12 images of 84 x 154, all losses but LPIPS), and its parts beside
//! PyTorch in turns: wall and processor seconds, the smallest of the repeats.
//!
//! `ROGS_PEER_PYTHON=python cargo bench -p rogs-train --bench update -- [REPEATS] [bf16]`, where that Python has `torch`;
//! without the variable our times are printed alone. Both sides use as many threads as rayon does. The peer has the same
//! network and the losses on its outputs; ours are timed so too, before rendered views are added.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

#[path = "../../../tests/support/bench.rs"]
mod bench;

use bench::{Peer, peak_memory_mib, processor, timed};
use burn::tensor::Device;
use rayon::prelude::*;
use rogs_lift::ProductPrecision;
use rogs_random::Pcg64;
use rogs_stage1::Stage1Config;
use rogs_tensors::optimiser::{self, Gradients, Rule};
use rogs_train::config::LossWeights;
use rogs_train::sample::Sample;
use rogs_train::stage1::forward::{Heads, lift};
use rogs_train::stage1::objective::objective;
use rogs_train::stage1::start::{rate_of, tracked};
use rogs_train::stage1::terms::Losses;
use rogs_train::stream::{Batch, batch};
use rogs_train::{Result, Stage1Trainer, Stage1Training, Trainer};

/// Wall and processor seconds.
type Seconds = [f64; 2];

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let repeats = arguments.iter().find_map(|text| text.parse().ok()).unwrap_or(7);
    let settings = settings(arguments.iter().any(|text| text == "bf16"));
    rogs_worker::keep_memory();
    println!("{}, {} threads", processor(), rayon::current_num_threads());
    let batch_of = |step| batch(&settings, step);
    let first = batch_of(0)?;
    let mut peers =
        ["contiguous", "channels_last"].map(|layout| Peer::start("update.py", &job(&settings, &first, layout)));

    let mut whole = Stage1Trainer::new(settings.clone(), &Device::flex())?;
    let mut parts = Parts::new(&settings)?;
    let mut table = Table::default();
    for step in 0..=repeats {
        let (clips, making) = timed(|| batch_of(step));
        let clips = clips?;
        let (report, update) = timed(|| whole.update(&clips));
        report?;
        let parts = parts.update(&clips)?;
        let answers: Vec<_> = peers.iter_mut().flatten().filter_map(answer).collect();
        if step == 0 {
            continue;
        }
        table.add("making of clips", making);
        table.add("update", update);
        table.parts("", parts);
        for (layout, parts) in ["contiguous", "channels last"].iter().zip(answers) {
            table.parts(&format!("PyTorch {layout}, "), parts);
        }
    }
    table.print();
    println!("peak memory {:.0} MiB", peak_memory_mib());
    Ok(())
}

/// `manifests/training/stage1.toml` with every loss but LPIPS.
fn settings(bf16: bool) -> Stage1Training {
    let mut settings = Stage1Training {
        configuration: "compact-sweep".into(),
        losses: LossWeights {
            movies_lpips: 0.0,
            stereo_robot: 0.5,
            sweep: 0.1,
            sweep_depth: 1.0,
            metric_robot: 0.001,
            ..LossWeights::default()
        },
        ..Stage1Training::default()
    };
    if bf16 {
        settings.precision = ProductPrecision::Bf16;
    }
    settings.data.size = [84, 154];
    settings.data.source_times = [2, 2];
    settings.data.queries = 1;
    settings.data.images_per_step = 12;
    settings
}

/// What the peer is told.
fn job(settings: &Stage1Training, batch: &Batch, layout: &str) -> String {
    let config = Stage1Config::by_name(&settings.configuration).unwrap();
    let [height, width] = settings.data.size.map(|side| side as usize);
    let mut job = serde_json::to_value(&config).unwrap();
    let more = serde_json::json!({
        "clips": batch.clips.len(), "frames": batch.clips[0].views.len(), "cameras": 3, "layout": layout,
        "grid": config.grid(height, width).unwrap(), "size": [height, width], "threads": rayon::current_num_threads(),
    });
    job.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    job.to_string()
}

fn answer(peer: &mut Peer) -> Option<[Seconds; 3]> {
    let told: serde_json::Value = serde_json::from_str(&peer.turn("update")?).ok()?;
    let part = |name: &str| serde_json::from_value(told[name].clone()).ok();
    Some([part("forward")?, part("backward")?, part("optimiser")?])
}

/// The parts of an update without rendered views, one after the other, clips side by side in each.
struct Parts {
    trainer: Stage1Trainer,
    losses: LossWeights,
}

impl Parts {
    fn new(settings: &Stage1Training) -> Result<Self> {
        Ok(Self {
            trainer: Stage1Trainer::new(settings.clone(), &Device::flex())?,
            losses: LossWeights {
                movies_mse: 0.0,
                track_final: 0.0,
                fk_final: 0.0,
                metric_final: 0.0,
                metric_right: 0.0,
                metric_robot: 0.0,
                coverage: 0.0,
                coverage_right: 0.0,
                ..settings.losses
            },
        })
    }

    /// Seconds of the forward pass with losses, of the backward pass, of the optimiser.
    fn update(&mut self, batch: &Batch) -> Result<[Seconds; 3]> {
        let settings = &self.trainer.settings;
        let forward = |clip: &Sample| {
            let network = tracked(&self.trainer.network, &settings.optimiser)?;
            let lifted = lift(&network, clip, true, Heads::All)?;
            let losses = Losses {
                weights: &self.losses,
                perceptual: None,
            };
            let judged = objective(clip, &lifted, losses, &mut Pcg64::from_seeds(&[batch.step]))?;
            Ok((network, judged.loss))
        };
        let (passed, forward) = timed(|| each(&batch.clips, forward));
        let passed = passed?;
        let (gradients, backward) = timed(|| {
            each(&passed, |(network, loss)| {
                Ok(optimiser::gradients(&network.parameters, loss)?)
            })
        });
        let gradients = gradients?;
        drop(passed);
        let share = 1.0 / batch.clips.len() as f64;
        let rule = Rule {
            rate: &|name| rate_of(name, &settings.optimiser),
            share: 1.0,
            betas: settings.optimiser.betas,
            weight_decay: &|_| settings.optimiser.weight_decay,
            clip: settings.optimiser.clip,
        };
        let (parameters, moments) = (&mut self.trainer.network.parameters, &mut self.trainer.moments);
        let (moved, optimiser) = timed(|| {
            let mut sum = Gradients::new();
            gradients
                .into_iter()
                .for_each(|one| optimiser::add(&mut sum, share, one));
            optimiser::update(parameters, moments, &sum, &rule, batch.step)
        });
        moved?;
        Ok([forward, backward, optimiser])
    }
}

fn each<T: Sync, R: Send>(items: &[T], work: impl Fn(&T) -> Result<R> + Sync + Send) -> Result<Vec<R>> {
    items.par_iter().with_max_len(1).map(work).collect()
}

/// Least seconds by what was timed, in the order of the first mention.
#[derive(Default)]
struct Table(Vec<(String, Seconds)>);

impl Table {
    fn add(&mut self, name: &str, seconds: Seconds) {
        match self.0.iter_mut().find(|(known, _)| known == name) {
            Some((_, least)) => *least = [0, 1].map(|side| least[side].min(seconds[side])),
            None => self.0.push((name.to_owned(), seconds)),
        }
    }

    fn parts(&mut self, prefix: &str, [forward, backward, optimiser]: [Seconds; 3]) {
        let sum = [0, 1].map(|side| forward[side] + backward[side] + optimiser[side]);
        for (name, seconds) in [
            ("forward", forward),
            ("backward", backward),
            ("optimiser", optimiser),
            ("together", sum),
        ] {
            self.add(&format!("{prefix}{name}"), seconds);
        }
    }

    fn print(&self) {
        println!("{:36} {:>8} {:>8}", "", "wall, s", "CPU, s");
        for (name, [wall, processor]) in &self.0 {
            println!("{name:36} {wall:8.3} {processor:8.3}");
        }
        let of = |name: &str| {
            self.0
                .iter()
                .find(|(known, _)| known == name)
                .map(|(_, seconds)| seconds)
        };
        for part in ["forward", "backward", "optimiser", "together"] {
            let peers = ["contiguous", "channels last"].map(|layout| of(&format!("PyTorch {layout}, {part}")));
            let Some(own) = of(part) else { continue };
            let best = |side: usize| peers.iter().flatten().map(|seconds| seconds[side]).reduce(f64::min);
            if let (Some(wall), Some(processor)) = (best(0), best(1)) {
                println!(
                    "{part}: {:.2} (wall) and {:.2} (CPU) times as fast as the better of PyTorch's layouts",
                    wall / own[0],
                    processor / own[1]
                );
            }
        }
    }
}
