//! What a calibration looks at: the clips, and the robot.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use rogs_calibration::rig;
use rogs_geometry::{Base, Camera, Frame, Pose};
use rogs_ingest::{EpisodeListing, Fit, Params, QueryChoice, count_frames, list_episodes, outline, read_clip};
use rogs_orchestrator::Error;
use rogs_orchestrator::manifest::Manifest;
use rogs_robot_maps::Robot as Meshes;
use rogs_schemas::FrameIndex;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::robot::RobotSpec;
use serde_json::{Value, json};

use super::Args;
use crate::commands::init::robot as found;
use crate::commands::stage_error;
use crate::output;

/// Most episodes that are looked at when none is named.
const MOST_EPISODES: usize = 8;
/// Most frames that are read, over all episodes.
const MOST_FRAMES: u64 = 180;

/// The robot of the episodes.
pub(super) struct Robot {
    pub(super) meshes: Meshes,
    pub(super) spec: RobotSpec,
}

impl Robot {
    /// The robot that is named, comes with the episode, or lies beside it.
    pub(super) fn find(named: Option<&Path>, folder: &Path, episode: &EpisodeListing) -> anyhow::Result<Self> {
        let outline = outline(folder, episode).map_err(stage_error)?;
        let written = |path: &Path| path.to_string_lossy().into_owned();
        let robot = found::find(named, folder, &outline, &written)?;
        let Some(urdf) = &robot.urdf else {
            let why = robot.problems.join("; ");
            return Err(Error::usage(format!("a calibration needs the robot: {why}")).into());
        };
        for problem in &robot.problems {
            output::note(&format!("warning: {problem}"));
        }
        Self::load(Path::new(urdf), robot.spec)
    }

    /// The robot of a manifest.
    pub(super) fn of_manifest(manifest: &Manifest) -> anyhow::Result<Self> {
        let spec = manifest.robot_spec().map_err(Error::usage)?;
        Self::load(&manifest.robot.urdf, spec)
    }

    /// Its visual meshes are what cameras see.
    fn load(urdf: &Path, spec: RobotSpec) -> anyhow::Result<Self> {
        let spec = RobotSpec {
            collision_links: Vec::new(),
            ..spec
        };
        let params = rogs_robot_maps::Params {
            robot: spec.clone(),
            ..rogs_robot_maps::Params::default()
        };
        let meshes = Meshes::load(urdf, &params).map_err(stage_error)?;
        for note in meshes.notes() {
            output::note(&format!("warning: {note}"));
        }
        Ok(Self { meshes, spec })
    }
}

/// The clips, read whole or in steps.
pub(super) struct Clips {
    pub(super) episodes: Vec<String>,
    pub(super) clips: Vec<Clip>,
    /// Where the start comes from, in words.
    pub(super) start: String,
}

/// The episodes that are named, or some of all.
pub(super) fn chosen(folder: &Path, named: &[String]) -> anyhow::Result<Vec<EpisodeListing>> {
    if !folder.is_dir() {
        return Err(Error::usage(format!("`{}` is not a folder", folder.display())).into());
    }
    let mut all = list_episodes(folder).map_err(stage_error)?;
    if all.is_empty() {
        return Err(Error::usage(format!("`{}` holds no episode", folder.display())).into());
    }
    if !named.is_empty() {
        let mut wanted = Vec::new();
        for name in named {
            let is_named = |episode: &&EpisodeListing| {
                [&episode.selector, &episode.episode_id, &episode.name].contains(&name)
                    || episode.selector.rsplit('/').next() == Some(name)
            };
            let Some(episode) = all.iter().find(is_named) else {
                let error = Error::usage(format!("`{}` holds no episode `{name}`", folder.display()));
                return Err(error.with_hint("`rogs list` shows selectors and ids").into());
            };
            wanted.push(episode.clone());
        }
        all = wanted;
    } else if all.len() > MOST_EPISODES {
        let count = all.len();
        all = (0..MOST_EPISODES)
            .map(|i| all[i * (count - 1) / (MOST_EPISODES - 1)].clone())
            .collect();
        output::note(&format!(
            "looking at {MOST_EPISODES} of {count} episodes, whose cameras must not have moved in between; --episode names others"
        ));
    }
    count_frames(folder, &mut all);
    Ok(all)
}

impl Clips {
    /// Reads the episodes, whole or in steps.
    pub(super) fn read(
        folder: &Path,
        episodes: &[EpisodeListing],
        robot: &Robot,
        manifest: Option<&Manifest>,
        args: &Args,
    ) -> anyhow::Result<Self> {
        let start = match args.new {
            true => Some(Start::write(folder, &episodes[0], args)?),
            false => None,
        };
        let input = manifest.and_then(|manifest| manifest.input.as_ref());
        let calibration = start
            .as_ref()
            .map(|start| start.path.as_path())
            .or(args.calibration.as_deref())
            .or(input.and_then(|input| input.calibration.as_deref()));
        let given = ingest(robot, manifest)?;
        let total: u64 = episodes.iter().filter_map(|episode| episode.frames).sum();
        let step = total.div_ceil(MOST_FRAMES).max(1);
        let (width, height) = args.size;
        let mut clips = Vec::new();
        for episode in episodes {
            let frames = episode
                .frames
                .with_context(|| format!("episode `{}` does not say how many frames it has", episode.episode_id))?;
            let params = Params {
                episode: episode.selector.clone(),
                start_frame: Some(rogs_schemas::EpisodeFrame(0)),
                frames: frames.div_ceil(step).max(1) as u32,
                frame_step: step as u32,
                source_frames: vec![FrameIndex(0)],
                query: QueryChoice::Frames(vec![FrameIndex(0)]),
                anchor_frame: Some(FrameIndex(0)),
                width,
                height,
                fit: Fit::Stretch,
                ..given.clone()
            };
            let (clip, warnings) =
                read_clip(&folder.join(&episode.folder), calibration, &params, &episode.name).map_err(stage_error)?;
            for warning in warnings {
                output::note(&format!("warning: episode `{}`: {warning}", episode.episode_id));
            }
            clips.push(clip);
        }
        Ok(Self {
            episodes: episodes.iter().map(|episode| episode.episode_id.clone()).collect(),
            start: match args.new {
                true => "nothing (lenses as built, poses searched)".to_owned(),
                false => clips[0].calibration_note.clone(),
            },
            clips,
        })
    }
}

/// What the manifest says of ingest, or what the robot does: one without a gripper has no state of it.
fn ingest(robot: &Robot, manifest: Option<&Manifest>) -> anyhow::Result<Params> {
    let Some(manifest) = manifest else {
        let mut params = Params::default();
        params.states.gripper = robot.spec.gripper_joint.is_empty().then(String::new);
        return Ok(params);
    };
    let mut given = Value::Object(manifest.ingest.clone());
    if let Some(input) = &manifest.input {
        rogs_schemas::overlay(&mut given, &Value::Object(input.ingest.clone()));
    }
    serde_json::from_value(given).context("reading `[ingest]` of the manifest")
}

/// A calibration file for data that has none, of lenses as they are built and poses that mean nothing yet.
struct Start {
    path: PathBuf,
}

impl Start {
    fn write(folder: &Path, episode: &EpisodeListing, args: &Args) -> anyhow::Result<Self> {
        let outline = outline(folder, episode).map_err(stage_error)?;
        let (width, height) = args.size;
        let mut cameras = serde_json::Map::new();
        for name in &outline.cameras {
            let on_hand = is_on_hand(name);
            let lens = match args.field_of_view {
                Some(degrees) => rig::lens_of_view(degrees, width, height),
                None => {
                    let [hand, fixed] = rig::DROID_FOCAL;
                    let focal = if on_hand { hand } else { fixed } * f64::from(width);
                    rogs_geometry::Pinhole::centred(focal, width, height)
                }
            };
            let i = lens.intrinsics;
            let mut entry = json!({"intrinsic": [[i.fx, 0, i.cx], [0, i.fy, i.cy], [0, 0, 1]]});
            if on_hand {
                entry["link"] = Value::from(rig::DROID_HAND);
                entry["camera_to_link"] = rows(&rig::droid_hand_eye());
            } else {
                entry["camera_to_base"] = rows(&Pose::<Base, Camera>::IDENTITY);
            }
            cameras.insert(name.clone(), entry);
        }
        let file =
            json!({"status": "a start of `rogs calibrate --new`", "image_size": [width, height], "cameras": cameras});
        let name = format!("rogs-calibrate-{}.json", std::process::id());
        let path = std::env::temp_dir().join(name);
        rogs_files::write_bytes(&path, file.to_string().as_bytes())?;
        Ok(Self { path })
    }
}

impl Drop for Start {
    fn drop(&mut self) {
        // A file that cannot be removed from the folder of temporary files does no harm there.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Whether a camera is called like one on the hand.
fn is_on_hand(name: &str) -> bool {
    let name = name.to_lowercase();
    ["wrist", "hand", "gripper"].iter().any(|word| name.contains(word))
}

/// The first three rows of a pose, to a nanometre and a nanoradian.
pub(super) fn rows<A: Frame, B: Frame>(pose: &Pose<A, B>) -> Value {
    let m = pose.to_matrix4().map(|value| (value * 1e9).round() / 1e9);
    json!([m[0..4], m[4..8], m[8..12]])
}
