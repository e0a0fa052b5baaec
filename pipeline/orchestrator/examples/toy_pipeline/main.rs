//! A pipeline of toy stages in one program, as `rogs` is one: `toy_pipeline stage NAME one|worker|describe ...`.
//!
//! An episode is a text file `NAME.txt`. Its words make stages misbehave: `fail@lift`, `panic@lift`, `abort@lift`,
//! `kill@lift`, `hang@lift`, `stop@lift` (ignores all but KILL), `io@lift` (fails the first time only), `memory@lift`
//! (takes 300 MB). All records are real ones, small, with pictures in them, so that everything that reads run folders can
//! be tested without the networks.
//!
//! Tests that stop a run at a certain moment set `ROGS_TOY_HOLD=CLIP@STAGE@begin|end` and `ROGS_TOY_FOLDER`: the worker
//! that gets there first writes its process number to `held` in that folder and waits for a file `release`. Every worker
//! holds a shared lock on the file `alive` there, so that a test can wait until all have ended.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod misbehaviour;
mod stages;

use std::ffi::OsString;
use std::path::Path;
use std::process::ExitCode;

use rogs_orchestrator::executor::ProgressMode;
use rogs_orchestrator::programs::StagePrograms;
use rogs_orchestrator::stage::StageId;
use rogs_orchestrator::{Error, Exit, Interrupts, Prepared};
use rogs_worker::stage_main_from;

use self::misbehaviour::keep_alive_lock;
use self::stages::{Ingest, Kappa, Lift, Maps, Refine, Score};

/// The face `list` of ingest: every text file is an episode; a word `frames=N` says how long it is.
fn list(root: &Path) -> std::io::Result<String> {
    let mut episodes = Vec::new();
    for entry in std::fs::read_dir(root)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if let Some(stem) = name.strip_suffix(".txt") {
            let text = std::fs::read_to_string(entry.path()).unwrap_or_default();
            let mut words = text.split_whitespace();
            let frames: Option<u64> = words.find_map(|word| word.strip_prefix("frames=")?.parse().ok());
            episodes.push(
                serde_json::json!({"episode_id": stem, "layout": "toy", "selector": stem, "files": [name],
                "frames": frames}),
            );
        }
    }
    Ok(serde_json::Value::Array(episodes).to_string())
}

/// `toy_pipeline run|submit MANIFEST WORKERS THREADS`: the orchestrator as a process of its own, for tests that kill it.
fn run(arguments: &[OsString]) -> ExitCode {
    let number = |index: usize| arguments[index].to_string_lossy().parse().unwrap_or(1);
    let result = StagePrograms::this_program().and_then(|programs| {
        let mut prepared = Prepared::load(Path::new(&arguments[1]), programs)?;
        (prepared.options.workers, prepared.options.threads) = (number(2), number(3));
        prepared.options.interrupts = Interrupts::install().map_err(|error| Error::usage(error.to_string()))?;
        prepared.options.progress = ProgressMode::Lines;
        if arguments[0] == "submit" {
            let program = std::env::current_exe().map_err(|error| Error::usage(error.to_string()))?;
            let finally = ["sh".into(), "-c".into(), finish_line(&program, &prepared.plan.run)];
            let finally = std::env::var_os("ROGS_TOY_FINALLY").is_some().then_some(&finally[..]);
            let submission = rogs_orchestrator::slurm::submit(&prepared, finally, false)?;
            println!(
                "{}",
                serde_json::json!({"ids": submission.ids, "shards": submission.shards})
            );
            return Ok(Exit::Done);
        }
        Ok(prepared.run()?.exit)
    });
    match result {
        Ok(exit) => ExitCode::from(exit.code()),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit().code())
        }
    }
}

/// What the job at the end of a submission runs: it keeps the state of the run as a text.
fn finish_line(program: &Path, run: &Path) -> String {
    format!(
        "{} status {} > {}",
        program.display(),
        run.display(),
        run.join("final.txt").display()
    )
}

fn main() -> ExitCode {
    let mut arguments: Vec<OsString> = std::env::args_os().skip(1).collect();
    if arguments.len() == 4 && (arguments[0] == "run" || arguments[0] == "submit") {
        return run(&arguments);
    }
    if arguments.len() == 2 && arguments[0] == "status" {
        return match rogs_orchestrator::status::status(Path::new(&arguments[1])) {
            Ok(status) => {
                print!("{}", status.table());
                ExitCode::from(status.exit.code())
            }
            Err(error) => {
                eprintln!("error: {error}");
                ExitCode::from(error.exit().code())
            }
        };
    }
    if arguments.len() < 2 || arguments[0] != "stage" {
        // `cargo test` starts examples without arguments nowhere; a person gets told.
        eprintln!("usage: toy_pipeline stage NAME one|worker|describe ...");
        return ExitCode::from(2);
    }
    let stage = arguments.remove(1).to_string_lossy().into_owned();
    arguments.remove(0);
    if arguments
        .first()
        .is_some_and(|face| face == "worker" || face == "batch")
    {
        keep_alive_lock();
    }
    match stage.parse() {
        Ok(StageId::Ingest) if arguments.first().is_some_and(|word| word == "list") => {
            match list(Path::new(&arguments[1])) {
                Ok(text) => {
                    println!("{text}");
                    ExitCode::SUCCESS
                }
                Err(error) => {
                    eprintln!("error: {error}");
                    ExitCode::from(2)
                }
            }
        }
        Ok(StageId::Ingest) => stage_main_from::<Ingest>(arguments),
        Ok(StageId::RobotMaps) => stage_main_from::<Maps>(arguments),
        Ok(StageId::Conditioning) => stage_main_from::<Kappa>(arguments),
        Ok(
            stage @ (StageId::References | StageId::Agreement | StageId::Lift4dgt | StageId::LiftSom | StageId::Fit),
        ) => {
            eprintln!("error: the toy pipeline has no stage `{stage}`");
            ExitCode::from(2)
        }
        Ok(StageId::Lift) => stage_main_from::<Lift>(arguments),
        Ok(StageId::Refine) => stage_main_from::<Refine>(arguments),
        Ok(StageId::Score) => stage_main_from::<Score>(arguments),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}
