//! Handing a run to Slurm: one job array per stage, one array element per shard of clips. Nothing is scheduled here.

mod client;
mod script;

use std::collections::{BTreeSet, HashSet};
use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::client::{array_limit, cancelled, sbatch};
pub use self::script::{SLURM_FOLDER, Script};
use self::script::{report_script, stage_script, units_file};
use crate::error::{Error, Result, io};
use crate::export::{shard_of, stages, write_units};
use crate::ledger::{StageCost, read_costs, tried};
use crate::manifest::{Slurm, parse_size};
use crate::plan::{Plan, WorkUnit};
use crate::prepare::Prepared;
use crate::quote::{path_word, shell_line};
use crate::stage::StageId;
use crate::state::OutputState;

/// Clips of one array element when the manifest does not say.
const CLIPS_PER_SHARD: usize = 16;

/// Memory of an array element when nothing is known, bytes.
const UNKNOWN_MEMORY: u64 = 4 << 30;

/// Doublings of memory for shards that were lost without a record, at most.
const MAX_DOUBLINGS: u32 = 3;

/// What was, or would be, submitted.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
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
/// When `sbatch` refuses, or the run folder cannot be written. A submission of nothing has no scripts.
pub fn submit(prepared: &Prepared, finally: Option<&[String]>, dry_run: bool) -> Result<Submission> {
    let _lock = if dry_run {
        None
    } else {
        Some(crate::lock::RunLock::acquire(&prepared.plan.run)?)
    };
    let mut submission = prepare(prepared, finally)?;
    if dry_run || submission.scripts.is_empty() {
        return Ok(submission);
    }
    let plan = &prepared.plan;
    plan.freeze()?;
    prepared.remember_sources();
    let folder = plan.run.join(SLURM_FOLDER);
    rogs_files::make_folder_below(&plan.run, &folder.join("logs"))?;
    rogs_files::write_with(&units_file(plan), |out| {
        write_units(plan, submission.shard_count, out).map(|_| ())
    })?;
    for script in &submission.scripts {
        rogs_files::write_bytes(&script.path, script.text.as_bytes())?;
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
            // Without what follows, the arrays that are in already would only waste time.
            Err(error) => return Err(cancelled(&ids, error)),
        }
    }
    let record = Submitted {
        ids: ids.clone(),
        shards: submission.shards.clone(),
    };
    // A job that nobody knows of is worse than none.
    append_line(&folder.join("submissions.jsonl"), &record).map_err(|error| cancelled(&record.ids, error))?;
    submission.ids = ids;
    Ok(submission)
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
        return Ok(Submission {
            shards: Vec::new(),
            shard_count,
            scripts: Vec::new(),
            commands: Vec::new(),
            ids: Vec::new(),
        });
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
    for (index, &stage) in names.iter().enumerate() {
        let memory = memory(slurm, stage, costs.get(stage.name()), doublings);
        let last = index + 1 == names.len();
        scripts.push(stage_script(prepared, stage, &shards, shard_count, memory, last)?);
        let mut command = vec!["sbatch".to_owned(), "--parsable".to_owned()];
        if let Some(before) = index.checked_sub(1) {
            // Without the second option a dependent of a failed element would wait forever.
            command.push(format!("--dependency=aftercorr:<id of {}>", names[before]));
            command.push("--kill-on-invalid-dep=yes".to_owned());
        }
        command.push(path_word(&scripts[index].path)?);
        commands.push(command);
    }
    if let (Some(words), Some(last)) = (finally, names.last()) {
        let script = report_script(prepared, words)?;
        let dependency = format!("--dependency=afterany:<id of {last}>");
        commands.push(vec![
            "sbatch".to_owned(),
            "--parsable".to_owned(),
            dependency,
            path_word(&script.path)?,
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
    let submissions = match rogs_files::read_to_string(&path) {
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
        Some((plan.output(WorkUnit { clip, node }, &keys), keys[node].key))
    };
    let wanted: HashSet<_> = open.iter().filter_map(first_open).collect();
    let lost = tried(&plan.run, &wanted)?.len() < wanted.len();
    Ok(if lost { submissions.min(MAX_DOUBLINGS) } else { 0 })
}

/// Memory of an array element, bytes: as the manifest says, or a third more than was measured; doubled after losses.
fn memory(slurm: &Slurm, stage: StageId, cost: Option<&StageCost>, doublings: u32) -> u64 {
    let said = slurm.memory.get(&stage).and_then(|text| parse_size(text).ok());
    let measured = cost.map(|cost| (cost.peak_rss_bytes / 3 * 4).max(512 << 20));
    said.or(measured)
        .unwrap_or(UNKNOWN_MEMORY)
        .saturating_mul(1 << doublings)
}

fn append_line(path: &Path, value: &impl Serialize) -> Result<()> {
    let mut line = serde_json::to_vec(value).map_err(|error| Error::Schemas(error.to_string()))?;
    line.push(b'\n');
    Ok(rogs_files::append(path, &line)?)
}

impl Submission {
    /// For people: every script and command.
    #[must_use]
    pub fn text(&self) -> String {
        if self.scripts.is_empty() {
            return "everything is up to date: there is nothing to submit".to_owned();
        }
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
    fn memory_grows_by_doubling_after_losses() {
        let cost = StageCost {
            count: 1,
            seconds: 1.0,
            output_bytes: 1,
            peak_rss_bytes: 3 << 30,
        };
        let slurm = Slurm::default();
        assert_eq!(memory(&slurm, StageId::Lift, Some(&cost), 0), 4 << 30);
        assert_eq!(memory(&slurm, StageId::Lift, Some(&cost), 2), 16 << 30);
        assert_eq!(memory(&slurm, StageId::Lift, None, 0), UNKNOWN_MEMORY);
    }
}
