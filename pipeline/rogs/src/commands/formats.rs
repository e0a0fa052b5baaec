//! The table of JSON outputs: name, version, type, command. `rogs schema` prints what it says.

use rogs_orchestrator::diff::Difference;
use rogs_orchestrator::estimate::Estimate;
use rogs_orchestrator::explain::Explanation;
use rogs_orchestrator::export::Export;
use rogs_orchestrator::gc::Collected;
use rogs_orchestrator::slurm::Submission;
use rogs_orchestrator::status::Status;
use rogs_report::ToldAudit;
use rogs_robot::fk_json::FkRow;
use rogs_schemas::ledger::Attempt;
use rogs_schemas::selection::Selection;
use rogs_score::folders::FolderScores;
use rogs_score::tables::Table;
use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde::Serialize;
use serde_json::{Value, json};

use super::demo::DemoOutcome;
use super::export::Folders;
use super::run::RunOutcome;
use super::verify::Verified;
use super::weights::catalogue::PublicFile;
use super::weights::told;
use super::{
    calibrate, completions, config, doctor, export_clip, export_field, film, init, inspect, list, man, render, status,
    synth,
};
use crate::output::{Format, Items};

/// One kind of JSON output.
pub(super) struct Entry {
    /// Its name.
    pub(super) name: &'static str,
    /// What prints it.
    pub(super) command: &'static str,
    /// What its entry `format` says.
    format: fn() -> String,
    /// Its schema.
    schema: fn() -> schemars::Schema,
}

/// Gives types their names and versions as [`Format`]s, and lists them.
macro_rules! formats {
    ($($name:literal $version:literal $type:ty, $command:literal;)*) => {
        $(impl Format for $type {
            const NAME: &'static str = $name;
            const VERSION: u32 = $version;
        })*

        /// All JSON outputs, by name.
        pub(super) const FORMATS: &[Entry] = &[$(Entry {
            name: $name,
            command: $command,
            format: <$type as Format>::format,
            schema: schema::<$type>,
        }),*];
    };
}

formats! {
    "audit" 1 ToldAudit, "rogs audit";
    "calibrate" 1 calibrate::told::Told, "rogs calibrate";
    "completions" 1 completions::Script, "rogs completions";
    "config" 1 config::Shown, "rogs config show";
    "demo" 1 DemoOutcome, "rogs demo";
    "diff" 1 Difference, "rogs diff";
    "doctor" 1 Items<doctor::Finding>, "rogs doctor";
    "export-clip" 1 export_clip::Written, "rogs export clip";
    "export-field" 1 export_field::Written, "rogs export field";
    "export-rollout-inputs" 1 Folders, "rogs export rollout-inputs";
    "film" 1 film::Made, "rogs render --video, rogs query --video";
    "fk" 1 Items<FkRow>, "rogs fk";
    "gc" 1 Collected, "rogs gc";
    "init" 1 init::Written, "rogs init";
    "inspect" 1 inspect::Inspected, "rogs inspect";
    "list" 1 list::Listed, "rogs list";
    "logs" 1 Items<Attempt>, "rogs logs";
    "man" 1 man::Pages, "rogs man";
    "metrics" 1 FolderScores, "rogs metrics";
    "plan" 1 Estimate, "rogs plan";
    "plan-emit" 1 Export, "rogs plan --emit";
    "plan-explain" 1 Items<Explanation>, "rogs plan --explain";
    "render" 1 Items<render::Rendered>, "rogs render, rogs query";
    "report" 1 status::Report, "rogs report";
    "run" 1 RunOutcome, "rogs run";
    "schemas" 1 Items<Named>, "rogs schema";
    "selection" 1 Selection, "rogs cohort";
    "status" 1 Status, "rogs status";
    "submit" 1 Submission, "rogs submit";
    "synth" 1 synth::Made, "rogs synth";
    "table" 1 Table, "rogs table, rogs report --table";
    "verify" 1 Verified, "rogs verify";
    "weights-average" 1 told::Averaged, "rogs weights average";
    "weights-fetch" 1 told::Fetched, "rogs weights fetch NAME";
    "weights-files" 1 Items<PublicFile>, "rogs weights fetch";
    "weights-generate" 1 told::Generated, "rogs weights generate";
    "weights-import" 1 told::Imported, "rogs weights import";
    "weights-list" 1 told::Listed, "rogs weights list";
    "weights-merge" 1 told::Merged, "rogs weights merge";
    "weights-verify" 1 told::Checked, "rogs weights verify";
}

/// Something that has a schema.
#[derive(Serialize, JsonSchema)]
pub(super) struct Named {
    /// What `rogs schema` takes.
    pub(super) name: &'static str,
    /// What the entry `format` of such a value says; null of what is no output.
    pub(super) format: Option<String>,
    /// What prints it.
    pub(super) command: &'static str,
}

impl Named {
    pub(super) fn of(entry: &Entry) -> Self {
        Self {
            name: entry.name,
            format: Some((entry.format)()),
            command: entry.command,
        }
    }
}

/// The schema of an output by its name, or by what its entry `format` says, with or without the version.
pub(super) fn schema_of(name: &str) -> Option<Value> {
    let bare = name.strip_prefix("rogs.").unwrap_or(name);
    let mut entries = FORMATS.iter();
    let entry = entries.find(|entry| entry.name == bare || (entry.format)() == name)?;
    Some((entry.schema)().to_value())
}

/// The schema of values as they are printed: that of the type, and the entry `format` before all others.
fn schema<T: Format>() -> schemars::Schema {
    let generator = SchemaSettings::draft2020_12().for_serialize().into_generator();
    let mut schema = generator.into_root_schema_for::<T>();
    let format = T::format();
    schema.insert("$id".to_owned(), format.clone().into());
    schema.insert("title".to_owned(), format.clone().into());
    let properties = schema.ensure_object().entry("properties").or_insert_with(|| json!({}));
    if let Value::Object(properties) = properties {
        properties.insert("format".to_owned(), json!({ "type": "string", "const": format }));
    }
    let required = schema.ensure_object().entry("required").or_insert_with(|| json!([]));
    if let Value::Array(required) = required {
        required.insert(0, "format".into());
    }
    schema
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_ascend_and_every_schema_is_of_an_object() {
        assert!(FORMATS.is_sorted_by(|a, b| a.name < b.name));
        for entry in FORMATS {
            let schema = schema_of(entry.name).unwrap();
            assert_eq!(schema["type"], "object", "{}", entry.name);
            assert_eq!(schema["required"][0], "format");
            assert_eq!(schema_of(&(entry.format)()), Some(schema));
        }
        assert_eq!(schema_of("rogs.status"), schema_of("status"));
        assert!(schema_of("rogs.status/99").is_none());
    }
}
