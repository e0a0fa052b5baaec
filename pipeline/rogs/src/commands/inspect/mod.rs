//! `rogs inspect`: what a container file holds.

mod header;

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use rogs_orchestrator::columns;
use rogs_r4c::{InspectReport, inspect};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

use self::header::Header;
use crate::output;

/// Shows header, provenance and streams of a `.r4c` file, every checksum verified.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The file.
    file: PathBuf,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// What is printed as JSON.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Inspected {
    #[serde(flatten)]
    report: InspectReport,
    /// What the record says of itself; what that is depends on `schema`.
    #[serde(skip_serializing_if = "Option::is_none")]
    header: Option<Value>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let report = inspect(&args.file)?;
    let header = header::header(&args.file, &report.schema)?;
    if args.json {
        output::json(&Inspected {
            report,
            header: header.map(|header| header.value),
        })?;
    } else {
        output::text(&describe(&report, header.as_ref()))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The lower-case name under which an enum value appears in JSON.
fn word<T: Serialize>(value: &T) -> String {
    serde_json::to_value(value)
        .ok()
        .and_then(|value| value.as_str().map(str::to_owned))
        .unwrap_or_default()
}

fn describe(report: &InspectReport, header: Option<&Header>) -> String {
    let material = &report.provenance.material;
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{} {} in container {}, {} bytes",
        report.schema, report.version, report.container, report.file_bytes
    );
    let _ = writeln!(
        text,
        "made by    {} (version {})",
        material.stage, material.stage_version
    );
    let _ = writeln!(text, "key        {}", report.key);
    let _ = writeln!(text, "content    {}", report.content);
    let _ = writeln!(text, "parameters {}", material.params);
    for (role, id) in &material.inputs {
        let _ = writeln!(text, "input      {role} = {id}");
    }
    for (name, text_of) in header.into_iter().flat_map(|header| &header.lines) {
        let _ = writeln!(text, "{name:<10} {text_of}");
    }
    let head = [
        "stream", "type", "shape", "unit", "frame", "codec", "elements", "decoded", "ratio", "min", "max", "NaN",
    ];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    for stream in &report.streams {
        let shape: Vec<String> = stream.shape.iter().map(u32::to_string).collect();
        let ratio = stream.totals.decoded_bytes as f64 / stream.totals.stored_bytes.max(1) as f64;
        let value = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.5}"));
        rows.push(vec![
            stream.name.clone(),
            word(&stream.dtype),
            if shape.is_empty() {
                "1".to_owned()
            } else {
                shape.join("x")
            },
            word(&stream.unit),
            word(&stream.frame),
            word(&stream.codec),
            stream.totals.elements.to_string(),
            stream.totals.decoded_bytes.to_string(),
            format!("{ratio:.2}"),
            value(stream.min),
            value(stream.max),
            stream.nan.to_string(),
        ]);
    }
    text.push('\n');
    text += &columns(&rows).join("\n");
    text
}
