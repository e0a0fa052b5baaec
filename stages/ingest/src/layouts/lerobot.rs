//! LeRobot data sets, v2.1 and v3.0 (`docs/spec/data.md` section 5): parquet tables and shared or own mp4 files.

use std::path::Path;

use rogs_schemas::ids::unknown;
use rogs_schemas::records::clip::CameraRole;
use rogs_worker::{StageError, StageResult};

use super::lerobot_meta::{Dataset, EpisodeMeta, Version};
use super::parquet_table::{Table, Work};
use super::{calibration_names, clip_camera};
use crate::calibration::Calibration;
use crate::checks;
use crate::fault::{inside, wrong};
use crate::images::{FrameOrder, FrameSource};
use crate::params::{Params, StateColumns};
use crate::source::{Source, SourceCamera, SourceMount, States};
use crate::video;

/// Opens an episode.
pub(crate) fn open(root: &Path, calibration: Option<&Calibration>, params: &Params) -> StageResult<Source> {
    let dataset = Dataset::open(root)?;
    let episode = &dataset.select(&params.episode)?;
    let frame_count = u32::try_from(episode.length).ok().filter(|&length| length > 0);
    let frame_count = frame_count
        .ok_or_else(|| StageError::bad_input(format!("episode {} has {} frames", episode.index, episode.length)))?;
    let rows = Rows::read(&dataset, episode)?;
    let states = rows.states(&dataset, &params.states)?;
    let names = camera_names(&dataset, params)?;
    let (mut cameras, mut warnings) = (Vec::new(), Vec::new());
    if params.cameras.is_empty() {
        let left_out = dataset.depth_videos().into_iter();
        warnings.extend(left_out.map(|key| format!("the video `{key}` holds depth maps: it is left out")));
    }
    for (id, key) in names {
        let camera = open_camera(&dataset, episode, &rows, calibration, (&id, &key), &mut warnings)?;
        cameras.push(camera);
    }
    let mut task = episode.task.clone();
    if task.is_empty() {
        // Kept by frame; the first one's is the clip's.
        task = rows.task_index().map(|number| dataset.task(number)).unwrap_or_default();
    }
    // Wrist first, then by name; a choice in the parameters keeps its order.
    if params.cameras.is_empty() {
        cameras.sort_by_key(|camera| (camera.id != "wrist", camera.id.clone()));
    }
    Ok(Source {
        episode_id: episode.selector(),
        layout: dataset.version.layout(),
        task,
        calibration_note: calibration.map(Calibration::note).unwrap_or_default(),
        fps: dataset.info.fps,
        frame_count,
        cameras,
        states,
        tracks: None,
        cameras_chosen: !params.cameras.is_empty(),
        warnings,
    })
}

/// First frame of an episode in its video, which it begins `from` seconds into. Writers add up lengths in seconds, and the
/// sum drifts away from the frames; the lengths of the episodes before it do not.
fn first_frame(
    dataset: &Dataset,
    episode: &EpisodeMeta,
    (key, from): (&str, f64),
    (path, frames): (&Path, u64),
    warnings: &mut Vec<String>,
) -> StageResult<u64> {
    let claimed = from * dataset.info.fps;
    if !(claimed.is_finite() && (0.0..1e12).contains(&claimed)) {
        return Err(wrong(path, format!("episode {} begins at {from} s", episode.index)));
    }
    let share = dataset.share(episode, key)?;
    let index = episode.index;
    if let Some(share) = share.filter(|share| share.before != claimed.round() as u64) {
        // All frames of the video are those of its episodes, so their lengths say where each begins.
        if share.all == frames {
            warnings.push(format!(
                "the timestamp {from} s at which episode {index} begins in the video of `{key}` is frame {claimed:.2}, the \
                 episodes before it have {} frames: the frames are taken by their lengths",
                share.before
            ));
            return Ok(share.before);
        }
    }
    if (claimed - claimed.round()).abs() > 0.1 {
        warnings.push(format!(
            "the timestamp {from} s at which episode {index} begins in the video of `{key}` is frame {claimed:.2}, no whole \
             number: check that images and states belong together"
        ));
    }
    Ok(claimed.round() as u64)
}

/// Clip camera and video feature of every camera that is wanted.
fn camera_names(dataset: &Dataset, params: &Params) -> StageResult<Vec<(String, String)>> {
    let videos = dataset.videos();
    if videos.is_empty() {
        return Err(
            StageError::bad_input(format!("`{}` has no video features", dataset.root.display()))
                .with_hint("images inside parquet files are not supported; convert the data set to videos"),
        );
    }
    if params.cameras.is_empty() {
        return Ok(videos
            .into_iter()
            .map(|key| (clip_camera(key), key.to_owned()))
            .collect());
    }
    let last = |key: &&str| key.rsplit('.').next().unwrap_or_default().to_owned();
    let short: Vec<String> = videos.iter().map(last).collect();
    let known: Vec<&str> = videos.iter().copied().chain(short.iter().map(String::as_str)).collect();
    let depth = dataset.depth_videos();
    let asked = params.cameras.iter().map(|choice| choice.from.as_str());
    if let Some(depth) = asked
        .clone()
        .find(|from| depth.iter().any(|key| key == from || last(key) == *from))
    {
        let text = format!("the video `{depth}` holds depth maps, as `info.json` says: it is no camera's images");
        return Err(StageError::bad_params(text).with_hint(format!("there are {}", videos.join(", "))));
    }
    if let Some(unknown) = unknown(asked, &known) {
        let text = format!("there is no video feature {unknown}, there are {}", videos.join(", "));
        return Err(StageError::bad_params(text).with_hint("`from` in `cameras` under [ingest] names them"));
    }
    let choose = |choice: &crate::params::CameraChoice| {
        let fits = |key: &&&str| **key == choice.from || last(key) == choice.from;
        Some((choice.id.clone(), (*videos.iter().find(fits)?).to_owned()))
    };
    Ok(params.cameras.iter().filter_map(choose).collect())
}

fn open_camera(
    dataset: &Dataset,
    episode: &EpisodeMeta,
    rows: &Rows,
    calibration: Option<&Calibration>,
    (id, key): (&str, &str),
    warnings: &mut Vec<String>,
) -> StageResult<SourceCamera> {
    let info_path = dataset.root.join("meta/info.json");
    let (file, from) = episode
        .videos
        .get(key)
        .ok_or_else(|| wrong(&info_path, format!("episode {} has no video of `{key}`", episode.index)))?;
    let path = inside(&dataset.root, file, &info_path)?;
    let mut info = video::probe(&path)?;
    info.notes.extend(info.other_rate(dataset.info.fps));
    let announced = dataset.info.features.get(key);
    let other_size = announced.and_then(|feature| feature.other_size((info.width, info.height)));
    info.notes.extend(other_size);
    let size = (info.width, info.height);
    let first = first_frame(dataset, episode, (key, *from), (&path, info.frames), warnings)?;
    let fits = match dataset.version {
        Version::V21 => info.frames == episode.length,
        Version::V30 => first + episode.length <= info.frames,
    };
    if !fits {
        let text = format!(
            "it has {} frames, episode {} needs frames {first} to {}",
            info.frames,
            episode.index,
            first + episode.length
        );
        return Err(wrong(&path, text));
    }
    let feature = key.rsplit('.').next().unwrap_or(key);
    let names = calibration_names(id, feature);
    let names: Vec<&str> = names.iter().map(String::as_str).chain([key]).collect();
    let calibrated = match calibration {
        Some(calibration) => calibration.camera(&names, size)?,
        None => None,
    };
    let Some(calibrated) = calibrated else {
        let text = format!("camera `{id}` ({key}) has no intrinsics: LeRobot data sets carry none");
        return Err(wrong(&info_path, text).with_hint(format!(
            "give a calibration file with an entry `{id}` for {}x{} images (docs/calibration-format.md)",
            size.0, size.1
        )));
    };
    let mount = match calibrated.mount {
        Some(mount) => mount,
        None => rows.extrinsics(feature)?.ok_or_else(|| {
            wrong(
                &info_path,
                format!("camera `{id}` ({key}) has no pose: neither the calibration nor the data has one"),
            )
            .with_hint("add `camera_to_base` or `camera_to_link` to its entry in the calibration file")
        })?,
    };
    Ok(SourceCamera {
        id: id.to_owned(),
        serial: None,
        role: CameraRole::Source,
        partner: None,
        width: size.0,
        height: size.1,
        intrinsics: calibrated.intrinsics,
        pixel_shift: 0.5,
        mount,
        images: Some(FrameSource::Video {
            path,
            info,
            order: FrameOrder::From(first),
            part: None,
        }),
        times_ms: None,
        depth: None,
    })
}

/// The rows of one episode in its data file.
struct Rows {
    path: std::path::PathBuf,
    /// In frame order.
    table: Table,
}

impl Rows {
    fn read(dataset: &Dataset, episode: &EpisodeMeta) -> StageResult<Self> {
        let path = inside(&dataset.root, &episode.data, &dataset.root.join("meta/info.json"))?;
        let wanted = |name: &str| {
            name.starts_with("observation.state")
                || name.starts_with("camera_extrinsics")
                || ["timestamp", "frame_index", "episode_index", "task_index"].contains(&name)
                || [STATES.as_slice(), &JOINTS, &GRIPPERS].concat().contains(&name)
        };
        let only = Some(("episode_index", episode.index));
        let table = Table::read_where(&path, &wanted, only, &mut Work::default())?;
        let rows = table.rows;
        if rows as u64 != episode.length {
            return Err(wrong(
                &path,
                format!(
                    "it has {rows} rows of episode {}, expected {}",
                    episode.index, episode.length
                ),
            ));
        }
        let frames = table.integers("frame_index")?;
        if let Some(frame) = (0..rows).find(|&frame| frames[frame] != frame as u64) {
            let text = format!(
                "row {frame} of episode {} holds frame {}, expected {frame}",
                episode.index, frames[frame]
            );
            return Err(wrong(&path, text));
        }
        if table.has("timestamp") {
            let (_, times) = table.numbers("timestamp")?;
            let late = |frame: usize| (times[frame] * dataset.info.fps - frame as f64).abs();
            let off = |&frame: &usize| late(frame).is_nan() || late(frame) >= 0.5;
            if let Some(frame) = (0..rows).find(off) {
                let text = format!(
                    "the timestamp {} of frame {frame} does not fit {} frames per second",
                    times[frame], dataset.info.fps
                );
                return Err(wrong(&path, text));
            }
        }
        Ok(Self { path, table })
    }

    /// Number of the task at the first frame, where the data has it.
    fn task_index(&self) -> Option<u64> {
        self.table.integer("task_index", 0).ok()
    }

    /// Entry `entry` of a column at every frame.
    fn entry(&self, (column, entry): &(String, usize)) -> StageResult<Vec<f64>> {
        let (width, values) = self.table.numbers(column)?;
        if *entry >= width {
            return Err(wrong(
                &self.path,
                format!("column `{column}` has {width} entries, number {entry} is needed"),
            ));
        }
        Ok(values.iter().skip(*entry).step_by(width).copied().collect())
    }

    fn states(&self, dataset: &Dataset, choice: &StateColumns) -> StageResult<States> {
        let (joints, gripper) = state_entries(dataset, choice, &self.path)?;
        let columns: StageResult<Vec<Vec<f64>>> = joints.iter().map(|(_, place)| self.entry(place)).collect();
        let columns = columns?;
        let positions = (0..self.table.rows)
            .flat_map(|row| columns.iter().map(move |column| column[row]))
            .collect();
        // A robot without a gripper is taken for one that stays open.
        let gripper = gripper.map_or_else(|| Ok(vec![0.0; self.table.rows]), |place| self.entry(&place))?;
        let names: Vec<String> = joints.into_iter().map(|(name, _)| name).collect();
        let joint_names = urdf_names(names, choice, dataset.info.robot_type.as_deref(), &self.path)?;
        let mut states = States {
            joint_names,
            positions,
            gripper,
        };
        choice.convert(&mut states);
        checks::states(&states, "frame", &self.path)?;
        Ok(states)
    }

    /// The pose of a camera from `camera_extrinsics.NAME`, where the data has it.
    fn extrinsics(&self, feature: &str) -> StageResult<Option<SourceMount>> {
        let column = format!("camera_extrinsics.{feature}");
        if !self.table.has(&column) {
            return Ok(None);
        }
        let (width, values) = self.table.numbers(&column)?;
        if width != 6 {
            return Err(wrong(
                &self.path,
                format!("column `{column}` has {width} entries, expected x y z roll pitch yaw"),
            ));
        }
        let pose = |(frame, six): (usize, &[f64; 6])| {
            checks::euler_pose(six, &format!("`{column}` at frame {frame}"), &self.path)
        };
        let poses: StageResult<Vec<_>> = values.as_chunks::<6>().0.iter().enumerate().map(pose).collect();
        let poses = poses?;
        let still = poses.windows(2).all(|pair| pair[0] == pair[1]);
        Ok(match poses.first() {
            Some(first) if still => Some(SourceMount::Fixed(*first)),
            _ => Some(SourceMount::Trajectory(poses)),
        })
    }
}

/// Columns of the whole state, as LeRobot and openpi call it.
const STATES: [&str; 2] = ["observation.state", "state"];
/// Columns of joint positions alone.
const JOINTS: [&str; 5] = [
    "observation.state.joint_position",
    "observation.state.joint_positions",
    "observation.joint_position",
    "joint_position",
    "joint_positions",
];
/// Columns of the gripper alone.
const GRIPPERS: [&str; 3] = [
    "observation.state.gripper_position",
    "observation.gripper_position",
    "gripper_position",
];

/// Column and entry of a state.
type Place = (String, usize);
/// Joints by their names.
type Named = Vec<(String, Place)>;

/// Names and places of the joints, and the place of the gripper, where there is one.
fn state_entries(dataset: &Dataset, choice: &StateColumns, path: &Path) -> StageResult<(Named, Option<Place>)> {
    let features = &dataset.info.features;
    let column = STATES.into_iter().find(|name| features.contains_key(*name));
    let column = column.unwrap_or(STATES[0]);
    let state = features
        .get(column)
        .map(|feature| feature.entry_names())
        .unwrap_or_default();
    let in_state = |name: &str| {
        state
            .iter()
            .position(|entry| entry == name)
            .map(|entry| (column.to_owned(), entry))
    };
    // All of them at once.
    let asked = choice
        .joints
        .iter()
        .chain(&choice.gripper)
        .filter(|name| !name.is_empty());
    let known: Vec<&str> = state.iter().map(String::as_str).collect();
    if let Some(unknown) = unknown(asked.map(String::as_str), &known) {
        let text = format!("`{column}` has no entry {unknown}; it has {}", known.join(", "));
        return Err(StageError::bad_params(text)
            .with_hint("`joints` and `gripper` under [ingest.states] of the manifest name them"));
    }
    let own_gripper = GRIPPERS.into_iter().find(|name| features.contains_key(*name));
    let gripper = match (&choice.gripper, own_gripper) {
        (Some(name), _) => in_state(name),
        (None, Some(own)) => Some((own.to_owned(), 0)),
        (None, None) => {
            let usual = ["gripper", "gripper_position", "gripper.pos", "main_gripper"];
            let found = usual.iter().find_map(|name| in_state(name));
            Some(found.ok_or_else(|| {
                wrong(path, "the data names no gripper state").with_hint(format!(
                    "under [ingest.states] of the manifest: gripper = \"ENTRY\" with the entry of `{column}` that is \
                     the gripper, or gripper = \"\" for a robot without; it has {}",
                    state.join(", ")
                ))
            })?)
        }
    };
    if !choice.joints.is_empty() {
        let named = |name: &String| Some((name.clone(), in_state(name)?));
        return Ok((choice.joints.iter().filter_map(named).collect(), gripper));
    }
    for column in JOINTS {
        if let Some(feature) = features.get(column) {
            let names = feature.entry_names();
            let unnamed = names.iter().all(|name| name.parse::<u32>().is_ok());
            let count = if names.is_empty() { 7 } else { names.len() };
            let names = match unnamed {
                true => (0..count).map(|joint| format!("joint_{joint}")).collect(),
                false => names,
            };
            let joints = names
                .into_iter()
                .enumerate()
                .map(|(entry, name)| (name, (column.to_owned(), entry)));
            return Ok((joints.collect(), gripper));
        }
    }
    let joints: Vec<_> = state
        .iter()
        .filter_map(|name| Some((name.clone(), in_state(name)?)))
        .filter(|(_, place)| gripper.as_ref() != Some(place))
        .collect();
    let unnamed = joints.iter().all(|(name, _)| name.parse::<u32>().is_ok());
    if joints.is_empty() || (unnamed && choice.joint_names.is_empty()) {
        return Err(wrong(path, "the data names no joint states").with_hint(format!(
            "under [ingest.states] of the manifest: joints = [\"ENTRY\", ...], the entries of `{column}` that are the arm's \
             joints, and joint_names = [...], their names in the URDF; it has {}",
            state.join(", ")
        )));
    }
    Ok((joints, gripper))
}

fn urdf_names(names: Vec<String>, choice: &StateColumns, robot: Option<&str>, path: &Path) -> StageResult<Vec<String>> {
    if !choice.joint_names.is_empty() {
        if choice.joint_names.len() != names.len() {
            let text = format!(
                "`joint_names` under [ingest.states] has {} names for {} joints",
                choice.joint_names.len(),
                names.len()
            );
            return Err(StageError::bad_params(text));
        }
        return Ok(choice.joint_names.clone());
    }
    let robot = robot.unwrap_or_default().to_ascii_lowercase();
    let franka = ["franka", "panda", "droid"].iter().any(|name| robot.contains(name));
    if franka && names.len() == 7 {
        return Ok((1..=7).map(|joint| format!("panda_joint{joint}")).collect());
    }
    if names.len() > 64 {
        return Err(wrong(path, format!("{} joints are too many", names.len())));
    }
    // LeRobot calls positions `NAME.pos` where a robot has other quantities too; the URDF has `NAME`.
    if let Some(bare) = names
        .iter()
        .map(|name| name.strip_suffix(".pos").map(str::to_owned))
        .collect()
    {
        return Ok(bare);
    }
    Ok(names)
}
