//! The nodes of a plan: stages with their parameters and where their inputs come from, for the run, its variants and
//! outside methods.

mod baselines;

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use rogs_schemas::ids::did_you_mean;
use rogs_schemas::overlay;
use rogs_schemas::protocol::{Description, InputDescription};
use serde_json::{Map, Value};

use super::model::{InputSource, Node, NodeInput, PlannedSource};
use crate::diagnose::{At, Text, path_hint, shown};
use crate::error::{Error, Result};
use crate::manifest::{Baseline, Chosen, Manifest, Params, Prediction, Setting, Variant};
use crate::programs::StagePrograms;
use crate::sources::SourceCache;
use crate::stage::{BASELINES, BaselineSpec, Filled, OUTSIDE, Output, Outside, Provider, StageId, WeightsRole, When};

/// Makes the nodes of the run, of its variants, and of outside methods. What variants have in common is one node.
///
/// # Errors
/// When the manifest does not fit the stages or a source is missing; with line and column.
pub(super) fn make_nodes(
    manifest: &Manifest,
    text: &Text,
    programs: &StagePrograms,
    sources: &SourceCache,
) -> Result<Vec<Node>> {
    let mut builder = Builder {
        manifest,
        text,
        programs,
        sources,
        wanted: wanted(manifest),
        described: HashMap::new(),
        nodes: Vec::new(),
    };
    builder.check_names()?;
    let variants = manifest.variants.iter().enumerate();
    let columns: Vec<Column<'_>> = std::iter::once(Column::Main)
        .chain(variants.map(|(index, variant)| Column::Variant(index, variant)))
        .collect();
    // What each column made of the setting before: a rollout shares what does not depend on the observations.
    let mut made: Vec<Option<Made>> = vec![None; columns.len()];
    let mut mains = Vec::new();
    for (number, &setting) in manifest.settings().iter().enumerate() {
        for (column, made) in columns.iter().zip(&mut made) {
            let chain = Chain {
                column: *column,
                setting,
                beside: number > 0,
            };
            *made = Some(builder.add_chain(chain, made.as_ref())?);
        }
        mains.extend(made[0].clone().map(|main| (setting, number > 0, main)));
    }
    for (index, method) in manifest.predictions.iter().enumerate() {
        let asked = method.setting.as_deref();
        let fits = |(setting, ..): &&(Setting, bool, Made)| asked.is_none_or(|asked| asked == setting.name());
        if let Some((setting, beside, main)) = mains.iter().find(fits) {
            let chain = Chain {
                column: Column::Outside(index, method),
                setting: *setting,
                beside: *beside,
            };
            builder.add_outside(chain, method, main)?;
        }
    }
    builder.add_baselines(&mains)?;
    Ok(builder.nodes)
}

/// The stages to run, with those they need: what `[run] stages` names, what baselines read, and what a table asks for
/// where a stage reads it.
fn wanted(manifest: &Manifest) -> Vec<StageId> {
    let mut wanted = StageId::with_producers(&manifest.run.stages);
    match manifest.run.agreement {
        Some(false) => wanted.retain(|stage| {
            let named = manifest.run.stages.contains(stage);
            *stage != StageId::Agreement || named
        }),
        Some(true) => wanted.push(StageId::Agreement),
        None => {}
    }
    wanted.extend(baselines::producers(manifest));
    let scored = !manifest.baselines.is_empty();
    let asks = |stage| manifest.asks(stage) || manifest.variants.iter().any(|variant| variant.asks(stage));
    // A stage that reads it under a condition reads it where some column meets that.
    let reads = |reader: &StageId, stage| {
        let mut inputs = reader
            .spec()
            .inputs
            .iter()
            .filter(|input| input.provider == Provider::Stage(stage));
        let variants = manifest.variants.iter().map(|variant| variant.params(*reader));
        let tables: Vec<&Params> = std::iter::once(manifest.params(*reader)).chain(variants).collect();
        let met = |when: &When| tables.iter().any(|table| when.holds(|name| table.get(name)));
        inputs.any(|input| input.when.as_ref().is_none_or(met))
    };
    for &stage in StageId::ALL.iter().filter(|stage| stage.spec().asked) {
        let scores = BASELINES.iter().any(|spec| reads(&spec.score, stage));
        if asks(stage) && (wanted.iter().any(|reader| reads(reader, stage)) || scored && scores) {
            wanted.push(stage);
        }
    }
    StageId::with_producers(&wanted)
}

/// Which node makes the output of a stage, while the nodes of a variant are made.
type Made = BTreeMap<StageId, usize>;

/// What a node is made for.
#[derive(Clone, Copy)]
enum Column<'a> {
    /// The run itself.
    Main,
    /// One of `[[variants]]`, by its index.
    Variant(usize, &'a Variant),
    /// One of `[[predictions]]`, by its index.
    Outside(usize, &'a Prediction),
    /// One of `[[baselines]]`, by its index.
    Baseline(usize, &'a Baseline, &'static BaselineSpec),
}

/// The nodes of a column that reconstruct the same kind of observations.
#[derive(Clone, Copy)]
struct Chain<'a> {
    column: Column<'a>,
    setting: Setting,
    /// Beside the nodes of another setting, from which its labels and folders must differ.
    beside: bool,
}

impl<'a> Chain<'a> {
    /// Where the manifest says something about it and a stage.
    fn at(self, stage: StageId) -> At<'a> {
        self.column.at(stage)
    }

    /// A stage's output in messages: `lift`, `lift@VARIANT`, `lift@rollout`, `lift@rollout@VARIANT`.
    fn label(self, output: &str) -> String {
        let setting = self.beside.then(|| self.setting.name());
        let parts = [Some(output), setting, self.column.name()];
        parts.into_iter().flatten().collect::<Vec<_>>().join("@")
    }
}

impl<'a> Column<'a> {
    /// Where the manifest says something about it and a stage.
    fn at(self, stage: StageId) -> At<'a> {
        match self {
            Column::Main => At::key(stage.name()),
            Column::Variant(index, _) => At::key("variants").item(index).then(stage.name()),
            Column::Outside(index, _) => At::key("predictions").item(index).then(stage.name()),
            Column::Baseline(index, _, spec) => {
                // Whatever stage makes the field, its parameters have one name.
                let table = if stage == spec.lift { StageId::Lift } else { stage }.name();
                At::key("baselines").item(index).then(table)
            }
        }
    }

    /// Its name in labels; the run has none.
    fn name(self) -> Option<&'a str> {
        match self {
            Column::Main => None,
            Column::Variant(_, variant) => Some(&variant.name),
            Column::Outside(_, method) => Some(&method.name),
            Column::Baseline(_, baseline, _) => Some(baseline.name()),
        }
    }

    /// Name of its rows in the tables; `+` stands for `/` in names of the manifest, as in `stage1+2/no-mesh/no-fk`.
    fn rows(self, output: &Output) -> String {
        match self.name().map(|name| name.replace('+', "/")) {
            None => output.method.to_owned(),
            Some(name) if output.method.is_empty() => name,
            Some(name) => format!("{}/{name}", output.method),
        }
    }
}

/// Names that a stage does not know: where each stands, what is wrong, what to do.
fn unknown<'t>(at: &At<'t>, given: &'t Params, defaults: &Value, found: &mut Vec<(At<'t>, String, String)>) {
    let Value::Object(defaults) = defaults else {
        return;
    };
    for (name, value) in given {
        let here = at.clone().then(name);
        match defaults.get(name) {
            Some(inside @ Value::Object(_)) => {
                if let Value::Object(value) = value {
                    unknown(&here, value, inside, found);
                }
            }
            Some(_) => {}
            None => {
                let hint = if name == "weights" {
                    "weights are named in a table of their own: [weights] with lift = \"FILE\"".to_owned()
                } else {
                    did_you_mean(name, defaults.keys().map(String::as_str)).map_or_else(
                        || {
                            let known: Vec<&str> = defaults.keys().map(String::as_str).collect();
                            format!("known: {}", known.join(", "))
                        },
                        |meant| format!("did you mean `{meant}`?"),
                    )
                };
                found.push((here, format!("unknown parameter `{name}` of `{at}`"), hint));
            }
        }
    }
}

struct Builder<'a> {
    manifest: &'a Manifest,
    text: &'a Text,
    programs: &'a StagePrograms,
    sources: &'a SourceCache,
    /// Stages to run, with those they need.
    wanted: Vec<StageId>,
    described: HashMap<(StageId, String), Description>,
    nodes: Vec<Node>,
}

impl<'a> Builder<'a> {
    fn describe(&mut self, stage: StageId, params: &Value) -> Result<Description> {
        let key = (stage, params.to_string());
        if let Some(description) = self.described.get(&key) {
            return Ok(description.clone());
        }
        let description = self.programs.describe(stage, params)?;
        Ok(self.described.entry(key).or_insert(description).clone())
    }

    /// Parameters of a stage as they are when nobody sets any.
    fn defaults(&mut self, stage: StageId) -> Result<Value> {
        Ok(self.describe(stage, &Value::Object(Map::new()))?.default_params)
    }

    /// Names in the stages' tables that the stages do not know, also of stages that this run does not reach.
    fn check_names(&mut self) -> Result<()> {
        let manifest = self.manifest;
        let has_table = |stage: StageId| {
            let mut tables = manifest.variants.iter().map(|variant| variant.params(stage));
            !manifest.params(stage).is_empty() || tables.any(|table| !table.is_empty())
        };
        for &stage in StageId::ALL {
            let wanted = self.wanted.contains(&stage);
            if !wanted && !has_table(stage) {
                continue;
            }
            let defaults = match self.defaults(stage) {
                Ok(defaults) => defaults,
                // What a run does not reach needs no program.
                Err(_) if !wanted => continue,
                Err(error) => return Err(error),
            };
            self.check_table(At::key(stage.name()), manifest.params(stage), &defaults)?;
            for (index, variant) in manifest.variants.iter().enumerate() {
                let at = Column::Variant(index, variant).at(stage);
                self.check_table(at, variant.params(stage), &defaults)?;
            }
            if stage == StageId::Ingest {
                if let Some(input) = &manifest.input {
                    self.check_table(At::key("input").then(stage.name()), &input.ingest, &defaults)?;
                }
                for (index, episode) in manifest.episodes.iter().enumerate() {
                    let at = At::key("episodes").item(index).then(stage.name());
                    self.check_table(at, &episode.ingest, &defaults)?;
                }
            }
        }
        Ok(())
    }

    /// Refuses names in a table of parameters that the stage does not know: all of them at once, at the place of the first.
    fn check_table(&self, at: At<'_>, given: &Params, defaults: &Value) -> Result<()> {
        let mut found = Vec::new();
        unknown(&at, given, defaults, &mut found);
        let mut found = found.into_iter();
        let Some((here, message, hint)) = found.next() else {
            return Ok(());
        };
        let others: Vec<String> = found.map(|(_, message, hint)| format!("{message} ({hint})")).collect();
        let hint = match others[..] {
            [] => hint,
            _ => format!("{hint}; also: {}", others.join("; ")),
        };
        Err(self.text.error(here, message).with_hint(hint))
    }

    /// Adds the nodes of the run or of a variant; says which node makes the output of each stage. `shared` are those of
    /// the same column with other observations.
    fn add_chain(&mut self, chain: Chain<'a>, shared: Option<&Made>) -> Result<Made> {
        let mut made = Made::new();
        for stage in self.wanted.clone() {
            if stage.spec().asked && !self.asked_by(chain.column, stage) {
                continue;
            }
            let shared = shared.filter(|_| stage.spec().blind);
            if let Some(&node) = shared.and_then(|shared| shared.get(&stage)) {
                made.insert(stage, node);
                continue;
            }
            for output in outputs(stage, chain.column, &made) {
                let mut params = Value::Object(self.manifest.params(stage).clone());
                if let Column::Variant(_, variant) = chain.column {
                    overlay(&mut params, &Value::Object(variant.params(stage).clone()));
                }
                let node = self.node(stage, output, chain, params, &made)?;
                let node = self.add(node);
                made.insert(stage, node);
            }
        }
        Ok(made)
    }

    /// Whether the run or a variant wants a stage that has to be asked for.
    fn asked_by(&self, column: Column<'_>, stage: StageId) -> bool {
        let variant = match column {
            Column::Variant(_, variant) => variant.asks(stage),
            Column::Main | Column::Outside(..) | Column::Baseline(..) => false,
        };
        variant || self.manifest.asks(stage) || self.manifest.run.stages.contains(&stage)
    }

    /// Adds the node that scores an outside method.
    fn add_outside(&mut self, chain: Chain<'a>, method: &'a Prediction, main: &Made) -> Result<()> {
        let Outside { stage, output, options } = &OUTSIDE;
        let stage = *stage;
        if !method.root.is_dir() {
            let message = format!("`{}` is not a folder", method.root.display());
            let at = match chain.column {
                Column::Outside(index, _) => At::key("predictions").item(index).then("root"),
                Column::Main | Column::Variant(..) | Column::Baseline(..) => At::key("predictions"),
            };
            let error = self.text.error(at, message);
            return Err(error.with_hint("it holds one folder a clip, named by the clip's id (`rogs status RUN`)"));
        }
        let defaults = self.defaults(stage)?;
        self.check_table(chain.at(stage), &method.score, &defaults)?;
        let mut params = Value::Object(self.manifest.params(stage).clone());
        overlay(&mut params, &Value::Object(method.score.clone()));
        overlay(&mut params, &serde_json::json!({ *options: method.options() }));
        let node = self.node(stage, output, chain, params, main)?;
        self.nodes.push(node);
        Ok(())
    }

    /// Adds a node, or finds the one that does the same already.
    fn add(&mut self, node: Node) -> usize {
        let same = |other: &Node| {
            other.stage == node.stage
                && other.file == node.file
                && other.params == node.params
                && other.inputs == node.inputs
        };
        if let Some(index) = self.nodes.iter().position(same) {
            let variants = &mut self.nodes[index].variants;
            for variant in node.variants {
                if !variants.contains(&variant) {
                    variants.push(variant);
                }
            }
            return index;
        }
        self.nodes.push(node);
        self.nodes.len() - 1
    }

    /// The node that makes an output of a stage; `made` are the nodes that it may read from.
    fn node(
        &mut self,
        stage: StageId,
        output: &Output,
        chain: Chain<'a>,
        mut params: Value,
        made: &Made,
    ) -> Result<Node> {
        let plain = self.describe(stage, &Value::Object(Map::new()))?;
        self.fill_in(stage, &mut params, &plain, chain, output);
        let description = self
            .describe(stage, &params)
            .map_err(|error| self.placed(error, chain.column, stage))?;
        let mut inputs = Vec::new();
        for input in &description.inputs {
            if let Some(from) = self.input(stage, output, chain, input, &description.default_params, made)? {
                inputs.push(NodeInput {
                    role: input.role.clone(),
                    from,
                });
            }
        }
        Ok(Node {
            label: chain.label(output.label),
            stage,
            stage_version: description.stage_version,
            schema: description.output_schema,
            params: description.default_params,
            file: output.file.to_owned(),
            by_key: chain.beside || chain.column.name().is_some(),
            inputs,
            variants: vec![match chain.column {
                Column::Variant(index, _) => index + 1,
                Column::Main | Column::Outside(..) | Column::Baseline(..) => 0,
            }],
        })
    }

    /// What a stage says of its parameters, at the place in the manifest that they come from.
    fn placed(&self, error: Error, column: Column<'_>, stage: StageId) -> Error {
        let Error::Usage { message, hint } = error else {
            return error;
        };
        let message = match column {
            Column::Outside(_, method) => format!("`{}`: {message}", method.name),
            Column::Baseline(_, baseline, _) => format!("`{}`: {message}", baseline.name()),
            Column::Main | Column::Variant(..) => message,
        };
        let error = self.text.error(column.at(stage), message);
        match hint {
            Some(hint) => error.with_hint(hint),
            None => error,
        }
    }

    /// Parameters that the manifest says in other places than the stage's own table.
    fn fill_in(&self, stage: StageId, params: &mut Value, plain: &Description, chain: Chain<'_>, output: &Output) {
        let Value::Object(params) = params else {
            return;
        };
        for &(name, filled) in stage.spec().filled {
            let known = plain.params_schema["properties"].get(name).is_some();
            if !known || params.contains_key(name) {
                continue;
            }
            let value = match filled {
                Filled::RobotSpec => (self.manifest.robot_spec().ok()).and_then(|spec| serde_json::to_value(spec).ok()),
                Filled::Method => Some(Value::String(chain.column.rows(output))),
                Filled::Observations => Some(Value::from(chain.setting.name())),
                Filled::HasRollouts => self.manifest.rollouts.as_ref().map(|_| Value::from(true)),
                Filled::Rollout => {
                    let rollouts = self.manifest.rollouts.as_ref();
                    let rollouts = rollouts.filter(|_| chain.setting == Setting::Rollout);
                    rollouts.map(|rollouts| Value::Object(rollouts.options()))
                }
                Filled::Weights(of) => match self.chosen_weights(of, chain.column).0 {
                    None => Some(Value::from("builtin")),
                    Some(Chosen::Word(word)) => Some(Value::from(word)),
                    Some(Chosen::File(_)) => None,
                },
            };
            if let Some(value) = value {
                params.insert(name.to_owned(), value);
            }
        }
    }

    /// Where an input of a node comes from; `None` for one that it does not read.
    fn input(
        &self,
        stage: StageId,
        output: &Output,
        chain: Chain<'_>,
        input: &InputDescription,
        params: &Value,
        made: &Made,
    ) -> Result<Option<InputSource>> {
        let role = input.role.as_str();
        let known = stage
            .spec()
            .inputs
            .iter()
            .find(|known| known.role == role && output.reads(role));
        let when = known.and_then(|known| known.when.as_ref());
        if when.is_some_and(|when| !when.holds(|name| params.get(name))) {
            return Ok(None);
        }
        let from = match known.map(|known| known.provider) {
            None | Some(Provider::Hand) => None,
            Some(Provider::Episode) => Some(InputSource::Episode),
            Some(Provider::Calibration) => Some(InputSource::Calibration),
            // Named for every clip where some may have it.
            Some(Provider::Reference) => self.has_references().then_some(InputSource::Reference),
            Some(Provider::Robot) => {
                let urdf = &self.manifest.robot.urdf;
                Some(self.source(role, urdf, At::key("robot").then("urdf"))?)
            }
            Some(Provider::Latents) => self.latents(chain.setting)?,
            Some(Provider::Sidecars) => Some(self.sidecars(stage, chain)?),
            Some(Provider::Rollout) => self.rollouts()?,
            Some(Provider::Predictions) => match chain.column {
                Column::Outside(index, _) => Some(InputSource::Prediction(index as u32)),
                Column::Main | Column::Variant(..) | Column::Baseline(..) => None,
            },
            Some(Provider::Weights(of)) => self.weights(role, of, chain.column)?,
            Some(Provider::Stage(producer)) => made.get(&producer).map(|&node| InputSource::Node(node)),
        };
        if from.is_some() {
            return Ok(from);
        }
        if let Some((when, needed)) = when.and_then(|when| Some((when, when.needed.as_ref()?))) {
            let message = format!("`{} = \"{}\"` needs {}", when.param, when.is, needed.what);
            return Err(self.text.error(chain.at(stage), message).with_hint(needed.hint));
        }
        if input.required {
            let message = match chain.column {
                Column::Outside(..) => format!("predictions need the stage that makes `{role}`"),
                Column::Main | Column::Variant(..) | Column::Baseline(..) => {
                    format!("nothing provides the input `{role}` of stage `{stage}`")
                }
            };
            let hint = match known.map(|known| known.provider) {
                Some(Provider::Stage(producer)) => format!("add `{producer}` to `stages` in [run]"),
                _ => "do the stage programs belong to this program?".to_owned(),
            };
            return Err(self.text.error(chain.at(stage), message).with_hint(hint));
        }
        Ok(None)
    }

    /// Whether the manifest names a folder with references of some episode.
    fn has_references(&self) -> bool {
        let input = self.manifest.input.as_ref().and_then(|input| input.pointworld.as_ref());
        input.is_some()
            || self
                .manifest
                .episodes
                .iter()
                .any(|episode| episode.pointworld.is_some())
    }

    /// A file of `[weights]`: the variant's own, else the run's.
    fn weights(&self, role: &str, of: WeightsRole, column: Column<'_>) -> Result<Option<InputSource>> {
        let (chosen, at) = self.chosen_weights(of, column);
        match chosen {
            Some(Chosen::File(path)) => Ok(Some(self.source(role, path, at)?)),
            Some(Chosen::Word(_)) | None => Ok(None),
        }
    }

    /// What `[weights]` says of a role, and where.
    fn chosen_weights(&self, of: WeightsRole, column: Column<'_>) -> (Option<Chosen<'a>>, At<'static>) {
        match column {
            Column::Variant(index, _) if self.manifest.variants[index].weights.get(of).is_some() => {
                let own = self.manifest.variants[index].weights.get(of);
                (own, At::key("variants").item(index).then("weights").then(of.key()))
            }
            Column::Baseline(_, _, spec) => {
                let of = spec.weights_of(of);
                (self.manifest.weights.get(of), At::key("weights").then(of.key()))
            }
            _ => (self.manifest.weights.get(of), At::key("weights").then(of.key())),
        }
    }

    /// The clips' latents, where the manifest names a folder of them: of the recordings, or of the rollouts.
    fn latents(&self, setting: Setting) -> Result<Option<InputSource>> {
        let (from, root, at) = match setting {
            Setting::Recorded => {
                let root = self.manifest.latents.as_ref().map(|latents| &latents.root);
                (InputSource::Latents, root, At::key("latents").then("root"))
            }
            Setting::Rollout => {
                let at = At::key("rollouts").then("latents");
                let root = self
                    .manifest
                    .rollouts
                    .as_ref()
                    .and_then(|rollouts| rollouts.latents.as_ref());
                if root.is_none() {
                    let message = "`tokens = \"latents\"` needs the latents of the rollouts";
                    let hint = "name their folder: latents = \"FOLDER\" under [rollouts] (docs/rollouts.md)";
                    return Err(self.text.error(At::key("rollouts"), message).with_hint(hint));
                }
                (InputSource::RolloutLatents, root, at)
            }
        };
        let Some(root) = root else { return Ok(None) };
        if !root.is_dir() {
            let error = self.text.error(at, format!("`{}` is not a folder", root.display()));
            return Err(error.with_hint("it holds CLIP.safetensors for every clip, named by the clip's id"));
        }
        Ok(Some(from))
    }

    /// The clips' sidecars: of the recordings, or of the rollouts.
    fn sidecars(&self, stage: StageId, chain: Chain<'_>) -> Result<InputSource> {
        let rollouts = self.manifest.rollouts.as_ref();
        let (from, root, at, key) = match chain.setting {
            Setting::Recorded => {
                let root = self.manifest.sidecars.as_ref().map(|sidecars| &sidecars.root);
                let at = At::key("sidecars").then("root");
                (InputSource::Sidecars, root, at, "[sidecars] with root = \"FOLDER\"")
            }
            Setting::Rollout => {
                let root = rollouts.and_then(|rollouts| rollouts.sidecars.as_ref());
                let at = At::key("rollouts").then("sidecars");
                (
                    InputSource::RolloutSidecars,
                    root,
                    at,
                    "sidecars = \"FOLDER\" under [rollouts]",
                )
            }
        };
        let Some(root) = root else {
            let message =
                format!("`{stage}` needs depth and tracks of every clip, and the manifest names no folder of them");
            let hint = format!("name it: {key} (docs/sidecars.md)");
            return Err(self.text.error(chain.at(stage), message).with_hint(hint));
        };
        if !root.is_dir() {
            let error = self.text.error(at, format!("`{}` is not a folder", shown(root)));
            return Err(error.with_hint("it holds a folder for every clip, named by the clip's id (docs/sidecars.md)"));
        }
        Ok(from)
    }

    /// The clips' rollouts, where the manifest names a folder of them.
    fn rollouts(&self) -> Result<Option<InputSource>> {
        let Some(rollouts) = &self.manifest.rollouts else {
            return Ok(None);
        };
        if !rollouts.root.is_dir() {
            let message = format!("`{}` is not a folder", rollouts.root.display());
            let error = self.text.error(At::key("rollouts").then("root"), message);
            return Err(error
                .with_hint("it holds a video or a folder for every clip, named by the clip's id (docs/rollouts.md)"));
        }
        Ok(Some(InputSource::Rollout))
    }

    fn source(&self, role: &str, path: &Path, at: At<'_>) -> Result<InputSource> {
        if !path.exists() {
            let error = self.text.error(at, format!("`{}` is not there", shown(path)));
            return Err(error.with_hint(path_hint(path)));
        }
        Ok(InputSource::Source(PlannedSource {
            path: path.to_owned(),
            content: self.sources.source(role, path)?,
        }))
    }
}

/// The outputs that a stage makes in the run or a variant: those that read from stages of the run alone. Of several, one
/// that a parameter of the variant speaks against is left out.
fn outputs(stage: StageId, column: Column<'_>, made: &Made) -> Vec<&'static Output> {
    let spec = stage.spec();
    let possible = |output: &&Output| {
        let mut needed = spec.producers(output).chain(output.with);
        needed.all(|producer| made.contains_key(&producer))
    };
    let mut outputs: Vec<&Output> = spec.outputs.iter().filter(possible).collect();
    if let (Column::Variant(_, variant), 2..) = (column, outputs.len()) {
        let given = variant.params(stage);
        outputs.retain(|output| !output.unless.is_some_and(|name| given.contains_key(name)));
    }
    outputs
}
