//! Clips for training, made in the background in a fixed order: nothing touches the disk, and update `n` sees the same
//! clips whether or not training was interrupted before it.

use std::ops::Range;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;

use rogs_random::Pcg64;

use crate::builder::SOURCE_CAMERAS;
use crate::config::{DataSettings, Stage1Training};
use crate::error::Result;
use crate::plan::ClipPlan;
use crate::sample::Sample;

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

/// What updates are made from, in order, made ahead in the background.
pub struct Stream<T> {
    receiver: Option<Receiver<Result<T>>>,
    worker: Option<JoinHandle<()>>,
}

/// The batches of a Stage-1 run from update `from` on.
#[must_use]
pub fn batches(settings: &Stage1Training, from: u64) -> Stream<Batch> {
    let settings = settings.clone();
    let mut first = clips_before(&settings, from);
    Stream::start(from..settings.steps, move |step| {
        let batch = batch_from(&settings, step, first)?;
        first += batch.clips.len() as u64;
        Ok(batch)
    })
}

/// The batch of one update of a Stage-1 run, made at once.
///
/// # Errors
/// When a clip cannot be made.
pub fn batch(settings: &Stage1Training, step: u64) -> Result<Batch> {
    batch_from(settings, step, clips_before(settings, step))
}

/// Number of clips of all updates before this one.
fn clips_before(settings: &Stage1Training, step: u64) -> u64 {
    let clips_of = |step| u64::from(shape(&settings.data, settings.seed, step).1);
    (0..step).map(clips_of).sum()
}

/// The batch of an update; `first` as in [`plans`].
fn batch_from(settings: &Stage1Training, step: u64, first: u64) -> Result<Batch> {
    let (data, with_targets) = (&settings.data, settings.losses.renders_views());
    let plans = plans(data, settings.seed, step, first);
    let clips: Result<_> = plans.iter().map(|plan| sampled(plan, data, with_targets)).collect();
    Ok(Batch { step, clips: clips? })
}

impl<T: Send + 'static> Stream<T> {
    /// Starts to make items for these updates; ends early after an error. They are made on threads of their own, as many as
    /// training has: those of training would not turn to them before an update is done.
    #[must_use]
    pub fn start(updates: Range<u64>, mut make: impl FnMut(u64) -> Result<T> + Send + 'static) -> Self {
        let (sender, receiver) = sync_channel(AHEAD);
        let threads = rayon::current_num_threads();
        let worker = std::thread::spawn(move || {
            // Where the system starts no more threads, those of training have to do.
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().ok();
            for update in updates {
                let item = match &pool {
                    Some(pool) => pool.install(|| make(update)),
                    None => make(update),
                };
                let failed = item.is_err();
                // An error of `send` says that nobody listens any more.
                if sender.send(item).is_err() || failed {
                    return;
                }
            }
        });
        Self {
            receiver: Some(receiver),
            worker: Some(worker),
        }
    }

    /// The next item; `None` after the last update.
    pub fn next_item(&mut self) -> Option<Result<T>> {
        self.receiver.as_ref()?.recv().ok()
    }
}

impl<T> Drop for Stream<T> {
    fn drop(&mut self) {
        self.receiver = None;
        if let Some(worker) = self.worker.take() {
            // A worker that panicked has said so on standard error already.
            let _ = worker.join();
        }
    }
}

/// The clip of a plan.
fn sampled(plan: &ClipPlan, data: &DataSettings, with_targets: bool) -> Result<Sample> {
    plan.or_another(|plan| plan.sample(data, with_targets))
}
