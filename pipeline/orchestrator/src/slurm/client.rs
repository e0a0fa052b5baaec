//! The clients of Slurm: `sbatch`, `scontrol`.

use std::process::{Command, Stdio};

use crate::error::{Error, Result};

/// Slurm's own default limit of array sizes.
const DEFAULT_ARRAY_LIMIT: u32 = 1001;

/// Waits between attempts to hand a job to a controller that is busy, milliseconds.
const PATIENCE_MS: [u64; 4] = [250, 1000, 4000, 15_000];

/// What clients of Slurm say when the controller is too busy or just away; the same call may work a moment later.
const PASSING: [&str; 7] = [
    "Socket timed out",
    "Unable to contact slurm controller",
    "Zero Bytes were transmitted",
    "Resource temporarily unavailable",
    "temporarily unable to accept job",
    "in standby mode",
    "Protocol authentication error",
];

/// Runs one `sbatch`, again where the trouble may pass, and returns the job's id.
///
/// A controller that timed out may have taken the job all the same. Then two elements meet on a unit: the second finds
/// it up to date, or makes the same bytes.
pub(super) fn sbatch(command: &[String]) -> Result<String> {
    let mut waits = PATIENCE_MS.iter();
    loop {
        match (sbatch_once(command), waits.next()) {
            (Answer::Busy(_), Some(&wait)) => std::thread::sleep(std::time::Duration::from_millis(wait)),
            (Answer::Busy(error) | Answer::Refused(error), _) => return Err(error),
            (Answer::Accepted(id), _) => return Ok(id),
        }
    }
}

/// What `sbatch` answered.
enum Answer {
    /// The job's id.
    Accepted(String),
    /// The controller is too busy or away: the same call may work a moment later.
    Busy(Error),
    Refused(Error),
}

fn sbatch_once(command: &[String]) -> Answer {
    let error = |message: String| Error::Program {
        program: "sbatch".to_owned(),
        message,
        hint: None,
    };
    let [program, arguments @ ..] = command else {
        return Answer::Refused(error("empty command".to_owned()));
    };
    let output = match Command::new(program).args(arguments).stdin(Stdio::null()).output() {
        Ok(output) => output,
        Err(why) => {
            let error = error(format!("cannot be started: {why}"));
            let hint = "run this where Slurm is installed, or use `rogs plan --emit jsonl` with another engine";
            return Answer::Refused(error.with_hint(hint));
        }
    };
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr).trim().to_owned();
        let error = error(format!("refused ({}): {said}", output.status));
        // One without a message was killed, or lost its connection before it could answer.
        let passing = said.is_empty() || PASSING.iter().any(|what| said.contains(what));
        return if passing {
            let hint = "is the controller up (`scontrol ping`)? The same command resumes";
            Answer::Busy(error.with_hint(hint))
        } else {
            Answer::Refused(error)
        };
    }
    // `ID` or `ID;CLUSTER`
    let answer = String::from_utf8_lossy(&output.stdout).into_owned();
    let id = answer.trim().split(';').next().unwrap_or_default().to_owned();
    if id.is_empty() || !id.bytes().all(|byte| byte.is_ascii_digit()) {
        return Answer::Refused(error(format!("answered no job id: `{}`", answer.trim())));
    }
    Answer::Accepted(id)
}

/// Largest array that this Slurm takes; its usual limit where Slurm does not answer.
pub(super) fn array_limit() -> u32 {
    let output = Command::new("scontrol")
        .args(["show", "config"])
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output();
    let text = output
        .map(|output| String::from_utf8_lossy(&output.stdout).into_owned())
        .unwrap_or_default();
    let limit = text.lines().find_map(|line| {
        line.trim()
            .strip_prefix("MaxArraySize")?
            .split('=')
            .nth(1)?
            .trim()
            .parse()
            .ok()
    });
    // Indices must lie below it.
    limit.unwrap_or(DEFAULT_ARRAY_LIMIT).saturating_sub(1).max(1)
}
