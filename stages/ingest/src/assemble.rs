//! From a described episode to a clip: choose frames, decode, resize.

use std::path::Path;

use rayon::prelude::*;
use rogs_schemas::ids::unknown;
use rogs_schemas::records::clip::{CameraMount, CameraRole, Clip, ClipCamera, DepthReference, RobotStates, Tracks};
use rogs_schemas::{CameraIndex, ClipId, EpisodeFrame, FrameIndex, RigidPose};
use rogs_worker::{StageError, StageResult};

use crate::checks;
use crate::params::{Observations, Params, QueryChoice, QueryPlanName};
use crate::resize::Mapping;
use crate::rollout::{self, Wanted};
use crate::source::{Source, SourceCamera, SourceMount, SourceTracks, States};

/// First frame of the paper's interval in a cached DROID episode (cached frames 7 to 23).
const PAPER_START: EpisodeFrame = EpisodeFrame(7);

/// The interval of a clip in its episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Interval {
    pub(crate) start: EpisodeFrame,
    step: u32,
    count: u32,
}

impl Interval {
    /// Its episode frames.
    pub(crate) fn frames(self) -> impl Iterator<Item = EpisodeFrame> {
        (0..self.count).map(move |index| EpisodeFrame(self.start.0 + index * self.step))
    }

    fn triple(self) -> (u32, u32, u32) {
        (self.start.0, self.step, self.count)
    }

    /// The clip frame of an episode frame.
    fn clip_frame(self, frame: EpisodeFrame) -> Option<FrameIndex> {
        let behind = frame.0.checked_sub(self.start.0)?;
        let index = behind / self.step;
        (behind.is_multiple_of(self.step) && index < self.count).then_some(FrameIndex(index))
    }
}

/// Makes the clip, from the recorded images or with a rollout; also returns what a person should know.
pub(crate) fn assemble(
    mut source: Source,
    rollout: Option<&Path>,
    params: &Params,
    clip_id: ClipId,
) -> StageResult<(Clip, Vec<String>)> {
    let mut warnings = std::mem::take(&mut source.warnings);
    let range_is_said = params.states.gripper_range.is_some() || params.states.gripper.as_deref() == Some("");
    warnings.extend(checks::odd_states(&source.states, range_is_said));
    let interval = interval(&source, params)?;
    let chosen = choose_cameras(&mut source, params)?;
    checks::names_apart(source.cameras.iter().map(|camera| camera.id.as_str()))?;
    warnings.extend(wrist_not_first(&source.cameras));
    let decoded: StageResult<Vec<(ClipCamera, Vec<String>)>> = source
        .cameras
        .par_iter()
        .map(|camera| make_camera(camera, &source, interval, params))
        .collect();
    let mut cameras = Vec::with_capacity(source.cameras.len());
    for (camera, said) in decoded? {
        cameras.push(camera);
        warnings.extend(said);
    }
    let fps = source.fps / f64::from(interval.step);
    let rollout = match (params.observations, rollout) {
        (Observations::Recorded, None) => None,
        (Observations::Recorded, Some(path)) => {
            let text = format!(
                "a rollout is given (`{}`), but `observations` are recorded",
                path.display()
            );
            return Err(StageError::bad_params(text).with_hint("set `observations` to \"rollout\", or leave it out"));
        }
        (Observations::Rollout, None) => return Err(rollout::missing(&source)),
        (Observations::Rollout, Some(path)) => {
            let wanted = Wanted {
                source: &source,
                frames: interval.count,
                start: interval.start,
                step: interval.step,
                fps,
            };
            let (rollout, said) = rollout::read(path, &wanted, &mut cameras, params)?;
            warnings.extend(said);
            Some(rollout)
        }
    };
    // Cameras that share a video say the same of it.
    let mut said = std::collections::BTreeSet::new();
    warnings.retain(|warning| said.insert(warning.clone()));
    let tracks = match &source.tracks {
        None => None,
        Some(tracks) => make_tracks(tracks, &chosen, &source, interval, params, &mut warnings)?,
    };
    let first_source = params.source_frames.first().copied().unwrap_or_default();
    let anchor_frame = params
        .anchor_frame
        .or(tracks.as_ref().map(|tracks| tracks.anchor_frame))
        .unwrap_or(first_source);
    let query_frames = match &params.query {
        QueryChoice::Plan(QueryPlanName::All) => FrameIndex::first(params.frames as usize).collect(),
        QueryChoice::Plan(QueryPlanName::Paper) => {
            let sources: Vec<u32> = params.source_frames.iter().map(|frame| frame.0).collect();
            let plan = rogs_random::query_plan(&source.episode_id, params.frames, &sources);
            plan.distinct.into_iter().map(FrameIndex).collect()
        }
        QueryChoice::Frames(frames) => {
            let mut frames = frames.clone();
            frames.sort_unstable();
            frames.dedup();
            frames
        }
    };
    let clip = Clip {
        clip_id,
        episode_id: source.episode_id,
        layout: source.layout.to_owned(),
        task: source.task,
        calibration_note: source.calibration_note,
        fps,
        episode_frames: interval.frames().collect(),
        source_frames: params.source_frames.clone(),
        query_frames,
        anchor_frame,
        height: params.height,
        width: params.width,
        cameras,
        robot: make_states(&source.states, interval),
        tracks,
        rollout,
    };
    Ok((clip, warnings))
}

/// Which frames: as the parameters say, or by the policy of [`Params::start_frame`].
pub(crate) fn interval(source: &Source, params: &Params) -> StageResult<Interval> {
    let (step, count) = (params.frame_step, params.frames);
    let span = u64::from(count - 1) * u64::from(step) + 1;
    let fits = |start: EpisodeFrame| u64::from(start.0) + span <= u64::from(source.frame_count);
    let policy = || match &source.tracks {
        Some(tracks) if fits(tracks.anchor_frame) => tracks.anchor_frame,
        None if fits(PAPER_START) => PAPER_START,
        _ => EpisodeFrame(0),
    };
    let start = params.start_frame.unwrap_or_else(policy);
    if !fits(start) {
        let text = format!(
            "episode `{}` has {} frames, a clip of {count} frames from frame {start} in steps of {step} needs {}",
            source.episode_id,
            source.frame_count,
            u64::from(start.0) + span
        );
        return Err(StageError::bad_input(text)
            .with_hint("set `start_frame`, `frames` or `frame_step` to what the episode has"));
    }
    Ok(Interval { start, step, count })
}

/// What is said where the wrist camera comes behind one that stands still: the networks take the first for the wrist's.
fn wrist_not_first(cameras: &[SourceCamera]) -> Option<String> {
    let sources = cameras.iter().filter(|camera| camera.role == CameraRole::Source);
    let mut sources = sources.map(|camera| (&camera.id, matches!(camera.mount, SourceMount::HandEye { .. })));
    let (first, moves) = sources.next()?;
    let (wrist, _) = sources.find(|(_, moves)| *moves).filter(|_| !moves)?;
    Some(format!(
        "the first camera, `{first}`, does not ride on the robot, and `{wrist}` does: the wrist camera must come first; \
         `cameras` under [ingest] sets their order"
    ))
}

/// Applies the choice of cameras, puts sources first and returns for every camera of the episode its place in the clip.
fn choose_cameras(source: &mut Source, params: &Params) -> StageResult<Vec<Option<CameraIndex>>> {
    let names: Vec<String> = source.cameras.iter().map(|camera| camera.id.clone()).collect();
    let mut renamed = names.clone();
    if !params.cameras.is_empty() && !source.cameras_chosen {
        let known: Vec<&str> = names.iter().map(String::as_str).collect();
        if let Some(unknown) = unknown(params.cameras.iter().map(|choice| choice.from.as_str()), &known) {
            let text = format!("the episode has no camera {unknown}, it has {}", known.join(", "));
            return Err(StageError::bad_params(text).with_hint("`from` in `cameras` under [ingest] names them"));
        }
        let mut kept = Vec::new();
        for choice in &params.cameras {
            let Some(position) = names.iter().position(|name| *name == choice.from) else {
                continue;
            };
            renamed[position] = choice.id.clone();
            kept.push(position);
        }
        let mut cameras: Vec<Option<SourceCamera>> =
            std::mem::take(&mut source.cameras).into_iter().map(Some).collect();
        for position in kept {
            let camera = cameras[position].take();
            let mut camera = camera
                .ok_or_else(|| StageError::bad_params(format!("camera `{}` is chosen twice", names[position])))?;
            camera.id = renamed[position].clone();
            camera.partner = camera.partner.map(|partner| {
                names
                    .iter()
                    .position(|name| *name == partner)
                    .map_or(partner, |position| renamed[position].clone())
            });
            source.cameras.push(camera);
        }
    }
    for choice in params.cameras.iter().filter(|choice| choice.held_out) {
        let own = source.cameras.iter_mut().filter(|camera| camera.id == choice.id);
        own.for_each(|camera| camera.role = CameraRole::Evaluation);
    }
    source.cameras.sort_by_key(|camera| camera.role != CameraRole::Source);
    if !source.cameras.iter().any(|camera| camera.role == CameraRole::Source) {
        return Err(StageError::bad_input(format!(
            "episode `{}` has no source camera",
            source.episode_id
        )));
    }
    let place = |name: &String| {
        source
            .cameras
            .iter()
            .position(|camera| camera.id == *name)
            .map(|place| CameraIndex(place as u32))
    };
    Ok(renamed.iter().map(place).collect())
}

fn make_camera(
    camera: &SourceCamera,
    source: &Source,
    interval: Interval,
    params: &Params,
) -> StageResult<(ClipCamera, Vec<String>)> {
    let size = (camera.width, camera.height);
    let mapping = Mapping::new(size, (params.width, params.height), params.fit);
    let area = params.width as usize * params.height as usize;
    let mut warnings = Vec::new();
    let odd = checks::odd_intrinsics(camera.intrinsics, size);
    warnings.extend(odd.map(|what| format!("camera `{}`: {what}", camera.id)));
    let is_observed = camera.role == CameraRole::Source && params.observations == Observations::Recorded;
    if is_observed && camera.images.is_none() {
        return Err(StageError::bad_input(format!(
            "source camera `{}` of episode `{}` has no images",
            camera.id, source.episode_id
        )));
    }
    let rgb = match &camera.images {
        None => None,
        Some(images) => {
            let mut rgb = Vec::with_capacity(interval.count as usize * area * 3);
            warnings.extend(images.read(interval.triple(), size, |image| rgb.extend(mapping.rgb(image)))?);
            Some(rgb)
        }
    };
    let depth = match &camera.depth {
        None => None,
        Some(depth) => {
            let mut depth_m = Vec::with_capacity(interval.count as usize * area);
            // Maps of a cache have a size of their own and show the same.
            let mapping = match &depth.cached {
                None => mapping,
                Some(cached) => Mapping::new(cached.size, (params.width, params.height), params.fit),
            };
            let told = depth.read(interval.triple(), source.frame_count, size, |map| {
                depth_m.extend(mapping.nearest(map))
            })?;
            warnings.extend(told);
            let range_m = params.depth_range_m.unwrap_or(depth.range_m);
            warnings.extend(depth.check_range(&depth_m, range_m, &camera.id)?);
            Some(DepthReference {
                depth_m,
                range_m,
                origin: depth.origin,
            })
        }
    };
    let partner = match &camera.partner {
        None => None,
        Some(name) => {
            let fits = |other: &SourceCamera| other.id == *name && other.role == CameraRole::Source;
            let found = source.cameras.iter().position(fits);
            if found.is_none() {
                warnings.push(format!(
                    "the partner `{name}` of camera `{}` is not a source camera of the clip",
                    camera.id
                ));
            }
            found.map(|position| CameraIndex(position as u32))
        }
    };
    let mount = match &camera.mount {
        SourceMount::Fixed(base_from_camera) => CameraMount::Fixed {
            base_from_camera: *base_from_camera,
        },
        SourceMount::HandEye { link, link_from_camera } => CameraMount::HandEye {
            link: link.clone(),
            link_from_camera: *link_from_camera,
        },
        SourceMount::Trajectory(poses) => {
            let pose = |frame: EpisodeFrame| poses.get(frame.at()).copied();
            let poses: Option<Vec<RigidPose>> = interval.frames().map(pose).collect();
            let missing = || StageError::bad_input(format!("the trajectory of camera `{}` is too short", camera.id));
            CameraMount::Trajectory {
                base_from_camera: poses.ok_or_else(missing)?,
            }
        }
    };
    let intrinsics = mapping.intrinsics(camera.intrinsics);
    Ok((
        ClipCamera {
            id: camera.id.clone(),
            role: camera.role,
            partner,
            intrinsics,
            mount,
            recorded: rgb,
            generated: None,
            depth,
        },
        warnings,
    ))
}

fn make_states(states: &States, interval: Interval) -> RobotStates {
    let joints = states.joint_names.len();
    let row = |frame: EpisodeFrame| {
        states.positions[frame.at() * joints..(frame.at() + 1) * joints]
            .iter()
            .copied()
    };
    RobotStates {
        joint_names: states.joint_names.clone(),
        positions: interval.frames().flat_map(row).collect(),
        gripper: interval.frames().map(|frame| states.gripper[frame.at()]).collect(),
    }
}

/// The tracks whose anchor pixel is in the clip's image; `None` when their anchor frame is not in the clip.
fn make_tracks(
    tracks: &SourceTracks,
    places: &[Option<CameraIndex>],
    source: &Source,
    interval: Interval,
    params: &Params,
    warnings: &mut Vec<String>,
) -> StageResult<Option<Tracks>> {
    let Some(anchor_frame) = interval.clip_frame(tracks.anchor_frame) else {
        warnings.push(format!(
            "the tracks are anchored at episode frame {}, outside the clip: left out",
            tracks.anchor_frame
        ));
        return Ok(None);
    };
    let frames = source.frame_count as usize;
    let mut kept = Tracks {
        anchor_frame,
        camera: vec![],
        pixel: vec![],
        position_m: vec![],
        visible: vec![],
        origin: tracks.origin,
    };
    for (index, &camera) in tracks.camera.iter().enumerate() {
        let place = places.get(camera as usize).copied();
        let place = place.ok_or_else(|| {
            StageError::bad_input(format!(
                "track {index} lies in camera {camera} of {} (episode `{}`)",
                places.len(),
                source.episode_id
            ))
        })?;
        let Some(place) = place else { continue };
        let of = &source.cameras[place.at()];
        let mapping = Mapping::new((of.width, of.height), (params.width, params.height), params.fit);
        let recorded = [0, 1].map(|axis| f64::from(tracks.pixel[2 * index + axis]) + of.pixel_shift);
        // The clip keeps anchor pixels with integer centres.
        let pixel = mapping.point(recorded).map(|coordinate| (coordinate - 0.5) as f32);
        let inside = |coordinate: f32, side: u32| (0.0..side as f32).contains(&(coordinate + 0.5).floor());
        if !(inside(pixel[0], params.width) && inside(pixel[1], params.height)) {
            continue;
        }
        kept.camera.push(place);
        kept.pixel.extend(pixel);
        for frame in interval.frames() {
            let at = index * frames + frame.at();
            kept.position_m
                .extend_from_slice(&tracks.position_m[3 * at..3 * at + 3]);
            kept.visible.push(tracks.visible[at]);
        }
    }
    let lost = tracks.camera.len() - kept.camera.len();
    if lost > 0 {
        warnings.push(format!(
            "{lost} of {} tracks lie outside the clip's images: left out",
            tracks.camera.len()
        ));
    }
    Ok(Some(kept))
}
