//! Every value that a run works with, and where it comes from.

use rogs_schemas::robots::DEFAULT_PRESET;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Value, json};

use crate::diagnose::{At, Text};
use crate::error::{Error, Result};
use crate::executor::RunOptions;
use crate::manifest::Manifest;
use crate::programs::StagePrograms;
use crate::stage::StageId;

/// One value.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct EffectiveValue {
    /// Its key as a manifest writes it, with the number of an entry in brackets, from 0: `ingest.height`,
    /// `variants[0].lift.seed`. A variable of the environment has its name.
    pub key: String,
    /// The value; null for none.
    pub value: Value,
    /// Where it comes from.
    pub origin: Origin,
    /// Line of the manifest, from 1, where it comes from there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<usize>,
}

/// Where a value comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Origin {
    /// The manifest says so.
    Manifest,
    /// The preset of the robot.
    Preset,
    /// It is so when nobody says otherwise.
    Default,
    /// It follows from the cores and the memory of this machine.
    Machine,
    /// The command line.
    CommandLine,
    /// The environment.
    Environment,
}

/// One step of a key.
#[derive(Debug, Clone)]
enum Step {
    Key(String),
    Item(usize),
}

/// The values of a manifest, defaults filled in; `options` are those of the run, of which `given` came from the command
/// line.
///
/// # Errors
/// When a stage program does not answer or refuses its parameters.
pub fn effective(
    manifest: &Manifest,
    text: &Text,
    programs: &StagePrograms,
    options: &RunOptions,
    given: &[&str],
) -> Result<Vec<EffectiveValue>> {
    let mut tree = serde_json::to_value(manifest).map_err(|error| Error::usage(error.to_string()))?;
    fill(&mut tree, manifest, programs, options)?;
    let mut leaves = Vec::new();
    flatten(&tree, &mut Vec::new(), &mut leaves);
    let lines = text.lines(leaves.iter().map(|(steps, _)| at(steps)));
    let value = |((steps, value), line): ((Vec<Step>, Value), Option<usize>)| {
        let key = name(&steps);
        let from_machine = ["executor.workers", "executor.threads", "executor.memory"].contains(&key.as_str());
        let (origin, line) = if given.contains(&key.as_str()) {
            (Origin::CommandLine, None)
        } else if from_machine && !given.is_empty() && key != "executor.memory" {
            // What the command line says of the one decides on the other.
            (Origin::Machine, None)
        } else if line.is_some() {
            (Origin::Manifest, line)
        } else if key.starts_with("robot.spec.") {
            (Origin::Preset, None)
        } else if from_machine {
            (Origin::Machine, None)
        } else {
            (Origin::Default, None)
        };
        EffectiveValue {
            key,
            value,
            origin,
            line,
        }
    };
    Ok(leaves.into_iter().zip(lines).map(value).collect())
}

/// Writes into the manifest what it leaves out.
fn fill(tree: &mut Value, manifest: &Manifest, programs: &StagePrograms, options: &RunOptions) -> Result<()> {
    let runs = |stage: &StageId| !stage.spec().asked || manifest.asks(*stage) || manifest.run.stages.contains(stage);
    for &stage in StageId::ALL {
        let given = Value::Object(manifest.params(stage).clone());
        if !runs(&stage) {
            continue;
        }
        let mut params = programs.describe(stage, &given)?.default_params;
        if let Value::Object(params) = &mut params {
            // What the manifest says elsewhere stands there.
            params.retain(|name, _| {
                given.get(name).is_some() || !stage.spec().filled.iter().any(|(filled, _)| filled == name)
            });
        }
        tree[stage.name()] = params;
    }
    if manifest.run.stages.is_empty() {
        let names = StageId::ALL
            .iter()
            .filter(|stage| runs(stage))
            .map(|stage| stage.name());
        tree["run"]["stages"] = names.collect::<Vec<_>>().into();
    }
    let setting = match manifest.settings() {
        [one] => one.name(),
        _ => "both",
    };
    tree["run"]["setting"] = setting.into();
    let robot = manifest.robot_spec().map_err(Error::usage)?;
    tree["robot"]["spec"] = serde_json::to_value(robot).map_err(|error| Error::usage(error.to_string()))?;
    let gibibytes = |bytes: u64| format!("{:.2} GiB", bytes as f64 / f64::from(1 << 30));
    let memory = manifest.executor.memory.clone();
    for (table, name, value) in [
        ("robot", "preset", json!(DEFAULT_PRESET)),
        ("weights", StageId::Lift.name(), json!("builtin")),
        ("weights", StageId::Refine.name(), json!("builtin")),
        (
            "executor",
            "memory",
            memory.unwrap_or_else(|| gibibytes(options.memory)).into(),
        ),
        ("executor", "grace", options.grace.into()),
        ("slurm", "shell", "/bin/sh".into()),
        ("slurm", "memory-by", "node".into()),
        ("report", "clips", crate::manifest::PICTURE_CLIPS.into()),
    ] {
        let place = &mut tree[table][name];
        if place.is_null() {
            *place = value;
        }
    }
    if let StagePrograms::Directory(folder) = programs {
        tree["executor"]["programs"] = folder.display().to_string().into();
    }
    tree["executor"]["workers"] = options.workers.into();
    tree["executor"]["threads"] = options.threads.into();
    Ok(())
}

/// Values that hold no others; a list of plain values is one value.
fn flatten(value: &Value, steps: &mut Vec<Step>, out: &mut Vec<(Vec<Step>, Value)>) {
    let mut inside = |step: Step, value: &Value| {
        steps.push(step);
        flatten(value, steps, out);
        steps.pop();
    };
    match value {
        Value::Object(entries) if !entries.is_empty() => {
            entries
                .iter()
                .for_each(|(name, value)| inside(Step::Key(name.clone()), value));
        }
        Value::Array(items) if items.iter().any(Value::is_object) => {
            let items = items.iter().enumerate();
            items.for_each(|(index, value)| inside(Step::Item(index), value));
        }
        Value::Object(_) => {}
        plain => out.push((steps.clone(), plain.clone())),
    }
}

fn at(steps: &[Step]) -> At<'_> {
    steps.iter().fold(At::top(), |at, step| match step {
        Step::Key(name) => at.then(name),
        Step::Item(index) => at.item(*index),
    })
}

fn name(steps: &[Step]) -> String {
    let mut name = String::new();
    for step in steps {
        match step {
            Step::Item(index) => name.push_str(&format!("[{index}]")),
            Step::Key(key) => {
                if !name.is_empty() {
                    name.push('.');
                }
                name.push_str(key);
            }
        }
    }
    name
}

impl EffectiveValue {
    /// The value as a manifest writes it.
    #[must_use]
    pub fn shown(&self) -> String {
        written(&self.value)
    }

    /// Where it comes from, in words.
    #[must_use]
    pub fn whence(&self) -> String {
        match (self.origin, self.line) {
            (Origin::Manifest, Some(line)) => format!("line {line}"),
            (Origin::Manifest, None) => "the manifest".to_owned(),
            (Origin::Preset, _) => "preset".to_owned(),
            (Origin::Default, _) => "default".to_owned(),
            (Origin::Machine, _) => "this machine".to_owned(),
            (Origin::CommandLine, _) => "command line".to_owned(),
            (Origin::Environment, _) => "environment".to_owned(),
        }
    }
}

fn written(value: &Value) -> String {
    match value {
        Value::Null => "none".to_owned(),
        Value::Array(items) => format!("[{}]", items.iter().map(written).collect::<Vec<_>>().join(", ")),
        plain => plain.to_string(),
    }
}

/// A variable of the environment that is set.
#[must_use]
pub fn variable(name: &str) -> Option<EffectiveValue> {
    let value = std::env::var_os(name)?;
    Some(EffectiveValue {
        key: name.to_owned(),
        value: value.to_string_lossy().into(),
        origin: Origin::Environment,
        line: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaves_have_the_keys_of_a_manifest() {
        let tree = json!({"run": {"name": "n", "stages": ["lift"]}, "variants": [{"lift": {"seed": 1}}], "slurm": {}, "x": null});
        let mut leaves = Vec::new();
        flatten(&tree, &mut Vec::new(), &mut leaves);
        let told: Vec<(String, String)> = leaves
            .iter()
            .map(|(steps, value)| (name(steps), written(value)))
            .collect();
        let expected = [
            ("run.name", "\"n\""),
            ("run.stages", "[\"lift\"]"),
            ("variants[0].lift.seed", "1"),
            ("x", "none"),
        ];
        assert_eq!(told, expected.map(|(key, value)| (key.to_owned(), value.to_owned())));
        let text = Text::new(
            std::path::Path::new("m.toml"),
            "[run]\nname = \"n\"\n[[variants]]\nlift = { seed = 1 }\n",
        );
        let lines = text.lines(leaves.iter().map(|(steps, _)| at(steps)));
        assert_eq!(lines, [Some(2), None, Some(4), None]);
    }
}
