//! The episodes that a `selection.json` names.

use std::io::Read as _;
use std::path::Path;

use rogs_random::Pcg64;
use rogs_schemas::selection::Selection;

use super::model::{PlanSelection, PlannedSource};
use crate::diagnose::{At, Text};
use crate::error::{Error, Result};
use crate::sources::SourceCache;

/// Longest selection, bytes: some thousand times the paper's.
const MOST_BYTES: u64 = 256 << 20;

/// Reads a selection and draws it again: what does not follow from its seed and its list is refused.
pub(super) fn read_selection(path: &Path, text: &Text, sources: &SourceCache) -> Result<(Selection, PlanSelection)> {
    let at = || At::key("input").then("selection");
    let wrong = |why: &dyn std::fmt::Display| text.error(at(), format!("`{}`: {why}", path.display()));
    if !path.is_file() {
        return Err(wrong(&"the selection is not there")
            .with_hint("`rogs cohort` writes one; paths in a manifest are relative to the manifest's folder"));
    }
    let mut bytes = Vec::new();
    let read = rogs_files::open(path).and_then(|file| file.take(MOST_BYTES + 1).read_to_end(&mut bytes));
    read.map_err(|error| wrong(&error))?;
    if bytes.len() as u64 > MOST_BYTES {
        return Err(wrong(&format!("it has more than {MOST_BYTES} bytes")));
    }
    let anew = |error: Error| error.with_hint("make it again with `rogs cohort`");
    let selection: Selection = serde_json::from_slice(&bytes)
        .map_err(|error| anew(wrong(&format!("not a selection of `rogs cohort`: {error}"))))?;
    selection.check().map_err(|why| anew(wrong(&why)))?;
    let many = u32::try_from(selection.eligible_sorted.len()).unwrap_or(u32::MAX);
    let drawn = Pcg64::from_seed(selection.seed).sorted_sample(many, selection.selected_indices.len());
    if drawn != selection.selected_indices {
        let why = format!(
            "its {} episodes are not those that seed {} draws from its list of {many}: it was edited, or made by another \
             seed or from another list",
            drawn.len(),
            selection.seed
        );
        return Err(anew(wrong(&why)));
    }
    let note = PlanSelection {
        source: PlannedSource {
            path: path.to_owned(),
            content: sources.source("selection", path)?,
        },
        seed: selection.seed,
        counts: selection.counts,
    };
    Ok((selection, note))
}

impl PlanSelection {
    /// It in a few words: `selection.json: 256 of 498 eligible episodes, seed 42`.
    #[must_use]
    pub fn describe(&self) -> String {
        let name = self.source.path.file_name().unwrap_or_default().to_string_lossy();
        format!(
            "{name}: {} of {} eligible episodes, seed {}",
            self.counts.selected, self.counts.eligible, self.seed
        )
    }
}
