//! `rogs inspect`: what a container file holds.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use rogs_orchestrator::columns;
use rogs_r4c::{InspectReport, Record as _, inspect, read_record};
use rogs_schemas::records::clip::Clip;
use rogs_schemas::{EpisodeFrame, FrameIndex};
use serde::Serialize;

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

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let report = inspect(&args.file)?;
    let clip = (report.schema == Clip::SCHEMA.name).then(|| read_record::<Clip>(&args.file));
    let clip = clip.transpose()?.map(|(clip, _)| ClipFrames::of(&clip));
    if args.json {
        output::json(&Inspected { report, clip })?;
    } else {
        output::text(&describe(&report, clip.as_ref()))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// What is printed as JSON.
#[derive(Serialize)]
struct Inspected {
    #[serde(flatten)]
    report: InspectReport,
    #[serde(skip_serializing_if = "Option::is_none")]
    clip: Option<ClipFrames>,
}

/// Which frames of its episode a clip is.
#[derive(Serialize)]
struct ClipFrames {
    episode: String,
    episode_frames: Vec<EpisodeFrame>,
    source_frames: Vec<FrameIndex>,
    query_frames: Vec<FrameIndex>,
}

impl ClipFrames {
    fn of(clip: &Clip) -> Self {
        Self {
            episode: clip.episode_id.clone(),
            episode_frames: clip.episode_frames.clone(),
            source_frames: clip.source_frames.clone(),
            query_frames: clip.query_frames.clone(),
        }
    }

    /// The frames of the episode at these clip frames.
    fn in_episode(&self, frames: &[FrameIndex]) -> String {
        let of = |frame: &FrameIndex| self.episode_frames.get(frame.at()).map(ToString::to_string);
        frames.iter().filter_map(of).collect::<Vec<_>>().join(" ")
    }
}

/// The lower-case name under which an enum value appears in JSON.
fn word<T: Serialize>(value: &T) -> String {
    serde_json::to_value(value)
        .ok()
        .and_then(|value| value.as_str().map(str::to_owned))
        .unwrap_or_default()
}

fn describe(report: &InspectReport, clip: Option<&ClipFrames>) -> String {
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
    if let Some((clip, first, last)) =
        clip.and_then(|clip| Some((clip, clip.episode_frames.first()?, clip.episode_frames.last()?)))
    {
        let _ = writeln!(
            text,
            "clip       {} frames of episode {}: its frames {first} to {last}",
            clip.episode_frames.len(),
            clip.episode
        );
        let _ = writeln!(
            text,
            "sources    episode frames {}",
            clip.in_episode(&clip.source_frames)
        );
        let _ = writeln!(
            text,
            "queries    episode frames {}",
            clip.in_episode(&clip.query_frames)
        );
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
