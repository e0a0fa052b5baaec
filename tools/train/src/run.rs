//! A whole run on a folder: updates, evaluations, checkpoints, report. What is trained is a [`Trainer`].

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use rogs_tensors::optimiser::Moments;
use rogs_tensors::parameters::Parameters;
use rogs_weights::ElementType;
use serde::Serialize;
use serde_json::json;

use crate::checkpoint::{RunFolder, State, export};
use crate::config::Cadence;
use crate::error::Result;
use crate::picture::Picture;
use crate::report;
use crate::stream::Stream;

/// Weight of the newest update in the running mean of seconds per update.
const PACE_WEIGHT: f64 = 0.05;

/// What an update did.
#[derive(Debug, Clone, PartialEq, Serialize, serde::Deserialize)]
pub struct UpdateReport {
    /// The update, counted from 0.
    pub step: u64,
    /// The weighted sum of all losses.
    pub loss: f64,
    /// Each loss before its weight, mean over the clips.
    pub terms: BTreeMap<String, f64>,
    /// Norm of the gradient before clipping.
    pub gradient_norm: f64,
    /// Source images of the update.
    pub images: usize,
}

/// Scores of held-out clips.
#[derive(Debug, Clone, Default)]
pub struct Evaluation {
    /// Scores by name.
    pub scores: BTreeMap<String, f64>,
    /// What the first clip looks like.
    pub picture: Option<Picture>,
}

/// Something that is trained update by update.
pub trait Trainer {
    /// Settings; a folder belongs to one value of them.
    type Settings: Serialize;
    /// What one update is made from.
    type Batch: Send + 'static;

    /// Title of the report.
    const TITLE: &'static str;
    /// What the sample pictures show.
    const PICTURE: &'static str;

    /// The settings.
    fn settings(&self) -> &Self::Settings;
    /// When to write and score.
    fn cadence(&self) -> Cadence;
    /// What changes from update to update.
    fn state(&mut self) -> State<'_>;
    /// The parameters as they are.
    fn parameters(&self) -> &Parameters;
    /// The moments as they are.
    fn moments(&self) -> &Moments;
    /// Updates done.
    fn step(&self) -> u64;
    /// Batches of all updates that are left.
    ///
    /// # Errors
    /// When what makes them cannot be loaded.
    fn stream(&self) -> Result<Stream<Self::Batch>>;
    /// One update.
    ///
    /// # Errors
    /// When a loss or gradient is not finite, or the device fails; nothing is changed then.
    fn update(&mut self, batch: &Self::Batch) -> Result<UpdateReport>;
    /// Scores held-out clips.
    ///
    /// # Errors
    /// When a clip cannot be made or rendered.
    fn evaluate(&self) -> Result<Evaluation>;
    /// Metadata of the weights file; `time` says how long training took.
    fn metadata(&self, time: &str) -> BTreeMap<String, String>;
}

/// Trains until the last update or until `stop_after` updates are done, whichever is first; resumes where the folder's
/// last checkpoint is. `say` gets lines for a person.
///
/// # Errors
/// When the folder belongs to another run, a clip cannot be made, or training diverges.
pub fn run<C: Trainer>(trainer: &mut C, root: &Path, stop_after: Option<u64>, say: &mut dyn FnMut(&str)) -> Result<()> {
    let folder = RunFolder::open(root, trainer.settings())?;
    folder.resume(trainer.state())?;
    let Cadence {
        steps,
        checkpoint_every,
        evaluate_every,
    } = trainer.cadence();
    let last = stop_after.unwrap_or(steps).min(steps);
    if trainer.step() > 0 {
        say(&format!("resumed after {} of {steps} updates", trainer.step()));
    }
    let mut clock = Clock::start(&folder)?;
    if trainer.step() == 0 && folder.lines("metrics.jsonl")?.is_empty() {
        scored(trainer, &folder, &clock, say)?;
    }
    if trainer.step() >= last {
        return Ok(());
    }
    let mut stream = trainer.stream()?;
    while trainer.step() < last {
        let Some(batch) = stream.next_item() else { break };
        let started = Instant::now();
        let report = trainer.update(&batch?)?;
        clock.pace(started.elapsed().as_secs_f64());
        folder.append("metrics.jsonl", &json!(report))?;
        let (step, done) = (trainer.step(), trainer.step() == last);
        if step.is_multiple_of(10) || done {
            say(&line(&report, steps, clock.seconds_per_update));
        }
        if done || step.is_multiple_of(evaluate_every) {
            scored(trainer, &folder, &clock, say)?;
        }
        if done || step.is_multiple_of(checkpoint_every) {
            folder.save(trainer.parameters(), trainer.moments(), step)?;
        }
    }
    Ok(())
}

/// Scores the network, writes picture, model and report.
fn scored<C: Trainer>(trainer: &C, folder: &RunFolder, clock: &Clock, say: &mut dyn FnMut(&str)) -> Result<()> {
    let step = trainer.step();
    let Evaluation { scores, picture } = trainer.evaluate()?;
    if !scores.is_empty() {
        folder.append("metrics.jsonl", &json!({ "step": step, "evaluation": scores }))?;
        let words: Vec<String> = scores.iter().map(|(key, value)| format!("{key} {value:.3}")).collect();
        say(&format!("after {step} updates, held-out clips: {}", words.join("  ")));
    }
    if let Some(picture) = picture.filter(|picture| picture.width > 0) {
        picture.save(&folder.path(&format!("samples/{step:06}.png")))?;
    }
    let seconds = clock.seconds();
    let line = json!({ "step": step, "evaluation": true, "seconds": seconds });
    folder.append("time.jsonl", &line)?;
    let metadata = trainer.metadata(&format!(", {:.0} minutes of wall time", seconds / 60.0));
    export(
        trainer.parameters(),
        &metadata,
        &folder.path("model.safetensors"),
        ElementType::F32,
    )?;
    report::write(folder, C::TITLE, C::PICTURE, trainer.cadence().steps)
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
