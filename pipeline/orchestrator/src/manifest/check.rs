//! What must hold of a manifest besides its form.

use std::collections::BTreeSet;

use rogs_schemas::ids::did_you_mean;
use rogs_schemas::protocol::{LONGEST_GRACE, MOST_THREADS};
use rogs_schemas::records::clip::{RECORDED, ROLLOUT};
use rogs_schemas::robots::{PRESETS, preset};

use super::{BOTH, MOST_WORKERS, Manifest, Setting, is_safe_name, parse_size};
use crate::diagnose::{At, Text};
use crate::error::Result;
use crate::stage::{BASELINES, BaselineSpec, StageId};

/// Longest deadline of a unit, seconds: a year.
const LONGEST_DEADLINE: f64 = 366.0 * 86_400.0;

/// What a name may consist of, for messages.
const CHARACTERS: &str = "use 1 to 128 letters, digits and . _ + -";

impl Manifest {
    /// Checks the values.
    ///
    /// # Errors
    /// When one is wrong; at its place in the text.
    pub(super) fn check(&self, text: &Text) -> Result<()> {
        if self.input.is_none() && self.episodes.is_empty() {
            let error = text.error(At::top(), "the manifest names no episodes");
            return Err(error.with_hint("add [[episodes]] with root = \"FOLDER\", or [input] with root = \"FOLDER\""));
        }
        self.check_settings(text)?;
        let (name, out) = (&self.run.name, self.run.out.to_string_lossy());
        for (key, value) in [("name", name.as_str()), ("out", &*out)] {
            if value.contains(char::is_control) {
                let at = At::key("run").then(key);
                return Err(text.error(at, format!("`{key}` has a line end or another control character")));
            }
        }
        if let Some(name) = self.robot.preset.as_deref().filter(|name| preset(name).is_none()) {
            let at = At::key("robot").then("preset");
            let error = text.error(at, format!("unknown robot preset `{name}`"));
            let known: Vec<&str> = PRESETS.iter().map(|preset| preset.name).collect();
            let hint = did_you_mean(name, known.iter().copied()).map_or_else(
                || format!("known: {}; describe others in [robot.spec]", known.join(", ")),
                |meant| format!("did you mean `{meant}`?"),
            );
            return Err(error.with_hint(hint));
        }
        self.robot_spec()
            .map_err(|why| text.unknown(At::key("robot").then("spec"), &why))?;
        self.check_names(text)?;
        self.check_cuts(text)?;
        self.check_resources(text)
    }

    /// Where clips are cut.
    fn check_cuts(&self, text: &Text) -> Result<()> {
        let input = self
            .input
            .iter()
            .map(|input| (At::key("input"), input.stride, input.clips));
        let episodes = self.episodes.iter().enumerate();
        let episodes = episodes.map(|(index, one)| (At::key("episodes").item(index), one.stride, one.clips));
        for (at, stride, clips) in input.chain(episodes) {
            if stride == Some(0) {
                return Err(text.error(at.then("stride"), "invalid stride 0: expected at least 1 episode frame"));
            }
            if stride.is_some() && clips.is_none() {
                let error = text.error(at.then("stride"), "`stride` without `clips`: there is only one clip");
                return Err(error.with_hint("say how many: clips = \"all\", or a number"));
            }
        }
        Ok(())
    }

    /// What is reconstructed, and that there is something for it.
    fn check_settings(&self, text: &Text) -> Result<()> {
        let at = || At::key("run").then("setting");
        let setting = self.run.setting.as_deref();
        if setting.is_some_and(|setting| ![RECORDED, ROLLOUT, BOTH].contains(&setting)) {
            return Err(text.error(at(), "`setting` must be `recorded`, `rollout` or `both`"));
        }
        if self.settings().contains(&Setting::Rollout) && self.rollouts.is_none() {
            let message = "a rollout needs frames of a world model: recorded images are none";
            let hint =
                "name their folder: [rollouts] with root = \"FOLDER\" (docs/rollouts.md), or leave `setting` out";
            return Err(text.error(at(), message).with_hint(hint));
        }
        // One clip is observed in one way; which is told for the run, so that both ways are of the same clips.
        let ingest = StageId::Ingest.name();
        let own = [(At::key(ingest), &self.ingest)];
        let variants = self.variants.iter().enumerate();
        let variants = variants.map(|(index, own)| (At::key("variants").item(index).then(ingest), &own.ingest));
        let episodes = self.episodes.iter().enumerate();
        let episodes = episodes.map(|(index, own)| (At::key("episodes").item(index).then(ingest), &own.ingest));
        let input = self
            .input
            .iter()
            .map(|own| (At::key("input").then(ingest), &own.ingest));
        for (at, params) in own.into_iter().chain(variants).chain(episodes).chain(input) {
            if let Some(name) = ["observations", "rollout"]
                .into_iter()
                .find(|name| params.contains_key(*name))
            {
                let error = text.error(at.then(name), format!("`{name}` is not set here"));
                return Err(error.with_hint("it follows from [rollouts] and from `setting` in [run]"));
            }
        }
        for (index, prediction) in self.predictions.iter().enumerate() {
            let Some(setting) = prediction.setting.as_deref() else {
                continue;
            };
            let known: Vec<&str> = self.settings().iter().map(|setting| setting.name()).collect();
            if !known.contains(&setting) {
                let at = At::key("predictions").item(index).then("setting");
                let message = format!("the run has no setting `{setting}`, it has {}", known.join(", "));
                return Err(text
                    .error(at, message)
                    .with_hint("add [rollouts] for predictions made from a rollout"));
            }
        }
        Ok(())
    }

    /// Names of variants, predictions and clips.
    fn check_names(&self, text: &Text) -> Result<()> {
        let mut taken = BTreeSet::from(["main".to_owned()]);
        for (index, variant) in self.variants.iter().enumerate() {
            let (name, at) = (&variant.name, At::key("variants").item(index).then("name"));
            if !is_safe_name(name) {
                return Err(text.error(at, format!("invalid variant name `{name}`: {CHARACTERS}")));
            }
            if !taken.insert(name.to_lowercase()) {
                return Err(text.error(at, format!("two variants are named `{name}`")));
            }
        }
        let mut taken = BTreeSet::new();
        for (index, prediction) in self.predictions.iter().enumerate() {
            let (name, at) = (&prediction.name, At::key("predictions").item(index).then("name"));
            if !is_safe_name(name) {
                return Err(text.error(at, format!("invalid predictions name `{name}`: {CHARACTERS}")));
            }
            if !taken.insert((name.to_lowercase(), prediction.setting.as_deref())) {
                return Err(text.error(at, format!("two predictions are named `{name}`")));
            }
        }
        self.check_baselines(text, taken.into_iter().map(|(name, _)| name).collect())?;
        for (index, episode) in self.episodes.iter().enumerate() {
            if let Some(id) = episode.id.as_deref().filter(|id| !is_safe_name(id)) {
                let at = At::key("episodes").item(index).then("id");
                return Err(text.error(at, format!("invalid clip name `{id}`: {CHARACTERS}")));
            }
        }
        Ok(())
    }

    /// Methods and names of baselines; `taken` are the names of predictions.
    fn check_baselines(&self, text: &Text, mut taken: BTreeSet<String>) -> Result<()> {
        taken.extend(self.variants.iter().map(|variant| variant.name.to_lowercase()));
        for (index, baseline) in self.baselines.iter().enumerate() {
            let at = At::key("baselines").item(index);
            if BaselineSpec::by_method(&baseline.method).is_none() {
                let message = format!("unknown baseline `{}`", baseline.method);
                let known: Vec<&str> = BASELINES.iter().map(|spec| spec.method).collect();
                let error = text.error(at.then("method"), message);
                return Err(error.with_hint(format!(
                    "these run here: {}; files of others are scored by [[predictions]] (docs/predictions.md)",
                    known.join(", ")
                )));
            }
            let (name, at) = (baseline.name(), at.then("name"));
            if !is_safe_name(name) {
                return Err(text.error(at, format!("invalid baseline name `{name}`: {CHARACTERS}")));
            }
            if !taken.insert(name.to_lowercase()) {
                let error = text.error(at, format!("another baseline, variant or prediction is named `{name}`"));
                return Err(error.with_hint("give it a `name` of its own"));
            }
        }
        Ok(())
    }

    /// Sizes and counts of the machine and of Slurm.
    fn check_resources(&self, text: &Text) -> Result<()> {
        let (executor, own) = (&self.executor, At::key("executor"));
        let all = executor.memory.iter().map(|size| (own.clone().then("memory"), size));
        let by_stage = executor.stage_memory.iter().map(|(stage, size)| {
            let at = own.clone().then("stage-memory").then(stage.name());
            (at, size)
        });
        let slurm = self.slurm.memory.iter().map(|(stage, size)| {
            let at = At::key("slurm").then("memory").then(stage.name());
            (at, size)
        });
        for (at, size) in all.chain(by_stage).chain(slurm) {
            parse_size(size).map_err(|why| text.error(at, why))?;
        }
        let counts = [
            (own.clone().then("workers"), executor.workers, MOST_WORKERS),
            (own.clone().then("threads"), executor.threads, MOST_THREADS),
        ];
        let slurm = [("shards", self.slurm.shards), ("at-once", self.slurm.at_once)];
        let slurm = slurm.map(|(name, count)| {
            (
                At::key("slurm").then(name),
                count.map(|count| count as usize),
                u32::MAX as usize,
            )
        });
        let cpus = self.slurm.cpus.iter().map(|(stage, &count)| {
            let at = At::key("slurm").then("cpus").then(stage.name());
            (at, Some(count as usize), MOST_THREADS)
        });
        for (at, count, most) in counts.into_iter().chain(slurm).chain(cpus) {
            if let Some(count) = count.filter(|count| !(1..=most).contains(count)) {
                let message = format!("invalid `{at}` {count}: expected 1 to {most}");
                return Err(text.error(at, message));
            }
        }
        let grace = executor
            .grace
            .map(|grace| (own.clone().then("grace"), grace, 0.0, LONGEST_GRACE));
        let deadlines = executor.deadline.iter().map(|(stage, &seconds)| {
            (
                own.clone().then("deadline").then(stage.name()),
                seconds,
                1e-3,
                LONGEST_DEADLINE,
            )
        });
        for (at, seconds, least, most) in grace.into_iter().chain(deadlines) {
            // NaN lies in no range.
            if !(least..=most).contains(&seconds) {
                let message = format!("invalid `{at}` {seconds}: expected {least} to {most} seconds");
                return Err(text.error(at, message));
            }
        }
        Ok(())
    }
}
