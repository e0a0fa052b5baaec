//! What a run folder holds for tables and reports: plan, ledgers and scores taken together.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use rogs_orchestrator::ledger::{last_by_output, read_all};
use rogs_orchestrator::plan::{Plan, WorkUnit, read_plan};
use rogs_orchestrator::stage::StageId;
use rogs_orchestrator::state::OutputState;
use rogs_orchestrator::status::{StatusFailure, status_of};
use rogs_orchestrator::{Error, Result};
use rogs_r4c::read_record;
use rogs_schemas::CacheKey;
use rogs_schemas::ledger::Attempt;
use rogs_schemas::records::agreement::Agreements;
use rogs_schemas::records::clip::{Clip, RECORDED, ROLLOUT};
use rogs_schemas::records::scores::{ScoreSheet, Scores};
use rogs_score::cohort::CohortCounts;
use rogs_score::tables::{MethodSignals, MissingScores, Table, TableId, TableInput, TableOptions, table};
use rogs_score::timing::ClipTiming;
use serde_json::Value;

use crate::contract::signals;
use crate::costs::{keep_some_timings, timing};
use crate::pictures::FieldFile;

/// What a run folder holds for tables and reports.
#[derive(Debug)]
pub struct RunResults {
    pub(crate) plan: Plan,
    /// Clips, in the order of the plan.
    pub(crate) clips: Vec<ClipResults>,
    /// Score sheets of all methods and clips that are up to date.
    pub(crate) sheets: Vec<ScoreSheet>,
    /// What the units cost, for the `timing` and `main` tables.
    timings: Vec<ClipTiming>,
    /// Whether the robot lies on the observations of every clip.
    pub(crate) agreements: Vec<Agreements>,
    /// What every method was given, by the first clip that has scores of it.
    signals: BTreeMap<(String, String), MethodSignals>,
    /// Clips that a method has no scores of, because something of its own failed.
    missing: Vec<MissingScores>,
}

/// What there is of one clip.
#[derive(Debug, Default)]
pub(crate) struct ClipResults {
    /// Clip id.
    pub(crate) id: String,
    /// The recorded clip.
    pub(crate) clip: Option<PathBuf>,
    /// The clip with observations of a world model.
    pub(crate) rollout: Option<PathBuf>,
    /// Robot maps.
    pub(crate) robot: Option<PathBuf>,
    /// Whether the robot lies on the images: of the recorded clip, and of the rollout.
    pub(crate) agreements: Vec<PathBuf>,
    /// The field of Stage 1.
    pub(crate) field: Option<PathBuf>,
    /// Every field of Stage 1, of the run and of its variants, in the order of the plan.
    pub(crate) fields: Vec<FieldFile>,
    /// What Stage 2 adds to it.
    pub(crate) refinement: Option<PathBuf>,
    /// The field that `fit` made of it.
    pub(crate) fitted: Option<PathBuf>,
    /// The field of the baseline 4DGT, the first of several.
    pub(crate) polynomial: Option<PathBuf>,
    /// The field of the baseline Shape of Motion, the first of several.
    pub(crate) motion_bases: Option<PathBuf>,
    /// Scores by method, in the order of the plan; by node where the file cannot be read.
    pub(crate) scores: Vec<(String, PathBuf)>,
    /// What went wrong.
    pub(crate) failures: Vec<StatusFailure>,
    /// The last attempt at each output, by node.
    pub(crate) attempts: Vec<(String, Attempt)>,
}

impl RunResults {
    /// Reads the plan, the ledgers and the scores of a run folder.
    ///
    /// # Errors
    /// When it is none, or cannot be read.
    pub fn read(run: &Path) -> Result<Self> {
        let plan = read_plan(run)?;
        let (status, states) = status_of(&plan)?;
        let attempts = last_by_output(read_all(&plan.run)?);
        let mut results = Self {
            clips: Vec::new(),
            sheets: Vec::new(),
            timings: Vec::new(),
            agreements: Vec::new(),
            signals: BTreeMap::new(),
            missing: Vec::new(),
            plan,
        };
        for index in 0..results.plan.clips.len() {
            results.add_clip(index, &states[index], &attempts);
        }
        for failure in status.failures {
            if let Some(clip) = results.clips.iter_mut().find(|clip| failure.clip == clip.id.as_str()) {
                clip.failures.push(failure);
            }
        }
        results.missing = missing(&results.plan, &results.clips);
        keep_some_timings(&mut results.timings);
        Ok(results)
    }

    fn add_clip(&mut self, index: usize, states: &[OutputState], attempts: &HashMap<(PathBuf, CacheKey), Attempt>) {
        let plan = &self.plan;
        // Records of the clip by node, read once where the signals of a method are not known yet.
        let mut records: BTreeMap<usize, Option<Clip>> = BTreeMap::new();
        let keys = plan.keys(index);
        let mut clip = ClipResults {
            id: plan.clips[index].id.to_string(),
            ..ClipResults::default()
        };
        // Attempts by node, for the timing of methods.
        let mut costs: BTreeMap<usize, &Attempt> = BTreeMap::new();
        for (node_index, node) in plan.nodes.iter().enumerate() {
            let unit = WorkUnit {
                clip: index,
                node: node_index,
            };
            let output = plan.output(unit, &keys);
            let path = plan.run.join(&output);
            if let Some(attempt) = attempts.get(&(output, keys[node_index].key)) {
                clip.attempts.push((node.label.clone(), attempt.clone()));
                costs.insert(node_index, attempt);
            }
            if states[node_index] != OutputState::UpToDate {
                continue;
            }
            match node.stage {
                StageId::Ingest if is_rollout(&node.params) => clip.rollout = clip.rollout.take().or(Some(path)),
                StageId::Ingest => clip.clip = clip.clip.take().or(Some(path)),
                StageId::RobotMaps if !node.by_key => clip.robot = Some(path),
                StageId::Agreement => {
                    // The page names a file that cannot be read.
                    self.agreements
                        .extend(read_record::<Agreements>(&path).map(|(own, _)| own));
                    clip.agreements.push(path);
                }
                StageId::Lift => {
                    clip.fields.push(field_file(plan, node_index, path.clone()));
                    if !node.by_key {
                        clip.field = clip.field.take().or(Some(path));
                    }
                }
                StageId::Refine if !node.by_key => clip.refinement = clip.refinement.take().or(Some(path)),
                StageId::Lift4dgt => clip.polynomial = clip.polynomial.take().or(Some(path)),
                StageId::LiftSom => clip.motion_bases = clip.motion_bases.take().or(Some(path)),
                StageId::Fit if !node.by_key => clip.fitted = clip.fitted.take().or(Some(path)),
                StageId::Score => match read_record::<Scores>(&path) {
                    // An outside method without a prediction for the clip: it does not count there.
                    Ok((scores, _)) if is_empty(&scores.summary) => {}
                    Ok((scores, _)) => {
                        let sheet = scores.summary;
                        clip.scores.push((sheet.method.clone(), path));
                        let name = (sheet.setting.clone(), sheet.method.clone());
                        let ingest = plan
                            .upstream(node_index)
                            .find(|&node| plan.nodes[node].stage == StageId::Ingest);
                        if let (false, Some(node)) = (self.signals.contains_key(&name), ingest) {
                            let unit = WorkUnit { clip: index, node };
                            let read = || read_record::<Clip>(&plan.run.join(plan.output(unit, &keys))).ok();
                            let record = records.entry(node).or_insert_with(|| Some(read()?.0));
                            let found = record.as_ref().map(|record| signals(plan, node_index, &sheet, record));
                            self.signals.extend(found.map(|found| (name, found)));
                        }
                        self.timings.push(timing(plan, index, node_index, &sheet, &costs));
                        self.sheets.push(sheet);
                    }
                    // The page names the file that cannot be read.
                    Err(_) => clip.scores.push((node.label.clone(), path)),
                },
                _ => {}
            }
        }
        self.clips.push(clip);
    }

    /// Takes in the scores, times and signals of another run, for tables over both: of other clips, methods or settings.
    pub fn add(&mut self, other: Self) {
        self.sheets.extend(other.sheets);
        self.timings.extend(other.timings);
        self.agreements.extend(other.agreements);
        self.missing.extend(other.missing);
        for (name, signals) in other.signals {
            self.signals.entry(name).or_insert(signals);
        }
        keep_some_timings(&mut self.timings);
    }

    /// One table of the paper over the clips of the run.
    ///
    /// # Errors
    /// When two outputs are scores of one method, setting and clip.
    pub fn table(&self, id: TableId, cohort: Option<&CohortCounts>, options: TableOptions) -> Result<Table> {
        let signals: Vec<MethodSignals> = self.signals.values().cloned().collect();
        let input = TableInput {
            sheets: &self.sheets,
            timings: &self.timings,
            // The selection that the run was planned with, unless another is given.
            cohort: cohort.or(self.plan.selection.as_ref().map(|own| &own.counts)),
            signals: &signals,
            agreements: &self.agreements,
            missing: &self.missing,
        };
        table(id, &input, options).map_err(|error| Error::usage(error.to_string()))
    }
}

/// The field of a node, and what it was lifted with.
fn field_file(plan: &Plan, node_index: usize, path: PathBuf) -> FieldFile {
    let node = &plan.nodes[node_index];
    let is = |name: &str, value: &Value| node.params.get(name) == Some(value);
    let mut ingests = plan
        .upstream(node_index)
        .filter(|&own| plan.nodes[own].stage == StageId::Ingest);
    // A baseline has the variant of the run, and a method of its own where it is scored.
    let scores = plan.nodes.iter().enumerate();
    let mut scores = scores
        .filter(|&(index, own)| own.stage == StageId::Score && plan.upstream(index).any(|read| read == node_index));
    let baseline = scores.find_map(|(_, own)| {
        let method = own.params.get("method").and_then(Value::as_str);
        method.filter(|method| !method.starts_with("stage1"))
    });
    // The first variant is the run itself; of others the label ends in the name, as in `lift@rollout@VARIANT`.
    let main = node.variants.contains(&0) && baseline.is_none();
    let variant = node.label.rsplit_once('@').filter(|_| !main).map(|(_, name)| name);
    FieldFile {
        name: match (baseline, variant) {
            (Some(method), _) => method.to_owned(),
            (None, Some(name)) => format!("stage1/{}", name.replace('+', "/")),
            (None, None) => "stage1".to_owned(),
        },
        path,
        camera_wise: is("attention", &Value::from("camera-wise")),
        anchored: !is("anchoring", &Value::from(false)),
        conditioned: !is("fk_conditioning", &Value::from(false)),
        of_rollout: ingests.any(|own| is_rollout(&plan.nodes[own].params)),
        main,
    }
}

/// What failed of a method alone, by clip: what it reads besides the clip and its robot, which all methods read.
fn missing(plan: &Plan, clips: &[ClipResults]) -> Vec<MissingScores> {
    let mut missing = Vec::new();
    for (index, node) in plan.nodes.iter().enumerate() {
        let method = node.params.get("method").and_then(Value::as_str);
        let Some(method) = method.filter(|_| node.stage == StageId::Score) else {
            continue;
        };
        // Inputs come first in a plan, so one pass backwards finds all that it reads.
        let mut read = vec![false; plan.nodes.len()];
        read[index] = true;
        for other in (0..=index).rev() {
            if read[other] {
                plan.upstream(other).for_each(|upstream| read[upstream] = true);
            }
        }
        let (mut own, mut setting) = (Vec::new(), RECORDED);
        for (other, _) in read.iter().enumerate().filter(|(_, read)| **read) {
            let other = &plan.nodes[other];
            match other.stage {
                StageId::Ingest if is_rollout(&other.params) => setting = ROLLOUT,
                StageId::Ingest | StageId::RobotMaps => {}
                _ => own.push(other.label.as_str()),
            }
        }
        for clip in clips {
            let failure = clip
                .failures
                .iter()
                .find(|failure| own.contains(&failure.node.as_str()));
            missing.extend(failure.map(|failure| MissingScores {
                setting: setting.to_owned(),
                method: method.to_owned(),
                clip: clip.id.clone(),
                reason: failure.failure.message.clone(),
            }));
        }
    }
    missing
}

/// Whether the parameters of an ingest node ask for a rollout.
fn is_rollout(params: &Value) -> bool {
    params.get("observations").and_then(Value::as_str) == Some(ROLLOUT)
}

/// Whether nothing was measured.
fn is_empty(sheet: &ScoreSheet) -> bool {
    sheet.images.is_empty() && sheet.tracks.is_empty()
}
