//! Tracks of scene points: absolute positions in the base frame at every canonical frame of a clip, by camera, with the
//! robot's states.

use std::path::Path;

use rogs_arrays::ANY;
use rogs_schemas::{EpisodeFrame, WrittenPose};
use rogs_worker::StageResult;

use super::clips::{CANONICAL_STEP, Clip, Clips, Numbers};
use super::{base_from_camera, camera_of, nearest, same_episode, serials};
use crate::assemble::Interval;
use crate::fault::wrong;
use crate::params::PointWorldParams;
use crate::source::{Source, SourceTracks};

/// Most track positions of a clip, over all episode frames.
const MAX_POSITIONS: usize = 1 << 26;
/// No point of a table-top scene is further away, metres.
const FAR_M: f32 = 20.0;
/// Joint positions of the cache and of the episode at one time differ by no more, radians.
const JOINTS_DIFFER: f64 = 0.05;

/// Adds the tracks of the clip that has most positions within the interval.
pub(super) fn join(path: &Path, source: &mut Source, interval: Interval, params: &PointWorldParams) -> StageResult<()> {
    let clips = Clips::open(path, &source.episode_id)?;
    if let Some(uuid) = &clips.uuid {
        same_episode(uuid, source, path)?;
    }
    let wanted: Vec<u32> = interval.frames().map(|frame| frame.0).collect();
    // Canonical frame of every clip frame, where there is one.
    let canonical = match &clips.clock {
        Some(clock) => by_clock(clock, &wanted, source, params.tolerance_ms, path)?,
        None => wanted.iter().map(|&frame| by_count(frame as usize)).collect(),
    };
    let within = |clip: &Clip| {
        let inside = |at: &&Option<usize>| at.is_some_and(|at| (clip.start..clip.end).contains(&at));
        canonical.iter().filter(inside).count()
    };
    // Of several that fit as well, the first.
    let best = clips
        .clips
        .iter()
        .max_by_key(|&clip| (within(clip), std::cmp::Reverse(clip.start)));
    let Some(clip) = best.filter(|&clip| within(clip) > 0) else {
        source
            .warnings
            .push(format!("`{}` has no track within the clip", path.display()));
        return Ok(());
    };
    let row = |at: usize| (clip.start..clip.end).contains(&at).then(|| at - clip.start);
    let rows: Vec<(u32, usize)> = wanted
        .iter()
        .zip(&canonical)
        .filter_map(|(&frame, at)| Some((frame, row((*at)?)?)))
        .collect();
    check_joints(&clips, clip, &rows, source)?;
    let mut tracks = SourceTracks {
        anchor_frame: EpisodeFrame(rows[0].0),
        camera: vec![],
        pixel: vec![],
        position_m: vec![],
        visible: vec![],
        origin: clips.origin,
    };
    for camera in clips.cameras(clip)? {
        add_camera(&clips, clip, &camera, &rows, source, &mut tracks)?;
    }
    if tracks.camera.is_empty() {
        let text = format!("`{}`: no point of `{}` can be used", path.display(), clip.name);
        source.warnings.push(text);
        return Ok(());
    }
    if rows.len() < wanted.len() {
        source.warnings.push(format!(
            "tracks are known at {} of the {} frames of the clip, from episode frame {} on: PointWorld keeps every second frame",
            rows.len(),
            wanted.len(),
            rows[0].0
        ));
    }
    source.tracks = Some(tracks);
    Ok(())
}

/// The canonical frame nearest in time to each of these episode frames.
fn by_clock(
    clock: &[f64],
    wanted: &[u32],
    source: &Source,
    tolerance_ms: f64,
    path: &Path,
) -> StageResult<Vec<Option<usize>>> {
    let times = source.cameras.iter().find_map(|camera| camera.times_ms.as_ref());
    let times = times
        .filter(|times| times.len() == source.frame_count as usize)
        .ok_or_else(|| {
            wrong(path, "the episode has no clock that its tracks could be paired with")
                .with_hint("give the depth file of the same episode too, whose maps are one a frame")
        })?;
    let wanted: Vec<f64> = wanted.iter().map(|&frame| times[frame as usize]).collect();
    Ok(nearest(clock, &wanted, tolerance_ms))
}

/// The canonical frame of a recorded one where there is no clock: every second frame is one.
fn by_count(frame: usize) -> Option<usize> {
    frame.is_multiple_of(CANONICAL_STEP).then_some(frame / CANONICAL_STEP)
}

/// The robot of the cache must do what that of the episode does: else clocks or episodes differ.
fn check_joints(clips: &Clips, clip: &Clip, rows: &[(u32, usize)], source: &Source) -> StageResult<()> {
    let at = format!("{}/joint_positions", clip.name);
    let own = source.states.joint_names.len();
    let joints = clips.numbers(clip, None, "joint_positions", &[clip.end - clip.start, ANY])?;
    if joints.shape[1] != own {
        let text = format!("`{at}` has {} joints, the episode {own}", joints.shape[1]);
        return Err(wrong(&clips.path, text));
    }
    let cached: Vec<f64> = joints.values.iter().map(|&value| f64::from(value)).collect();
    for &(frame, row) in rows {
        for joint in 0..own {
            let (here, there) = (
                source.states.positions[frame as usize * own + joint],
                cached[row * own + joint],
            );
            let off = (here - there).abs();
            if off.is_nan() || off > JOINTS_DIFFER {
                let text = format!(
                    "`{at}` is {there:.3} rad for `{}` where the episode has {here:.3} at frame {frame}",
                    source.states.joint_names[joint]
                );
                return Err(wrong(&clips.path, text).with_hint("the clocks differ, or the file is of another episode"));
            }
        }
    }
    Ok(())
}

/// Appends the points of one camera that are seen at the anchor.
fn add_camera(
    clips: &Clips,
    clip: &Clip,
    camera: &str,
    rows: &[(u32, usize)],
    source: &mut Source,
    tracks: &mut SourceTracks,
) -> StageResult<()> {
    let path = &clips.path;
    let serial = camera.trim_start_matches("camera_");
    let serial = serial.rsplit_once('_').map_or(serial, |(serial, _)| serial);
    let Some(index) = camera_of(source, serial) else {
        let known = serials(source);
        source.warnings.push(format!(
            "`{}` has tracks of camera `{serial}`, the episode has {known}",
            path.display()
        ));
        return Ok(());
    };
    let moments = clip.end - clip.start;
    let Numbers { shape, values: flows } = clips.numbers(clip, Some(camera), "scene_flows", &[moments, ANY, 3])?;
    let points = shape[1];
    let flags = |name: &str| -> StageResult<Vec<u8>> {
        let flags = clips.numbers(clip, Some(camera), name, &[moments, points])?;
        Ok(flags.values.iter().map(|&value| u8::from(value != 0.0)).collect())
    };
    let (visible, valid) = (flags("scene_visibility")?, flags("scene_depth_valid_mask")?);
    if let Some(far) = flows.iter().find(|value| value.is_finite() && value.abs() > FAR_M) {
        let text = format!("`{}/{camera}/scene_flows` has a point {far} m away", clip.name);
        return Err(wrong(path, text).with_hint("positions are metres in the base frame; were these millimetres?"));
    }
    let view = View::read(clips, clip, camera, source, index)?;
    let frames = source.frame_count as usize;
    let anchor = rows[0].1;
    let shift = source.cameras[index].pixel_shift;
    let (mut behind, mut seen) = (0, 0);
    for point in 0..points {
        let here = anchor * points + point;
        let position = &flows[3 * here..3 * here + 3];
        if visible[here] == 0 || valid[here] == 0 || position.iter().any(|value| !value.is_finite()) {
            continue;
        }
        seen += 1;
        let Some(pixel) = view.project(position) else {
            behind += 1;
            continue;
        };
        if (tracks.camera.len() + 1) * frames > MAX_POSITIONS {
            return Err(wrong(path, format!("`{}` has too many points", clip.name)));
        }
        tracks.camera.push(index as u32);
        tracks.pixel.extend(pixel.map(|coordinate| (coordinate - shift) as f32));
        let first = tracks.visible.len();
        tracks.position_m.resize(3 * (first + frames), f32::NAN);
        tracks.visible.resize(first + frames, 0);
        for &(frame, row) in rows {
            let (from, to) = (row * points + point, first + frame as usize);
            if valid[from] != 0 {
                tracks.position_m[3 * to..3 * to + 3].copy_from_slice(&flows[3 * from..3 * from + 3]);
                tracks.visible[to] = visible[from];
            }
        }
    }
    if 2 * behind > seen {
        let text = format!(
            "{behind} of {seen} points of `{}/{camera}` lie behind its camera",
            clip.name
        );
        return Err(wrong(path, text).with_hint("`extrinsic` is base-to-camera; is it inverted?"));
    }
    Ok(())
}

/// The camera of a group.
struct View {
    /// Rows of base-to-camera.
    rows: [[f64; 4]; 4],
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// From pixels of the cached images, centres at integers, to those of the recorded ones, centres at + 0.5.
    scale: [f64; 2],
}

impl View {
    fn read(clips: &Clips, clip: &Clip, name: &str, source: &Source, index: usize) -> StageResult<Self> {
        let path = &clips.path;
        let doubles = |what: &str, shape: &[usize]| -> StageResult<Vec<f64>> {
            let numbers = clips.numbers(clip, Some(name), what, shape)?;
            Ok(numbers.values.iter().map(|&value| f64::from(value)).collect())
        };
        let (k, e) = (doubles("intrinsic", &[3, 3])?, doubles("extrinsic", &[4, 4])?);
        let rows = [0, 4, 8, 12].map(|row| [e[row], e[row + 1], e[row + 2], e[row + 3]]);
        let camera = &source.cameras[index];
        // Refuses what is not rigid, is not in metres, or fits the episode's camera only when it is inverted.
        base_from_camera(
            &WrittenPose::Matrix(rows),
            &format!("`{}/{name}/extrinsic`", clip.name),
            &camera.mount,
            path,
        )?;
        let image = clips.numbers(clip, Some(name), "initial_depth", &[ANY, ANY])?;
        let (height, width) = (image.shape[0] as f64, image.shape[1] as f64);
        let scale = [f64::from(camera.width) / width, f64::from(camera.height) / height];
        let view = Self {
            rows,
            fx: k[0],
            fy: k[4],
            cx: k[2],
            cy: k[5],
            scale,
        };
        /// Intrinsics of the cache and of the episode differ by no more.
        const FOCAL_DIFFERS: f64 = 0.1;
        let off = (view.fx * scale[0] / camera.intrinsics.fx - 1.0).abs();
        if off.is_nan() || off > FOCAL_DIFFERS {
            let text = format!(
                "`{}/{name}/intrinsic` has a focal length of {:.1} for images {width} wide, the episode {:.1} for {}",
                clip.name, view.fx, camera.intrinsics.fx, camera.width
            );
            return Err(wrong(path, text));
        }
        Ok(view)
    }

    /// Recorded pixel of a point, centres at + 0.5; `None` behind the camera.
    fn project(&self, position: &[f32]) -> Option<[f64; 2]> {
        let at = |row: [f64; 4]| (0..3).map(|axis| row[axis] * f64::from(position[axis])).sum::<f64>() + row[3];
        let (x, y, z) = (at(self.rows[0]), at(self.rows[1]), at(self.rows[2]));
        let pixel = [self.fx * x / z + self.cx, self.fy * y / z + self.cy];
        (z > 0.0).then(|| [(pixel[0] + 0.5) * self.scale[0], (pixel[1] + 0.5) * self.scale[1]])
    }
}
