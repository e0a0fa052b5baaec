//! Is an output up to date? The file alone answers.

use std::path::Path;

use rayon::prelude::*;
use rogs_r4c::Error;
use rogs_schemas::CacheKey;

use crate::plan::{KeyMaker, Plan, WorkUnit};

/// What lies at the place of an output.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum OutputState {
    /// A whole file with the right key.
    UpToDate,
    /// Nothing.
    Missing,
    /// A whole file with another key.
    Stale(CacheKey),
    /// A file that is not whole, or that cannot be read.
    Damaged(String),
}

/// Looks at an output: checks everything but its chunks.
#[must_use]
pub fn output_state(path: &Path, key: CacheKey) -> OutputState {
    state_of(key, rogs_r4c::read_header(path).map(|header| header.key))
}

/// Reads an output of a run folder completely and removes it when it is damaged; says what is wrong with it. `None` for one that is whole,
/// or not there, or that the system does not let us read, which says nothing about it.
///
/// # Errors
/// When it is damaged and cannot be removed.
pub fn remove_damaged(run: &Path, output: &Path) -> crate::Result<Option<String>> {
    let path = run.join(output);
    let why = match rogs_r4c::verify(&path) {
        Ok(_) | Err(Error::Io { .. }) => return Ok(None),
        Err(error) => crate::Error::from(error).to_string(),
    };
    rogs_files::remove_below(run, &path)?;
    Ok(Some(why))
}

/// Looks at an output more quickly: whether it is finished, as long as it should be, and has the key.
#[must_use]
pub fn output_key_state(path: &Path, key: CacheKey) -> OutputState {
    state_of(key, rogs_r4c::read_key(path))
}

fn state_of(key: CacheKey, found: rogs_r4c::Result<CacheKey>) -> OutputState {
    match found {
        Ok(found) if found == key => OutputState::UpToDate,
        Ok(found) => OutputState::Stale(found),
        Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => OutputState::Missing,
        Err(error) => OutputState::Damaged(crate::Error::from(error).to_string()),
    }
}

impl Plan {
    /// States of all units, clip by clip, node by node, by the keys of finished files ([`output_key_state`]).
    #[must_use]
    pub fn states(&self) -> Vec<Vec<OutputState>> {
        self.all_states(output_key_state)
    }

    /// The same with every file's header and index checked ([`output_state`]), for a caller that builds on them.
    #[must_use]
    pub fn checked_states(&self) -> Vec<Vec<OutputState>> {
        self.all_states(output_state)
    }

    fn all_states(&self, look: fn(&Path, CacheKey) -> OutputState) -> Vec<Vec<OutputState>> {
        let maker = self.key_maker();
        (0..self.clips.len())
            .into_par_iter()
            .map(|clip| self.states_with(clip, &maker, look))
            .collect()
    }

    /// States of the units of one clip, by node.
    #[must_use]
    pub fn clip_states(&self, clip: usize) -> Vec<OutputState> {
        self.states_with(clip, &self.key_maker(), output_state)
    }

    fn states_with(
        &self,
        clip: usize,
        maker: &KeyMaker<'_>,
        look: fn(&Path, CacheKey) -> OutputState,
    ) -> Vec<OutputState> {
        if !self.clip_folder(clip).is_dir() {
            return vec![OutputState::Missing; self.nodes.len()];
        }
        let keys = maker.keys(clip);
        let state = |node: usize| {
            let unit = WorkUnit { clip, node };
            look(&self.run.join(self.output(unit, &keys)), keys[node].key)
        };
        (0..self.nodes.len()).map(state).collect()
    }
}
