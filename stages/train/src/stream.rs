//! Clips for training, made in the background in a fixed order: nothing touches the disk, and update `n` sees the same
//! clips whether or not training was interrupted before it.

use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;

use rogs_random::Pcg64;

use crate::config::{DataSettings, Stage1Training};
use crate::error::Result;
use crate::sample::{ClipPlan, SOURCE_CAMERAS, Sample};

/// Batches that wait for training.
const AHEAD: usize = 3;

/// The clips of one update.
#[derive(Debug, Clone, PartialEq)]
pub struct Batch {
    /// The update.
    pub step: u64,
    /// Its clips.
    pub clips: Vec<Sample>,
}

/// Number of source times and of clips of an update.
fn shape(data: &DataSettings, seed: u64, step: u64) -> (u32, u32) {
    let [fewest, most] = data.source_times;
    let times = fewest + (Pcg64::from_seeds(&[seed, 1, step]).next_double() * f64::from(most - fewest + 1)) as u32;
    let times = times.min(most);
    (times, (data.images_per_step / (SOURCE_CAMERAS as u32 * times)).max(1))
}

/// What the clips of an update are cut from; `first` is the number of clips of all updates before it.
fn plans(data: &DataSettings, seed: u64, step: u64, first: u64) -> Vec<ClipPlan> {
    let (times, clips) = shape(data, seed, step);
    (0..u64::from(clips))
        .map(|clip| {
            let index = first + clip;
            ClipPlan::draw(
                data.first_seed + index,
                times,
                data,
                &mut Pcg64::from_seeds(&[seed, 2, index]),
            )
        })
        .collect()
}

/// Batches from an update on, in order.
pub struct Stream {
    receiver: Option<Receiver<Result<Batch>>>,
    worker: Option<JoinHandle<()>>,
}

impl Stream {
    /// Starts to make batches from update `from` to the last.
    #[must_use]
    pub fn start(settings: &Stage1Training, from: u64) -> Self {
        let (sender, receiver) = sync_channel(AHEAD);
        let settings = settings.clone();
        let worker = std::thread::spawn(move || {
            let (data, seed) = (&settings.data, settings.seed);
            let mut first: u64 = (0..from).map(|step| u64::from(shape(data, seed, step).1)).sum();
            let with_targets = settings.losses.renders_views();
            for step in from..settings.steps {
                let plans = plans(data, seed, step, first);
                first += plans.len() as u64;
                let clips: Result<Vec<Sample>> = plans.iter().map(|plan| made(plan, data, with_targets)).collect();
                if sender.send(clips.map(|clips| Batch { step, clips })).is_err() {
                    return; // nobody listens any more
                }
            }
        });
        Self {
            receiver: Some(receiver),
            worker: Some(worker),
        }
    }

    /// The next batch; `None` after the last update.
    pub fn next_batch(&mut self) -> Option<Result<Batch>> {
        self.receiver.as_ref()?.recv().ok()
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        self.receiver = None;
        if let Some(worker) = self.worker.take() {
            // A worker that panicked has said so on standard error already.
            let _ = worker.join();
        }
    }
}

/// A clip; a seed for which no motion is found gives way to another one far from all others.
fn made(plan: &ClipPlan, data: &DataSettings, with_targets: bool) -> Result<Sample> {
    const FAR: u64 = 1 << 40;
    match plan.sample(data, with_targets) {
        Err(crate::Error::Synth(_)) => {
            let other = ClipPlan {
                seed: plan.seed + FAR,
                ..plan.clone()
            };
            other.sample(data, with_targets)
        }
        result => result,
    }
}
