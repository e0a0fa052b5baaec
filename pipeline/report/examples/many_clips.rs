//! A run of many clips made of one of few, to measure reports: `many_clips RUN OUT COUNT`, then
//! `/usr/bin/time -v rogs report OUT`.
//!
//! Every clip of OUT has the records of a clip of RUN under a name of its own, the costs of it, and nothing else. Needs as
//! much space as COUNT clips have; the manifest of RUN is that of OUT, so `[report] clips` says how many have pictures.
#![allow(clippy::print_stdout, reason = "a program for people")]

use std::error::Error;
use std::path::{Path, PathBuf};

use rogs_orchestrator::ledger::{last_by_output, read_all};
use rogs_orchestrator::plan::{UnitKey, WorkUnit, read_plan};
use rogs_orchestrator::stage::StageId;
use rogs_r4c::ledger::append;
use rogs_r4c::{Record, read_record, write_record};
use rogs_schemas::records::agreement::Agreements;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::field::Field;
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::records::scores::Scores;
use rogs_schemas::{CacheKey, ClipId, Provenance};

type Failable<T> = Result<T, Box<dyn Error>>;

fn main() -> Failable<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [run, out, count] = arguments.as_slice() else {
        return Err("usage: many_clips RUN OUT COUNT".into());
    };
    let plan = read_plan(Path::new(run))?;
    let attempts = last_by_output(read_all(&plan.run)?);
    let mut many = plan.clone();
    many.run = std::path::absolute(out)?;
    many.clips.clear();
    let source = |index: usize| index % plan.clips.len();
    for index in 0..count.parse()? {
        let mut clip = plan.clips[source(index)].clone();
        clip.id = format!("clip-{:04}", index + 1).parse()?;
        many.clips.push(clip);
    }
    many.freeze()?;
    for clip in 0..many.clips.len() {
        let id = many.clips[clip].id.clone();
        let (keys, from_keys) = (many.keys(clip), plan.keys(source(clip)));
        let lift = many
            .nodes
            .iter()
            .position(|node| node.stage == StageId::Lift && !node.by_key);
        let field = lift.map(|node| keys[node].key).unwrap_or_default();
        for node in 0..many.nodes.len() {
            let from = plan.output(
                WorkUnit {
                    clip: source(clip),
                    node,
                },
                &from_keys,
            );
            let to = many.output(WorkUnit { clip, node }, &keys);
            if let Some(attempt) = attempts.get(&(from.clone(), from_keys[node].key)) {
                let mut attempt = attempt.clone();
                (attempt.clip_id, attempt.output, attempt.key) = (id.clone(), to.clone(), keys[node].key);
                append(&many.run.join("ledger/many-1.jsonl"), &attempt)?;
            }
            let copy = Copy {
                from: plan.run.join(from),
                to: many.run.join(to),
                key: &keys[node],
                id: &id,
                field,
            };
            if copy.from.is_file() {
                copy.of_stage(many.nodes[node].stage)?;
            }
        }
        println!("{id}");
    }
    Ok(())
}

/// An output under another name.
struct Copy<'a> {
    from: PathBuf,
    to: PathBuf,
    key: &'a UnitKey,
    id: &'a ClipId,
    /// Of the clip's own field.
    field: CacheKey,
}

impl Copy<'_> {
    fn of_stage(&self, stage: StageId) -> Failable<()> {
        let id = || self.id.clone();
        match stage {
            StageId::Ingest => self.of::<Clip>(|record| record.clip_id = id()),
            StageId::RobotMaps => self.of::<RobotMaps>(|record| record.clip_id = id()),
            StageId::Agreement => self.of::<Agreements>(|record| record.clip_id = id()),
            StageId::Lift => self.of::<Field>(|record| record.clip_id = id()),
            StageId::Refine => self.of::<Refinement>(|record| {
                record.clip_id = id();
                record.field_key = self.field;
            }),
            StageId::Score => self.of::<Scores>(|record| record.summary.clip_id = id()),
            // No report reads it.
            _ => Ok(()),
        }
    }

    fn of<R: Record>(&self, rename: impl FnOnce(&mut R)) -> Failable<()> {
        let (mut record, _) = read_record::<R>(&self.from)?;
        rename(&mut record);
        if let Some(folder) = self.to.parent() {
            std::fs::create_dir_all(folder)?;
        }
        let provenance = Provenance {
            material: self.key.material.clone(),
            input_content: [].into(),
        };
        write_record(&self.to, &record, &provenance)?;
        Ok(())
    }
}
