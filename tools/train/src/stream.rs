//! Clips for training, made in the background in a fixed order: nothing touches the disk, and update `n` sees the same
//! clips whether or not training was interrupted before it.

use std::ops::Range;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;

use rogs_random::Pcg64;

use crate::config::{DataSettings, Stage1Training};
use crate::error::Result;
use crate::plan::ClipPlan;
use crate::recorded::Recordings;
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

/// What the clips of an update have in common.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Shape {
    times: u32,
    cameras: u32,
    size: [u32; 2],
    clips: u32,
}

impl Shape {
    /// That of an update: times, cameras and size from streams of their own.
    fn of(data: &DataSettings, seed: u64, step: u64) -> Self {
        let unit = |purpose: u64| Pcg64::from_seeds(&[seed, purpose, step]).next_double();
        let between = |[fewest, most]: [u32; 2], share: f64| {
            let drawn = fewest + (share * f64::from(most - fewest + 1)) as u32;
            drawn.min(most)
        };
        let times = between(data.source_times, unit(1));
        let cameras = between(data.source_cameras, unit(7));
        let mut size = data.size;
        let mut left = unit(6);
        for more in &data.more_sizes {
            if left < more.share {
                size = more.size;
                break;
            }
            left -= more.share;
        }
        let area = |[height, width]: [u32; 2]| u64::from(height) * u64::from(width);
        // What an update may hold is counted in pixels: of larger images a clip has fewer times.
        let images = (u64::from(data.images_per_step) * area(data.size) / area(size)) as u32;
        let times = times.min((images / cameras).max(1));
        let clips = images / (cameras * times);
        Self {
            times,
            cameras,
            size,
            clips: clips.max(1),
        }
    }
}

/// What the clips of an update are cut from where they are procedural; `first` is the number of clips of all updates before
/// it.
fn plans(data: &DataSettings, seed: u64, step: u64, first: u64) -> Vec<ClipPlan> {
    let shape = Shape::of(data, seed, step);
    (0..u64::from(shape.clips))
        .map(|clip| {
            let index = first + clip;
            let random = |purpose: u64| Pcg64::from_seeds(&[seed, purpose, index]);
            let plan = ClipPlan::draw(data.first_seed + index, shape.times, data, &mut random(2));
            ClipPlan {
                size: shape.size,
                ..plan.with_cameras(shape.cameras, &mut random(8))
            }
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
    let mut opened = None;
    Stream::start(from..settings.steps, move |step| {
        let recordings = match &opened {
            Some(recordings) => recordings,
            None => opened.insert(Recordings::open(&settings.data)?),
        };
        let batch = batch_from(&settings, recordings, step, first)?;
        first += batch.clips.len() as u64;
        Ok(batch)
    })
}

/// The batch of one update of a Stage-1 run, made at once.
///
/// # Errors
/// When a clip cannot be made.
pub fn batch(settings: &Stage1Training, step: u64) -> Result<Batch> {
    let recordings = Recordings::open(&settings.data)?;
    batch_from(settings, &recordings, step, clips_before(settings, step))
}

/// Number of clips of all updates before this one.
fn clips_before(settings: &Stage1Training, step: u64) -> u64 {
    let clips_of = |step| u64::from(Shape::of(&settings.data, settings.seed, step).clips);
    (0..step).map(clips_of).sum()
}

/// The batch of an update; `first` as in [`plans`].
fn batch_from(settings: &Stage1Training, recordings: &Recordings, step: u64, first: u64) -> Result<Batch> {
    let (data, with_targets) = (&settings.data, settings.losses.renders_views());
    let plans = plans(data, settings.seed, step, first);
    let clip = |(plan, index): (&ClipPlan, u64)| {
        let shape = (plan.size, plan.sources.len() as u32);
        let recorded = recordings.clip(data, (settings.seed, index), shape, with_targets)?;
        recorded.map_or_else(|| sampled(plan, data, with_targets), Ok)
    };
    let clips: Result<_> = plans.iter().zip(first..).map(clip).collect();
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
