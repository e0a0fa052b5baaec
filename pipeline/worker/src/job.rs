//! Running one job: checks before, the stage inside a panic barrier, checks after.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::panic::AssertUnwindSafe;
use std::path::PathBuf;
use std::sync::{Mutex, Once, PoisonError};
use std::time::{Instant, SystemTime};

use rogs_schemas::interim;
use rogs_schemas::key::{CacheKey, Provenance};
use rogs_schemas::protocol::{FailureCode, Job};

use crate::context::Context;
use crate::error::{StageError, StageResult};
use crate::params::{canonical, parse_params};
use crate::stage::Stage;

/// What a job that went well tells.
#[derive(Debug)]
pub(crate) struct Report {
    pub(crate) seconds: BTreeMap<String, f64>,
    pub(crate) warnings: Vec<String>,
}

/// Keeps a loaded stage between jobs.
pub(crate) struct Runner<S: Stage> {
    loaded: Option<Loaded<S>>,
}

struct Loaded<S: Stage> {
    stage: S,
    params: S::Params,
    sources: BTreeMap<String, Stamp>,
}

/// Identity of a source input (weights, robot) as far as reloading is concerned.
type Stamp = (PathBuf, u64, Option<SystemTime>);

/// Output of the job in hand, for whoever has to clean up behind an abandoned job.
static CURRENT: Mutex<Option<PathBuf>> = Mutex::new(None);

/// The last panic's message and place.
static PANIC: Mutex<Option<String>> = Mutex::new(None);

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<S: Stage> Runner<S> {
    pub(crate) fn new() -> Self {
        remember_panics();
        Self { loaded: None }
    }

    /// Runs one job. On failure nothing lies at the output's place but what lay there before.
    pub(crate) fn run(&mut self, job: &Job, progress: &mut dyn FnMut(f64, &str)) -> StageResult<Report> {
        let start = Instant::now();
        let params = check::<S>(job)?;
        *lock(&CURRENT) = Some(job.output.clone());
        let result = self.guarded(job, &params, progress);
        rogs_files::remove_own(&job.output);
        // After a full disk or a lost network the next attempt may resume.
        let may_help = |error: &StageError| matches!(error.code, FailureCode::Io | FailureCode::Resource);
        if !result.as_ref().is_err_and(may_help) {
            for ending in interim::ENDINGS {
                let _ = std::fs::remove_file(interim::beside(&job.output, ending));
            }
        }
        *lock(&CURRENT) = None;
        let mut report = result?;
        report.seconds.insert("total".to_owned(), start.elapsed().as_secs_f64());
        Ok(report)
    }

    fn guarded(&mut self, job: &Job, params: &S::Params, progress: &mut dyn FnMut(f64, &str)) -> StageResult<Report> {
        let attempt = std::panic::catch_unwind(AssertUnwindSafe(|| self.load_and_run(job, params, progress)));
        attempt.unwrap_or_else(|payload| {
            // A stage that panicked half-way may be in any state.
            self.loaded = None;
            let text = payload.downcast_ref::<&str>().map(|text| (*text).to_owned());
            let text = lock(&PANIC)
                .take()
                .or(text)
                .or_else(|| payload.downcast_ref::<String>().cloned());
            let what = text.unwrap_or_else(|| "no message".to_owned());
            Err(StageError::internal(format!(
                "stage `{}` panicked on clip `{}`: {what}",
                S::NAME,
                job.clip_id
            ))
            .with_hint("this is a bug in the stage; please report it with the clip's log"))
        })
    }

    fn load_and_run(
        &mut self,
        job: &Job,
        params: &S::Params,
        progress: &mut dyn FnMut(f64, &str),
    ) -> StageResult<Report> {
        let sources = source_stamps::<S>(job);
        let start = Instant::now();
        let kept = self
            .loaded
            .take()
            .filter(|loaded| loaded.params == *params && loaded.sources == sources);
        let mut seconds = BTreeMap::new();
        let loaded = match kept {
            Some(loaded) => loaded,
            None => {
                let stage = S::load(params, &job.inputs)?;
                seconds.insert("load".to_owned(), start.elapsed().as_secs_f64());
                Loaded {
                    stage,
                    params: params.clone(),
                    sources,
                }
            }
        };
        let loaded = self.loaded.insert(loaded);
        let provenance = Provenance {
            material: job.material.clone(),
            input_content: BTreeMap::new(),
        };
        let mut context = Context::new(&job.clip_id, &job.inputs, &job.output, provenance, progress);
        let result = loaded.stage.run(&mut context);
        let outcome = context.into_outcome();
        if let Err(error) = result {
            if outcome.written.is_some() {
                // The stage wrote and then found something wrong: its output must not count.
                let _ = std::fs::remove_file(&job.output);
            }
            return Err(error);
        }
        if outcome.written.is_none() {
            return Err(StageError::internal(format!(
                "stage `{}` returned without writing its output",
                S::NAME
            )));
        }
        seconds.extend(outcome.seconds);
        Ok(Report {
            seconds,
            warnings: outcome.warnings,
        })
    }
}

/// Everything about a job that can be wrong before the stage sees it; returns its parameters.
fn check<S: Stage>(job: &Job) -> StageResult<S::Params> {
    let material = &job.material;
    let mismatch = |what: &str, planned: &dyn std::fmt::Display, ours: &dyn std::fmt::Display| {
        StageError::bad_params(format!("the plan says {what} `{planned}`, this program has `{ours}`"))
            .with_hint("plan and stage programs are of different builds; plan again")
    };
    if material.stage != S::NAME {
        return Err(mismatch("stage", &material.stage, &S::NAME));
    }
    if material.stage_version != S::VERSION {
        return Err(mismatch("stage version", &material.stage_version, &S::VERSION));
    }
    if material.schema != S::OUTPUT.to_string() {
        return Err(mismatch("output schema", &material.schema, &S::OUTPUT));
    }
    let found: CacheKey = material.key();
    if job.key != found {
        return Err(StageError::bad_params(format!(
            "the job's key {} is not that of its material, {found}",
            job.key
        )));
    }
    let params: S::Params = parse_params(&job.params)?;
    let ours = canonical(&params);
    if ours != material.params {
        return Err(mismatch("parameters", &material.params, &ours));
    }
    for input in S::inputs() {
        match job.inputs.get(&input.role) {
            None if input.required => {
                return Err(StageError::bad_params(format!(
                    "the job names no input `{}`",
                    input.role
                )));
            }
            Some(path) if !path.exists() => {
                let message = format!(
                    "input `{}` of clip `{}` is missing: `{}`",
                    input.role,
                    job.clip_id,
                    path.display()
                );
                return Err(StageError::bad_input(message).with_hint("the stage before has not written it; run again"));
            }
            _ => {}
        }
    }
    Ok(params)
}

/// Stamps of the inputs that are not records of this pipeline.
fn source_stamps<S: Stage>(job: &Job) -> BTreeMap<String, Stamp> {
    let is_record = |role: &str| S::inputs().iter().any(|input| input.role == role && input.is_record());
    let stamp = |path: &PathBuf| {
        let metadata = std::fs::metadata(path).ok();
        let length = metadata.as_ref().map_or(0, std::fs::Metadata::len);
        (
            path.clone(),
            length,
            metadata.and_then(|metadata| metadata.modified().ok()),
        )
    };
    let sources = job.inputs.iter().filter(|(role, _)| !is_record(role));
    sources.map(|(role, path)| (role.clone(), stamp(path))).collect()
}

/// Gives up the job in hand: removes its temporary file. The process must exit right after.
pub(crate) fn abandon() {
    if let Some(output) = lock(&CURRENT).as_ref() {
        rogs_files::remove_own(output);
    }
}

thread_local! {
    /// Set while a panic of this thread is the answer to a question, and no bug of ours.
    static QUIET: Cell<bool> = const { Cell::new(false) };
}

/// Runs a reader of somebody else that panics on some damaged input; `None` when it does, and nothing is printed. Only for
/// work on the calling thread.
pub fn quietly<T>(work: impl FnOnce() -> T + std::panic::UnwindSafe) -> Option<T> {
    remember_panics();
    QUIET.set(true);
    let result = std::panic::catch_unwind(work);
    QUIET.set(false);
    result.ok()
}

/// Keeps the message and place of panics for the `failed` event; the usual report on stderr stays.
fn remember_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let usual = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if QUIET.get() {
                return;
            }
            let payload = info.payload();
            let text = payload
                .downcast_ref::<&str>()
                .copied()
                .or(payload.downcast_ref::<String>().map(String::as_str));
            let place = info
                .location()
                .map(|place| format!(" ({}:{})", place.file(), place.line()));
            *lock(&PANIC) = Some(format!("{}{}", text.unwrap_or("no message"), place.unwrap_or_default()));
            usual(info);
        }));
    });
}
