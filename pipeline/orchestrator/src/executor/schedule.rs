//! The loop that gives ready units to slots and notes how they end.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use rogs_r4c::ledger::now_ms;
use rogs_schemas::ledger::{Attempt, Failure, Outcome};
use rogs_schemas::protocol::{FailureCode, JobId};

use super::policy::{Retry, retry};
use super::progress::{Display, Outlook};
use super::queue::{Queue, Standing};
use super::slot::{JobResult, Message, Slot};
use super::{ClipCounts, RunOptions, RunSummary, UnitCounts, UnitFailure};
use crate::costs::node_costs;
use crate::error::{Error, Result, io};
use crate::exit::Exit;
use crate::ledger::{Ledger, read_costs};
use crate::lock::RunLock;
use crate::plan::{Plan, WorkUnit};
use crate::stage::StageId;
use crate::state::{OutputState, output_state, remove_damaged};

/// Units of one stage that a slot takes in a row before it changes to a stage deeper in the pipeline: few enough to
/// see whole clips early, enough that starting workers and loading weights costs nothing.
const STREAK: usize = 16;

/// An output that is damaged more often than this in one run is not made again: then the disk or the memory is at fault.
const MOST_HEALINGS: u8 = 2;

/// What a worker is expected to take before anything is known, bytes.
const UNKNOWN_MEMORY: u64 = 512 << 20;

/// Runs what is not up to date. Takes the lock of the run folder, freezes the plan into it, and notes every attempt.
/// Failures of clips are part of the summary.
///
/// # Errors
/// When the run folder is in use or cannot be written, or a stage program cannot be started.
pub fn execute(plan: &Plan, options: &RunOptions) -> Result<RunSummary> {
    let start = Instant::now();
    let lock = RunLock::acquire(&plan.run)?;
    plan.freeze()?;
    let states = plan.checked_states();
    sweep(plan, &states)?;
    let warnings = lock.warning().into_iter().chain(damages(plan, &states)).collect();
    let (sender, messages) = channel();
    std::thread::scope(|scope| {
        let slots = (0..options.workers)
            .map(|number| Slot::start(scope, number, options, sender.clone()))
            .collect();
        let mut schedule = Schedule::new(plan, options, &states, slots)?;
        schedule.warn_all(warnings);
        drop(states);
        let result = schedule.run(&messages);
        // Dropping the slots ends their threads, and those their workers.
        schedule.slots.clear();
        result.map(|()| schedule.summary(start))
    })
}

/// Removes what killed writers left behind, in the folders of clips that are not done.
fn sweep(plan: &Plan, states: &[Vec<OutputState>]) -> Result<()> {
    for (clip, states) in states.iter().enumerate() {
        let folder = plan.clip_folder(clip);
        let is_folder = std::fs::symlink_metadata(&folder).is_ok_and(|found| found.is_dir());
        if states.iter().all(|state| *state == OutputState::UpToDate) || !is_folder {
            continue;
        }
        rogs_files::sweep(&folder)?;
        for entry in std::fs::read_dir(&folder)
            .map_err(io("cannot list", &folder))?
            .flatten()
        {
            if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                rogs_files::sweep(&entry.path())?;
            }
        }
    }
    Ok(())
}

/// What is said of outputs that are found damaged before anything is made: they are made again.
fn damages(plan: &Plan, states: &[Vec<OutputState>]) -> Vec<String> {
    let mut said = Vec::new();
    for (clip, states) in states.iter().enumerate() {
        for (state, node) in states.iter().zip(&plan.nodes) {
            if let OutputState::Damaged(why) = state {
                said.push(format!(
                    "{} {}: {why}; it is made again",
                    plan.clips[clip].id, node.label
                ));
            }
        }
    }
    said
}

struct Schedule<'a> {
    plan: &'a Plan,
    options: &'a RunOptions,
    queue: Queue<'a>,
    slots: Vec<Slot>,
    ledger: Ledger,
    display: Display,
    /// Units in hand by job number.
    running: HashMap<JobId, WorkUnit>,
    attempts: HashMap<WorkUnit, u8>,
    /// How often an output was made again because it was found damaged.
    healed: HashMap<WorkUnit, u8>,
    /// Largest peak memory by stage, bytes.
    memory: BTreeMap<StageId, u64>,
    failures: Vec<UnitFailure>,
    warnings: Vec<String>,
    next_job: u64,
    alone: bool,
}

impl<'a> Schedule<'a> {
    fn new(plan: &'a Plan, options: &'a RunOptions, states: &[Vec<OutputState>], slots: Vec<Slot>) -> Result<Self> {
        let queue = Queue::new(plan, states, options.only.as_deref());
        let waiting = |standing: &&Standing| **standing == Standing::Waiting;
        let todo = queue.standings().iter().filter(waiting).count();
        let nodes = plan.nodes.len().max(1);
        let seconds = node_costs(plan)?.into_iter().map(|node| Some(node.cost?.seconds));
        let left = queue.standings().iter().enumerate();
        let left = left
            .filter(|(_, standing)| waiting(standing))
            .map(|(unit, _)| unit % nodes);
        let outlook = Outlook::new(seconds.collect(), slots.len(), left);
        let mut memory = options.stage_memory.clone();
        for (stage, cost) in read_costs(&plan.run)? {
            // The ledgers may know stages that this program has no more.
            if let Ok(stage) = stage.parse() {
                memory.insert(stage, cost.peak_rss_bytes);
            }
        }
        Ok(Self {
            plan,
            options,
            queue,
            display: Display::new(options.progress, todo, slots.len(), outlook),
            slots,
            ledger: Ledger::new(&plan.run),
            running: HashMap::new(),
            attempts: HashMap::new(),
            healed: HashMap::new(),
            memory,
            failures: Vec::new(),
            warnings: Vec::new(),
            next_job: 0,
            alone: false,
        })
    }

    fn run(&mut self, messages: &Receiver<Message>) -> Result<()> {
        let mut announced = false;
        loop {
            let stopping = self.options.interrupts.count() > 0;
            if stopping && !announced {
                announced = true;
                self.display
                    .note("stopping: clips in hand may finish; press Ctrl-C again to stop at once");
            }
            if !stopping {
                self.assign()?;
            }
            if self.running.is_empty() && (stopping || self.queue.is_empty()) {
                return Ok(());
            }
            match messages.recv_timeout(Duration::from_millis(200)) {
                Ok(Message::Progress {
                    slot,
                    fraction,
                    message,
                }) => self.display.progress(slot, fraction, &message),
                Ok(Message::Ended { slot, job, result }) => {
                    self.slots[slot].running = None;
                    self.display.idle(slot);
                    if let Some(unit) = self.running.remove(&job) {
                        self.ended(unit, *result)?;
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(Error::usage("all worker slots have ended").after_start());
                }
            }
        }
    }

    fn expected_memory(&self, stage: StageId) -> u64 {
        self.memory.get(&stage).copied().unwrap_or(UNKNOWN_MEMORY)
    }

    /// Gives every idle slot a unit, as far as memory goes. One unit always runs, however large.
    fn assign(&mut self) -> Result<()> {
        for number in 0..self.slots.len() {
            if self.slots[number].running.is_some() || self.alone {
                continue;
            }
            let used: u64 = self.slots.iter().filter_map(|slot| slot.running).sum();
            let fits = |&stage: &StageId| {
                self.running.is_empty() || used.saturating_add(self.expected_memory(stage)) <= self.options.memory
            };
            let fitting: BTreeSet<StageId> = StageId::ALL.iter().copied().filter(fits).collect();
            let slot = &self.slots[number];
            let (loaded, stay) = (slot.stage, slot.streak < STREAK);
            let unit = self.queue.take(loaded, stay, |stage| fitting.contains(&stage));
            let unit = unit.or_else(|| {
                let unit = self.running.is_empty().then(|| self.queue.take_alone()).flatten();
                self.alone = unit.is_some();
                unit
            });
            if let Some(unit) = unit {
                self.start(number, unit)?;
            }
        }
        Ok(())
    }

    fn start(&mut self, slot: usize, unit: WorkUnit) -> Result<()> {
        let keys = self.plan.keys(unit.clip);
        let job = self.plan.job(JobId(self.next_job), unit, &keys);
        self.next_job += 1;
        if let Some(folder) = job.output.parent() {
            rogs_files::make_folder_below(&self.plan.run, folder)?;
        }
        self.running.insert(job.job, unit);
        let node = &self.plan.nodes[unit.node];
        self.display.start(slot, &job.clip_id, &node.label);
        let memory = self.expected_memory(node.stage);
        self.slots[slot].assign(node.stage, job, memory);
        Ok(())
    }

    fn ended(&mut self, unit: WorkUnit, mut result: JobResult) -> Result<()> {
        self.alone = false;
        if let Some(error) = result.fatal.take() {
            return Err(error);
        }
        let keys = self.plan.keys(unit.clip);
        let output = self.plan.output(unit, &keys);
        let path = self.plan.run.join(&output);
        if result.outcome == Outcome::Done && output_state(&path, keys[unit.node].key) != OutputState::UpToDate {
            // Truth is in the outputs, whatever a worker says.
            result.outcome = Outcome::Failed;
            result.failure = Some(Failure {
                code: FailureCode::Internal,
                message: format!("the worker reports success, but `{}` is not up to date", path.display()),
                hint: Some("does another process change the run folder?".to_owned()),
            });
        }
        let node = &self.plan.nodes[unit.node];
        let clip = &self.plan.clips[unit.clip];
        let attempt = Attempt {
            unix_ms: now_ms(),
            clip_id: clip.id.clone(),
            stage: node.stage.to_string(),
            output,
            key: keys[unit.node].key,
            outcome: result.outcome,
            seconds: result.seconds,
            peak_rss_bytes: result.peak_rss_bytes,
            threads: result.threads,
            output_bytes: if result.outcome == Outcome::Done {
                std::fs::metadata(&path).map_or(0, |file| file.len())
            } else {
                0
            },
            warnings: result.warnings,
            failure: result.failure,
            stderr: result.stderr,
            worker: self.ledger.worker().to_owned(),
        };
        self.ledger.note(&attempt)?;
        match attempt.outcome {
            Outcome::Stopped => self.queue.stopped(unit),
            Outcome::Done => {
                let known = self.memory.entry(node.stage).or_default();
                *known = (*known).max(attempt.peak_rss_bytes);
                self.queue.made(unit);
                let seconds = attempt.seconds.get("total").copied().unwrap_or_default();
                self.display.done(&clip.id, (unit.node, &node.label), seconds);
                for warning in &attempt.warnings {
                    let text = format!("{} {}: {warning}", clip.id, node.label);
                    self.display.warn(&text);
                    self.warnings.push(text);
                }
            }
            Outcome::Failed => {
                let code = attempt.failure.as_ref().map(|failure| failure.code);
                if !self.heals(unit, code.unwrap_or(FailureCode::Internal))? {
                    self.failed(unit, attempt.failure);
                }
            }
        }
        Ok(())
    }

    /// Says and keeps what a person should know of the run as a whole.
    fn warn_all(&mut self, warnings: Vec<String>) {
        for text in warnings {
            self.display.warn(&text);
            self.warnings.push(text);
        }
    }

    /// Looks at what a unit that failed was made from. Outputs that are damaged are removed and made again, then the unit;
    /// true when that is so. A payload is not read before somebody needs it, so this is where damage shows.
    fn heals(&mut self, unit: WorkUnit, code: FailureCode) -> Result<bool> {
        if matches!(
            code,
            FailureCode::BadParams | FailureCode::Resource | FailureCode::Deadline
        ) {
            return Ok(false);
        }
        let keys = self.plan.keys(unit.clip);
        let mut lost = Vec::new();
        for node in self.plan.upstream(unit.node) {
            let maker = WorkUnit { node, ..unit };
            let output = self.plan.output(maker, &keys);
            let Some(why) = remove_damaged(&self.plan.run, &output)? else {
                continue;
            };
            let healed = self.healed.entry(maker).or_default();
            *healed += 1;
            if *healed > MOST_HEALINGS {
                return Ok(false);
            }
            lost.push((node, why));
        }
        let (clip, label) = (&self.plan.clips[unit.clip].id, &self.plan.nodes[unit.node].label);
        let say = |(_, why): &(usize, String)| format!("{clip} {label}: {why}; it is made again");
        let warnings = lost.iter().map(say).collect();
        let lost: Vec<usize> = lost.into_iter().map(|(node, _)| node).collect();
        if lost.is_empty() {
            return Ok(false);
        }
        let more = self.queue.again_after(unit, &lost);
        self.display.more(more, &lost);
        self.warn_all(warnings);
        Ok(true)
    }

    fn failed(&mut self, unit: WorkUnit, failure: Option<Failure>) {
        let (clip, node) = (&self.plan.clips[unit.clip], &self.plan.nodes[unit.node]);
        let unknown = || Failure {
            code: FailureCode::Internal,
            message: "no reason given".into(),
            hint: None,
        };
        let failure = failure.unwrap_or_else(unknown);
        let attempts = self.attempts.entry(unit).or_default();
        *attempts += 1;
        match retry(failure.code, *attempts) {
            Retry::No => {
                let blocked = self.queue.failed(unit);
                let failure = UnitFailure {
                    clip: clip.id.clone(),
                    episode: clip.episode.clone(),
                    node: node.label.clone(),
                    code: failure.code,
                    message: failure.message,
                    hint: failure.hint,
                    blocks: blocked
                        .iter()
                        .map(|&node| self.plan.nodes[node].label.clone())
                        .collect(),
                };
                let nodes: Vec<usize> = std::iter::once(unit.node).chain(blocked).collect();
                self.display.failed(&failure, &nodes);
                self.failures.push(failure);
            }
            retry => {
                let alone = retry == Retry::Alone;
                let how = if alone { " alone" } else { "" };
                self.display.note(&format!(
                    "{} {}: {}; trying again{how}",
                    clip.id, node.label, failure.message
                ));
                self.queue.again(unit, alone);
            }
        }
    }

    fn summary(&mut self, start: Instant) -> RunSummary {
        self.display.finish();
        let mut units = UnitCounts {
            total: self.queue.standings().len(),
            ..UnitCounts::default()
        };
        for standing in self.queue.standings() {
            match standing {
                Standing::UpToDate => units.up_to_date += 1,
                Standing::Made => units.made += 1,
                Standing::Failed => units.failed += 1,
                Standing::Blocked => units.blocked += 1,
                Standing::Waiting | Standing::Running => units.left += 1,
            }
        }
        let mut clips = ClipCounts {
            total: self.plan.clips.len(),
            ..ClipCounts::default()
        };
        for of_clip in self.queue.standings().chunks(self.plan.nodes.len().max(1)) {
            let done = |standing: &Standing| matches!(standing, Standing::UpToDate | Standing::Made);
            if of_clip.contains(&Standing::Failed) {
                clips.failed += 1;
            } else if of_clip.iter().all(done) {
                clips.done += 1;
            } else {
                clips.left += 1;
            }
        }
        let stopped = self.options.interrupts.count() > 0 && units.left > 0;
        let exit = match (stopped, units.failed) {
            (true, _) => Exit::Stopped,
            (false, 0) => Exit::Done,
            (false, _) if clips.done > 0 || clips.left > 0 => Exit::Partial,
            _ => Exit::Failed,
        };
        let mut failures = std::mem::take(&mut self.failures);
        failures.sort_by(|a, b| (&a.clip, &a.node).cmp(&(&b.clip, &b.node)));
        RunSummary {
            name: self.plan.name.clone(),
            run: self.plan.run.clone(),
            exit,
            units,
            clips,
            failures,
            warnings: std::mem::take(&mut self.warnings),
            seconds: start.elapsed().as_secs_f64(),
        }
    }
}
