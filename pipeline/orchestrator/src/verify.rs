//! Checking every byte of the outputs of a run.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;

use crate::error::Result;
use crate::exit::Exit;
use crate::lock::RunLock;
use crate::plan::{Plan, WorkUnit, read_plan};

/// What a check of a run found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Verification {
    /// Outputs that are whole, byte for byte, and carry the key of the plan.
    pub good: usize,
    /// Outputs that are not there.
    pub missing: usize,
    /// Outputs that are wrong.
    pub bad: Vec<BadOutput>,
}

/// An output that is wrong.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub struct BadOutput {
    /// The file, relative to the run folder.
    pub output: PathBuf,
    /// What is wrong with it.
    pub what: String,
}

/// Reads every output of a run folder and checks it.
///
/// # Errors
/// When the folder is not a run folder.
pub fn verify(run: &Path) -> Result<Verification> {
    Ok(verify_plan(&read_plan(run)?))
}

/// [`verify`], and removes what is wrong, so that the next run makes it again.
///
/// # Errors
/// When the folder is not a run folder or in use, or something that is wrong cannot be removed.
pub fn remove_bad(run: &Path) -> Result<Verification> {
    let _lock = RunLock::acquire(&read_plan(run)?.run)?;
    let plan = read_plan(run)?;
    let found = verify_plan(&plan);
    for bad in &found.bad {
        rogs_files::remove_below(&plan.run, &plan.run.join(&bad.output))?;
    }
    Ok(found)
}

fn verify_plan(plan: &Plan) -> Verification {
    let maker = plan.key_maker();
    let check = |clip: usize| -> Vec<Option<BadOutput>> {
        let keys = maker.keys(clip);
        let states = plan.clip_states(clip);
        let unit = |node: usize| {
            let output = plan.output(WorkUnit { clip, node }, &keys);
            let what = match rogs_r4c::verify(&plan.run.join(&output)) {
                _ if states[node] == crate::state::OutputState::Missing => return None,
                Ok(header) if header.key == keys[node].key => String::new(),
                Ok(header) => format!("it has key {}, the plan says {}", header.key, keys[node].key),
                Err(error) => crate::Error::from(error).to_string(),
            };
            Some(BadOutput { output, what })
        };
        (0..plan.nodes.len()).map(unit).collect()
    };
    let all: Vec<_> = (0..plan.clips.len()).into_par_iter().flat_map_iter(check).collect();
    let missing = all.iter().filter(|checked| checked.is_none()).count();
    let (bad, good): (Vec<_>, Vec<_>) = all.into_iter().flatten().partition(|checked| !checked.what.is_empty());
    Verification {
        good: good.len(),
        missing,
        bad,
    }
}

impl Verification {
    /// Done when nothing is wrong; missing outputs are not wrong.
    #[must_use]
    pub fn exit(&self) -> Exit {
        if self.bad.is_empty() { Exit::Done } else { Exit::Failed }
    }
}
