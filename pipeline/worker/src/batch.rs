//! The face `batch`: one shard of a plan file, for engines that start processes on other machines.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use rogs_r4c::ledger;
use rogs_schemas::ledger::{Attempt, Failure, Outcome, PlannedUnit};
use rogs_schemas::protocol::{FailureCode, InputDescription};

use crate::error::{StageError, StageResult};
use crate::exit::{EXIT_FAILED, EXIT_OK, EXIT_TEMPORARY};
use crate::job::Runner;
use crate::serve::{InHand, drain_on_signals, draining};
use crate::stage::Stage;
use crate::sys;

/// What the command line of `batch` says.
pub(crate) struct BatchArguments {
    /// Plan file: one [`PlannedUnit`] a line.
    pub(crate) plan: PathBuf,
    /// A number, or `auto`.
    pub(crate) shard: String,
    /// Must be that of the plan, when given.
    pub(crate) shards: Option<u32>,
    pub(crate) grace: Duration,
    /// Exit 0 although units failed for good.
    pub(crate) keep_going: bool,
}

/// Environment variables in which engines put the index, in the order they are asked.
const INDEX_VARIABLES: [&str; 3] = ["SLURM_ARRAY_TASK_ID", "JOB_COMPLETION_INDEX", "HQ_TASK_ID"];

/// Counts of one shard.
#[derive(Default)]
struct Counts {
    made: usize,
    up_to_date: usize,
    failed: usize,
    blocked: usize,
    temporary: usize,
}

/// Runs the units of a shard that belong to this stage and are not up to date. `begin` prepares the process, after it
/// hears signals.
pub(crate) fn batch<S: Stage>(
    arguments: &BatchArguments,
    begin: impl FnOnce() -> StageResult<()>,
) -> StageResult<ExitCode> {
    let shard = shard_index(&arguments.shard)?;
    drain_on_signals(arguments.grace).map_err(|error| StageError::io(format!("cannot handle signals: {error}")))?;
    begin()?;
    let units = read_units(&arguments.plan, S::NAME, shard, arguments.shards)?;
    let mut runner = Runner::<S>::new();
    let mut counts = Counts::default();
    for unit in &units {
        let _in_hand = InHand::take();
        if draining() {
            counts.temporary += 1;
            break;
        }
        if up_to_date(unit) {
            counts.up_to_date += 1;
            continue;
        }
        if let Some(missing) = missing_input::<S>(unit) {
            counts.blocked += 1;
            crate::message!(
                "{} {}: blocked: its input {missing} is missing",
                unit.job.clip_id,
                S::NAME
            );
            continue;
        }
        run_unit(&mut runner, unit, &mut counts);
    }
    let Counts {
        made,
        up_to_date,
        failed,
        blocked,
        temporary,
    } = counts;
    let name = S::NAME;
    crate::message!("{name} shard {shard}: {made} made, {up_to_date} up to date, {failed} failed, {blocked} blocked");
    Ok(ExitCode::from(match (temporary, failed + blocked) {
        (0, 0) => EXIT_OK,
        (0, _) if arguments.keep_going => EXIT_OK,
        (0, _) => EXIT_FAILED,
        _ => EXIT_TEMPORARY,
    }))
}

fn run_unit<S: Stage>(runner: &mut Runner<S>, unit: &PlannedUnit, counts: &mut Counts) {
    let job = &unit.job;
    let made = job.output.parent().map_or(Ok(()), |folder| {
        rogs_files::make_folder_below(&unit.run, folder).map_err(|error| rogs_r4c::Error::from(error).into())
    });
    let result = made.and_then(|()| runner.run(job, &mut |_, _| {}));
    let result = result.map_err(|error| damaged_input::<S>(unit).unwrap_or(error));
    let mut attempt = Attempt {
        unix_ms: ledger::now_ms(),
        clip_id: job.clip_id.clone(),
        stage: S::NAME.to_owned(),
        output: job.output.strip_prefix(&unit.run).unwrap_or(&job.output).to_owned(),
        key: job.key,
        outcome: Outcome::Done,
        seconds: Default::default(),
        peak_rss_bytes: sys::peak_rss_bytes(),
        threads: sys::threads(),
        output_bytes: std::fs::metadata(&job.output).map_or(0, |file| file.len()),
        warnings: Vec::new(),
        failure: None,
        stderr: Vec::new(),
        worker: ledger::this_worker(),
    };
    match result {
        Ok(report) => {
            counts.made += 1;
            crate::message!("{} {}: done", job.clip_id, S::NAME);
            (attempt.seconds, attempt.warnings) = (report.seconds, report.warnings);
        }
        Err(StageError { code, message, hint }) => {
            // Trying again later may help with these; with the others it will not.
            let passing = matches!(code, FailureCode::Io | FailureCode::Resource);
            *(if passing {
                &mut counts.temporary
            } else {
                &mut counts.failed
            }) += 1;
            crate::message!("{} {}: failed: {message}", job.clip_id, S::NAME);
            if let Some(hint) = &hint {
                crate::message!("  hint: {hint}");
            }
            attempt.outcome = Outcome::Failed;
            attempt.output_bytes = 0;
            attempt.failure = Some(Failure { code, message, hint });
        }
    }
    // Records are for people; the output counts without them.
    if let Err(error) = ledger::note(&unit.run, &attempt) {
        crate::message!("warning: {}", StageError::from(error));
    }
}

/// The failure of a unit one of whose inputs is a damaged output of a stage before: that is removed, so that it is made
/// again by whoever hands out the work. `None` when all are whole or cannot be read.
fn damaged_input<S: Stage>(unit: &PlannedUnit) -> Option<StageError> {
    let records = S::inputs().into_iter().filter(InputDescription::is_record);
    let own = records.filter_map(|input| unit.job.inputs.get(&input.role));
    let own = own.filter(|path| path.starts_with(&unit.run));
    let mut removed = None;
    for path in own {
        match rogs_r4c::verify(path) {
            Ok(_) | Err(rogs_r4c::Error::Io { .. }) => {}
            Err(why) if rogs_files::remove_below(&unit.run, path).is_ok() => removed = Some(StageError::from(why)),
            Err(_) => {}
        }
    }
    removed.map(|why| {
        StageError::io(format!("{}; it was removed", why.message))
            .with_hint("submit or run again: it is made again, then this")
    })
}

/// The output of a stage before that is not there: that stage failed on the clip, or has not run.
fn missing_input<S: Stage>(unit: &PlannedUnit) -> Option<String> {
    let records = S::inputs().into_iter().filter(InputDescription::is_record);
    records.into_iter().find_map(|input| {
        let path = unit.job.inputs.get(&input.role)?;
        (!path.exists()).then(|| format!("`{}` ({})", input.role, path.display()))
    })
}

fn up_to_date(unit: &PlannedUnit) -> bool {
    rogs_r4c::read_header(&unit.job.output).is_ok_and(|header| header.key == unit.job.key)
}

fn shard_index(text: &str) -> StageResult<u32> {
    let parse = |text: &str, from: &str| {
        text.trim()
            .parse()
            .map_err(|_| StageError::bad_params(format!("invalid shard index `{text}` in {from}: expected a number")))
    };
    if text != "auto" {
        return parse(text, "--shard-index");
    }
    let found = INDEX_VARIABLES
        .iter()
        .find_map(|name| Some((std::env::var(name).ok()?, *name)));
    match found {
        Some((value, name)) => parse(&value, name),
        None => Err(
            StageError::bad_params("`--shard-index auto` finds no index in the environment")
                .with_hint(format!("one of {} must be set", INDEX_VARIABLES.join(", "))),
        ),
    }
}

fn read_units(plan: &Path, stage: &str, shard: u32, shards: Option<u32>) -> StageResult<Vec<PlannedUnit>> {
    let wrong = |line: usize, why: String| StageError::bad_params(format!("`{}` line {line}: {why}", plan.display()));
    let file = rogs_files::open(plan).map_err(|error| wrong(0, error.to_string()))?;
    let mut units = Vec::new();
    for (index, line) in BufReader::new(file).lines().enumerate() {
        let line = line.map_err(|error| wrong(index + 1, error.to_string()))?;
        let unit: PlannedUnit = serde_json::from_str(&line).map_err(|error| wrong(index + 1, error.to_string()))?;
        if shards.is_some_and(|shards| shards != unit.shards) || shard >= unit.shards {
            let message = format!(
                "the plan has {} shards, asked for shard {shard} of {shards:?}",
                unit.shards
            );
            return Err(wrong(index + 1, message));
        }
        if unit.shard == shard && unit.job.material.stage == stage {
            units.push(unit);
        }
    }
    Ok(units)
}
