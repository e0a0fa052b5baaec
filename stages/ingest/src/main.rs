//! `rogs-ingest`: the faces of the stage, and `list` and `caches` `ROOT [--json]`.

use std::ffi::OsString;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments: Vec<OsString> = std::env::args_os().skip(1).collect();
    match rogs_ingest::list_main(&arguments) {
        Some(code) => code,
        None => rogs_worker::stage_main::<rogs_ingest::Ingest>(),
    }
}
