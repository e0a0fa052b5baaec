//! Command line of a stage program.

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::{Arg, ArgAction, ArgMatches, Command, value_parser};
use rogs_schemas::ClipId;
use rogs_schemas::protocol::{InputDescription, LONGEST_GRACE, MOST_THREADS};

use crate::batch::{BatchArguments, batch};
use crate::describe::describe;
use crate::error::{StageError, StageResult};
use crate::exit::{EXIT_OK, EXIT_TEMPORARY, EXIT_USAGE, print_error};
use crate::one::{OneArguments, one};
use crate::params::read_arguments;
use crate::serve::serve;
use crate::stage::Stage;
use crate::sys;

/// The `main` of a stage program.
pub fn stage_main<S: Stage>() -> ExitCode {
    stage_main_from::<S>(std::env::args_os().skip(1).collect())
}

/// The same with given arguments (without the program name); `rogs stage NAME ...` ends here.
pub fn stage_main_from<S: Stage>(arguments: Vec<OsString>) -> ExitCode {
    let program = OsString::from(format!("rogs-{}", S::NAME));
    let matches = match command::<S>().try_get_matches_from(std::iter::once(program).chain(arguments)) {
        Ok(matches) => matches,
        Err(error) => {
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { EXIT_USAGE } else { EXIT_OK });
        }
    };
    match dispatch::<S>(&matches) {
        Ok(code) => code,
        Err(error) => {
            print_error(&error);
            ExitCode::from(EXIT_USAGE)
        }
    }
}

fn dispatch<S: Stage>(matches: &ArgMatches) -> StageResult<ExitCode> {
    match matches.subcommand() {
        Some(("one", matches)) => {
            set_threads(matches)?;
            let path = |name: &str| matches.get_one::<PathBuf>(name).cloned();
            let roles = S::inputs().into_iter().map(|input| input.role);
            let inputs = roles.filter_map(|role| path(&role).map(|path| (role, path))).collect();
            let arguments = OneArguments {
                inputs,
                output: path("out").unwrap_or_default(),
                params: params_of(matches)?,
                clip_id: matches.get_one::<ClipId>("clip-id").cloned(),
                quiet: matches.get_flag("quiet"),
            };
            Ok(one::<S>(&arguments))
        }
        Some(("worker", matches)) => {
            // The worker hears of its parent's end before it does anything that takes time.
            let parent = matches.get_one::<u32>("parent").copied();
            if parent.is_some_and(|parent| !sys::die_with_parent(parent)) {
                return Ok(ExitCode::from(EXIT_TEMPORARY));
            }
            Ok(serve::<S>(grace(matches), parent, || set_threads(matches)))
        }
        Some(("batch", matches)) => {
            let arguments = BatchArguments {
                plan: matches.get_one::<PathBuf>("plan").cloned().unwrap_or_default(),
                shard: matches.get_one::<String>("shard-index").cloned().unwrap_or_default(),
                shards: matches.get_one::<u32>("shard-count").copied(),
                grace: grace(matches),
                keep_going: matches.get_flag("keep-going"),
            };
            batch::<S>(&arguments, || set_threads(matches))
        }
        Some(("describe", matches)) => {
            let description = describe::<S>(&params_of(matches)?)?;
            let text = serde_json::to_string_pretty(&description)
                .map_err(|error| StageError::internal(format!("the description is not JSON: {error}")))?;
            crate::answer!("{text}").map_err(|error| StageError::io(format!("cannot print the answer: {error}")))?;
            Ok(ExitCode::from(EXIT_OK))
        }
        _ => Err(StageError::bad_params("no such command")),
    }
}

fn params_of(matches: &ArgMatches) -> StageResult<serde_json::Value> {
    let given: Vec<String> = matches
        .get_many::<String>("params")
        .into_iter()
        .flatten()
        .cloned()
        .collect();
    read_arguments(&given)
}

fn grace(matches: &ArgMatches) -> Duration {
    Duration::from_secs_f64(matches.get_one::<f64>("grace").copied().unwrap_or(5.0))
}

/// A number of threads that a machine can have; 0: one per core.
fn count_of_threads(text: &str) -> Result<usize, String> {
    let count = text.parse().ok().filter(|&count| count <= MOST_THREADS);
    count.ok_or_else(|| format!("expected at most {MOST_THREADS} threads"))
}

fn seconds_of_grace(text: &str) -> Result<f64, String> {
    let seconds = text
        .parse()
        .ok()
        .filter(|seconds| (0.0..=LONGEST_GRACE).contains(seconds));
    seconds.ok_or_else(|| format!("expected 0 to {LONGEST_GRACE} seconds"))
}

fn set_threads(matches: &ArgMatches) -> StageResult<()> {
    let Some(&threads) = matches.get_one::<usize>("threads") else {
        return Ok(());
    };
    let built = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    built.map_err(|error| StageError::bad_params(format!("cannot use {threads} threads: {error}")))
}

fn command<S: Stage>() -> Command {
    let threads = Arg::new("threads")
        .long("threads")
        .value_name("N")
        .value_parser(count_of_threads)
        .help("Threads for computation [default: one per core]; results do not depend on it");
    let grace = Arg::new("grace")
        .long("grace")
        .value_name("SECONDS")
        .value_parser(seconds_of_grace)
        .help("On SIGTERM, how long the clip in hand may still take before it is given up [default: 5]");
    let params = Arg::new("params")
        .long("params")
        .value_name("NAME=VALUE|JSON|@FILE")
        .action(ArgAction::Append)
        .help("Parameters that differ from the defaults; may be repeated");
    let mut one = Command::new("one")
        .about("Run one clip by hand")
        .arg(params.clone())
        .arg(threads.clone());
    for input in S::inputs() {
        one = one.arg(input_argument(&input));
    }
    let out = Arg::new("out")
        .long("out")
        .value_name("FILE")
        .required(true)
        .value_parser(value_parser!(PathBuf));
    let clip_id = Arg::new("clip-id")
        .long("clip-id")
        .value_name("ID")
        .value_parser(value_parser!(ClipId))
        .help("Name of the clip in messages");
    let quiet = Arg::new("quiet")
        .long("quiet")
        .short('q')
        .action(ArgAction::SetTrue)
        .help("Say nothing but errors");
    one = one.arg(out.help("The file to write")).arg(clip_id).arg(quiet);

    let plan = Arg::new("plan")
        .long("plan")
        .value_name("FILE")
        .required(true)
        .value_parser(value_parser!(PathBuf));
    let index = Arg::new("shard-index")
        .long("shard-index")
        .value_name("N|auto")
        .default_value("auto");
    let count = Arg::new("shard-count")
        .long("shard-count")
        .value_name("M")
        .value_parser(value_parser!(u32));
    let keep_going = Arg::new("keep-going").long("keep-going").action(ArgAction::SetTrue);
    let batch = Command::new("batch")
        .about("Run one shard of a plan file, skipping what is up to date")
        .arg(plan.help("The file that `rogs plan --emit jsonl` writes"))
        .arg(index.help("The shard; auto: SLURM_ARRAY_TASK_ID, JOB_COMPLETION_INDEX or HQ_TASK_ID"))
        .arg(count.help("Number of shards, to check that it is that of the plan"))
        .arg(keep_going.help("Exit 0 although clips failed for good, so that dependent jobs continue with the others"))
        .args([threads.clone(), grace.clone()]);
    let worker = Command::new("worker")
        .about("Serve jobs: JSON lines on stdin, events on stdout")
        .arg(threads)
        .arg(grace);
    let parent = Arg::new("parent")
        .long("parent")
        .value_name("PID")
        .value_parser(value_parser!(u32));
    let worker = worker.arg(parent.help("Stop when this process, which started the worker, is gone"));
    let describe = Command::new("describe")
        .about("Print what this stage is, as JSON")
        .arg(params);
    Command::new(forever(format!("rogs-{}", S::NAME)))
        .about(S::SUMMARY)
        .version(forever(format!(
            "{} (stage version {}, writes {})",
            env!("CARGO_PKG_VERSION"),
            S::VERSION,
            S::OUTPUT
        )))
        .subcommand_required(true)
        .arg_required_else_help(true)
        .subcommands([one, worker, batch, describe])
}

/// clap wants names that live as long as the program; there are a handful, made once.
fn forever(text: String) -> &'static str {
    text.leak()
}

fn input_argument(input: &InputDescription) -> Arg {
    let kind = if input.is_record() {
        format!("a `{}` file", input.kind)
    } else {
        input.kind.clone()
    };
    let help = if input.required {
        format!("Input: {kind}")
    } else {
        format!("Optional input: {kind}")
    };
    let (role, name) = (
        forever(input.role.clone()),
        if input.kind == "folder" { "FOLDER" } else { "FILE" },
    );
    Arg::new(role)
        .long(role)
        .value_name(name)
        .required(input.required)
        .value_parser(value_parser!(PathBuf))
        .help(help)
}
