//! The clients of Slurm: `sbatch`, `scancel`, `scontrol`. Their answers are read tolerantly: sites wrap them and print
//! notes of their own.

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

/// What Slurm says when it refuses a job, and what to do about it; the first that fits counts.
const REFUSALS: [(&[&str], &str); 8] = [
    (
        &[
            "SubmitJob",
            "submit limit",
            "accounting/QOS policy",
            "MaxJobs",
            "MaxJobCount",
            "Too many jobs",
        ],
        "every element of every stage counts as a job in the queue: lower `shards` in [slurm], or name fewer `stages` in \
         [run] and submit again when they are done",
    ),
    (
        &["nvalid job array", "MaxArraySize"],
        "lower `shards` in [slurm]: this Slurm takes smaller arrays",
    ),
    (
        &["nvalid account", "account/partition combination"],
        "set `account` and `partition` in [slurm]: `sacctmgr show assoc user=$USER` lists yours",
    ),
    (
        &["nvalid partition", "No partition specified"],
        "set `partition` in [slurm]: `sinfo -s` lists them",
    ),
    (
        &["time limit", "TimeLimit"],
        "set `time` in [slurm]: `sinfo -o '%P %l'` lists the limits",
    ),
    (
        &["nvalid generic resource", "gres"],
        "check `gres` in [slurm]: `sinfo -o '%P %G'` lists what there is",
    ),
    (
        &["node configuration is not available", "Memory required", "CPU count"],
        "no node has so much: lower `memory`, `cpus` or `gres` in [slurm], or choose another `partition`",
    ),
    (
        &[
            "nvalid qos",
            "nvalid feature",
            "nvalid directive",
            "unrecognized option",
        ],
        "check `extra` in [slurm]: its lines are handed to Slurm as they are",
    ),
];

fn tool(tool: &'static str, message: String) -> Error {
    Error::Tool {
        tool,
        message,
        hint: None,
    }
}

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
    let error = |message: String| tool("sbatch", message);
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
        let error = error(format!("refused ({}): {}", output.status, one_line(&said)));
        // One without a message was killed, or lost its connection before it could answer.
        let passing = said.is_empty() || PASSING.iter().any(|what| said.contains(what));
        return if passing {
            let hint = "is the controller up (`scontrol ping`)? The same command resumes";
            Answer::Busy(error.with_hint(hint))
        } else {
            Answer::Refused(match way_on(&said) {
                Some(hint) => error.with_hint(hint),
                None => error,
            })
        };
    }
    let answer = String::from_utf8_lossy(&output.stdout).into_owned();
    match job_id(&answer) {
        Some(id) => Answer::Accepted(id),
        None => {
            let error = error(format!("answered no job id: `{}`", one_line(answer.trim())));
            let hint = "a job may be in the queue all the same: `squeue --me` shows it, `scancel` removes it";
            Answer::Refused(error.with_hint(hint))
        }
    }
}

/// What a person can do about a refusal, where something is known.
fn way_on(said: &str) -> Option<&'static str> {
    let found = REFUSALS
        .iter()
        .find(|(words, _)| words.iter().any(|word| said.contains(word)));
    found.map(|(_, hint)| *hint)
}

/// The job's id in an answer: a line `ID` or `ID;CLUSTER`, as asked for, or a sentence such as `Submitted batch job ID`;
/// among the notes of a site the last one.
fn job_id(answer: &str) -> Option<String> {
    let number =
        |word: &str| (!word.is_empty() && word.bytes().all(|byte| byte.is_ascii_digit())).then(|| word.to_owned());
    let alone = |line: &str| number(line.trim().split(';').next()?.trim());
    let sentence = |line: &str| number(line.split_once("Submitted batch job ")?.1.split_whitespace().next()?);
    let lines = || answer.lines().rev();
    lines().find_map(alone).or_else(|| lines().find_map(sentence))
}

/// Cancels jobs that are in the queue already, and returns the error for which it is done; where they could not be
/// cancelled the error says so.
pub(super) fn cancelled(ids: &[String], error: Error) -> Error {
    if ids.is_empty() {
        return error;
    }
    let mut scancel = Command::new("scancel");
    let done = scancel.args(ids).stdin(Stdio::null()).stderr(Stdio::null()).status();
    if done.is_ok_and(|status| status.success()) {
        return error;
    }
    let hint = error.hint().map(|hint| format!("; {hint}")).unwrap_or_default();
    let message = format!("{error}; jobs of this submission are still in the queue");
    tool("sbatch", message).with_hint(format!("cancel them: scancel {}{hint}", ids.join(" ")))
}

/// What a program said, as part of a message of one line.
fn one_line(said: &str) -> String {
    said.lines()
        .map(str::trim)
        .filter(|line| !line.is_empty())
        .collect::<Vec<_>>()
        .join("; ")
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
    // Indices must lie below it.
    max_array_size(&text)
        .unwrap_or(DEFAULT_ARRAY_LIMIT)
        .saturating_sub(1)
        .max(1)
}

/// `MaxArraySize = 1001` among the lines of a configuration, however it is spaced and written.
fn max_array_size(configuration: &str) -> Option<u32> {
    configuration.lines().find_map(|line| {
        let (name, value) = line.split_once('=')?;
        let value = value.split_whitespace().next()?;
        name.trim()
            .eq_ignore_ascii_case("MaxArraySize")
            .then(|| value.parse().ok())?
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_found_among_the_notes_of_a_site() {
        for (answer, id) in [
            ("401\n", Some("401")),
            ("401;cluster\n", Some("401")),
            ("sbatch: your project has 3 days left\n 401 \n\n", Some("401")),
            ("Submitted batch job 401\n", Some("401")),
            ("Submitted batch job 401 on cluster a\n", Some("401")),
            ("== welcome ==\n401;a\ncharged to x\n", Some("401")),
            ("welcome to cluster 7\n", None),
            ("", None),
        ] {
            assert_eq!(job_id(answer).as_deref(), id, "{answer:?}");
        }
    }

    #[test]
    fn refusals_come_with_a_way_on() {
        for (said, word) in [
            ("sbatch: error: AssocMaxSubmitJobLimit", "`shards`"),
            ("sbatch: error: QOSMaxSubmitJobPerUserLimit", "`stages`"),
            (
                "Batch job submission failed: Job violates accounting/QOS policy (job submit limit, user's size and/or time limits)",
                "`shards`",
            ),
            (
                "Batch job submission failed: Invalid job array specification",
                "`shards`",
            ),
            ("invalid partition specified: gpu", "`partition`"),
            (
                "Invalid account or account/partition combination specified",
                "`account`",
            ),
            (
                "Requested time limit is invalid (missing or exceeds some limit)",
                "`time`",
            ),
            ("Invalid generic resource (gres) specification", "`gres`"),
            ("Requested node configuration is not available", "`memory`"),
            ("Invalid qos specification", "`extra`"),
        ] {
            let hint = way_on(said).unwrap_or_else(|| panic!("{said}"));
            assert!(hint.contains(word), "{said}: {hint}");
        }
        assert_eq!(way_on("something else"), None);
    }

    #[test]
    fn the_largest_array_is_read_in_any_spelling() {
        assert_eq!(max_array_size("A = 1\nMaxArraySize            = 1001\n"), Some(1001));
        assert_eq!(max_array_size("maxarraysize=40001 (default)\n"), Some(40_001));
        assert_eq!(max_array_size("MaxArraySizes = 3\n"), None);
    }
}
