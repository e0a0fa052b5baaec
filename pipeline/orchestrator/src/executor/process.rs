//! One worker process and the conversation with it.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::process::CommandExt as _;
use std::process::{Child, ChildStdin, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use rogs_schemas::protocol::{Event, Job};
use rustix::process::{Pid, Signal, kill_process};

use crate::error::{Error, Result};
use crate::programs::StagePrograms;
use crate::stage::StageId;

/// Lines of stderr that are kept for the clip's log.
const STDERR_LINES: usize = 40;

/// Longest line that is kept, bytes.
const LINE_BYTES: usize = 4096;

/// A worker may take this long to come up.
const START_SECONDS: u64 = 120;

/// A running worker.
pub(super) struct WorkerProcess {
    pub(super) stage: StageId,
    child: Child,
    stdin: Option<ChildStdin>,
    events: Receiver<Event>,
    stderr: Arc<Mutex<VecDeque<String>>>,
}

/// What came from a worker within some time.
pub(super) enum Received {
    Event(Event),
    Nothing,
    /// The worker closed its events: it is dead or dying.
    Closed,
}

impl WorkerProcess {
    /// Starts a worker and waits until it is ready. The calling thread must outlive it: the worker is told to stop when
    /// the thread that started it ends.
    pub(super) fn start(programs: &StagePrograms, stage: StageId, threads: usize, grace: f64) -> Result<Self> {
        let mut command = programs.command(stage);
        command.args([
            "worker",
            "--threads",
            &threads.to_string(),
            "--grace",
            &grace.to_string(),
        ]);
        command.args(["--parent", &std::process::id().to_string()]);
        // A group of its own: Ctrl-C reaches the orchestrator alone, which then tells its workers.
        command
            .process_group(0)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let program = || programs.words(stage).join(" ");
        let error = |message: String| Error::Program {
            program: program(),
            message,
            hint: None,
        };
        let mut child = command
            .spawn()
            .map_err(|why| error(format!("cannot be started: {why}")))?;
        let (sender, events) = channel();
        if let Some(stdout) = child.stdout.take() {
            std::thread::spawn(move || {
                for line in BufReader::new(stdout).lines().map_while(std::result::Result::ok) {
                    // A line that is not an event can only come from a broken program; the job then fails at its end.
                    let Ok(event) = serde_json::from_str(&line) else { break };
                    if sender.send(event).is_err() {
                        break;
                    }
                }
            });
        }
        let stderr = Arc::new(Mutex::new(VecDeque::new()));
        if let Some(pipe) = child.stderr.take() {
            let kept = Arc::clone(&stderr);
            std::thread::spawn(move || keep_last_lines(pipe, &kept));
        }
        let mut worker = Self {
            stage,
            stdin: child.stdin.take(),
            child,
            events,
            stderr,
        };
        match worker.events.recv_timeout(Duration::from_secs(START_SECONDS)) {
            Ok(Event::Ready { stage: name, .. }) if name == stage.name() => Ok(worker),
            Ok(other) => {
                worker.kill();
                Err(error(format!("does not speak the worker protocol: {other:?}")))
            }
            Err(_) => {
                let stderr = worker.stderr_tail().join(" | ");
                worker.kill();
                Err(error(format!("did not start as a worker: {stderr}")))
            }
        }
    }

    /// Sends a job; false when the worker is gone.
    pub(super) fn send(&mut self, job: &Job) -> bool {
        let Ok(mut line) = serde_json::to_vec(job) else {
            return false;
        };
        line.push(b'\n');
        self.stdin
            .as_mut()
            .is_some_and(|stdin| stdin.write_all(&line).and_then(|()| stdin.flush()).is_ok())
    }

    /// Waits for the next event.
    pub(super) fn listen(&self, timeout: Duration) -> Received {
        match self.events.recv_timeout(timeout) {
            Ok(event) => Received::Event(event),
            Err(RecvTimeoutError::Timeout) => Received::Nothing,
            Err(RecvTimeoutError::Disconnected) => Received::Closed,
        }
    }

    /// Last lines of stderr.
    pub(super) fn stderr_tail(&self) -> Vec<String> {
        self.stderr
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .iter()
            .cloned()
            .collect()
    }

    /// Forgets the lines so far: what follows belongs to the next job.
    pub(super) fn clear_stderr(&self) {
        self.stderr.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    /// Asks the worker to finish or give up its job within its grace period.
    pub(super) fn terminate(&self) {
        // The child is not reaped yet, so its number is nobody else's. One that has ended already needs no signal.
        let _ = kill_process(Pid::from_child(&self.child), Signal::TERM);
    }

    /// Ends the worker where it stands and reaps it.
    pub(super) fn kill(&mut self) -> Option<ExitStatus> {
        let _ = self.child.kill();
        self.child.wait().ok()
    }

    /// Waits for a worker whose events are closed; kills it when it lingers.
    pub(super) fn reap(&mut self) -> Option<ExitStatus> {
        self.stdin = None;
        for _ in 0..1000 {
            if let Ok(Some(status)) = self.child.try_wait() {
                return Some(status);
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        self.kill()
    }
}

impl Drop for WorkerProcess {
    fn drop(&mut self) {
        // The end of stdin is the usual end of a worker.
        self.stdin = None;
        self.reap();
    }
}

fn keep_last_lines(pipe: impl Read, kept: &Mutex<VecDeque<String>>) {
    let mut reader = BufReader::new(pipe);
    let mut line = Vec::new();
    while reader
        .by_ref()
        .take(LINE_BYTES as u64)
        .read_until(b'\n', &mut line)
        .is_ok_and(|count| count > 0)
    {
        let text = String::from_utf8_lossy(&line).trim_end().to_owned();
        line.clear();
        let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() == STDERR_LINES {
            kept.pop_front();
        }
        kept.push_back(text);
    }
}
