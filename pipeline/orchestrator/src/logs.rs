//! What happened to one clip.

use std::path::Path;

use rogs_r4c::ledger;
use rogs_schemas::ledger::{Attempt, LOG_FILE, Outcome};
use rogs_schemas::shown;

use crate::error::Result;
use crate::plan::read_plan;

/// Attempts at the units of a clip, oldest first. The clip is named by its id or its episode's.
///
/// # Errors
/// When the run has no such clip, or its log cannot be read.
pub fn logs(run: &Path, clip: &str) -> Result<Vec<Attempt>> {
    let plan = read_plan(run)?;
    let clip = plan.find_clip(clip)?;
    Ok(ledger::read(&plan.clip_folder(clip).join(LOG_FILE))?)
}

/// An attempt for people.
#[must_use]
pub fn text(attempt: &Attempt) -> String {
    let seconds = attempt
        .seconds
        .get("total")
        .map(|seconds| format!(" {seconds:.2} s"))
        .unwrap_or_default();
    let outcome = match attempt.outcome {
        Outcome::Done => "done",
        Outcome::Failed => "failed",
        Outcome::Stopped => "stopped",
    };
    let mut out = format!(
        "{} {outcome}{seconds} ({}, key {})",
        attempt.output.display(),
        attempt.worker,
        attempt.key
    );
    for warning in &attempt.warnings {
        out.push_str(&format!("\n  warning: {}", shown::line(warning)));
    }
    if let Some(failure) = &attempt.failure {
        out.push_str(&format!("\n  {}", shown::line(&failure.message)));
        if let Some(hint) = &failure.hint {
            out.push_str(&format!("\n  hint: {}", shown::line(hint)));
        }
    }
    for line in &attempt.stderr {
        out.push_str(&format!("\n  | {}", shown::line(line)));
    }
    out
}
