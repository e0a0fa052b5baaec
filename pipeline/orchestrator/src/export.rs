//! The plan as one self-contained line a unit, for engines that start processes on other machines.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};

use rogs_schemas::ledger::PlannedUnit;
use rogs_schemas::protocol::JobId;
use schemars::JsonSchema;
use serde::Serialize;

use crate::error::{Result, io};
use crate::plan::{Plan, WorkUnit};
use crate::programs::StagePrograms;
use crate::quote::path_word;
use crate::stage::StageId;

/// What was exported and how to run it.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Export {
    /// The file.
    pub plan: PathBuf,
    /// Lines in it.
    pub units: usize,
    /// Shards.
    pub shards: u32,
    /// One command a stage and shard, in an order in which what they need comes first. All commands of a stage may run
    /// at the same time; the next stage of a shard needs the stage before of the same shard.
    pub commands: Vec<Vec<String>>,
}

/// Shard of a clip: slices of equal length in the order of the plan. The plan file freezes it, so a longer plan moves
/// no unit of an older file.
#[must_use]
pub fn shard_of(clip: usize, clips: usize, shards: u32) -> u32 {
    (clip as u64 * u64::from(shards) / clips.max(1) as u64) as u32
}

/// Stages of a plan in pipeline order, each once.
#[must_use]
pub fn stages(plan: &Plan) -> Vec<StageId> {
    let stages: BTreeSet<StageId> = plan.nodes.iter().map(|node| node.stage).collect();
    stages.into_iter().collect()
}

/// Writes the units of a plan, one JSON line each.
///
/// # Errors
/// The error of the writer.
pub fn write_units(plan: &Plan, shards: u32, out: &mut dyn Write) -> std::io::Result<usize> {
    let mut number = 0;
    let maker = plan.key_maker();
    for clip in 0..plan.clips.len() {
        let keys = maker.keys(clip);
        let shard = shard_of(clip, plan.clips.len(), shards);
        for node in 0..plan.nodes.len() {
            let job = plan.job(JobId(number), WorkUnit { clip, node }, &keys);
            let unit = PlannedUnit {
                shard,
                shards,
                run: plan.run.clone(),
                job,
            };
            serde_json::to_writer(&mut *out, &unit)?;
            out.write_all(b"\n")?;
            number += 1;
        }
    }
    Ok(number as usize)
}

/// Freezes the plan, writes its units to `file`, and tells the commands that run them.
///
/// # Errors
/// When the file cannot be written.
pub fn export(plan: &Plan, programs: &StagePrograms, shards: u32, file: &Path) -> Result<Export> {
    let shards = shards.clamp(1, plan.clips.len().max(1) as u32);
    let file = std::path::absolute(file).map_err(io("cannot find", file))?;
    let commands: Result<_> = stages(plan)
        .into_iter()
        .flat_map(|stage| (0..shards).map(move |shard| (stage, shard)))
        .map(|(stage, shard)| batch_command(programs, stage, &file, &shard.to_string(), shards))
        .collect();
    let commands = commands?;
    plan.freeze()?;
    let mut units = 0;
    rogs_files::write_with(&file, |out| {
        units = write_units(plan, shards, out)?;
        Ok(())
    })?;
    Ok(Export {
        commands,
        plan: file.clone(),
        units,
        shards,
    })
}

/// The command that runs one shard of one stage.
///
/// # Errors
/// When a path in it cannot be written down.
pub(crate) fn batch_command(
    programs: &StagePrograms,
    stage: StageId,
    file: &Path,
    shard: &str,
    shards: u32,
) -> Result<Vec<String>> {
    path_word(programs.path())?;
    let mut words = programs.words(stage);
    words.extend(["batch".to_owned(), "--plan".to_owned(), path_word(file)?]);
    words.extend([
        "--shard-index".to_owned(),
        shard.to_owned(),
        "--shard-count".to_owned(),
        shards.to_string(),
    ]);
    Ok(words)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_are_slices_of_even_length() {
        let shards: Vec<u32> = (0..10).map(|clip| shard_of(clip, 10, 3)).collect();
        assert_eq!(shards, [0, 0, 0, 0, 1, 1, 1, 2, 2, 2]);
        assert_eq!(shard_of(0, 0, 1), 0);
    }
}
