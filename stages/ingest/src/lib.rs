//! Ingest: episode folder of any supported layout to clip.
//!
//! A layout (own folder, raw DROID, DROID in the Ctrl-World form, LeRobot v2.1 and v3.0) describes and checks an episode without
//! decoding anything; then the frames of the clip are decoded, resized and written as a
//! [`Clip`]. Whatever is wrong with an episode is one error that names file and row.
//!
//! [`list_episodes`] finds what a folder holds, [`survey`] opens all of it, [`media_report`] says which videos can be decoded here.

mod assemble;
mod calibration;
mod checks;
mod depth;
mod fault;
mod images;
mod layouts;
mod listing;
mod media;
mod outline;
mod params;
mod pointworld;
mod resize;
mod rollout;
mod source;
mod survey;
mod video;
#[cfg(feature = "libav")]
mod video_libav;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rogs_r4c::Record;
use rogs_schemas::ClipId;
use rogs_schemas::SchemaId;
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::shown;
use rogs_worker::{Context, Stage, StageError, StageResult};

#[doc(hidden)]
pub use crate::layouts::droid::look_up_published;
pub use crate::params::{DroidParams, IdleSteps, Quality};
pub use listing::{EpisodeListing, count_frames, list_episodes};
pub use media::{MediaReport, media_report};
pub use outline::outline;
pub use params::{
    CameraChoice, Fit, LayoutChoice, Observations, Params, PointWorldParams, QueryChoice, QueryPlanName, RolloutLayout,
    RolloutParams, StateColumns,
};
pub use pointworld::{PointWorldFiles, ReferenceFiles, list_references};
pub use rollout::compose;
pub use source::EpisodeOutline;
pub use survey::{EpisodeContent, EpisodeFacts, survey};

/// The stage.
pub struct Ingest {
    params: Params,
}

impl Stage for Ingest {
    const NAME: &'static str = "ingest";
    const SUMMARY: &'static str = "Reads an episode folder of any supported layout and writes one clip of it.";
    const VERSION: u32 = 2;
    const OUTPUT: SchemaId = Clip::SCHEMA;
    type Params = Params;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("episode", "folder"),
            InputDescription::optional("calibration", "file or folder"),
            InputDescription::optional(pointworld::ROLES[0], "file"),
            InputDescription::optional(pointworld::ROLES[1], "file"),
            InputDescription::optional(pointworld::ROLES[2], "file"),
            InputDescription::optional("rollout", "folder"),
        ]
    }

    fn load(params: &Params, _inputs: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        params.check()?;
        Ok(Self { params: params.clone() })
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        context.progress(0.0, "reading the episode");
        let root = context.input("episode")?.to_owned();
        let calibration = context.optional_input("calibration").map(Path::to_owned);
        let rollout = context.optional_input("rollout").map(Path::to_owned);
        let clip_id = context.clip_id().to_owned();
        let params = &self.params;
        let cache = PointWorldFiles::by_role(|role| context.optional_input(role).map(Path::to_owned));
        let beside = Beside {
            calibration: calibration.as_deref(),
            cache: &cache,
            rollout: rollout.as_deref(),
        };
        let (clip, warnings) = context.timed("read", |_| read(&root, &beside, params, &clip_id))?;
        warnings.into_iter().for_each(|warning| context.warn(warning));
        context.progress(0.9, "writing the clip");
        context.timed("write", |context| context.write(&clip))
    }
}

/// Reads a clip of an episode; also returns what a person should know.
///
/// # Errors
/// When the parameters or the episode are wrong; the message names file and row.
pub fn read_clip(
    root: &Path,
    calibration: Option<&Path>,
    params: &Params,
    clip_id: &str,
) -> StageResult<(Clip, Vec<String>)> {
    read_joined_clip(root, calibration, &PointWorldFiles::default(), params, clip_id)
}

/// The same with references of a PointWorld cache.
///
/// # Errors
/// As for [`read_clip`], and when the cache is wrong or of another episode.
pub fn read_joined_clip(
    root: &Path,
    calibration: Option<&Path>,
    cache: &PointWorldFiles,
    params: &Params,
    clip_id: &str,
) -> StageResult<(Clip, Vec<String>)> {
    let beside = Beside {
        calibration,
        cache,
        rollout: None,
    };
    read(root, &beside, params, clip_id)
}

/// Reads a clip of an episode with the frames of a world model as its observations: a video or a folder
/// (`docs/rollouts.md`). [`Params::observations`] must say so. Also returns what a person should know.
///
/// # Errors
/// When the parameters, the episode or the rollout are wrong, or do not belong together; the message names the file.
pub fn read_rollout(
    root: &Path,
    calibration: Option<&Path>,
    rollout: &Path,
    params: &Params,
    clip_id: &str,
) -> StageResult<(Clip, Vec<String>)> {
    let beside = Beside {
        calibration,
        cache: &PointWorldFiles::default(),
        rollout: Some(rollout),
    };
    read(root, &beside, params, clip_id)
}

/// What is read beside an episode.
struct Beside<'a> {
    calibration: Option<&'a Path>,
    cache: &'a PointWorldFiles,
    rollout: Option<&'a Path>,
}

fn read(root: &Path, beside: &Beside<'_>, params: &Params, clip_id: &str) -> StageResult<(Clip, Vec<String>)> {
    params.check()?;
    let mut source = layouts::open(root, beside.calibration, params)?;
    let clip_id = ClipId::new(clip_id).map_err(|error| StageError::bad_params(error.to_string()))?;
    let params = beside.cache.join(&mut source, params)?;
    assemble::assemble(source, beside.rollout, &params, clip_id)
}

/// The faces `list ROOT [--json] [--frames]` (frames also of episodes that have to be opened for it) and `caches ROOT
/// [--json]` (files of PointWorld by episode); `None` when the arguments ask for something else.
#[must_use]
pub fn list_main(arguments: &[std::ffi::OsString]) -> Option<std::process::ExitCode> {
    use std::process::ExitCode;
    let (first, rest) = arguments.split_first()?;
    let face = first.to_str().filter(|face| ["list", "caches"].contains(face))?;
    let json = rest.iter().any(|argument| argument == "--json");
    let frames = rest.iter().any(|argument| argument == "--frames");
    let is_flag = |argument: &&std::ffi::OsString| ["--json", "--frames"].iter().any(|flag| **argument == **flag);
    let roots: Vec<&std::ffi::OsString> = rest.iter().filter(|argument| !is_flag(argument)).collect();
    let [root] = roots[..] else {
        rogs_worker::message!("usage: rogs-ingest {face} ROOT [--json] [--frames]");
        return Some(ExitCode::from(2));
    };
    let lines = match face {
        "list" => list_episodes(Path::new(root)).map(|mut episodes| {
            if frames {
                listing::count_frames(Path::new(root), &mut episodes);
            }
            lines(&episodes, json, episode_line)
        }),
        _ => list_references(Path::new(root)).map(|files| match json {
            true => vec![serde_json::to_string(&files).unwrap_or_default()],
            false => files.iter().flat_map(reference_lines).collect(),
        }),
    };
    Some(match lines {
        Ok(lines) => printed(lines.iter().try_for_each(|line| rogs_worker::answer!("{line}"))),
        Err(error) => {
            rogs_worker::message!("error: {error}");
            error.hint.iter().for_each(|hint| rogs_worker::message!("hint: {hint}"));
            ExitCode::FAILURE
        }
    })
}

/// One JSON value (not by way of a `Value`: a data set may have a hundred thousand episodes), or a line each.
fn lines<T: serde::Serialize>(values: &[T], json: bool, line: impl Fn(&T) -> String) -> Vec<String> {
    match json {
        true => vec![serde_json::to_string(values).unwrap_or_default()],
        false => values.iter().map(line).collect(),
    }
}

fn episode_line(episode: &EpisodeListing) -> String {
    let EpisodeListing {
        episode_id,
        layout,
        folder,
        selector,
        ..
    } = episode;
    [episode_id, layout, folder, selector]
        .map(|field| shown::line(field))
        .join("\t")
}

fn reference_lines((uuid, files): (&String, &BTreeMap<String, String>)) -> Vec<String> {
    files
        .iter()
        .map(|(role, file)| [uuid, role, file].map(|field| shown::line(field)).join("\t"))
        .collect()
}

/// The exit code of a list that was, or could not be, printed.
fn printed(outcome: std::io::Result<()>) -> std::process::ExitCode {
    match outcome {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            rogs_worker::message!("error: cannot print the list: {error}");
            std::process::ExitCode::FAILURE
        }
    }
}
