//! What a plan consists of.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rogs_schemas::selection::CohortCounts;
use rogs_schemas::{ClipId, ContentHash};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::stage::StageId;

/// Value of [`Plan::format`].
pub const PLAN_FORMAT: &str = "rogs-plan 1";

/// A frozen plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Always [`PLAN_FORMAT`].
    pub format: String,
    /// Name of the run.
    pub name: String,
    /// The run folder. Not part of the file: whoever reads it knows where it lies.
    #[serde(skip)]
    pub run: PathBuf,
    /// The manifest it was made from.
    pub manifest: PathBuf,
    /// What is reconstructed: `recorded`, `rollout` or `recorded, rollout`.
    pub setting: String,
    /// Names of the variants; the first is `main`.
    pub variants: Vec<String>,
    /// What is done for every clip, in an order in which inputs come first.
    pub nodes: Vec<Node>,
    /// The selection that the episodes of `[input]` are taken from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub selection: Option<PlanSelection>,
    /// Folders that episodes lie in.
    pub roots: Vec<PathBuf>,
    /// Calibration files with their content.
    pub calibrations: Vec<PlannedSource>,
    /// Folders with the predictions of outside methods, in the order of the manifest.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub predictions: Vec<PathBuf>,
    /// Folder with the latents of the clips.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latents: Option<PathBuf>,
    /// Folder with the sidecars of the clips.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sidecars: Option<PathBuf>,
    /// Folder with the sidecars of the rollouts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rollout_sidecars: Option<PathBuf>,
    /// Folder with the rollouts of the clips.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rollouts: Option<PathBuf>,
    /// Folder with the latents of the rollouts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rollout_latents: Option<PathBuf>,
    /// The clips, in the order of the manifest. One line each in the file.
    #[serde(skip)]
    pub clips: Vec<PlannedClip>,
}

/// The `selection.json` behind a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlanSelection {
    /// The file and what is in it.
    #[serde(flatten)]
    pub source: PlannedSource,
    /// Seed of the draw.
    pub seed: u64,
    /// Episodes left after every step of the draw.
    pub counts: CohortCounts,
}

/// One stage as it is done for every clip: a column of the plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// Name in messages: `lift`, `score-2`, `lift@VARIANT`.
    pub label: String,
    /// The stage.
    pub stage: StageId,
    /// Version of the stage.
    pub stage_version: u32,
    /// Schema of the output.
    pub schema: String,
    /// Parameters, normalised by the stage.
    pub params: Value,
    /// Name of the output file.
    pub file: String,
    /// True when the output lies in a folder named by its key: it is not of the main run.
    pub by_key: bool,
    /// Inputs by role.
    pub inputs: Vec<NodeInput>,
    /// Variants that use it, as indices into [`Plan::variants`].
    pub variants: Vec<usize>,
}

/// One input of a node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NodeInput {
    /// Role.
    pub role: String,
    /// Where it comes from.
    pub from: InputSource,
}

/// Where an input comes from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InputSource {
    /// The clip's episode.
    Episode,
    /// The clip's calibration file, where it has one.
    Calibration,
    /// The clip's file of the input's role in [`PlannedClip::references`], where it has one.
    Reference,
    /// The clip's folder in one of [`Plan::predictions`], where it has one.
    Prediction(u32),
    /// The clip's file in [`Plan::latents`], where it has one.
    Latents,
    /// The clip's folder in [`Plan::sidecars`], where it has one.
    Sidecars,
    /// The clip's folder in [`Plan::rollout_sidecars`], where it has one.
    RolloutSidecars,
    /// The clip's video or folder in [`Plan::rollouts`], where it has one.
    Rollout,
    /// The clip's file in [`Plan::rollout_latents`], where it has one.
    RolloutLatents,
    /// The output of another node, an index into [`Plan::nodes`].
    Node(usize),
    /// The same source for all clips.
    Source(PlannedSource),
}

/// A source with its content.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedSource {
    /// Where it lies.
    pub path: PathBuf,
    /// What is in it.
    pub content: ContentHash,
}

/// One clip: a row of the plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedClip {
    /// Safe name, unique in the run also without regard to case.
    pub id: ClipId,
    /// Id in its dataset.
    pub episode: String,
    /// Layout of the episode.
    pub layout: String,
    /// Index into [`Plan::roots`].
    pub root: u32,
    /// What ingest needs to pick it out of the root.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub selector: String,
    /// Content of the episode's files.
    pub content: ContentHash,
    /// Index into [`Plan::calibrations`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<u32>,
    /// Files with references that lie in a folder of their own, by role.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub references: BTreeMap<String, PlannedSource>,
    /// Content of the clip's folder in each of [`Plan::predictions`]; empty when no method has one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub predictions: Vec<Option<ContentHash>>,
    /// Content of the clip's file in [`Plan::latents`], where it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latents: Option<ContentHash>,
    /// Content of the clip's folder in [`Plan::sidecars`], where it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sidecars: Option<ContentHash>,
    /// Content of the clip's folder in [`Plan::rollout_sidecars`], where it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rollout_sidecars: Option<ContentHash>,
    /// The clip's video or folder in [`Plan::rollouts`], where it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rollout: Option<RolloutFile>,
    /// Content of the clip's file in [`Plan::rollout_latents`], where it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rollout_latents: Option<ContentHash>,
    /// Parameters of ingest for this clip, normalised, laid over the node's.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub ingest: Map<String, Value>,
}

/// A clip's rollout.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RolloutFile {
    /// Its name in [`Plan::rollouts`].
    pub name: String,
    /// What is in it.
    pub content: ContentHash,
}

impl PlannedClip {
    /// Content of the clip's folder in one of [`Plan::predictions`], where it has one.
    #[must_use]
    pub fn prediction(&self, index: u32) -> Option<ContentHash> {
        self.predictions.get(index as usize).copied().flatten()
    }
}

/// A unit of work: a clip (index) at a node (index).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct WorkUnit {
    /// Index into [`Plan::clips`].
    pub clip: usize,
    /// Index into [`Plan::nodes`].
    pub node: usize,
}

impl Plan {
    /// Folder of a clip.
    #[must_use]
    pub fn clip_folder(&self, clip: usize) -> PathBuf {
        self.run.join("clips").join(&self.clips[clip].id)
    }

    /// Nodes whose outputs a node reads.
    pub fn upstream(&self, node: usize) -> impl Iterator<Item = usize> + '_ {
        self.nodes[node].inputs.iter().filter_map(|input| match input.from {
            InputSource::Node(node) => Some(node),
            _ => None,
        })
    }

    /// Index of a clip by its id or its episode's id.
    ///
    /// # Errors
    /// When there is none; with what was probably meant.
    pub fn find_clip(&self, name: &str) -> crate::Result<usize> {
        let found = self.clips.iter().position(|clip| clip.id == name);
        let found = found.or_else(|| self.clips.iter().position(|clip| clip.episode == name));
        found.ok_or_else(|| {
            let error = crate::Error::usage(format!("the run has no clip `{name}`"));
            let ids = self.clips.iter().map(|clip| clip.id.as_str());
            let episodes = self.clips.iter().map(|clip| clip.episode.as_str());
            // Where a clip is called as its episode is, that is one name.
            let names: std::collections::BTreeSet<&str> = ids.chain(episodes).collect();
            match rogs_schemas::ids::did_you_mean(name, names) {
                Some(meant) => error.with_hint(format!("did you mean `{meant}`?")),
                None => error.with_hint("`rogs status RUN` lists the clips"),
            }
        })
    }
}

/// Where the latents of a clip lie.
pub(super) fn latents_file(root: &Path, clip: &ClipId) -> PathBuf {
    root.join(format!("{clip}.safetensors"))
}
