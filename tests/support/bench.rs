//! Timing, memory and peers of benches.
#![allow(dead_code, reason = "each bench uses a part")]

use std::path::Path;
use std::process::Command;
use std::time::Instant;

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
