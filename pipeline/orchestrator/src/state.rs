//! Is an output up to date? The file alone answers.

use std::path::Path;

use rayon::prelude::*;
use rogs_schemas::{CacheKey, Error};

use crate::plan::{KeyMaker, Plan, Unit};

/// What lies at the place of an output.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum OutputState {
    /// A whole file with the right key.
    UpToDate,
    /// Nothing.
    Missing,
    /// A whole file with another key.
    Stale(CacheKey),
    /// Something that is no whole file, or that cannot be read.
    Damaged(String),
}

/// Looks at an output.
#[must_use]
pub fn output_state(path: &Path, key: CacheKey) -> OutputState {
    match rogs_schemas::r4c::read_header(path) {
        Ok(header) if header.key == key => OutputState::UpToDate,
        Ok(header) => OutputState::Stale(header.key),
        Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => OutputState::Missing,
        Err(error) => OutputState::Damaged(crate::Error::from(error).to_string()),
    }
}

impl Plan {
    /// States of all units, clip by clip, node by node.
    #[must_use]
    pub fn states(&self) -> Vec<Vec<OutputState>> {
        let maker = self.key_maker();
        (0..self.clips.len())
            .into_par_iter()
            .map(|clip| self.states_with(clip, &maker))
            .collect()
    }

    /// States of the units of one clip, by node.
    #[must_use]
    pub fn clip_states(&self, clip: usize) -> Vec<OutputState> {
        self.states_with(clip, &self.key_maker())
    }

    fn states_with(&self, clip: usize, maker: &KeyMaker<'_>) -> Vec<OutputState> {
        if !self.clip_folder(clip).is_dir() {
            return vec![OutputState::Missing; self.nodes.len()];
        }
        let keys = maker.keys(clip);
        let state = |node: usize| {
            let unit = Unit { clip, node };
            output_state(&self.run.join(self.output(unit, &keys)), keys[node].key)
        };
        (0..self.nodes.len()).map(state).collect()
    }
}
