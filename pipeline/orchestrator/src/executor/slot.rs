//! A slot: a thread that owns at most one worker process and gives it one job after another.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use rogs_schemas::ledger::{Failure, Outcome};
use rogs_schemas::protocol::{Event, FailureCode, Job, JobId};

use super::RunOptions;
use super::policy::of_crash;
use super::process::{Received, WorkerProcess};
use crate::stage::StageId;

/// How often a waiting slot looks for signals and deadlines.
const TICK: Duration = Duration::from_millis(100);

/// A slot as the scheduler sees it.
pub(super) struct Slot {
    /// Stage that the slot's worker has loaded.
    pub(super) stage: Option<StageId>,
    /// Units of that stage in a row.
    pub(super) streak: usize,
    /// Memory that the unit in hand is expected to take, while there is one.
    pub(super) running: Option<u64>,
    assign: Sender<(StageId, Job)>,
}

/// What a slot tells the scheduler.
pub(super) enum Message {
    Progress {
        slot: usize,
        fraction: f64,
        message: String,
    },
    Ended {
        slot: usize,
        job: JobId,
        result: Box<JobResult>,
    },
}

/// How a job ended.
pub(super) struct JobResult {
    pub(super) outcome: Outcome,
    pub(super) seconds: std::collections::BTreeMap<String, f64>,
    pub(super) peak_rss_bytes: u64,
    pub(super) threads: u32,
    pub(super) warnings: Vec<String>,
    pub(super) failure: Option<Failure>,
    pub(super) stderr: Vec<String>,
    /// The stage program itself is unusable: no other unit will fare better.
    pub(super) fatal: Option<crate::Error>,
}

impl JobResult {
    fn of(outcome: Outcome) -> Self {
        let (seconds, warnings, stderr) = Default::default();
        Self {
            outcome,
            seconds,
            peak_rss_bytes: 0,
            threads: 0,
            warnings,
            failure: None,
            stderr,
            fatal: None,
        }
    }

    fn failed(failure: Failure, stderr: Vec<String>) -> Self {
        Self {
            failure: Some(failure),
            stderr,
            ..Self::of(Outcome::Failed)
        }
    }
}

impl Slot {
    /// Starts the slot's thread in a scope.
    pub(super) fn start<'scope>(
        scope: &'scope std::thread::Scope<'scope, '_>,
        number: usize,
        options: &'scope RunOptions,
        messages: Sender<Message>,
    ) -> Self {
        let (assign, jobs) = channel();
        scope.spawn(move || serve(number, options, &jobs, &messages));
        Self {
            stage: None,
            streak: 0,
            running: None,
            assign,
        }
    }

    /// Gives the slot a job. It must be idle.
    pub(super) fn assign(&mut self, stage: StageId, job: Job, memory: u64) {
        if self.stage == Some(stage) {
            self.streak += 1;
        } else {
            self.stage = Some(stage);
            self.streak = 1;
        }
        self.running = Some(memory);
        // The thread lives as long as this sender.
        let _ = self.assign.send((stage, job));
    }
}

fn serve(number: usize, options: &RunOptions, jobs: &Receiver<(StageId, Job)>, messages: &Sender<Message>) {
    let mut worker: Option<WorkerProcess> = None;
    while let Ok((stage, job)) = jobs.recv() {
        let mut progress = |fraction, message| {
            let _ = messages.send(Message::Progress {
                slot: number,
                fraction,
                message,
            });
        };
        let result = Box::new(run(options, &mut worker, stage, &job, &mut progress));
        if messages
            .send(Message::Ended {
                slot: number,
                job: job.job,
                result,
            })
            .is_err()
        {
            break;
        }
    }
}

/// Runs one job on the slot's worker, starting or changing the worker where needed.
fn run(
    options: &RunOptions,
    kept: &mut Option<WorkerProcess>,
    stage: StageId,
    job: &Job,
    progress: &mut dyn FnMut(f64, String),
) -> JobResult {
    let mut worker = match kept.take() {
        Some(worker) if worker.stage == stage => worker,
        other => {
            drop(other);
            match WorkerProcess::start(&options.programs, stage, options.threads, options.grace) {
                Ok(worker) => worker,
                Err(_) if options.interrupts.count() > 0 => return JobResult::of(Outcome::Stopped),
                Err(error) => {
                    return JobResult {
                        fatal: Some(error),
                        ..JobResult::of(Outcome::Stopped)
                    };
                }
            }
        }
    };
    worker.clear_stderr();
    let sent = worker.send(job);
    let start = Instant::now();
    let deadline = options
        .deadline
        .get(&stage)
        .map(|&seconds| Duration::from_secs_f64(seconds.clamp(0.0, 1e9)));
    let mut stopping_since = None::<Instant>;
    let mut overdue = false;
    loop {
        match if sent { worker.listen(TICK) } else { Received::Closed } {
            Received::Event(Event::Progress { fraction, message, .. }) => progress(fraction, message),
            Received::Event(Event::Done {
                job: number,
                seconds,
                peak_rss_bytes,
                threads,
                warnings,
            }) if number == job.job => {
                *kept = stopping_since.is_none().then_some(worker);
                return JobResult {
                    seconds,
                    peak_rss_bytes,
                    threads,
                    warnings,
                    ..JobResult::of(Outcome::Done)
                };
            }
            Received::Event(Event::Failed {
                job: number,
                code,
                message,
                hint,
            }) if number == job.job => {
                let stderr = worker.stderr_tail();
                *kept = stopping_since.is_none().then_some(worker);
                return JobResult::failed(Failure { code, message, hint }, stderr);
            }
            Received::Event(_) | Received::Nothing => {}
            Received::Closed => {
                let status = worker.reap();
                let stderr = worker.stderr_tail();
                return match status {
                    _ if overdue => JobResult::failed(too_slow(job, deadline.unwrap_or_default()), stderr),
                    _ if stopping_since.is_some() => JobResult::of(Outcome::Stopped),
                    Some(status) => JobResult::failed(of_crash(stage, &job.clip_id, status, &stderr), stderr),
                    None => JobResult::of(Outcome::Stopped),
                };
            }
        }
        overdue |= deadline.is_some_and(|deadline| start.elapsed() > deadline);
        let stop = overdue || options.interrupts.count() > 0;
        match stopping_since {
            None if stop => {
                stopping_since = Some(Instant::now());
                worker.terminate();
            }
            // A worker that does not end by itself, or a second signal: no more patience.
            Some(since) if since.elapsed().as_secs_f64() > options.grace + 5.0 || options.interrupts.count() > 1 => {
                worker.kill();
            }
            _ => {}
        }
    }
}

fn too_slow(job: &Job, deadline: Duration) -> Failure {
    let seconds = deadline.as_secs_f64();
    Failure {
        code: FailureCode::Deadline,
        message: format!(
            "`{}` took longer than {seconds} s on clip `{}`",
            job.material.stage, job.clip_id
        ),
        hint: Some("raise `deadline` in [executor], or use more threads".to_owned()),
    }
}
