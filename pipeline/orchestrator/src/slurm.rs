//! Handing a run to Slurm: one job array per stage, one array element per shard of clips. Nothing is scheduled here.

use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, io};
use crate::export::{batch_command, shard_of, shell_line, stages, write_units};
use crate::ledger::{StageCost, read_costs, tried};
use crate::manifest::{Slurm, parse_size, safe_name};
use crate::plan::{Plan, Unit};
use crate::prepare::Prepared;
use crate::state::OutputState;

/// Clips of one array element when the manifest does not say.
const CLIPS_PER_SHARD: usize = 16;

/// Slurm's own default limit of array sizes.
const DEFAULT_ARRAY_LIMIT: u32 = 1001;

/// Memory of an array element when nothing is known, bytes.
const UNKNOWN_MEMORY: u64 = 4 << 30;

/// Doublings of memory for shards that were lost without a record, at most.
const MAX_DOUBLINGS: u32 = 3;

/// Folder with scripts, unit list and job output in a run folder.
pub const SLURM_FOLDER: &str = "slurm";

/// What was, or would be, submitted.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Submission {
    /// Shards with something to do.
    pub shards: Vec<u32>,
    /// Number of shards of the plan.
    pub shard_count: u32,
    /// The scripts, in order.
    pub scripts: Vec<Script>,
    /// The calls of `sbatch`, word by word; job ids that are not known yet are written as `<id of STAGE>`.
    pub commands: Vec<Vec<String>>,
    /// Job ids, in the order of the scripts; empty in a dry run.
    pub ids: Vec<String>,
}

/// One job script.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Script {
    /// Stage, or `report`.
    pub name: String,
    /// Where it lies.
    pub path: PathBuf,
    /// What is in it.
    pub text: String,
}

/// A line of `slurm/submissions.jsonl`.
#[derive(Debug, Serialize, Deserialize)]
struct Submitted {
    ids: Vec<String>,
    shards: Vec<u32>,
}

/// Submits what is not up to date, or only says what it would do. A second call submits a sparse array with the shards
/// that are left.
///
/// `finally` is a command for the end, when all arrays have ended in whatever way, such as `rogs report RUN`.
///
/// # Errors
/// When there is nothing to submit, `sbatch` refuses, or the run folder cannot be written.
pub fn submit(prepared: &Prepared, finally: Option<&[String]>, dry_run: bool) -> Result<Submission> {
    let _lock = if dry_run {
        None
    } else {
        Some(crate::lock::RunLock::acquire(&prepared.plan.run)?)
    };
    let mut submission = prepare(prepared, finally)?;
    if dry_run {
        return Ok(submission);
    }
    let plan = &prepared.plan;
    plan.freeze()?;
    let folder = plan.run.join(SLURM_FOLDER);
    std::fs::create_dir_all(folder.join("logs")).map_err(io("cannot make the folder", &folder))?;
    rogs_schemas::atomic::write_with(&units_file(plan), |out| {
        let mut out = std::io::BufWriter::new(out);
        write_units(plan, submission.shard_count, &mut out)?;
        std::io::Write::flush(&mut out)
    })?;
    for script in &submission.scripts {
        rogs_schemas::atomic::write_bytes(&script.path, script.text.as_bytes())?;
    }
    let mut ids: Vec<String> = Vec::new();
    for (index, command) in submission.commands.iter_mut().enumerate() {
        if let Some(before) = index
            .checked_sub(1)
            .and_then(|before| Some((ids.get(before)?, &submission.scripts[before].name)))
        {
            let placeholder = format!("<id of {}>", before.1);
            for word in command.iter_mut() {
                *word = word.replace(&placeholder, before.0);
            }
        }
        match sbatch(command) {
            Ok(id) => ids.push(id),
            Err(error) => {
                // Without what follows, the arrays that are in already would only waste time.
                if !ids.is_empty() {
                    let _ = Command::new("scancel").args(&ids).stderr(Stdio::null()).status();
                }
                return Err(error);
            }
        }
    }
    let record = Submitted {
        ids: ids.clone(),
        shards: submission.shards.clone(),
    };
    append_line(&folder.join("submissions.jsonl"), &record)?;
    submission.ids = ids;
    Ok(submission)
}

fn units_file(plan: &Plan) -> PathBuf {
    plan.run.join(SLURM_FOLDER).join("units.jsonl")
}

fn prepare(prepared: &Prepared, finally: Option<&[String]>) -> Result<Submission> {
    let (plan, slurm) = (&prepared.plan, &prepared.manifest.slurm);
    let limit = array_limit();
    let wanted = plan
        .clips
        .len()
        .div_ceil(CLIPS_PER_SHARD)
        .clamp(1, 1000.min(limit as usize)) as u32;
    let shard_count = slurm.shards.unwrap_or(wanted).clamp(1, plan.clips.len().max(1) as u32);
    if shard_count > limit {
        let error = Error::usage(format!(
            "{shard_count} shards, but this Slurm takes arrays of at most {limit} elements"
        ));
        return Err(error.with_hint("lower `shards` in [slurm]"));
    }
    let states = plan.states();
    let open: BTreeSet<usize> = (0..plan.clips.len())
        .filter(|&clip| states[clip].iter().any(|state| *state != OutputState::UpToDate))
        .collect();
    if open.is_empty() {
        return Err(Error::usage("everything is up to date: there is nothing to submit"));
    }
    let shards: BTreeSet<u32> = open
        .iter()
        .map(|&clip| shard_of(clip, plan.clips.len(), shard_count))
        .collect();
    let costs = read_costs(&plan.run)?;
    let doublings = doublings(plan, &open, &states)?;
    let mut scripts = Vec::new();
    let mut commands = Vec::new();
    let names = stages(plan);
    for (index, stage) in names.iter().enumerate() {
        let memory = memory(slurm, stage, costs.get(*stage), doublings);
        let last = index + 1 == names.len();
        scripts.push(stage_script(prepared, stage, &shards, shard_count, memory, last));
        let mut command = vec!["sbatch".to_owned(), "--parsable".to_owned()];
        if let Some(before) = index.checked_sub(1) {
            // Without the second option a dependent of a failed element would wait for ever.
            command.push(format!("--dependency=aftercorr:<id of {}>", names[before]));
            command.push("--kill-on-invalid-dep=yes".to_owned());
        }
        command.push(scripts[index].path.display().to_string());
        commands.push(command);
    }
    if let (Some(words), Some(last)) = (finally, names.last()) {
        let script = report_script(prepared, words);
        let dependency = format!("--dependency=afterany:<id of {last}>");
        commands.push(vec![
            "sbatch".to_owned(),
            "--parsable".to_owned(),
            dependency,
            script.path.display().to_string(),
        ]);
        scripts.push(script);
    }
    Ok(Submission {
        shards: shards.into_iter().collect(),
        shard_count,
        scripts,
        commands,
        ids: Vec::new(),
    })
}

/// How often memory is doubled: once for each earlier submission, while units were lost without any record, which is
/// what the kernel's or Slurm's memory killer leaves behind.
fn doublings(plan: &Plan, open: &BTreeSet<usize>, states: &[Vec<OutputState>]) -> Result<u32> {
    let path = plan.run.join(SLURM_FOLDER).join("submissions.jsonl");
    let submissions = match std::fs::read_to_string(&path) {
        Ok(text) => text
            .lines()
            .filter(|line| serde_json::from_str::<Submitted>(line).is_ok())
            .count() as u32,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => 0,
        Err(error) => return Err(io("cannot read", &path)(error)),
    };
    if submissions == 0 {
        return Ok(0);
    }
    let maker = plan.key_maker();
    // The first open unit of a clip decides: what follows it has had no chance.
    let first_open = |&clip: &usize| {
        let node = (0..plan.nodes.len()).find(|&node| states[clip][node] != OutputState::UpToDate)?;
        let keys = maker.keys(clip);
        Some((plan.output(Unit { clip, node }, &keys), keys[node].key))
    };
    let wanted: HashSet<_> = open.iter().filter_map(first_open).collect();
    let lost = tried(&plan.run, &wanted)?.len() < wanted.len();
    Ok(if lost { submissions.min(MAX_DOUBLINGS) } else { 0 })
}

/// Memory of an array element, bytes: as the manifest says, or a third more than was measured; doubled after losses.
fn memory(slurm: &Slurm, stage: &str, cost: Option<&StageCost>, doublings: u32) -> u64 {
    let said = slurm.memory.get(stage).and_then(|text| parse_size(text).ok());
    let measured = cost.map(|cost| (cost.peak_rss_bytes / 3 * 4).max(512 << 20));
    said.or(measured).unwrap_or(UNKNOWN_MEMORY) << doublings
}

/// Array elements as Slurm writes them: `0-3,7`.
fn ranges(shards: &BTreeSet<u32>) -> String {
    let mut runs: Vec<(u32, u32)> = Vec::new();
    for &shard in shards {
        match runs.last_mut() {
            Some((_, end)) if *end + 1 == shard => *end = shard,
            _ => runs.push((shard, shard)),
        }
    }
    let text = |&(start, end): &(u32, u32)| {
        if start == end {
            start.to_string()
        } else {
            format!("{start}-{end}")
        }
    };
    runs.iter().map(text).collect::<Vec<_>>().join(",")
}

fn stage_script(
    prepared: &Prepared,
    stage: &str,
    shards: &BTreeSet<u32>,
    shard_count: u32,
    memory: u64,
    last: bool,
) -> Script {
    let (plan, slurm) = (&prepared.plan, &prepared.manifest.slurm);
    let cpus = slurm.cpus.get(stage).copied().unwrap_or(1);
    let at_once = slurm.at_once.map(|count| format!("%{count}")).unwrap_or_default();
    let mut options = vec![
        format!("--array={}{at_once}", ranges(shards)),
        format!("--cpus-per-task={cpus}"),
        format!("--mem={}M", memory.div_ceil(1 << 20)),
        // The worker gets time to give up its clip before the end of the wall time.
        "--signal=B:TERM@60".to_owned(),
    ];
    options.extend(slurm.gres.get(stage).map(|gres| format!("--gres={gres}")));
    let mut words = batch_command(
        &prepared.options.programs,
        stage,
        &units_file(plan),
        "auto",
        shard_count,
    );
    words.extend([
        "--threads".to_owned(),
        cpus.to_string(),
        "--grace".to_owned(),
        "25".to_owned(),
    ]);
    if !last {
        // A clip that failed must not keep the others of its shard from the next stage.
        words.push("--keep-going".to_owned());
    }
    script(prepared, stage, options, &words)
}

fn report_script(prepared: &Prepared, words: &[String]) -> Script {
    script(
        prepared,
        "report",
        vec!["--cpus-per-task=1".to_owned(), "--mem=4096M".to_owned()],
        words,
    )
}

fn script(prepared: &Prepared, name: &str, mut options: Vec<String>, words: &[String]) -> Script {
    let (plan, slurm) = (&prepared.plan, &prepared.manifest.slurm);
    let folder = plan.run.join(SLURM_FOLDER);
    options.insert(0, format!("--job-name=rogs-{}-{name}", safe_name(&plan.name)));
    options.push(format!("--output={}", folder.join("logs/%x_%A_%a.out").display()));
    options.push("--open-mode=append".to_owned());
    options.extend(
        slurm
            .partition
            .as_ref()
            .map(|partition| format!("--partition={partition}")),
    );
    options.extend(slurm.account.as_ref().map(|account| format!("--account={account}")));
    options.extend(slurm.time.as_ref().map(|time| format!("--time={time}")));
    options.extend(slurm.extra.iter().cloned());
    let mut text = "#!/bin/sh\n".to_owned();
    for option in options {
        text.push_str(&format!("#SBATCH {option}\n"));
    }
    for line in &slurm.setup {
        text.push_str(line);
        text.push('\n');
    }
    // `exec`, so that the signal reaches the program and not a shell that waits for it.
    text.push_str(&format!("exec {}\n", shell_line(words)));
    Script {
        name: name.to_owned(),
        path: folder.join(format!("{name}.sbatch")),
        text,
    }
}

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
fn sbatch(command: &[String]) -> Result<String> {
    let mut waits = PATIENCE_MS.iter();
    loop {
        match (sbatch_once(command), waits.next()) {
            (Refusal::Passing(_), Some(&wait)) => std::thread::sleep(std::time::Duration::from_millis(wait)),
            (Refusal::Passing(error) | Refusal::Final(error), _) => return Err(error),
            (Refusal::None(id), _) => return Ok(id),
        }
    }
}

/// How a call of `sbatch` ended.
enum Refusal {
    /// Not refused: the job's id.
    None(String),
    Passing(Error),
    Final(Error),
}

fn sbatch_once(command: &[String]) -> Refusal {
    let error = |message: String| Error::Program {
        program: "sbatch".to_owned(),
        message,
        hint: None,
    };
    let [program, arguments @ ..] = command else {
        return Refusal::Final(error("empty command".to_owned()));
    };
    let output = match Command::new(program).args(arguments).stdin(Stdio::null()).output() {
        Ok(output) => output,
        Err(why) => {
            let error = error(format!("cannot be started: {why}"));
            let hint = "run this where Slurm is installed, or use `rogs plan --emit jsonl` with another engine";
            return Refusal::Final(error.with_hint(hint));
        }
    };
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr).trim().to_owned();
        let error = error(format!("refused ({}): {said}", output.status));
        // One that says nothing was killed, or lost its connection before it could.
        let passing = said.is_empty() || PASSING.iter().any(|what| said.contains(what));
        return if passing {
            let hint = "is the controller well (`scontrol ping`)? The same command goes on";
            Refusal::Passing(error.with_hint(hint))
        } else {
            Refusal::Final(error)
        };
    }
    // `ID` or `ID;CLUSTER`
    let answer = String::from_utf8_lossy(&output.stdout).into_owned();
    let id = answer.trim().split(';').next().unwrap_or_default().to_owned();
    if id.is_empty() || !id.bytes().all(|byte| byte.is_ascii_digit()) {
        return Refusal::Final(error(format!("answered no job id: `{}`", answer.trim())));
    }
    Refusal::None(id)
}

/// Largest array that this Slurm takes; its usual limit where Slurm does not answer.
fn array_limit() -> u32 {
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

fn append_line(path: &Path, value: &impl Serialize) -> Result<()> {
    let mut line = serde_json::to_vec(value).map_err(|error| Error::Schemas(error.to_string()))?;
    line.push(b'\n');
    let file = std::fs::OpenOptions::new().create(true).append(true).open(path);
    file.and_then(|mut file| std::io::Write::write_all(&mut file, &line))
        .map_err(io("cannot write", path))
}

impl Submission {
    /// For people: every script and command.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = String::new();
        for (script, command) in self.scripts.iter().zip(&self.commands) {
            out.push_str(&format!(
                "# {}\n{}\n$ {}\n\n",
                script.path.display(),
                script.text,
                shell_line(command)
            ));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sparse_arrays_are_written_as_ranges() {
        assert_eq!(ranges(&BTreeSet::from([0, 1, 2, 5, 7, 8])), "0-2,5,7-8");
    }

    #[test]
    fn memory_grows_by_doubling_after_losses() {
        let cost = StageCost {
            count: 1,
            seconds: 1.0,
            output_bytes: 1,
            peak_rss_bytes: 3 << 30,
        };
        let slurm = Slurm::default();
        assert_eq!(memory(&slurm, "lift", Some(&cost), 0), 4 << 30);
        assert_eq!(memory(&slurm, "lift", Some(&cost), 2), 16 << 30);
        assert_eq!(memory(&slurm, "lift", None, 0), UNKNOWN_MEMORY);
    }
}
