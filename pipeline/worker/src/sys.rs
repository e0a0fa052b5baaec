//! What the standard library does not offer: termination signals, the private event stream, peak memory.
//!
//! The only unsafe code of the crate: four calls of libc whose arguments are owned here.
#![allow(unsafe_code)]

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::{AsRawFd, FromRawFd};
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};

/// Write end of the pipe that the signal handler writes to; -1 until [`on_termination`] ran.
static SIGNAL_PIPE: AtomicI32 = AtomicI32::new(-1);

/// Set by the handler itself, before the thread that acts on the signal has had its turn.
static SIGNALLED: AtomicBool = AtomicBool::new(false);

/// True once one of the signals of [`on_termination`] has arrived.
pub(crate) fn signalled() -> bool {
    SIGNALLED.load(Ordering::SeqCst)
}

/// Only stores an atomic and calls `write`, which are async-signal-safe.
extern "C" fn handle_signal(signal: libc::c_int) {
    SIGNALLED.store(true, Ordering::SeqCst);
    let byte = [signal as u8];
    // SAFETY: the buffer lives on this stack; a bad descriptor only makes `write` fail.
    unsafe { libc::write(SIGNAL_PIPE.load(Ordering::Relaxed), byte.as_ptr().cast(), 1) };
}

/// Calls `act` with the signal's number, on a thread of its own, for each of the given signals that arrives.
pub(crate) fn on_termination(signals: &[i32], mut act: impl FnMut(i32) + Send + 'static) -> std::io::Result<()> {
    let (mut reader, writer) = std::io::pipe()?;
    let descriptor = writer.as_raw_fd();
    // The write end stays open for the life of the process.
    std::mem::forget(writer);
    SIGNAL_PIPE.store(descriptor, Ordering::Relaxed);
    for &signal in signals {
        // SAFETY: `action` is a plain struct for which all zeros is valid; the handler is async-signal-safe.
        unsafe {
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = handle_signal as *const () as usize;
            action.sa_flags = libc::SA_RESTART;
            libc::sigemptyset(&mut action.sa_mask);
            if libc::sigaction(signal, &action, std::ptr::null_mut()) != 0 {
                return Err(std::io::Error::last_os_error());
            }
        }
    }
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        let mut byte = [0];
        while reader.read_exact(&mut byte).is_ok() {
            act(i32::from(byte[0]));
        }
    })?;
    Ok(())
}

/// Takes standard output for events and points descriptor 1 at standard error, so that nothing a library prints can
/// get between two events.
pub(crate) fn take_stdout() -> std::io::Result<File> {
    std::io::stdout().flush()?;
    // SAFETY: 1 and 2 are open descriptors of this process; the duplicate is owned by the returned file alone.
    unsafe {
        let events = libc::fcntl(1, libc::F_DUPFD_CLOEXEC, 3);
        if events < 0 || libc::dup2(2, 1) < 0 {
            return Err(std::io::Error::last_os_error());
        }
        Ok(File::from_raw_fd(events))
    }
}

/// Asks the system to send SIGTERM when the process that started us dies (Linux; elsewhere the end of stdin tells).
/// False when `parent` is gone already.
pub(crate) fn die_with_parent(parent: u32) -> bool {
    #[cfg(target_os = "linux")]
    // SAFETY: prctl with these constants touches no memory of ours.
    unsafe {
        libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGTERM);
    }
    std::os::unix::process::parent_id() == parent
}

/// Threads that stages compute with.
pub(crate) fn threads() -> u32 {
    rayon::current_num_threads() as u32
}

/// Largest resident memory of this process so far, bytes; 0 where the system does not tell.
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
    if let Some(kib) = status.lines().find_map(kibibytes) {
        return kib * 1024;
    }
    // SAFETY: `usage` is a plain struct for which all zeros is valid, and getrusage only fills it.
    let usage = unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        libc::getrusage(libc::RUSAGE_SELF, &mut usage);
        usage
    };
    let unit = if cfg!(target_os = "macos") { 1 } else { 1024 };
    u64::try_from(usage.ru_maxrss).unwrap_or(0) * unit
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
