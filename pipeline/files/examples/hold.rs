//! `hold write PATH`: writes a file and stands still half way. `hold lock PATH`: holds a lock. `hold sweep FOLDER`: sweeps.
//!
//! Says `ready` when it stands, and goes on at the end of standard input. For tests that look at it from another space of
//! process numbers.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a helper of tests: it fails aloud")]

use std::io::{Read as _, Write as _};
use std::path::Path;

fn stand() {
    println!("ready");
    let _ = std::io::stdin().read_to_end(&mut Vec::new());
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [what, path] = &words[..] else {
        println!("usage: hold write|lock|sweep PATH");
        return;
    };
    let path = Path::new(path);
    match what.as_str() {
        "write" => rogs_files::write_with(path, |out| {
            out.write_all(b"one ")?;
            out.flush()?;
            stand();
            out.write_all(b"two")
        })
        .unwrap(),
        "lock" => {
            let lock = rogs_files::Lock::acquire(path, "one that stands").unwrap();
            stand();
            drop(lock);
        }
        _ => println!("removed {}", rogs_files::sweep(path).unwrap().len()),
    }
}
