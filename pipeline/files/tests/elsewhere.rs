//! Writers and holders of locks that this process cannot see: in another space of process numbers, as on another host.
#![allow(clippy::unwrap_used, clippy::expect_used)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, SystemTime};

use rogs_needs::needs;

/// `cargo test` builds examples beside the tests.
fn hold() -> PathBuf {
    let test = std::env::current_exe().unwrap();
    test.ancestors().nth(2).unwrap().join("examples/hold")
}

/// A command in a space of process numbers of its own.
fn elsewhere() -> Command {
    let mut command = Command::new("unshare");
    command.args(["--pid", "--fork", "--mount-proc", "--kill-child"]);
    command.arg(hold());
    command
}

/// Starts the helper and waits until it stands.
fn start(mut command: Command, what: &str, path: &Path) -> Child {
    command.arg(what).arg(path).stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    assert_eq!(line, "ready\n");
    child
}

fn finish(mut child: Child) {
    drop(child.stdin.take());
    assert!(child.wait().unwrap().success());
}

fn removed(mut command: Command, folder: &Path) -> String {
    let output = command.arg("sweep").arg(folder).output().unwrap();
    String::from_utf8(output.stdout).unwrap()
}

#[needs(mount)]
#[test]
fn what_a_living_writer_elsewhere_writes_is_not_removed() {
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("a.r4c");
    let there = start(elsewhere(), "write", &path);
    assert_eq!(rogs_files::sweep(scratch.path()).unwrap(), [] as [PathBuf; 0]);
    finish(there);
    assert_eq!(std::fs::read(&path).unwrap(), b"one two");
    // The other way round, and beside each other.
    let here = start(Command::new(hold()), "write", &path);
    assert_eq!(removed(elsewhere(), scratch.path()), "removed 0\n");
    assert_eq!(removed(Command::new(hold()), scratch.path()), "removed 0\n");
    finish(here);
    // One that was killed: here it is known to be gone, there after a day.
    let mut killed = start(Command::new(hold()), "write", &path);
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert_eq!(removed(elsewhere(), scratch.path()), "removed 0\n");
    assert_eq!(removed(Command::new(hold()), scratch.path()), "removed 1\n");
    let mut killed = start(elsewhere(), "write", &path);
    killed.kill().unwrap();
    killed.wait().unwrap();
    for entry in std::fs::read_dir(scratch.path()).unwrap() {
        let file = std::fs::File::options()
            .write(true)
            .open(entry.unwrap().path())
            .unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(2 * 86_400))
            .unwrap();
    }
    assert_eq!(rogs_files::sweep(scratch.path()).unwrap().len(), 1);
    assert_eq!(std::fs::read_dir(scratch.path()).unwrap().count(), 1);
}

#[needs(mount)]
#[test]
fn a_lock_elsewhere_is_a_lock_here() {
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("lock");
    let there = start(elsewhere(), "lock", &path);
    let error = rogs_files::Lock::acquire(&path, "me").unwrap_err();
    assert_eq!(error.to_string(), "held by one that stands");
    finish(there);
    rogs_files::Lock::acquire(&path, "me").unwrap();
}

/// Makes every lock and every flush of a folder fail, as some network file systems do.
const WITHOUT: &str = r#"
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdlib.h>
#include <sys/stat.h>
int flock(int file, int how) { errno = getenv("NO_LOCKD") ? ENOLCK : ENOSYS; return -1; }
int fsync(int file) {
    struct stat status;
    if (fstat(file, &status) == 0 && S_ISDIR(status.st_mode)) { errno = EINVAL; return -1; }
    return ((int (*)(int))dlsym(RTLD_NEXT, "fsync"))(file);
}
"#;

#[needs(cc, mount)]
#[test]
fn where_a_file_system_has_no_locks_a_lease_keeps_others_out() {
    let scratch = tempfile::tempdir().unwrap();
    let (source, library, path) = (
        scratch.path().join("without.c"),
        scratch.path().join("without.so"),
        scratch.path().join("lock"),
    );
    std::fs::write(&source, WITHOUT).unwrap();
    let made = Command::new("cc")
        .args(["-shared", "-fPIC", "-o"])
        .args([&library, &source])
        .arg("-ldl")
        .status();
    assert!(made.unwrap().success());
    for lockd in [None, Some(("NO_LOCKD", "1"))] {
        for here in [true, false] {
            let without = |mut command: Command| {
                command.env("LD_PRELOAD", &library).envs(lockd);
                command
            };
            let own = if here { Command::new(hold()) } else { elsewhere() };
            let first = start(without(own), "lock", &path);
            assert!(rogs_files::is_locked(&path));
            let second = without(Command::new(hold())).arg("lock").arg(&path).output().unwrap();
            let said = String::from_utf8_lossy(&second.stderr).into_owned();
            assert!(said.contains("one that stands"), "{said}");
            finish(first);
            assert!(!rogs_files::is_locked(&path));
            let file = scratch.path().join("file");
            finish(start(without(Command::new(hold())), "write", &file));
            assert_eq!(std::fs::read(file).unwrap(), b"one two");
        }
    }
}
