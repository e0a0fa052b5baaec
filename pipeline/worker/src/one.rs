//! The face `one`: a person runs a stage on one clip by hand.

use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use rogs_r4c::source::hash_source;
use rogs_schemas::ClipId;
use rogs_schemas::key::KeyMaterial;
use rogs_schemas::protocol::{Job, JobId};
use serde_json::Value;

use crate::error::{StageError, StageResult};
use crate::exit::{EXIT_FAILED, EXIT_OK, print_error};
use crate::job::{Report, Runner};
use crate::params::{canonical, parse_params};
use crate::serve::drain_on_signals;
use crate::stage::Stage;
use crate::sys;

/// What the command line of `one` says.
pub(crate) struct OneArguments {
    pub(crate) inputs: BTreeMap<String, PathBuf>,
    pub(crate) output: PathBuf,
    pub(crate) params: Value,
    pub(crate) clip_id: Option<ClipId>,
    pub(crate) quiet: bool,
}

/// Runs the stage once and tells on stderr how it went.
pub(crate) fn one<S: Stage>(arguments: &OneArguments) -> ExitCode {
    let _ = drain_on_signals(Duration::ZERO);
    let mut line = ProgressLine::new(S::NAME, arguments.quiet);
    let result = job_of::<S>(arguments)
        .and_then(|job| Runner::<S>::new().run(&job, &mut |fraction, message| line.show(fraction, message)));
    line.clear();
    match result {
        Ok(report) => {
            if !arguments.quiet {
                tell(&arguments.output, &report);
            }
            ExitCode::from(EXIT_OK)
        }
        Err(error) => {
            print_error(&error);
            ExitCode::from(EXIT_FAILED)
        }
    }
}

fn job_of<S: Stage>(arguments: &OneArguments) -> StageResult<Job> {
    let params: S::Params = parse_params(&arguments.params)?;
    let mut ids = BTreeMap::new();
    let mut clip_id = arguments.clip_id.clone();
    for input in S::inputs() {
        let Some(path) = arguments.inputs.get(&input.role) else {
            continue;
        };
        let id = if input.is_record() {
            rogs_r4c::Reader::open(path)?.provenance().key().to_string()
        } else {
            hash_source(&input.role, path)?.to_string()
        };
        ids.insert(input.role, id);
    }
    let folder = arguments
        .output
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder {
        std::fs::create_dir_all(folder)
            .map_err(|error| StageError::io(format!("cannot make the folder `{}`: {error}", folder.display())))?;
    }
    let first = || {
        arguments
            .inputs
            .values()
            .next()
            .and_then(|path| path.file_stem())
            .map(|stem| stem.to_string_lossy())
    };
    let clip_id = clip_id
        .take()
        .or_else(|| first().map(|stem| ClipId::made_of(&stem)))
        .unwrap_or_else(|| ClipId::made_of("clip"));
    let material = KeyMaterial {
        stage: S::NAME.to_owned(),
        stage_version: S::VERSION,
        schema: S::OUTPUT.to_string(),
        params: canonical(&params),
        inputs: ids,
    };
    Ok(Job {
        job: JobId(0),
        clip_id,
        inputs: arguments.inputs.clone(),
        output: arguments.output.clone(),
        params: arguments.params.clone(),
        key: material.key(),
        material,
    })
}

fn tell(output: &Path, report: &Report) {
    for warning in &report.warnings {
        crate::message!("warning: {warning}");
    }
    let seconds = report.seconds.get("total").copied().unwrap_or_default();
    let mebibytes = sys::peak_rss_bytes() >> 20;
    crate::message!(
        "wrote {} in {seconds:.2} s, peak memory {mebibytes} MiB",
        output.display()
    );
    let phases = report.seconds.iter().filter(|(name, _)| *name != "total");
    let phases: Vec<_> = phases.map(|(name, seconds)| format!("{name} {seconds:.2} s")).collect();
    if !phases.is_empty() {
        crate::message!("  {}", phases.join(", "));
    }
}

/// Progress as one line that is rewritten on a terminal, and as an occasional line elsewhere.
struct ProgressLine {
    stage: &'static str,
    terminal: bool,
    quiet: bool,
    last: Option<Instant>,
    shown: bool,
}

impl ProgressLine {
    fn new(stage: &'static str, quiet: bool) -> Self {
        Self {
            stage,
            terminal: std::io::stderr().is_terminal(),
            quiet,
            last: None,
            shown: false,
        }
    }

    fn show(&mut self, fraction: f64, message: &str) {
        let interval = if self.terminal {
            Duration::from_millis(100)
        } else {
            Duration::from_secs(5)
        };
        if self.quiet || self.last.is_some_and(|last| last.elapsed() < interval) {
            return;
        }
        self.last = Some(Instant::now());
        let percent = 100.0 * fraction.clamp(0.0, 1.0);
        if self.terminal {
            crate::console::print_progress(format_args!("{} {percent:3.0} % {message}", self.stage));
            self.shown = true;
        } else {
            crate::message!("{} {percent:3.0} % {message}", self.stage);
        }
    }

    fn clear(&mut self) {
        if self.shown {
            crate::console::print_progress(format_args!(""));
        }
    }
}
