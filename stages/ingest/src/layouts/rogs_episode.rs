//! Our own episode folder (`docs/episode-format.md`).

use std::collections::BTreeSet;
use std::path::Path;

use rogs_arrays::{ANY, NpyFile};
use rogs_schemas::episode::{
    EPISODE_FILE, EPISODE_FORMAT, Episode, EpisodeCamera, EpisodeCameraRole, EpisodeMount, EpisodeRobot, EpisodeTracks,
    GRIPPER_COLUMN, PixelCentres, TIME_COLUMN,
};
use rogs_schemas::ids::{did_you_mean, misspelt};
use rogs_schemas::records::clip::CameraRole;
use rogs_schemas::{Intrinsics, WrittenPose};
use rogs_worker::StageResult;

use crate::calibration::Calibration;
use crate::checks;
use crate::fault::{inside, read_text, unreadable, wrong};
use crate::images::FrameSource;
use crate::params::StateColumns;
use crate::source::{Source, SourceCamera, SourceDepth, SourceMount, SourceTracks, States};

/// Name of the layout, as the clip keeps it.
pub(crate) const LAYOUT: &str = "rogs-episode";

/// Longest `episode.json`, bytes.
const MAX_JSON: u64 = 4 << 20;
/// Longest table of states, bytes.
const MAX_CSV: u64 = 64 << 20;
/// Most frames of an episode.
const MAX_FRAMES: u32 = 1 << 20;

/// The description of an episode folder.
pub(crate) fn read_description(root: &Path) -> StageResult<Episode> {
    let path = root.join(EPISODE_FILE);
    let text = read_text(&path, MAX_JSON)?;
    let episode: Episode = rogs_schemas::json::read(&text).map_err(|said| {
        let hint = match misspelt(&said) {
            Some((_, Some(meant))) => format!("did you mean `{meant}`? docs/episode-format.md has all keys"),
            _ => "docs/episode-format.md shows one".to_owned(),
        };
        wrong(&path, format!("not an episode description: {said}")).with_hint(hint)
    })?;
    if episode.format != EPISODE_FORMAT {
        return Err(wrong(
            &path,
            format!(
                "the format is `{}`, this program reads `{EPISODE_FORMAT}`",
                episode.format
            ),
        ));
    }
    checks::episode_id(&episode.episode_id, &path)?;
    Ok(episode)
}

/// Opens an episode folder.
pub(crate) fn open(root: &Path, calibration: Option<&Calibration>, choice: &StateColumns) -> StageResult<Source> {
    let path = root.join(EPISODE_FILE);
    let episode = read_description(root)?;
    if !(1..=MAX_FRAMES).contains(&episode.frame_count) {
        return Err(wrong(
            &path,
            format!("`frame_count` {} is impossible", episode.frame_count),
        ));
    }
    if !(episode.fps.is_finite() && episode.fps > 0.0) {
        return Err(wrong(&path, format!("`fps` {} must be above 0", episode.fps)));
    }
    let mut names = BTreeSet::new();
    if let Some(camera) = episode.cameras.iter().find(|camera| !names.insert(camera.id.as_str())) {
        return Err(wrong(&path, format!("two cameras are named `{}`", camera.id)));
    }
    let frames = episode.frame_count;
    let (states, times, warnings) = read_states(root, &path, &episode.robot, (frames, episode.fps), choice)?;
    let times_ms: Option<Vec<f64>> =
        (!times.is_empty()).then(|| times.iter().map(|seconds| 1000.0 * seconds).collect());
    let cameras: StageResult<Vec<SourceCamera>> = episode
        .cameras
        .into_iter()
        .map(|camera| {
            let camera = open_camera(root, &path, camera, (frames, episode.fps), calibration)?;
            Ok(SourceCamera {
                times_ms: times_ms.clone(),
                ..camera
            })
        })
        .collect();
    let tracks = episode
        .tracks
        .map(|tracks| read_tracks(root, &path, &tracks, frames))
        .transpose()?;
    let calibration_note = match calibration {
        Some(calibration) => calibration.note(),
        None => episode.calibration_note,
    };
    Ok(Source {
        episode_id: episode.episode_id,
        layout: LAYOUT,
        task: episode.task,
        calibration_note,
        fps: episode.fps,
        frame_count: frames,
        cameras: cameras?,
        states,
        tracks,
        cameras_chosen: false,
        warnings,
    })
}

fn open_camera(
    root: &Path,
    path: &Path,
    camera: EpisodeCamera,
    (frames, fps): (u32, f64),
    calibration: Option<&Calibration>,
) -> StageResult<SourceCamera> {
    let id = &camera.id;
    let size = (camera.width, camera.height);
    if !(1..=8192).contains(&size.0) || !(1..=8192).contains(&size.1) {
        return Err(wrong(
            path,
            format!("camera `{id}` has images of {}x{} pixels", size.0, size.1),
        ));
    }
    let pixel_shift = match camera.pixel_centres {
        PixelCentres::Half => 0.0,
        PixelCentres::Integer => 0.5,
    };
    let calibrated = match calibration {
        Some(calibration) => calibration.camera(&[id], size)?,
        None => None,
    };
    let own = || {
        let Intrinsics { fx, fy, cx, cy } = camera.intrinsics;
        let shifted = Intrinsics {
            fx,
            fy,
            cx: cx + pixel_shift,
            cy: cy + pixel_shift,
        };
        checks::intrinsics(shifted, size, &format!("camera `{id}`"), path)
    };
    let (intrinsics, other_mount) = match calibrated {
        Some(calibrated) => (calibrated.intrinsics, calibrated.mount),
        None => (own()?, None),
    };
    let rigid =
        |written: &WrittenPose, what: &str| checks::rigid_pose(written, &format!("{what} of camera `{id}`"), path);
    let mount = match (other_mount, &camera.mount) {
        (Some(mount), _) => mount,
        (None, EpisodeMount::Fixed { base_from_camera }) => {
            SourceMount::Fixed(rigid(base_from_camera, "`base_from_camera`")?)
        }
        (None, EpisodeMount::HandEye { link, link_from_camera }) => SourceMount::HandEye {
            link: link.clone(),
            link_from_camera: rigid(link_from_camera, "`link_from_camera`")?,
        },
        (None, EpisodeMount::Trajectory { base_from_camera }) => {
            read_trajectory(&inside(root, base_from_camera, path)?, frames)?
        }
    };
    let images = match &camera.images {
        Some(images) => Some(FrameSource::open(inside(root, images, path)?, (frames, fps), size)?),
        None => None,
    };
    let depth = match &camera.depth {
        Some(depth) if depth.unit_m.is_some_and(|unit| !(1e-9..1e3).contains(&unit)) => {
            let what = format!("`unit_m` of the depth of camera `{id}` must be metres a step, e.g. 0.001");
            return Err(wrong(path, what));
        }
        Some(depth) => Some(SourceDepth {
            path: inside(root, &depth.path, path)?,
            unit_m: depth.unit_m,
            range_m: depth.range_m,
            origin: depth.origin,
            cached: None,
        }),
        None => None,
    };
    let role = match camera.role {
        EpisodeCameraRole::Source => CameraRole::Source,
        EpisodeCameraRole::Evaluation => CameraRole::Evaluation,
    };
    let (width, height) = size;
    Ok(SourceCamera {
        id: camera.id,
        serial: None,
        role,
        partner: camera.partner,
        width,
        height,
        intrinsics,
        pixel_shift,
        mount,
        images,
        times_ms: None,
        depth,
    })
}

fn read_trajectory(path: &Path, frames: u32) -> StageResult<SourceMount> {
    let mut array = NpyFile::open(path).map_err(unreadable)?;
    array.expect_floats().map_err(unreadable)?;
    let shape = array.shape().to_vec();
    let (Some(&count), [4 | 3, 4] | [6]) = (shape.first(), &shape[1..]) else {
        let what = format!("its shape is {shape:?}, poses are [{frames}, 4, 4], [{frames}, 3, 4] or [{frames}, 6]");
        return Err(
            wrong(path, what).with_hint("six numbers are x, y, z, roll, pitch, yaw; quaternions: convert to matrices")
        );
    };
    if count != frames as usize {
        return Err(wrong(
            path,
            format!("it has {count} poses, the episode {frames} frames"),
        ));
    }
    let numbers = shape[1..].iter().product();
    let values = array.all().map_err(unreadable)?;
    let pose = |(frame, numbers): (usize, &[f64])| {
        let what = format!("the pose at frame {frame}");
        let written = WrittenPose::from_numbers(numbers).ok_or_else(|| wrong(path, format!("{what}: not a pose")))?;
        checks::rigid_pose(&written, &what, path)
    };
    let poses: StageResult<Vec<_>> = values.chunks_exact(numbers).enumerate().map(pose).collect();
    Ok(SourceMount::Trajectory(poses?))
}

/// A table as programs write it: cells between commas, semicolons or tabs, perhaps in quotes, below lines of comments.
struct Table<'a> {
    header: &'a str,
    separator: char,
    /// Lines below the header that hold something.
    rows: std::iter::Filter<std::str::Lines<'a>, fn(&&'a str) -> bool>,
}

impl<'a> Table<'a> {
    fn new(text: &'a str) -> Self {
        let holds_something: fn(&&'a str) -> bool = |line| {
            let line = line.trim();
            // Spreadsheets say the separator in a line of its own.
            !(line.is_empty() || line.starts_with('#') || line.starts_with("sep="))
        };
        let mut rows = text.trim_start_matches('\u{feff}').lines().filter(holds_something);
        let header = rows.next().unwrap_or_default();
        let separator = [',', ';', '\t']
            .into_iter()
            .find(|&separator| header.contains(separator));
        Self {
            header,
            separator: separator.unwrap_or(','),
            rows,
        }
    }

    fn cells(&self, line: &'a str) -> Vec<&'a str> {
        let bare = |cell: &'a str| {
            let cell = cell.trim();
            let quoted = cell.strip_prefix('"').and_then(|cell| cell.strip_suffix('"'));
            quoted.unwrap_or(cell).trim()
        };
        line.split(self.separator).map(bare).collect()
    }

    /// A number, with a decimal comma where the comma does not separate cells.
    fn number(&self, cell: &str) -> Option<f64> {
        match self.separator {
            ',' => cell.parse().ok(),
            _ => cell.replace(',', ".").parse().ok(),
        }
    }
}

/// The table of joint and gripper states, their times in seconds where it has them, and what is odd about these.
fn read_states(
    root: &Path,
    json: &Path,
    robot: &EpisodeRobot,
    (frames, fps): (u32, f64),
    choice: &StateColumns,
) -> StageResult<(States, Vec<f64>, Vec<String>)> {
    let path = inside(root, &robot.states, json)?;
    let text = read_text(&path, MAX_CSV)?;
    let table = Table::new(&text);
    let header: Vec<&str> = table.cells(table.header);
    let column = |name: &str| {
        let found: Vec<usize> = (0..header.len()).filter(|&index| header[index] == name).collect();
        match found[..] {
            [column] => Ok(column),
            [] => {
                let meant = did_you_mean(name, header.iter().copied());
                let meant = meant.map_or_else(String::new, |meant| format!(", did you mean `{meant}`?"));
                let what = format!("there is no column `{name}`{meant}; the header is `{}`", table.header);
                Err(wrong(&path, what))
            }
            _ => Err(wrong(&path, format!("there are several columns `{name}`"))),
        }
    };
    let columns: StageResult<Vec<usize>> = robot.joint_names.iter().map(|name| column(name)).collect();
    let columns = columns?;
    // A robot without a gripper is taken for one that stays open.
    let none = choice.gripper.as_deref() == Some("");
    let gripper_column = (!none).then(|| column(GRIPPER_COLUMN)).transpose().map_err(|error| {
        error.with_hint("for a robot without gripper, under [ingest.states] of the manifest: gripper = \"\"")
    })?;
    let time_column = header.iter().position(|name| *name == TIME_COLUMN);
    let mut states = States {
        joint_names: robot.joint_names.clone(),
        positions: Vec::new(),
        gripper: Vec::new(),
    };
    let mut times: Vec<f64> = Vec::new();
    for (row, line) in table.rows.clone().enumerate() {
        if row >= frames as usize {
            return Err(wrong(
                &path,
                format!("there are more rows than the {frames} frames of the episode"),
            ));
        }
        let cells = table.cells(line);
        if cells.len() != header.len() {
            return Err(wrong(
                &path,
                format!("row {row} has {} cells, the header {}", cells.len(), header.len()),
            ));
        }
        let number = |column: usize| {
            let cell = cells[column];
            table.number(cell).ok_or_else(|| {
                wrong(
                    &path,
                    format!("invalid number `{cell}` in column `{}`, row {row}", header[column]),
                )
            })
        };
        for &column in &columns {
            states.positions.push(number(column)?);
        }
        states.gripper.push(gripper_column.map_or(Ok(0.0), number)?);
        if let Some(column) = time_column {
            let time = number(column)?;
            if !time.is_finite() || times.last().is_some_and(|&before| time <= before) {
                return Err(wrong(&path, format!("the time {time} at row {row} does not ascend")));
            }
            times.push(time);
        }
    }
    if states.gripper.len() != frames as usize {
        return Err(wrong(
            &path,
            format!(
                "there are {} rows, the episode has {frames} frames",
                states.gripper.len()
            ),
        ));
    }
    choice.convert(&mut states);
    checks::states(&states, "row", &path)?;
    let warnings = checks::times(&times, fps, &path)?;
    Ok((states, times, warnings.into_iter().collect()))
}

fn read_tracks(root: &Path, json: &Path, tracks: &EpisodeTracks, frames: u32) -> StageResult<SourceTracks> {
    let array = |name: &str, shape: &[usize]| {
        let path = inside(root, name, json)?;
        let mut array = NpyFile::open(&path).map_err(unreadable)?;
        array.expect_shape(shape).map_err(unreadable)?;
        StageResult::Ok((array.all().map_err(unreadable)?, path))
    };
    let (camera, camera_path) = array(&tracks.camera, &[ANY])?;
    let (count, moments) = (camera.len(), frames as usize);
    let (pixel, _) = array(&tracks.pixel, &[count, 2])?;
    let (position, _) = array(&tracks.position_m, &[count, moments, 3])?;
    let (visible, visible_path) = array(&tracks.visible, &[count, moments])?;
    if let Some(index) = camera
        .iter()
        .position(|value| value.fract() != 0.0 || !(0.0..256.0).contains(value))
    {
        return Err(wrong(
            &camera_path,
            format!("invalid camera index {} at {index}", camera[index]),
        ));
    }
    if let Some(index) = visible.iter().position(|value| *value != 0.0 && *value != 1.0) {
        return Err(wrong(
            &visible_path,
            format!("{} at {index} is neither 0 nor 1", visible[index]),
        ));
    }
    if tracks.anchor_frame.0 >= frames {
        return Err(wrong(
            json,
            format!(
                "the anchor frame {} of the tracks is not below {frames}",
                tracks.anchor_frame
            ),
        ));
    }
    let floats = |values: Vec<f64>| values.into_iter().map(|value| value as f32).collect();
    Ok(SourceTracks {
        anchor_frame: tracks.anchor_frame,
        camera: camera.into_iter().map(|value| value as u32).collect(),
        pixel: floats(pixel),
        position_m: floats(position),
        visible: visible.into_iter().map(|value| value as u8).collect(),
        origin: tracks.origin,
    })
}
