//! What the standard library does not offer: termination signals, the private event stream, peak memory.

use std::fs::File;
use std::io::Write;
use std::os::fd::AsFd as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::iterator::Signals;

/// Termination signals of this process.
#[derive(Debug, Clone)]
pub(crate) struct Termination {
    /// Set by the signal handler itself, before the thread that acts on the signal has had its turn.
    arrived: Arc<AtomicBool>,
}

impl Termination {
    /// Calls `act`, on a thread of its own, for each of the given signals that arrives.
    pub(crate) fn watch(signals: &[i32], mut act: impl FnMut() + Send + 'static) -> std::io::Result<Self> {
        let arrived = Arc::new(AtomicBool::new(false));
        for &signal in signals {
            signal_hook::flag::register(signal, Arc::clone(&arrived))?;
        }
        let mut signals = Signals::new(signals)?;
        std::thread::Builder::new()
            .name("signals".into())
            .spawn(move || signals.forever().for_each(|_| act()))?;
        Ok(Self { arrived })
    }

    /// True once one of the signals has arrived.
    pub(crate) fn arrived(&self) -> bool {
        self.arrived.load(Ordering::SeqCst)
    }
}

/// Takes standard output for events and points descriptor 1 at standard error, so that nothing a library prints can
/// get between two events.
pub(crate) fn take_stdout() -> std::io::Result<File> {
    let mut stdout = std::io::stdout();
    stdout.flush()?;
    let events = stdout.as_fd().try_clone_to_owned()?;
    rustix::stdio::dup2_stdout(std::io::stderr())?;
    Ok(File::from(events))
}

/// Asks the system to send SIGTERM when the process that started us dies (Linux; elsewhere the end of stdin tells).
/// False when `parent` is gone already.
pub(crate) fn die_with_parent(parent: u32) -> bool {
    #[cfg(target_os = "linux")]
    // Where the system refuses, the end of stdin tells here as well.
    let _ = rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::TERM));
    std::os::unix::process::parent_id() == parent
}

/// Threads that stages compute with.
pub(crate) fn threads() -> u32 {
    rayon::current_num_threads() as u32
}

/// Largest resident memory of this process so far, bytes; 0 where the system has no `/proc`.
#[must_use]
pub fn peak_rss_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let kibibytes = |line: &str| {
        line.strip_prefix("VmHWM:")?
            .trim()
            .strip_suffix("kB")?
            .trim()
            .parse::<u64>()
            .ok()
    };
    status.lines().find_map(kibibytes).map_or(0, |kib| kib * 1024)
}

/// Largest block that [`keep_memory`] keeps, bytes: what glibc allows on 64-bit machines.
#[cfg(all(target_os = "linux", target_env = "gnu", target_pointer_width = "64"))]
const KEPT_BYTES: libc::c_int = 32 << 20;

/// Has the allocator keep what is freed for the next that asks, instead of giving blocks of more than a few hundred KiB
/// back to the system each time, which then fills every page with zeros anew. For programs whose work allocates the same
/// sizes over and over; the peak of memory stays what it is. Does nothing where the C library is not glibc.
#[allow(unsafe_code)]
pub fn keep_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu", target_pointer_width = "64"))]
    // SAFETY: these calls only set numbers that later allocations obey.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, KEPT_BYTES);
        libc::mallopt(libc::M_TRIM_THRESHOLD, libc::c_int::MAX);
        // Blocks that one thread frees are of use to all.
        libc::mallopt(libc::M_ARENA_MAX, 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peak_memory_grows_with_what_is_touched() {
        let before = peak_rss_bytes();
        assert!(before > 0);
        let block = std::hint::black_box(vec![1u8; 64 << 20]);
        assert!(peak_rss_bytes() >= before + (32 << 20), "{}", block.len());
    }
}
