//! A writer that is killed leaves the old file, the new one, or none; never half of one.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![cfg(unix)]

mod common;

use std::process::{Command, Stdio};
use std::time::Duration;

use common::Scratch;
use rogs_files::sweep;
use rogs_r4c::{verify, write_record};

const FOLDER: &str = "ROGS_TEST_KILL_FOLDER";

/// The child: writes files until it is killed.
#[test]
#[ignore = "the writer that `a_killed_writer_leaves_whole_files` starts and kills"]
fn writer() {
    let folder = std::path::PathBuf::from(std::env::var_os(FOLDER).expect(FOLDER));
    let field = common::field();
    loop {
        for name in ["a.r4c", "b.r4c", "c.r4c"] {
            write_record(&folder.join(name), &field, &common::provenance("field")).unwrap();
        }
    }
}

#[test]
fn a_killed_writer_leaves_whole_files() {
    let scratch = Scratch::new("kill");
    let mut seen = 0;
    for round in 0..25u64 {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "writer", "--ignored"])
            .env(FOLDER, &scratch.0)
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        // A busy machine may start the writer late: the first round waits for its first file, however long that takes.
        while round == 0 && !scratch.0.join("a.r4c").exists() {
            assert!(child.try_wait().unwrap().is_none(), "the writer stopped by itself");
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(Duration::from_micros(4_000 + 1_700 * round));
        child.kill().unwrap();
        child.wait().unwrap();
        sweep(&scratch.0).unwrap();
        for entry in std::fs::read_dir(&scratch.0).unwrap() {
            let path = entry.unwrap().path();
            assert_eq!(
                path.extension().unwrap(),
                "r4c",
                "round {round}: {} is left",
                path.display()
            );
            verify(&path).unwrap_or_else(|error| panic!("round {round}: {error}"));
            seen += 1;
        }
    }
    assert!(
        seen > 0,
        "the writer was killed before it wrote anything, in every round"
    );
}
