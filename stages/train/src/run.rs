//! A whole run on a folder: updates, evaluations, checkpoints, report.

use std::path::Path;
use std::time::Instant;

use burn::tensor::Device;
use rogs_networks::checkpoint::ElementType;
use serde_json::json;

use crate::checkpoint::{RunFolder, export};
use crate::config::Stage1Training;
use crate::error::{Error, Result};
use crate::evaluate::{Picture, Scores, evaluate};
use crate::report;
use crate::stream::Stream;
use crate::trainer::{Trainer, UpdateReport};

/// Weight of the newest update in the running mean of seconds per update.
const PACE_WEIGHT: f64 = 0.05;

/// Trains until the last update or until `stop_after` updates are done, whichever is first; goes on where the folder's
/// last checkpoint is. `say` gets lines for a person.
///
/// # Errors
/// When the folder belongs to another run, a clip cannot be made, or training diverges.
pub fn run(
    settings: &Stage1Training,
    root: &Path,
    stop_after: Option<u64>,
    say: &mut dyn FnMut(&str),
) -> Result<Trainer> {
    let folder = RunFolder::open(root, settings)?;
    let mut trainer = Trainer::new(settings.clone(), &Device::flex())?;
    folder.resume(&mut trainer)?;
    let last = stop_after.unwrap_or(settings.steps).min(settings.steps);
    if trainer.step > 0 {
        say(&format!("resumed after {} of {} updates", trainer.step, settings.steps));
    }
    let mut clock = Clock::start(&folder)?;
    if trainer.step == 0 && folder.lines("metrics.jsonl")?.is_empty() {
        scored(&trainer, &folder, &clock, say)?;
    }
    let mut stream = Stream::start(settings, trainer.step);
    while trainer.step < last {
        let Some(batch) = stream.next_batch() else { break };
        let started = Instant::now();
        let report = trainer.update(&batch?)?;
        clock.pace(started.elapsed().as_secs_f64());
        folder.append("metrics.jsonl", &json!(report))?;
        if trainer.step.is_multiple_of(10) || trainer.step == last {
            say(&line(&report, settings.steps, clock.seconds_per_update));
        }
        let done = trainer.step == last;
        if done || trainer.step.is_multiple_of(settings.evaluate_every) {
            scored(&trainer, &folder, &clock, say)?;
        }
        if done || trainer.step.is_multiple_of(settings.checkpoint_every) {
            folder.save(&trainer)?;
        }
    }
    Ok(trainer)
}

/// Scores the network, writes picture, model and report.
fn scored(trainer: &Trainer, folder: &RunFolder, clock: &Clock, say: &mut dyn FnMut(&str)) -> Result<()> {
    let settings = &trainer.settings;
    if settings.evaluation_clips > 0 {
        let (scores, picture) = evaluate(&trainer.network, settings)?;
        folder.append("metrics.jsonl", &json!({ "step": trainer.step, "evaluation": scores }))?;
        if let Some(picture) = picture.filter(|picture| picture.width > 0) {
            save_picture(&folder.path(&format!("samples/{:06}.png", trainer.step)), &picture)?;
        }
        say(&words(trainer.step, &scores));
    }
    let seconds = clock.seconds();
    folder.append(
        "time.jsonl",
        &json!({ "step": trainer.step, "evaluation": true, "seconds": seconds }),
    )?;
    let provenance = provenance(trainer, Some(seconds));
    export(
        trainer,
        &folder.path("model.safetensors"),
        ElementType::F32,
        &provenance,
    )?;
    report::write(folder, settings)
}

/// Where the weights come from, for a person.
#[must_use]
pub fn provenance(trainer: &Trainer, seconds: Option<f64>) -> String {
    let settings = &trainer.settings;
    let start = match &settings.start {
        Some(path) => format!(
            "started from {}",
            path.file_name().unwrap_or_default().to_string_lossy()
        ),
        None => format!("from scratch, seed {}", settings.seed),
    };
    let [height, width] = settings.data.size;
    let time = seconds.map_or_else(String::new, |seconds| {
        format!(", {:.0} minutes of wall time", seconds / 60.0)
    });
    format!(
        "trained by rogs-train on procedural clips only, {} updates at {height} x {width}, {start}{time}",
        trainer.step
    )
}

fn save_picture(path: &Path, picture: &Picture) -> Result<()> {
    let image = image::RgbImage::from_raw(picture.width, picture.height, picture.rgb.clone());
    let failed = |reason: String| Error::Folder {
        path: path.to_owned(),
        reason,
    };
    image
        .ok_or_else(|| failed("the picture has another size than its pixels".into()))?
        .save(path)
        .map_err(|error| failed(error.to_string()))
}

fn line(report: &UpdateReport, steps: u64, seconds_per_update: f64) -> String {
    let terms: Vec<String> = report
        .terms
        .iter()
        .map(|(key, value)| format!("{key} {value:.4}"))
        .collect();
    let left = (steps - report.step - 1) as f64 * seconds_per_update;
    format!(
        "update {}/{steps}  loss {:.4}  norm {:.2}  {}  {seconds_per_update:.2} s/update, {:.0} min left",
        report.step + 1,
        report.loss,
        report.gradient_norm,
        terms.join("  "),
        left / 60.0
    )
}

fn words(step: u64, scores: &Scores) -> String {
    format!(
        "after {step} updates, {} held-out clips: AbsRel head {:.3}, source {:.3}, novel {:.3}; PSNR source {:.1} dB, novel \
         {:.1} dB; EPE robot {:.1} mm (unconditioned {:.1} mm), objects {:.1} mm",
        scores.clips,
        scores.head_abs_rel,
        scores.source_abs_rel,
        scores.novel_abs_rel,
        scores.source_psnr,
        scores.novel_psnr,
        scores.robot_epe_mm,
        scores.robot_epe_unconditioned_mm,
        scores.object_epe_mm
    )
}

/// Seconds of training over all parts of a run.
struct Clock {
    before: f64,
    started: Instant,
    seconds_per_update: f64,
}

impl Clock {
    fn start(folder: &RunFolder) -> Result<Self> {
        let lines = folder.lines("time.jsonl")?;
        let before = lines.last().and_then(|line| line["seconds"].as_f64()).unwrap_or(0.0);
        Ok(Self {
            before,
            started: Instant::now(),
            seconds_per_update: 0.0,
        })
    }

    fn pace(&mut self, seconds: f64) {
        self.seconds_per_update = if self.seconds_per_update == 0.0 {
            seconds
        } else {
            (1.0 - PACE_WEIGHT) * self.seconds_per_update + PACE_WEIGHT * seconds
        };
    }

    fn seconds(&self) -> f64 {
        self.before + self.started.elapsed().as_secs_f64()
    }
}
