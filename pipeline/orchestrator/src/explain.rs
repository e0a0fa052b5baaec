//! Why a unit has to be made, down to the value that changed.

use rogs_schemas::ClipId;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

use crate::plan::{InputSource, Plan, UnitKey, WorkUnit};
use crate::state::{OutputState, output_state};

/// Why one unit has to be made.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Explanation {
    /// The clip.
    pub clip: ClipId,
    /// The node, for example `lift`.
    pub node: String,
    /// The output, relative to the run folder.
    pub output: String,
    /// The reason.
    #[serde(flatten)]
    pub reason: Reason,
}

/// The reason.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "reason")]
pub enum Reason {
    /// There is no file.
    Missing,
    /// There is a file that is not whole.
    Damaged {
        /// What is wrong with it.
        what: String,
    },
    /// The file was made from something else.
    Stale {
        /// What differs.
        changes: Vec<Change>,
    },
}

/// One difference between what a file was made from and what the plan asks for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Change {
    /// What: `stage version`, `output schema`, `params.NAME`, `input ROLE`.
    pub what: String,
    /// As the file has it.
    pub old: String,
    /// As the plan has it.
    pub new: String,
    /// For an input that another stage makes: that stage, whose own line says why.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub because_of: Option<String>,
}

impl Plan {
    /// Explanations for every unit of the clip that is not up to date, in pipeline order.
    #[must_use]
    pub fn explain_clip(&self, clip: usize) -> Vec<Explanation> {
        let keys = self.keys(clip);
        (0..self.nodes.len())
            .filter_map(|node| self.explain(WorkUnit { clip, node }, &keys))
            .collect()
    }

    fn explain(&self, unit: WorkUnit, keys: &[UnitKey]) -> Option<Explanation> {
        let output = self.output(unit, keys);
        let path = self.run.join(&output);
        let reason = match output_state(&path, keys[unit.node].key) {
            OutputState::UpToDate => return None,
            OutputState::Missing => Reason::Missing,
            OutputState::Damaged(what) => Reason::Damaged { what },
            OutputState::Stale(_) => match rogs_r4c::read_header(&path) {
                Ok(header) => Reason::Stale {
                    changes: self.changes(unit, keys, &header.info.provenance.material),
                },
                Err(error) => Reason::Damaged {
                    what: crate::Error::from(error).to_string(),
                },
            },
        };
        let (clip, node) = (self.clips[unit.clip].id.clone(), self.nodes[unit.node].label.clone());
        Some(Explanation {
            clip,
            node,
            output: output.display().to_string(),
            reason,
        })
    }

    fn changes(&self, unit: WorkUnit, keys: &[UnitKey], old: &rogs_schemas::KeyMaterial) -> Vec<Change> {
        let new = &keys[unit.node].material;
        let mut changes = Vec::new();
        let mut note = |what: String, old: String, new: String, because_of: Option<String>| {
            if old != new {
                changes.push(Change {
                    what,
                    old,
                    new,
                    because_of,
                });
            }
        };
        note("stage".into(), old.stage.clone(), new.stage.clone(), None);
        note(
            "stage version".into(),
            old.stage_version.to_string(),
            new.stage_version.to_string(),
            None,
        );
        note("output schema".into(), old.schema.clone(), new.schema.clone(), None);
        let parse = |text: &str| serde_json::from_str(text).unwrap_or(Value::String(text.to_owned()));
        for (name, old, new) in differences("params", &parse(&old.params), &parse(&new.params)) {
            note(name, old, new, None);
        }
        let roles: std::collections::BTreeSet<&String> = old.inputs.keys().chain(new.inputs.keys()).collect();
        for role in roles {
            let id = |inputs: &std::collections::BTreeMap<String, String>| {
                inputs.get(role).cloned().unwrap_or("none".into())
            };
            let input = self.nodes[unit.node].inputs.iter().find(|input| input.role == *role);
            let upstream = input.and_then(|input| match input.from {
                InputSource::Node(node) => Some(self.nodes[node].label.clone()),
                _ => None,
            });
            note(format!("input {role}"), id(&old.inputs), id(&new.inputs), upstream);
        }
        changes
    }
}

/// Leaves in which two JSON values differ: name, old, new.
fn differences(name: &str, old: &Value, new: &Value) -> Vec<(String, String, String)> {
    if let (Value::Object(old), Value::Object(new)) = (old, new) {
        let names: std::collections::BTreeSet<&String> = old.keys().chain(new.keys()).collect();
        let absent = &Value::Null;
        let pair = |key: &String| {
            let (old, new) = (old.get(key).unwrap_or(absent), new.get(key).unwrap_or(absent));
            differences(&format!("{name}.{key}"), old, new)
        };
        return names.into_iter().flat_map(pair).collect();
    }
    if old == new {
        Vec::new()
    } else {
        vec![(name.to_owned(), old.to_string(), new.to_string())]
    }
}

impl std::fmt::Display for Explanation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}: ", self.clip, self.node)?;
        match &self.reason {
            Reason::Missing => write!(f, "not there yet"),
            Reason::Damaged { what } => write!(f, "damaged: {what}"),
            Reason::Stale { changes } => {
                let changes: Vec<_> = changes.iter().map(ToString::to_string).collect();
                write!(f, "{}", changes.join("; "))
            }
        }
    }
}

impl std::fmt::Display for Change {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // Hashes are long and say little.
        let short = |text: &str| {
            let hash = text.len() >= 32 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
            if hash {
                format!("{}…", &text[..8])
            } else {
                text.to_owned()
            }
        };
        write!(f, "{} {} → {}", self.what, short(&self.old), short(&self.new))?;
        match &self.because_of {
            Some(node) => write!(f, " (because of {node})"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn differences_name_the_leaf() {
        let old = json!({"a": {"b": 1, "c": 2}, "d": [1]});
        let new = json!({"a": {"b": 1, "c": 3}, "d": [1], "e": true});
        let found = differences("params", &old, &new);
        let text = |(name, old, new): &(String, String, String)| format!("{name} {old} {new}");
        assert_eq!(
            found.iter().map(text).collect::<Vec<_>>(),
            ["params.a.c 2 3", "params.e null true"]
        );
    }
}
