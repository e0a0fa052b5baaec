//! DROID episodes as Ctrl-World keeps them (`docs/spec/data.md` section 4): `annotation/[SPLIT/]ID.json` and
//! `videos/[SPLIT/]ID/{0,1,2}.mp4`, every third frame of the 15 Hz recording; and the rig of its authors, whose states
//! are already at the rate of the video.

use std::path::{Path, PathBuf};

use rogs_schemas::ids::suggestion;
use rogs_schemas::records::clip::CameraRole;
use rogs_worker::{StageError, StageResult};
use serde::Deserialize;

use super::calibration_names;
use crate::calibration::Calibration;
use crate::checks;
use crate::fault::{inside, io_error, read_text, wrong};
use crate::images::{FrameOrder, FrameSource};
use crate::media::VideoInfo;
use crate::params::Params;
use crate::source::{Source, SourceCamera, States};
use crate::video;

/// Longest annotation, bytes.
const MAX_JSON: u64 = 64 << 20;
/// Raw states per video frame.
const RAW_STEP: usize = 3;
/// Frames per second of the raw states.
const RAW_FPS: f64 = 15.0;
/// Clip cameras in the order of a clip, with the index of their video.
const CAMERAS: [(&str, usize); 3] = [("wrist", 2), ("ext1", 0), ("ext2", 1)];

#[derive(Deserialize)]
struct Annotation {
    #[serde(default)]
    texts: Vec<String>,
    episode_id: Id,
    video_length: u32,
    #[serde(default)]
    raw_length: Option<u32>,
    videos: Vec<VideoPath>,
    /// 7 joints and gripper per video frame.
    #[serde(default)]
    joints: Option<Vec<Vec<f64>>>,
    #[serde(default, rename = "observation.state.joint_position")]
    raw_joints: Option<Vec<Vec<f64>>>,
    #[serde(default, rename = "observation.state.gripper_position")]
    raw_gripper: Option<Vec<f64>>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Id {
    Number(u64),
    Text(String),
}

#[derive(Deserialize)]
struct VideoPath {
    video_path: String,
}

/// Name of the layout, as the clip keeps it.
pub(crate) const LAYOUT: &str = "droid-ctrlworld";

/// Whether a calibration lies beside an episode.
pub(crate) fn is_calibrated(root: &Path, selector: &str) -> bool {
    calibration_beside(root, selector).is_some()
}

/// Selectors of all episodes below a root: the annotation's path without `annotation/` and `.json`.
pub(crate) fn selectors(root: &Path) -> StageResult<Vec<String>> {
    let mut found = Vec::new();
    let folder = root.join("annotation");
    for (prefix, folder) in std::iter::once((String::new(), folder.clone())).chain(subfolders(&folder)?) {
        for name in file_names(&folder)? {
            if let Some(stem) = name.strip_suffix(".json") {
                found.push(format!("{prefix}{stem}"));
            }
        }
    }
    found.sort();
    Ok(found)
}

fn subfolders(folder: &Path) -> StageResult<Vec<(String, PathBuf)>> {
    let names = file_names(folder)?;
    Ok(names
        .into_iter()
        .map(|name| (format!("{name}/"), folder.join(name)))
        .filter(|(_, path)| path.is_dir())
        .collect())
}

fn file_names(folder: &Path) -> StageResult<Vec<String>> {
    let entries = rogs_files::entries(folder).map_err(|error| io_error(folder, &error))?;
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .collect();
    names.sort();
    Ok(names)
}

/// Id, frames and files of an episode: annotation, videos, and a calibration beside them where there is one, relative to
/// the root.
pub(crate) fn files(root: &Path, selector: &str) -> StageResult<(String, u32, Vec<String>)> {
    let annotation_name = format!("annotation/{selector}.json");
    let (path, annotation) = read_annotation(root, &annotation_name)?;
    let mut files = vec![annotation_name];
    for index in 0..annotation.videos.len() {
        files.push(video_file(root, &path, &annotation, selector, index)?);
    }
    if let Some(name) = calibration_beside(root, selector) {
        files.push(name);
    }
    Ok((annotation.episode_id.text(), annotation.video_length, files))
}

/// Opens an episode. Cameras that the parameters do not choose need no calibration.
pub(crate) fn open(root: &Path, calibration: Option<Calibration>, params: &Params) -> StageResult<Source> {
    let selector = resolve_selector(root, &params.episode)?;
    let (path, annotation) = read_annotation(root, &format!("annotation/{selector}.json"))?;
    let calibration = match (calibration, calibration_beside(root, &selector)) {
        (Some(given), _) => given,
        (None, Some(beside)) => Calibration::read(&root.join(beside))?,
        (None, None) => {
            return Err(wrong(&path, "this layout has no camera calibration").with_hint(format!(
                "give a calibration file (docs/calibration-format.md), or put it beside as `{}`",
                calibration_name(&selector)
            )));
        }
    };
    let episode_id = checks::episode_id(&annotation.episode_id.text(), &path)?;
    let states = states(&annotation, &path)?;
    let frame_count = annotation.video_length;
    let (mut cameras, mut warnings) = (Vec::new(), Vec::new());
    let mut fps: Option<f64> = None;
    let chosen = |id: &str| params.cameras.is_empty() || params.cameras.iter().any(|choice| choice.from == id);
    for (id, index) in CAMERAS {
        if !chosen(id) && !has_camera(&calibration, (id, index)) {
            continue;
        }
        let (file, info) = open_video(root, &path, &annotation, &selector, (id, index), &mut warnings)?;
        if *fps.get_or_insert(info.fps) != info.fps {
            warnings.push(format!(
                "`{}` runs at {} frames per second, another video at {fps:?}",
                file.display(),
                info.fps
            ));
        }
        cameras.push(camera((id, index), &calibration, file, info, &path)?);
    }
    // DROID copies hold every third frame of 15 Hz; the rig of the authors has the rate of its video header.
    let fps = match (annotation.raw_length, fps) {
        (Some(_), _) => RAW_FPS / RAW_STEP as f64,
        (None, Some(fps)) if fps > 0.0 => fps,
        (None, _) => return Err(wrong(&path, "the videos do not say their frames per second")),
    };
    Ok(Source {
        episode_id,
        layout: LAYOUT,
        task: annotation.texts.into_iter().next().unwrap_or_default(),
        calibration_note: calibration.note(),
        fps,
        frame_count,
        cameras,
        states,
        tracks: None,
        cameras_chosen: false,
        warnings,
    })
}

/// The video of a camera, which must have the frames of the annotation.
fn open_video(
    root: &Path,
    path: &Path,
    annotation: &Annotation,
    selector: &str,
    (id, index): (&str, usize),
    warnings: &mut Vec<String>,
) -> StageResult<(PathBuf, VideoInfo)> {
    let videos = annotation.videos.len();
    if index >= videos {
        let text = format!("it names {videos} videos, camera `{id}` is number {index}");
        return Err(wrong(path, text));
    }
    let file = root.join(video_file(root, path, annotation, selector, index)?);
    let info = video::probe(&file)?;
    let frame_count = u64::from(annotation.video_length);
    // The authors' rig writes one video frame more than states now and then; the last one is not used then.
    if annotation.raw_length.is_none() && info.frames == frame_count + 1 {
        warnings.push(format!(
            "`{}` has one frame more than states; it is not used",
            file.display()
        ));
    } else if info.frames != frame_count {
        let text = format!("it has {} frames, the annotation {frame_count}", info.frames);
        return Err(wrong(&file, text));
    }
    Ok((file, info))
}

/// Whether a calibration has an entry of a camera, under any of its names.
fn has_camera(calibration: &Calibration, (id, index): (&str, usize)) -> bool {
    let names = calibration_names(id, &index.to_string());
    calibration
        .cameras()
        .iter()
        .any(|known| names.iter().any(|name| name == known))
}

/// A source camera with its video; `path` is the annotation, for messages.
fn camera(
    (id, index): (&str, usize),
    calibration: &Calibration,
    file: PathBuf,
    info: VideoInfo,
    path: &Path,
) -> StageResult<SourceCamera> {
    let names = calibration_names(id, &index.to_string());
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let missing = || {
        let known = calibration.cameras();
        let text = format!("the calibration has no camera `{id}`{}", suggestion(id, known));
        wrong(path, text).with_hint(
            "`cameras` under [ingest] chooses those that are calibrated; docs/calibration-format.md says what an entry looks \
             like",
        )
    };
    let calibrated = calibration
        .camera(&names, (info.width, info.height))?
        .ok_or_else(missing)?;
    let mount = calibrated
        .mount
        .ok_or_else(|| wrong(path, format!("the calibration gives no pose of camera `{id}`")))?;
    Ok(SourceCamera {
        id: id.to_owned(),
        serial: None,
        role: CameraRole::Source,
        partner: None,
        width: info.width,
        height: info.height,
        intrinsics: calibrated.intrinsics,
        pixel_shift: 0.5,
        mount,
        images: Some(FrameSource::Video {
            path: file,
            info,
            order: FrameOrder::From(0),
            part: None,
        }),
        times_ms: None,
        depth: None,
    })
}

fn resolve_selector(root: &Path, selector: &str) -> StageResult<String> {
    let all = selectors(root)?;
    if selector.is_empty() {
        return match &all[..] {
            [only] => Ok(only.clone()),
            _ => Err(
                StageError::bad_params(format!("`{}` holds {} episodes: say which", root.display(), all.len()))
                    .with_hint("set `episode` to a selector that `rogs list FOLDER` prints"),
            ),
        };
    }
    let named = |candidate: &&String| *candidate == selector || candidate.rsplit('/').next() == Some(selector);
    let matches: Vec<&String> = all.iter().filter(named).collect();
    match matches[..] {
        [one] => Ok(one.clone()),
        [] => Err(
            StageError::bad_input(format!("`{}` has no episode `{selector}`", root.display())).with_hint(format!(
                "it has {}",
                all.iter().take(10).cloned().collect::<Vec<_>>().join(", ")
            )),
        ),
        _ => Err(StageError::bad_params(format!(
            "`{selector}` names several episodes of `{}`",
            root.display()
        ))),
    }
}

fn read_annotation(root: &Path, name: &str) -> StageResult<(PathBuf, Annotation)> {
    let path = inside(root, name, root)?;
    let text = read_text(&path, MAX_JSON)?;
    let annotation = rogs_schemas::json::read(&text).map_err(|error| {
        let error = wrong(&path, format!("not a Ctrl-World annotation: {error}"));
        if text.contains("NaN") {
            error.with_hint("Python's `NaN` is not a number: a state that was not measured cannot be used")
        } else {
            error
        }
    })?;
    Ok((path, annotation))
}

impl Id {
    fn text(&self) -> String {
        match self {
            Self::Number(number) => number.to_string(),
            Self::Text(text) => text.clone(),
        }
    }
}

/// A video's place: as the annotation says, or below `videos/` under the episode's own selector.
fn video_file(root: &Path, path: &Path, annotation: &Annotation, selector: &str, index: usize) -> StageResult<String> {
    let named = &annotation.videos[index].video_path;
    let own = format!("videos/{selector}/{index}.mp4");
    for candidate in [named, &own] {
        if inside(root, candidate, path)?.is_file() {
            return Ok(candidate.clone());
        }
    }
    Err(wrong(
        path,
        format!(
            "video {index} is missing: neither `{named}` nor `{own}` exists in `{}`",
            root.display()
        ),
    ))
}

fn calibration_name(selector: &str) -> String {
    format!("calibration_{}.json", selector.replace('/', "_"))
}

fn calibration_beside(root: &Path, selector: &str) -> Option<String> {
    let name = calibration_name(selector);
    root.join(&name).is_file().then_some(name)
}

/// One state per video frame: as stored, or every third raw one. Where both exist they must agree.
fn states(annotation: &Annotation, path: &Path) -> StageResult<States> {
    let frames = annotation.video_length as usize;
    let raw = match (&annotation.raw_joints, &annotation.raw_gripper) {
        (Some(joints), Some(gripper)) => Some(decimated(joints, gripper, frames, path)?),
        _ => None,
    };
    let rows = match (&annotation.joints, raw) {
        (Some(stored), raw) => {
            if stored.len() != frames {
                return Err(wrong(
                    path,
                    format!("there are {} rows of `joints` for {frames} video frames", stored.len()),
                ));
            }
            let differs =
                |(stored, raw): (&Vec<f64>, &Vec<f64>)| stored.iter().zip(raw).any(|(a, b)| (a - b).abs() > 1e-6);
            if let Some(row) = raw.and_then(|raw| stored.iter().zip(&raw).position(differs)) {
                return Err(wrong(
                    path,
                    format!("`joints` row {row} is not raw state {}", RAW_STEP * row),
                ));
            }
            stored.clone()
        }
        (None, Some(raw)) => raw,
        (None, None) => return Err(wrong(path, "it has no joint positions")),
    };
    let joint_names: Vec<String> = (1..=7).map(|joint| format!("panda_joint{joint}")).collect();
    let mut states = States {
        joint_names,
        positions: Vec::new(),
        gripper: Vec::new(),
    };
    for (row, values) in rows.iter().enumerate() {
        let [joints @ .., gripper] = &values[..] else {
            return Err(wrong(path, format!("row {row} of the joints is empty")));
        };
        if joints.len() != 7 {
            return Err(wrong(
                path,
                format!("row {row} has {} joints, a Panda has 7", joints.len()),
            ));
        }
        states.positions.extend_from_slice(joints);
        states.gripper.push(*gripper);
    }
    checks::states(&states, "row", path)?;
    Ok(states)
}

fn decimated(joints: &[Vec<f64>], gripper: &[f64], frames: usize, path: &Path) -> StageResult<Vec<Vec<f64>>> {
    if joints.len() != gripper.len() || joints.len().div_ceil(RAW_STEP) != frames {
        return Err(wrong(
            path,
            format!(
                "{} raw joint states and {} gripper states do not make {frames} video frames",
                joints.len(),
                gripper.len()
            ),
        ));
    }
    let row = |index: usize| joints[index].iter().copied().chain([gripper[index]]).collect();
    Ok((0..joints.len()).step_by(RAW_STEP).map(row).collect())
}
