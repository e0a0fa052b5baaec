//! What the standard library does not offer: counting termination signals, memory and disk of the machine.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

/// Termination signals since the start.
static SIGNALS: AtomicUsize = AtomicUsize::new(0);

/// Termination signals (Ctrl-C, TERM) of this process, counted instead of fatal: the first asks to finish, the second to
/// stop at once; the third ends the process where it stands. A terminal that goes away (HUP) ends nothing.
#[derive(Debug, Clone, Copy)]
pub struct Interrupts {
    counted: bool,
}

impl Interrupts {
    /// Starts counting.
    ///
    /// # Errors
    /// When the system refuses the handler.
    pub fn install() -> std::io::Result<Self> {
        signal_hook::flag::register(SIGHUP, Arc::default())?;
        let mut signals = Signals::new([SIGINT, SIGTERM])?;
        std::thread::Builder::new().name("signals".into()).spawn(move || {
            for _ in signals.forever() {
                if SIGNALS.fetch_add(1, Ordering::SeqCst) >= 2 {
                    // Without running anything else.
                    signal_hook::low_level::exit(130);
                }
            }
        })?;
        Ok(Self { counted: true })
    }

    /// Never interrupted: signals keep their usual meaning.
    #[must_use]
    pub fn none() -> Self {
        Self { counted: false }
    }

    /// Signals so far.
    #[must_use]
    pub fn count(self) -> usize {
        if self.counted {
            SIGNALS.load(Ordering::SeqCst)
        } else {
            0
        }
    }
}

/// Memory that this process may still take, bytes: what the system has free, bounded by the control group.
pub(crate) fn available_memory() -> u64 {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let meminfo = read("/proc/meminfo");
    let kib = meminfo.lines().find_map(|line| {
        line.strip_prefix("MemAvailable:")?
            .trim()
            .strip_suffix("kB")?
            .trim()
            .parse()
            .ok()
    });
    let free = kib.map_or(4 << 30, |kib: u64| kib * 1024);
    let number = |path: &str| read(path).trim().parse::<u64>().ok();
    let left = |limit: &str, used: &str| Some(number(limit)?.saturating_sub(number(used)?));
    let group = left("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current");
    group.map_or(free, |group| free.min(group))
}

/// Bytes free for this user on the file system of a path.
pub(crate) fn free_disk(path: &std::path::Path) -> Option<u64> {
    let found = rustix::fs::statvfs(path).ok()?;
    Some(found.f_bavail * found.f_frsize)
}
