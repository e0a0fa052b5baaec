//! The face `worker`: jobs on stdin, events on stdout.

use std::fs::File;
use std::io::{BufRead, Read, Write};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rogs_schemas::protocol::{Event, Job};
use signal_hook::consts::{SIGINT, SIGTERM, SIGUSR1};

use crate::error::{StageError, StageResult};
use crate::exit::{EXIT_OK, EXIT_TEMPORARY, EXIT_USAGE, print_error};
use crate::job::{self, Runner};
use crate::stage::Stage;
use crate::sys::{self, Termination};

/// Longest job line, bytes; a longer one is not ours.
const MAX_LINE: u64 = 4 << 20;

/// Least time between two progress events.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(200);

/// Set when a termination signal came: no further job is begun.
static DRAINING: AtomicBool = AtomicBool::new(false);

/// Set from the moment a job is taken until it has been told how it ended.
static IN_HAND: AtomicBool = AtomicBool::new(false);

/// True once a termination signal came.
pub(crate) fn draining() -> bool {
    DRAINING.load(Ordering::SeqCst)
}

/// A job is in hand while this lives: a termination signal gives it its grace period.
pub(crate) struct InHand;

impl InHand {
    pub(crate) fn take() -> Self {
        IN_HAND.store(true, Ordering::SeqCst);
        Self
    }
}

impl Drop for InHand {
    fn drop(&mut self) {
        IN_HAND.store(false, Ordering::SeqCst);
    }
}

/// On TERM, USR1 or INT: no new job; the one in hand has `grace` to finish, then it is abandoned. Exits 75 at once
/// when no job is in hand.
pub(crate) fn drain_on_signals(grace: Duration) -> std::io::Result<Termination> {
    Termination::watch(&[SIGTERM, SIGUSR1, SIGINT], move || {
        drain(grace);
        leave();
    })
}

/// Gives up the job in hand and ends the process, whatever its other threads are doing.
fn leave() -> ! {
    job::abandon();
    // Without running anything else, which might wait for one of them.
    signal_hook::low_level::exit(i32::from(EXIT_TEMPORARY))
}

/// Ends the process as a signal does when `parent` is gone. The system says so by a signal where it can; this is for the
/// others, and for a signal that came before it was waited for.
fn watch_parent(parent: u32, grace: Duration) -> std::io::Result<()> {
    let watch = move || {
        while std::os::unix::process::parent_id() == parent {
            std::thread::sleep(Duration::from_millis(500));
        }
        drain(grace);
        leave();
    };
    std::thread::Builder::new()
        .name("parent".into())
        .spawn(watch)
        .map(|_| ())
}

/// Begins no further job and waits until the one in hand has ended, for `grace` at most.
fn drain(grace: Duration) {
    DRAINING.store(true, Ordering::SeqCst);
    let until = Instant::now() + grace;
    while IN_HAND.load(Ordering::SeqCst) && Instant::now() < until {
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Serves jobs until the end of stdin, or until `parent` is gone. `begin` prepares the process, after it hears signals.
pub(crate) fn serve<S: Stage>(
    grace: Duration,
    parent: Option<u32>,
    begin: impl FnOnce() -> StageResult<()>,
) -> ExitCode {
    let set_up = sys::take_stdout().and_then(|events| {
        let termination = drain_on_signals(grace)?;
        parent.map_or(Ok(()), |parent| watch_parent(parent, grace))?;
        Ok((Mutex::new(events), termination))
    });
    let (events, termination) = match set_up {
        Ok(set_up) => set_up,
        Err(error) => {
            crate::message!("error: cannot set up the worker: {error}");
            return ExitCode::from(EXIT_USAGE);
        }
    };
    if let Err(error) = begin() {
        print_error(&error);
        return ExitCode::from(EXIT_USAGE);
    }
    let ready = Event::Ready {
        stage: S::NAME.to_owned(),
        stage_version: S::VERSION,
    };
    if !send(&events, &ready) {
        return ExitCode::from(EXIT_TEMPORARY);
    }
    let mut runner = Runner::<S>::new();
    let mut stdin = std::io::stdin().lock();
    let mut line = Vec::new();
    loop {
        line.clear();
        match stdin.by_ref().take(MAX_LINE).read_until(b'\n', &mut line) {
            // Whoever sent a signal and then closed the pipe gets the answer to the signal.
            Ok(0) if termination.arrived() => return ExitCode::from(EXIT_TEMPORARY),
            Ok(0) => return ExitCode::from(EXIT_OK),
            Ok(_) => {}
            Err(error) => {
                crate::message!("error: cannot read jobs: {error}");
                return ExitCode::from(EXIT_TEMPORARY);
            }
        }
        if line.trim_ascii().is_empty() {
            continue;
        }
        let _in_hand = InHand::take();
        if draining() {
            return ExitCode::from(EXIT_TEMPORARY);
        }
        let job: Job = match serde_json::from_slice(&line) {
            Ok(job) => job,
            Err(error) => {
                crate::message!("error: a line on stdin is not a job: {error}");
                return ExitCode::from(EXIT_USAGE);
            }
        };
        if !send(&events, &Event::Started { job: job.job }) {
            return ExitCode::from(EXIT_TEMPORARY);
        }
        let mut last = None::<Instant>;
        let mut progress = |fraction: f64, message: &str| {
            if last.is_none_or(|last| last.elapsed() >= PROGRESS_INTERVAL) {
                last = Some(Instant::now());
                send(
                    &events,
                    &Event::Progress {
                        job: job.job,
                        fraction,
                        message: message.to_owned(),
                    },
                );
            }
        };
        let event = match runner.run(&job, &mut progress) {
            Ok(report) => Event::Done {
                job: job.job,
                seconds: report.seconds,
                peak_rss_bytes: sys::peak_rss_bytes(),
                threads: sys::threads(),
                warnings: report.warnings,
            },
            Err(StageError { code, message, hint }) => Event::Failed {
                job: job.job,
                code,
                message,
                hint,
            },
        };
        // Nobody listens any more: the output is in its place, so nothing is lost by stopping.
        if !send(&events, &event) || draining() {
            return ExitCode::from(EXIT_TEMPORARY);
        }
    }
}

/// Writes one event as one line in one call; false when nobody listens any more.
fn send(events: &Mutex<File>, event: &Event) -> bool {
    let mut line = serde_json::to_vec(event).unwrap_or_default();
    line.push(b'\n');
    events.lock().is_ok_and(|mut events| events.write_all(&line).is_ok())
}
