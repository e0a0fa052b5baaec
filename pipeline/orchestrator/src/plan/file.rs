//! `plan.jsonl`: a header line, then one line a clip.

use std::fs::File;
use std::io::{BufRead, BufReader, Lines, Write as _};
use std::path::Path;

use super::model::{InputSource, NodeInput, PLAN_FORMAT, Plan, PlannedClip};
use crate::error::{Error, Result, io};

/// Name of the plan in a run folder.
pub const PLAN_FILE: &str = "plan.jsonl";

impl Plan {
    /// Writes the plan to its run folder, whole or not at all.
    ///
    /// # Errors
    /// When the folder cannot be made or written.
    pub fn freeze(&self) -> Result<()> {
        rogs_files::make_folder_below(&self.run, &self.run)?;
        rogs_files::write_with(&self.run.join(PLAN_FILE), |out| {
            serde_json::to_writer(&mut *out, self)?;
            for clip in &self.clips {
                out.write_all(b"\n")?;
                serde_json::to_writer(&mut *out, clip)?;
            }
            out.write_all(b"\n")
        })?;
        Ok(())
    }
}

/// Reads the plan of a run folder.
///
/// # Errors
/// When the folder has none, or it is damaged or of another version.
pub fn read_plan(run: &Path) -> Result<Plan> {
    let (mut plan, lines) = open(run)?;
    let path = run.join(PLAN_FILE);
    let damaged = |line: usize, why: &dyn std::fmt::Display| damaged(&path, line, why);
    for (index, line) in lines.enumerate() {
        let line = line.map_err(io("cannot read", &path))?;
        let clip: PlannedClip = serde_json::from_str(&line).map_err(|error| damaged(index + 2, &error))?;
        let known = (clip.root as usize) < plan.roots.len()
            && clip
                .calibration
                .is_none_or(|index| (index as usize) < plan.calibrations.len())
            && crate::manifest::is_safe_name(&clip.id);
        if !known {
            return Err(damaged(index + 2, &"a clip with an unsafe name or an unknown root"));
        }
        plan.clips.push(clip);
    }
    plan.check_nodes().map_err(|why| damaged(1, &why))?;
    Ok(plan)
}

/// Reads the plan of a run folder without its clips.
///
/// # Errors
/// See [`read_plan`].
pub fn read_header(run: &Path) -> Result<Plan> {
    Ok(open(run)?.0)
}

/// The header of a plan file, and the lines of its clips.
fn open(run: &Path) -> Result<(Plan, Lines<BufReader<File>>)> {
    let path = run.join(PLAN_FILE);
    let file = rogs_files::open(&path).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => Error::usage(format!(
            "`{}` is not a run folder: it has no {PLAN_FILE}",
            run.display()
        ))
        .with_hint("name the `out` folder of a manifest that has been run or planned"),
        _ => io("cannot read", &path)(error),
    })?;
    let mut lines = BufReader::new(file).lines();
    let header = lines
        .next()
        .ok_or_else(|| damaged(&path, 1, &"it is empty"))?
        .map_err(io("cannot read", &path))?;
    let mut plan: Plan = serde_json::from_str(&header).map_err(|error| damaged(&path, 1, &error))?;
    if plan.format != PLAN_FORMAT {
        let why = format!("format `{}`, expected `{PLAN_FORMAT}`", plan.format);
        return Err(damaged(&path, 1, &why));
    }
    plan.run = std::path::absolute(run).map_err(io("cannot find", run))?;
    Ok((plan, lines))
}

fn damaged(path: &Path, line: usize, why: &dyn std::fmt::Display) -> Error {
    Error::usage(format!("`{}` is damaged at line {line}: {why}", path.display()))
        .with_hint("run the manifest to make it again (finished outputs are kept)")
}

impl Plan {
    /// Nothing in a plan file may lead out of the run folder or out of its own tables.
    fn check_nodes(&self) -> std::result::Result<(), String> {
        for (index, node) in self.nodes.iter().enumerate() {
            if !crate::manifest::is_safe_name(&node.file) {
                return Err(format!("node `{}` has an unsafe file name", node.label));
            }
            if self.upstream(index).any(|upstream| upstream >= index) {
                return Err(format!("node `{}` reads from a node after it", node.label));
            }
            let beyond = |input: &NodeInput| match input.from {
                InputSource::Prediction(index) => index as usize >= self.predictions.len(),
                _ => false,
            };
            if node.inputs.iter().any(beyond) {
                return Err(format!("node `{}` reads unknown predictions", node.label));
            }
            if node.variants.iter().any(|&variant| variant >= self.variants.len()) {
                return Err(format!("node `{}` is of an unknown variant", node.label));
            }
        }
        Ok(())
    }
}
