//! Job scripts.

use std::collections::BTreeSet;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::Serialize;

use crate::error::Result;
use crate::export::batch_command;
use crate::manifest::{MemoryBy, Slurm, safe_name};
use crate::plan::Plan;
use crate::prepare::Prepared;
use crate::quote::{check_word, sbatch_pattern, sbatch_word, shell_line};
use crate::stage::StageId;

/// Folder with scripts, unit list and job output in a run folder.
pub const SLURM_FOLDER: &str = "slurm";

/// The units of a plan, for the job arrays.
pub(super) fn units_file(plan: &Plan) -> PathBuf {
    plan.run.join(SLURM_FOLDER).join("units.jsonl")
}

/// One job script.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Script {
    /// Stage, or `report`.
    pub name: String,
    /// Where it lies.
    pub path: PathBuf,
    /// What is in it.
    pub text: String,
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

/// The script of the job array of a stage.
///
/// # Errors
/// When a path or an option cannot be written into a job script.
pub(super) fn stage_script(
    prepared: &Prepared,
    stage: StageId,
    shards: &BTreeSet<u32>,
    shard_count: u32,
    memory: u64,
    last: bool,
) -> Result<Script> {
    let (plan, slurm) = (&prepared.plan, &prepared.manifest.slurm);
    let cpus = slurm.cpus.get(&stage).copied().unwrap_or(1);
    let at_once = slurm.at_once.map(|count| format!("%{count}")).unwrap_or_default();
    let mut options = vec![
        format!("--array={}{at_once}", ranges(shards)),
        format!("--cpus-per-task={cpus}"),
    ];
    options.extend(memory_option(slurm, memory, cpus));
    // The worker gets time to give up its clip before the end of the wall time.
    options.push("--signal=B:TERM@60".to_owned());
    options.extend(slurm.gres.get(&stage).map(|gres| format!("--gres={gres}")));
    let mut words = batch_command(
        &prepared.options.programs,
        stage,
        &units_file(plan),
        "auto",
        shard_count,
    )?;
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
    script(prepared, stage.name(), options, &words)
}

/// The script of the job at the end.
///
/// # Errors
/// As [`stage_script`].
pub(super) fn report_script(prepared: &Prepared, words: &[String]) -> Result<Script> {
    let mut options = vec!["--cpus-per-task=1".to_owned()];
    options.extend(memory_option(&prepared.manifest.slurm, 4 << 30, 1));
    script(prepared, "report", options, words)
}

/// How the memory of an element is asked for, bytes; some sites know it by core only, or want no word about it.
fn memory_option(slurm: &Slurm, memory: u64, cpus: u32) -> Option<String> {
    let mebibytes = memory.div_ceil(1 << 20);
    match slurm.memory_by.unwrap_or_default() {
        MemoryBy::Node => Some(format!("--mem={mebibytes}M")),
        MemoryBy::Cpu => Some(format!("--mem-per-cpu={}M", mebibytes.div_ceil(u64::from(cpus.max(1))))),
        MemoryBy::None => None,
    }
}

fn script(prepared: &Prepared, name: &str, mut options: Vec<String>, words: &[String]) -> Result<Script> {
    let (plan, slurm) = (&prepared.plan, &prepared.manifest.slurm);
    let folder = plan.run.join(SLURM_FOLDER);
    options.insert(0, format!("--job-name=rogs-{}-{name}", safe_name(&plan.name)));
    options.push(format!("--output={}/logs/%x_%A_%a.out", sbatch_pattern(&folder)?));
    options.push("--open-mode=append".to_owned());
    options.extend(
        slurm
            .partition
            .as_ref()
            .map(|partition| format!("--partition={partition}")),
    );
    options.extend(slurm.account.as_ref().map(|account| format!("--account={account}")));
    options.extend(slurm.time.as_ref().map(|time| format!("--time={time}")));
    let shell = slurm.shell.as_deref().unwrap_or("/bin/sh");
    check_word(shell)?;
    let mut text = format!("#!{shell}\n");
    for option in options {
        text.push_str(&format!("#SBATCH {}\n", sbatch_word(&option)?));
    }
    for line in &slurm.extra {
        check_word(line)?;
        text.push_str(&format!("#SBATCH {line}\n"));
    }
    if !slurm.setup.is_empty() {
        // A module that does not load must not go on without it: the job ends here, and its log says why.
        text.push_str("set -e\n");
    }
    for line in &slurm.setup {
        text.push_str(line);
        text.push('\n');
    }
    let words = as_jobs_call(prepared, words);
    words.iter().try_for_each(|word| check_word(word))?;
    // `exec`, so that the signal reaches the program and not a shell that waits for it.
    text.push_str(&format!("exec {}\n", shell_line(&words)));
    Ok(Script {
        name: name.to_owned(),
        path: folder.join(format!("{name}.sbatch")),
        text,
    })
}

/// The words of a command as jobs call it: behind those of a container, and by the program's path in there.
fn as_jobs_call(prepared: &Prepared, words: &[String]) -> Vec<String> {
    let slurm = &prepared.manifest.slurm;
    let mut words = words.to_vec();
    if let (Some(program), Some(first)) = (&slurm.program, words.first_mut()) {
        first.clone_from(program);
    }
    slurm.wrap.iter().cloned().chain(words).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_asked_for_as_the_site_knows_it() {
        let by = |memory_by| {
            let slurm = Slurm {
                memory_by,
                ..Slurm::default()
            };
            memory_option(&slurm, 5 << 30, 4)
        };
        assert_eq!(by(None).as_deref(), Some("--mem=5120M"));
        assert_eq!(by(Some(MemoryBy::Cpu)).as_deref(), Some("--mem-per-cpu=1280M"));
        assert_eq!(by(Some(MemoryBy::None)), None);
    }

    #[test]
    fn sparse_arrays_are_written_as_ranges() {
        assert_eq!(ranges(&BTreeSet::from([0, 1, 2, 5, 7, 8])), "0-2,5,7-8");
    }
}
