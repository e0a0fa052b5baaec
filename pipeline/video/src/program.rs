//! The programs `ffmpeg` and `ffprobe`.

use std::ffi::OsString;
use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;

/// The program that decodes and encodes.
pub const FFMPEG: &str = "ffmpeg";
/// The program that says what a video holds.
pub const FFPROBE: &str = "ffprobe";
/// What to do where they cannot be started.
pub const INSTALL: &str = "install ffmpeg (it brings ffprobe) and see that it is on the PATH; `rogs doctor` checks it";

/// Bytes that are kept of what a program says.
const SAID: u64 = 4096;

/// A command of one of the programs, which asks nobody and says errors only.
#[must_use]
pub fn command(program: &str) -> Command {
    let mut command = Command::new(program);
    command.args(["-v", "error"]).stdin(Stdio::null());
    command
}

/// What a program prints to standard output; `None` where it cannot be run or fails.
#[must_use]
pub fn printed(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program)
        .args(arguments)
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    output.status.success().then_some(text)
}

/// A path as the programs must see it: never an option, never another protocol.
#[must_use]
pub fn url(path: &Path) -> OsString {
    let mut url = OsString::from("file:");
    url.push(path);
    url
}

/// The last line that says something, cut to what a message may hold.
#[must_use]
pub fn last_line(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes);
    let line = text
        .lines()
        .rev()
        .find(|line| !line.trim().is_empty())
        .unwrap_or("it gave no reason");
    line.trim().chars().take(300).collect()
}

/// A child that does not outlive its owner.
#[derive(Debug)]
pub struct Running(pub Child);

impl Drop for Running {
    fn drop(&mut self) {
        // Both fail only when it has ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Reads what a program says in a thread of its own, so that a talkative one does not block; the beginning is kept.
pub fn listen(mut complaints: impl Read + Send + 'static) -> JoinHandle<std::io::Result<Vec<u8>>> {
    std::thread::spawn(move || {
        let mut text = Vec::new();
        let kept = complaints.by_ref().take(SAID).read_to_end(&mut text);
        let drained = std::io::copy(&mut complaints, &mut std::io::sink());
        kept.and(drained).map(|_| text)
    })
}

/// What [`listen`] heard.
#[must_use]
pub fn heard(listener: JoinHandle<std::io::Result<Vec<u8>>>) -> Vec<u8> {
    listener.join().ok().and_then(Result::ok).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_never_an_option() {
        assert_eq!(url(Path::new("-i")), "file:-i");
    }

    #[test]
    fn the_last_line_that_says_something_is_told() {
        assert_eq!(last_line(b"one\ntwo \n\n"), "two");
        assert_eq!(last_line(b"\n"), "it gave no reason");
        let long = heard(listen(std::io::repeat(b'x').take(1 << 20)));
        assert_eq!((long.len() as u64, last_line(&long).len()), (SAID, 300));
    }

    #[test]
    fn a_program_that_is_not_there_prints_nothing() {
        assert_eq!(printed("no-such-program-of-rogs", &["-version"]), None);
    }
}
