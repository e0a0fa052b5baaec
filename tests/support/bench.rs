//! Timing, memory and peers of benches.
#![allow(dead_code, reason = "each bench uses a part")]

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Instant;

/// The processor that a benchmark runs on, with the vector instructions that decide which kernels it takes.
pub(crate) fn processor() -> String {
    let told = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let field = |name: &str| {
        let line = told.lines().find(|line| line.starts_with(name))?;
        Some(line.split_once(':')?.1.trim().to_owned())
    };
    let (name, flags) = (
        field("model name").unwrap_or_default(),
        field("flags").unwrap_or_default(),
    );
    let has = |wanted: &&str| flags.split_whitespace().any(|flag| flag == *wanted);
    let sets: Vec<&str> = ["avx2", "fma", "avx512f", "avx512_bf16", "amx_bf16"]
        .into_iter()
        .filter(has)
        .collect();
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    format!("{name} ({}), {cores} cores", sets.join(" "))
}

/// A peer script that does a piece of work for every line and answers it with one, so that both sides take turns.
pub(crate) struct Peer {
    process: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl Peer {
    /// Starts a script with the Python that `ROGS_PEER_PYTHON` names and tells it its job; `None` with the reason printed.
    pub(crate) fn start(script: &str, job: &str) -> Option<Self> {
        let Some(python) = std::env::var_os("ROGS_PEER_PYTHON") else {
            println!("peers skipped: set ROGS_PEER_PYTHON to a Python with what benches/peers/{script} imports");
            return None;
        };
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/peers").join(script);
        let mut command = Command::new(python);
        let started = command.arg(path).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
        let mut process = started.ok()?;
        let (mut input, output) = (process.stdin.take()?, BufReader::new(process.stdout.take()?));
        writeln!(input, "{job}").ok()?;
        Some(Self { process, input, output })
    }

    /// What it answers to a line; `None` when it has died, with its message above.
    pub(crate) fn turn(&mut self, what: &str) -> Option<String> {
        let mut line = String::new();
        writeln!(self.input, "{what}").and_then(|()| self.input.flush()).ok()?;
        (self.output.read_line(&mut line).ok()? > 0).then_some(line)
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Median and least seconds of several runs after a warm-up.
pub(crate) fn seconds(runs: usize, mut work: impl FnMut()) -> (f64, f64) {
    work();
    let mut times: Vec<f64> = (0..runs)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    (times[times.len() / 2], times[0])
}

/// Processor time of all threads of this process so far, seconds: what a busy machine can measure. NaN where the system
/// does not tell.
pub(crate) fn processor_seconds() -> f64 {
    let Ok(threads) = std::fs::read_dir("/proc/self/task") else {
        return f64::NAN;
    };
    let of = |thread: std::io::Result<std::fs::DirEntry>| -> Option<f64> {
        let text = std::fs::read_to_string(thread.ok()?.path().join("schedstat")).ok()?;
        Some(text.split(' ').next()?.parse::<f64>().ok()? * 1e-9)
    };
    threads.filter_map(of).sum()
}

/// Wall and processor seconds of a piece of work.
pub(crate) fn timed<T>(work: impl FnOnce() -> T) -> (T, [f64; 2]) {
    let (start, processor) = (Instant::now(), processor_seconds());
    let result = work();
    (result, [start.elapsed().as_secs_f64(), processor_seconds() - processor])
}

/// Peak resident memory of this process, MiB, where the system tells.
pub(crate) fn peak_memory_mib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM"));
    let kib = line
        .and_then(|line| line.split_whitespace().nth(1))
        .and_then(|word| word.parse::<f64>().ok());
    kib.unwrap_or(f64::NAN) / 1024.0
}

/// Runs a peer script with the Python that `ROGS_PEER_PYTHON` names; its output, or `None` with the reason printed.
pub(crate) fn run_peer(script: &str, arguments: &[&std::ffi::OsStr]) -> Option<String> {
    let Some(python) = std::env::var_os("ROGS_PEER_PYTHON") else {
        println!(
            "peers skipped: set ROGS_PEER_PYTHON to a Python with the packages that benches/peers/{script} imports"
        );
        return None;
    };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/peers").join(script);
    let output = Command::new(python).arg(path).args(arguments).output().ok()?;
    if !output.status.success() {
        println!("peers failed: {}", String::from_utf8_lossy(&output.stderr));
        return None;
    }
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}
