//! What the standard library does not offer: counting termination signals, signalling children, memory of the machine.
//!
//! The only unsafe code of the crate: calls of libc whose arguments are plain numbers or owned here.
#![allow(unsafe_code)]

use std::sync::atomic::{AtomicUsize, Ordering};

/// Termination signals since the start.
static SIGNALS: AtomicUsize = AtomicUsize::new(0);

/// Only touches an atomic and calls `_exit`; both are async-signal-safe.
extern "C" fn count_signal(_signal: libc::c_int) {
    if SIGNALS.fetch_add(1, Ordering::SeqCst) >= 2 {
        // SAFETY: ends the process without running anything else.
        unsafe { libc::_exit(130) };
    }
}

/// Termination signals (Ctrl-C, TERM, HUP) of this process, counted instead of fatal: the first asks to finish, the
/// second to stop at once; the third ends the process where it stands.
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
        for signal in [libc::SIGINT, libc::SIGTERM, libc::SIGHUP] {
            // SAFETY: `action` is a plain struct for which all zeros is valid; the handler is async-signal-safe.
            unsafe {
                let mut action: libc::sigaction = std::mem::zeroed();
                action.sa_sigaction = count_signal as *const () as usize;
                action.sa_flags = libc::SA_RESTART;
                libc::sigemptyset(&mut action.sa_mask);
                if libc::sigaction(signal, &action, std::ptr::null_mut()) != 0 {
                    return Err(std::io::Error::last_os_error());
                }
            }
        }
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

/// Sends a signal to a child that has not been waited for.
pub(crate) fn signal(child: &std::process::Child, signal: i32) {
    if let Ok(id) = libc::pid_t::try_from(child.id()) {
        // SAFETY: plain numbers; the child is not reaped yet, so its number is not anyone else's.
        unsafe { libc::kill(id, signal) };
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
    use std::os::unix::ffi::OsStrExt as _;
    let path = std::ffi::CString::new(path.as_os_str().as_bytes()).ok()?;
    // SAFETY: `path` is a terminated string that lives through the call; `stat` is a plain struct that the call fills.
    unsafe {
        let mut stat: libc::statvfs = std::mem::zeroed();
        (libc::statvfs(path.as_ptr(), &mut stat) == 0).then(|| stat.f_bavail as u64 * stat.f_frsize as u64)
    }
}
