//! Making a plan from a manifest.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use rogs_schemas::protocol::Description;
use rogs_schemas::{canonical_json, source::ROBOT_MODEL};
use serde_json::{Map, Value};

use super::{From, Node, NodeInput, PLAN_FORMAT, Plan, Source};
use crate::diagnose::Text;
use crate::error::{Error, Result, did_you_mean};
use crate::manifest::{Manifest, Params, STAGES, Variant};
use crate::programs::StagePrograms;
use crate::sources::SourceCache;

/// Makes the plan: asks the stage programs what they are, lists and hashes the sources. Writes nothing.
///
/// # Errors
/// When the manifest does not fit the stages or a source is missing; with line and column.
pub fn make_plan(manifest: &Manifest, text: &Text, programs: &StagePrograms, sources: &SourceCache) -> Result<Plan> {
    let mut builder = Builder {
        manifest,
        text,
        programs,
        sources,
        described: HashMap::new(),
        nodes: Vec::new(),
    };
    builder.check_names()?;
    let variants = std::iter::once(None).chain(manifest.variants.iter().map(Some));
    for (index, variant) in variants.enumerate() {
        builder.add_variant(index, variant)?;
    }
    builder.add_predictions()?;
    let mut plan = Plan {
        format: PLAN_FORMAT.to_owned(),
        name: manifest.run.name.clone(),
        run: manifest.run.out.clone(),
        manifest: text.path.clone(),
        setting: manifest.run.setting.clone().unwrap_or_else(|| "recorded".to_owned()),
        variants: std::iter::once("main")
            .chain(manifest.variants.iter().map(|variant| variant.name.as_str()))
            .map(String::from)
            .collect(),
        nodes: std::mem::take(&mut builder.nodes),
        roots: Vec::new(),
        calibrations: Vec::new(),
        predictions: manifest.predictions.iter().map(|own| own.root.clone()).collect(),
        latents: None,
        clips: Vec::new(),
    };
    let reads_latents = |node: &Node| node.inputs.iter().any(|input| input.from == From::Latents);
    if plan.nodes.iter().any(reads_latents) {
        plan.latents = manifest.latents.as_ref().map(|latents| latents.root.clone());
    }
    super::clips::add_clips(&mut plan, manifest, text, programs, sources)?;
    Ok(plan)
}

/// Where one stage's output is found while nodes of a variant are made.
type Made = HashMap<&'static str, usize>;

struct Builder<'a> {
    manifest: &'a Manifest,
    text: &'a Text,
    programs: &'a StagePrograms,
    sources: &'a SourceCache,
    described: HashMap<(String, String), Description>,
    nodes: Vec<Node>,
}

impl Builder<'_> {
    /// Stages to run, with those they need.
    fn wanted(&self) -> Vec<&'static str> {
        let asked = &self.manifest.run.stages;
        let ask = |stage: &str| asked.is_empty() || asked.iter().any(|asked| asked == stage);
        // The first four are a chain; refine and score both follow lift.
        let last = (0..4).rev().find(|&index| ask(STAGES[index]));
        let last = if ask("refine") || ask("score") { Some(3) } else { last };
        let chain = STAGES[..last.map_or(0, |last| last + 1)].iter().copied();
        chain
            .chain(["refine", "score"].into_iter().filter(|stage| ask(stage)))
            .collect()
    }

    fn describe(&mut self, stage: &str, params: &Value) -> Result<Description> {
        let key = (stage.to_owned(), params.to_string());
        if let Some(description) = self.described.get(&key) {
            return Ok(description.clone());
        }
        let description = self.programs.describe(stage, params)?;
        Ok(self.described.entry(key).or_insert(description).clone())
    }

    /// Names in the stages' tables that the stages do not know.
    fn check_names(&mut self) -> Result<()> {
        for stage in self.wanted() {
            let defaults = self.describe(stage, &Value::Object(Map::new()))?.default_params;
            self.check_table(&[stage], self.manifest.params(stage), &defaults)?;
            for variant in &self.manifest.variants {
                self.check_table(&["variants", stage], variant.params(stage), &defaults)?;
            }
            if stage == "ingest" {
                let episodes = self
                    .manifest
                    .episodes
                    .iter()
                    .map(|episode| ("episodes", &episode.ingest));
                for (table, params) in self
                    .manifest
                    .input
                    .iter()
                    .map(|input| ("input", &input.ingest))
                    .chain(episodes)
                {
                    self.check_table(&[table, "ingest"], params, &defaults)?;
                }
            }
        }
        Ok(())
    }

    fn check_table(&self, keys: &[&str], given: &Params, defaults: &Value) -> Result<()> {
        let Value::Object(defaults) = defaults else {
            return Ok(());
        };
        for (name, value) in given {
            let path: Vec<&str> = keys.iter().copied().chain([name.as_str()]).collect();
            let Some(default) = defaults.get(name) else {
                let error = self
                    .text
                    .error(&path, format!("unknown parameter `{name}` of `{}`", keys.join(".")));
                let known: Vec<&str> = defaults.keys().map(String::as_str).collect();
                return Err(match did_you_mean(name, known.iter().copied()) {
                    Some(meant) => error.with_hint(format!("did you mean `{meant}`?")),
                    None => error.with_hint(format!("known: {}", known.join(", "))),
                });
            };
            if let (Value::Object(value), Value::Object(_)) = (value, default) {
                self.check_table(&path, value, default)?;
            }
        }
        Ok(())
    }

    fn add_variant(&mut self, index: usize, variant: Option<&Variant>) -> Result<()> {
        let mut made = Made::new();
        for stage in self.wanted() {
            // The field after some updates is a row of the refined field alone.
            let of_update = variant.is_some_and(|variant| variant.score.contains_key("update"));
            let rounds: &[(&str, bool)] = match stage {
                "score" if of_update && made.contains_key("refine") => &[("stage1+2", true)],
                "score" if made.contains_key("refine") => &[("stage1", false), ("stage1+2", true)],
                "score" => &[("stage1", false)],
                _ => &[("", false)],
            };
            for &(method, refined) in rounds {
                // Rows of the paper's tables are named like `stage1+2/no-mesh/no-fk`.
                let method = match variant {
                    Some(variant) => format!("{method}/{}", variant.name.replace('+', "/")),
                    None => method.to_owned(),
                };
                let node = self.node(stage, index, variant, &made, &method, refined)?;
                let node = self.add(node, index);
                made.insert(stage, node);
            }
        }
        Ok(())
    }

    /// Scores of outside methods: the stage `score` on files instead of a field.
    fn add_predictions(&mut self) -> Result<()> {
        let stage = "score";
        for (index, own) in self.manifest.predictions.iter().enumerate() {
            if !own.root.is_dir() {
                let message = format!("`{}` is no folder", own.root.display());
                let error = self.text.error(&["predictions", "root"], message);
                return Err(error.with_hint("it holds one folder a clip, named by the clip's id (`rogs status RUN`)"));
            }
            let plain = self.describe(stage, &Value::Object(Map::new()))?;
            self.check_table(&["predictions", stage], &own.score, &plain.default_params)?;
            let mut params = Value::Object(self.manifest.score.clone());
            overlay(&mut params, &Value::Object(own.score.clone()));
            let mut prediction = Map::new();
            for (name, value) in [("frame", &own.frame), ("scale", &own.scale)] {
                if let Some(value) = value {
                    prediction.insert(name.to_owned(), Value::String(value.clone()));
                }
            }
            let mut table = Map::new();
            table.insert("prediction".to_owned(), Value::Object(prediction));
            overlay(&mut params, &Value::Object(table));
            self.fill_in(&mut params, &plain, &own.name.replace('+', "/"));
            let description = self
                .describe(stage, &params)
                .map_err(|error| self.text.error(&["predictions"], format!("`{}`: {error}", own.name)))?;
            let made = |stage: &str| self.nodes.iter().position(|node| node.stage == stage && !node.by_key);
            let mut inputs = Vec::new();
            for input in &description.inputs {
                let from = match input.role.as_str() {
                    "clip" => made("ingest").map(From::Node),
                    "robot" => made("robot-maps").map(From::Node),
                    "predictions" => Some(From::Prediction(index as u32)),
                    role => match self.manifest.weights.of(stage, role) {
                        Some(path) => Some(From::Source(self.source(role, path, &["weights"])?)),
                        None => None,
                    },
                };
                match from {
                    Some(from) => inputs.push(NodeInput {
                        role: input.role.clone(),
                        from,
                    }),
                    None if input.required => {
                        let message = format!("predictions need the stage that makes `{}`", input.role);
                        let error = self.text.error(&["predictions"], message);
                        return Err(error.with_hint("add `robot-maps` to `stages` in [run]"));
                    }
                    None => {}
                }
            }
            let node = Node {
                label: format!("score@{}", own.name),
                stage: stage.to_owned(),
                stage_version: description.stage_version,
                schema: description.output_schema,
                params: description.default_params,
                file: output_file("score-1").to_owned(),
                by_key: true,
                inputs,
                variants: vec![0],
            };
            self.nodes.push(node);
        }
        Ok(())
    }

    /// Adds a node, or finds the one that does the same already.
    fn add(&mut self, node: Node, variant: usize) -> usize {
        let same = |other: &Node| {
            other.stage == node.stage
                && other.file == node.file
                && other.params == node.params
                && other.inputs == node.inputs
        };
        if let Some(index) = self.nodes.iter().position(same) {
            if !self.nodes[index].variants.contains(&variant) {
                self.nodes[index].variants.push(variant);
            }
            return index;
        }
        self.nodes.push(node);
        self.nodes.len() - 1
    }

    fn node(
        &mut self,
        stage: &'static str,
        index: usize,
        variant: Option<&Variant>,
        made: &Made,
        method: &str,
        refined: bool,
    ) -> Result<Node> {
        let plain = self.describe(stage, &Value::Object(Map::new()))?;
        let mut params = Value::Object(self.manifest.params(stage).clone());
        if let Some(variant) = variant {
            overlay(&mut params, &Value::Object(variant.params(stage).clone()));
        }
        self.fill_in(&mut params, &plain, method);
        let description = self.describe(stage, &params).map_err(|error| match error {
            Error::Usage { message, hint } => {
                let keys: &[&str] = if variant.is_some() {
                    &["variants", stage]
                } else {
                    &[stage]
                };
                let error = self.text.error(keys, message);
                match hint {
                    Some(hint) => error.with_hint(hint),
                    None => error,
                }
            }
            other => other,
        })?;
        let weights = variant.map_or(&self.manifest.weights, |variant| &variant.weights);
        let mut inputs = Vec::new();
        for input in &description.inputs {
            let role = input.role.as_str();
            let weight = weights
                .of(stage, role)
                .or_else(|| self.manifest.weights.of(stage, role));
            let is_from_latents = description.default_params.get("tokens").and_then(Value::as_str) == Some("latents");
            let upstream = |stage: &'static str| made.get(stage).map(|&node| From::Node(node));
            let from = match role {
                "episode" => Some(From::Episode),
                "calibration" => Some(From::Calibration),
                ROBOT_MODEL => Some(From::Source(self.source(
                    role,
                    &self.manifest.robot.urdf,
                    &["robot", "urdf"],
                )?)),
                "clip" => upstream("ingest"),
                "robot" => upstream("robot-maps"),
                "conditioning" => upstream("conditioning"),
                "field" => upstream("lift"),
                "refinement" if refined => upstream("refine"),
                "latents" if is_from_latents => Some(self.latents(stage)?),
                "adapter" if is_from_latents && weight.is_none() => {
                    let error = self.text.error(&[stage], "`tokens = \"latents\"` needs an adapter");
                    return Err(error.with_hint("name it under [weights]: adapter = \"FILE\""));
                }
                "latents" | "adapter" if !is_from_latents => None,
                _ => match weight {
                    Some(path) => Some(From::Source(self.source(role, path, &["weights"])?)),
                    None => None,
                },
            };
            match from {
                Some(from) => inputs.push(NodeInput {
                    role: role.to_owned(),
                    from,
                }),
                None if input.required => {
                    let error = self.text.error(
                        &[stage],
                        format!("nothing provides the input `{role}` of stage `{stage}`"),
                    );
                    return Err(error.with_hint("add the stage that makes it to `stages` in [run]"));
                }
                None => {}
            }
        }
        let label = match (stage, refined) {
            ("score", false) => "score-1",
            ("score", true) => "score-2",
            _ => stage,
        };
        Ok(Node {
            label: variant.map_or(label.to_owned(), |variant| format!("{label}@{}", variant.name)),
            stage: stage.to_owned(),
            stage_version: description.stage_version,
            schema: description.output_schema,
            params: description.default_params,
            file: output_file(label).to_owned(),
            by_key: variant.is_some(),
            inputs,
            variants: vec![index],
        })
    }

    /// Parameters that the manifest says in other places than the stage's own table.
    fn fill_in(&self, params: &mut Value, plain: &Description, method: &str) {
        let (Value::Object(params), Value::Object(defaults)) = (params, &plain.default_params) else {
            return;
        };
        let mut set = |name: &str, value: Value| {
            if defaults.contains_key(name) && !params.contains_key(name) {
                params.insert(name.to_owned(), value);
            }
        };
        let describes_robot = defaults
            .get("robot")
            .is_some_and(|robot| robot.get("gripper_joint").is_some());
        if describes_robot && let Ok(spec) = self.manifest.robot_spec() {
            set("robot", serde_json::to_value(spec).unwrap_or_default());
        }
        if plain.stage == "score" {
            set("method", Value::String(method.to_owned()));
            if let Some(setting) = &self.manifest.run.setting {
                set("setting", Value::String(setting.clone()));
            }
        }
    }

    /// The clips' latents, which a stage asks for.
    fn latents(&self, stage: &str) -> Result<From> {
        let Some(latents) = &self.manifest.latents else {
            let error = self
                .text
                .error(&[stage], "`tokens = \"latents\"` needs the clips' latents");
            return Err(error.with_hint("name their folder: [latents] with root = \"FOLDER\" (docs/latents-format.md)"));
        };
        if !latents.root.is_dir() {
            let message = format!("`{}` is no folder", latents.root.display());
            let error = self.text.error(&["latents", "root"], message);
            return Err(error.with_hint("it holds CLIP.safetensors for every clip, named by the clip's id"));
        }
        Ok(From::Latents)
    }

    fn source(&self, role: &str, path: &Path, keys: &[&str]) -> Result<Source> {
        if !path.exists() {
            let error = self.text.error(keys, format!("`{}` is not there", path.display()));
            return Err(error.with_hint("paths in a manifest are relative to the manifest's folder"));
        }
        Ok(Source {
            path: path.to_owned(),
            content: self.sources.source(role, path)?,
        })
    }
}

/// Name of the output file of a node, by its label without a variant.
fn output_file(label: &str) -> &'static str {
    match label {
        "ingest" => "clip.r4c",
        "robot-maps" => "robot.r4c",
        "conditioning" => "conditioning.r4c",
        "lift" => "field-1.r4c",
        "refine" => "field-2.r4c",
        "score-1" => "scores-1.r4c",
        _ => "scores-2.r4c",
    }
}

/// Lays `given` over `base`, table by table.
pub(crate) fn overlay(base: &mut Value, given: &Value) {
    match (base, given) {
        (Value::Object(base), Value::Object(given)) => {
            for (name, value) in given {
                overlay(base.entry(name.clone()).or_insert(Value::Null), value);
            }
        }
        (base, given) => *base = given.clone(),
    }
}

/// Normalises parameters that a clip has of its own: those names of what the stage makes of them.
pub(crate) fn normalise_overrides(
    programs: &StagePrograms,
    node: &Node,
    given: &Params,
    cache: &mut HashMap<String, Map<String, Value>>,
) -> Result<Map<String, Value>> {
    if given.is_empty() {
        return Ok(Map::new());
    }
    let text = canonical_json(given);
    if let Some(known) = cache.get(&text) {
        return Ok(known.clone());
    }
    let mut params = node.params.clone();
    overlay(&mut params, &Value::Object(given.clone()));
    let normalised = programs.describe(&node.stage, &params)?.default_params;
    let take = |name: &String| Some((name.clone(), normalised.get(name)?.clone()));
    let map: Map<String, Value> = given.keys().filter_map(take).collect();
    cache.insert(text, map.clone());
    Ok(map)
}

/// All files and folders that a plan reads, for `doctor`.
impl Plan {
    /// Weights, robots and calibrations, each once.
    #[must_use]
    pub fn source_paths(&self) -> Vec<PathBuf> {
        let inputs = self.nodes.iter().flat_map(|node| &node.inputs);
        let fixed = inputs.filter_map(|input| match &input.from {
            From::Source(source) => Some(source.path.clone()),
            _ => None,
        });
        let mut paths: Vec<_> = fixed
            .chain(self.calibrations.iter().map(|source| source.path.clone()))
            .collect();
        paths.sort();
        paths.dedup();
        paths
    }
}
