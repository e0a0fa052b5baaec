//! Which frames of their episodes the clips of a plan are.

use std::collections::BTreeMap;
use std::fmt;

use schemars::JsonSchema;
use serde::Serialize;

use super::model::{Plan, WorkUnit};

/// Clips that are the same frames of their episodes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub struct ClipInterval {
    /// Episode frame at which they start; none where the stage decides.
    pub start: Option<u64>,
    /// How it decides; empty where the start is given.
    #[serde(skip_serializing_if = "str::is_empty")]
    pub decided: &'static str,
    /// Frames of each.
    pub frames: u64,
    /// Episode frames from one to the next.
    pub step: u64,
    /// Number of clips.
    pub clips: usize,
}

impl Plan {
    /// Which frames of their episodes the clips are, ascending by start.
    #[must_use]
    pub fn clip_intervals(&self) -> Vec<ClipInterval> {
        let cuts = |node: &super::model::Node| node.stage.spec().interval.is_some();
        let Some(node) = self.nodes.iter().position(cuts) else {
            return Vec::new();
        };
        let Some(names) = &self.nodes[node].stage.spec().interval else {
            return Vec::new();
        };
        let mut counts: BTreeMap<(Option<u64>, u64, u64), usize> = BTreeMap::new();
        for clip in 0..self.clips.len() {
            let params = self.params(WorkUnit { clip, node });
            let number = |name: &str| params.get(name).and_then(serde_json::Value::as_u64);
            let key = (
                number(names.start),
                number(names.frames).unwrap_or(0),
                number(names.step).unwrap_or(1),
            );
            *counts.entry(key).or_default() += 1;
        }
        let interval = |((start, frames, step), clips)| ClipInterval {
            start,
            decided: if start.is_none() { names.decides } else { "" },
            frames,
            step,
            clips,
        };
        counts.into_iter().map(interval).collect()
    }
}

impl fmt::Display for ClipInterval {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let steps = if self.step == 1 {
            String::new()
        } else {
            format!(", every {}th", self.step)
        };
        write!(f, "{} clips of {} episode frames{steps}, ", self.clips, self.frames)?;
        match self.start {
            Some(start) => {
                let last = start + self.frames.saturating_sub(1) * self.step;
                write!(f, "{start} to {last}")
            }
            None => write!(f, "from {}", self.decided),
        }
    }
}
