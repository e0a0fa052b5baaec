//! Depth of both eyes of every stereo pair.

use rayon::prelude::*;
use rogs_geometry::{Base, Camera, Pose, PosedCamera};
use rogs_schemas::records::clip::{Clip, ClipCamera, Target};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::records::references::MadeDepth;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_stereo::{Concern, Grey, Rig, diagnose, match_offset_pair, match_pair};
use rogs_worker::{StageError, StageResult};

use crate::params::Params;

/// Images of more pixels are matched one pair after the other, so that few of their volumes are in memory.
const SMALL_AREA: usize = 200_000;
/// Less known depth than this is told.
const LITTLE_COVERAGE: f64 = 0.1;

/// A pair of the clip: places of its cameras, and which of them need depth.
struct Pair<'a> {
    left: (CameraIndex, &'a ClipCamera),
    right: (CameraIndex, &'a ClipCamera),
    wanted: [bool; 2],
}

/// One frame of a pair, ready to be matched.
struct View {
    eyes: [Grey; 2],
    rig: Rig,
}

/// Depth of the cameras that need it, cameras ascending.
pub(crate) fn make(
    clip: &Clip,
    robot: &RobotMaps,
    frames: &[FrameIndex],
    params: &Params,
    notes: &mut Vec<String>,
) -> StageResult<Vec<MadeDepth>> {
    let mut made = Vec::new();
    for pair in pairs(clip, params) {
        match of_pair(clip, robot, frames, &pair, params) {
            Ok(done) => {
                notes.extend(done.notes);
                made.extend(done.depth);
            }
            Err(why) => notes.push(format!("{}: no stereo depth: {why}", pair.name())),
        }
    }
    let alone = |camera: &&ClipCamera| camera.depth.is_none() && !has_pair(clip, camera);
    let alone: Vec<&str> = (clip.cameras.iter().filter(alone))
        .map(|camera| camera.id.as_str())
        .collect();
    if !alone.is_empty() && params.depth.wants(false) {
        notes.push(format!(
            "no stereo depth of {}: there is no pair of images of two eyes",
            alone.join(", ")
        ));
    }
    made.sort_by_key(|made: &MadeDepth| made.camera);
    if made.is_sorted_by(|a, b| a.camera < b.camera) {
        Ok(made)
    } else {
        Err(StageError::bad_input("a camera of the clip has two right eyes"))
    }
}

impl Pair<'_> {
    fn name(&self) -> String {
        format!("stereo pair `{}`, `{}`", self.left.1.id, self.right.1.id)
    }
}

/// Whether a camera has images and a partner that has some.
fn has_pair(clip: &Clip, camera: &ClipCamera) -> bool {
    let seen = |camera: &ClipCamera| camera.recorded.is_some();
    let of_pair = |other: &ClipCamera| {
        let left = other.partner.and_then(|left| clip.cameras.get(left.at()));
        let member = other.id == camera.id || left.is_some_and(|left| left.id == camera.id);
        member && seen(other) && left.is_some_and(seen)
    };
    clip.cameras.iter().any(of_pair)
}

/// The pairs with images in which a camera needs depth.
fn pairs<'a>(clip: &'a Clip, params: &Params) -> Vec<Pair<'a>> {
    let pair = |(place, right): (CameraIndex, &'a ClipCamera)| {
        let at = right.partner?;
        let left = clip.cameras.get(at.at())?;
        let wanted = [left, right].map(|camera| params.depth.wants(camera.depth.is_some()));
        let useful = wanted.contains(&true) && left.recorded.is_some() && right.recorded.is_some();
        useful.then_some(Pair {
            left: (at, left),
            right: (place, right),
            wanted,
        })
    };
    let cameras = CameraIndex::first(clip.cameras.len()).zip(&clip.cameras);
    cameras.filter_map(pair).collect()
}

/// What a pair gave.
struct Done {
    depth: Vec<MadeDepth>,
    notes: Vec<String>,
}

fn of_pair(
    clip: &Clip,
    robot: &RobotMaps,
    frames: &[FrameIndex],
    pair: &Pair<'_>,
    params: &Params,
) -> Result<Done, String> {
    let views: Vec<View> = frames
        .iter()
        .map(|&frame| view(clip, robot, pair, frame).map_err(|why| format!("frame {frame}: {why}")))
        .collect::<Result<_, String>>()?;
    let mut notes = Vec::new();
    let mut offset = None;
    if let Some(View {
        eyes: [left, right],
        rig,
    }) = views.first()
    {
        for concern in diagnose(left, right, rig, &params.stereo).map_err(|error| error.to_string())? {
            match concern {
                Concern::Swapped { .. } => return Err(concern.to_string()),
                Concern::Rows { rows_px, .. } => {
                    notes.push(format!(
                        "{}: {concern}; matched with its rows moved by that",
                        pair.name()
                    ));
                    offset = Some(rows_px);
                }
            }
        }
    }
    let one = |view: &View| {
        let View {
            eyes: [left, right],
            rig,
        } = view;
        let found = match offset {
            None => match_pair(left, right, rig, &params.stereo),
            Some(rows_px) => match_offset_pair(left, right, rows_px, rig, &params.stereo),
        };
        Ok(found.map_err(|error| error.to_string())?.depths_m(rig))
    };
    let small = clip.height as usize * clip.width as usize <= SMALL_AREA;
    let maps: Vec<[Vec<f32>; 2]> = if small {
        views.par_iter().map(one).collect::<Result<_, String>>()?
    } else {
        views.iter().map(one).collect::<Result<_, String>>()?
    };
    let places = [pair.left, pair.right];
    let mut depth = Vec::new();
    for (eye, (camera, of)) in places.into_iter().enumerate() {
        if !pair.wanted[eye] {
            continue;
        }
        let depth_m: Vec<f32> = maps.iter().flat_map(|eyes| eyes[eye].iter().copied()).collect();
        let known = depth_m.iter().filter(|value| value.is_finite()).count() as f64 / depth_m.len().max(1) as f64;
        if known < LITTLE_COVERAGE {
            notes.push(format!(
                "stereo depth of `{}` is known at {:.1} % of its pixels only: little texture, or a pair that does not fit",
                of.id,
                100.0 * known
            ));
        }
        depth.push(MadeDepth {
            camera,
            depth_m,
            range_m: params.depth_range_m,
            origin: ReferenceOrigin::ClassicalStereo,
        });
    }
    Ok(Done { depth, notes })
}

/// The images of a pair at a frame and its geometry then.
fn view(clip: &Clip, robot: &RobotMaps, pair: &Pair<'_>, frame: FrameIndex) -> Result<View, String> {
    let posed = |camera| PosedCamera::of_clip(clip, robot, camera, frame).map_err(|error| error.to_string());
    let (left, right) = (posed(pair.left.0)?, posed(pair.right.0)?);
    let base_from_left: Pose<Base, Camera> = left.world_from_camera;
    let left_from_right: Pose<Camera, Camera> = base_from_left.inverse() * right.world_from_camera;
    let rig = Rig::new(&left.lens, &right.lens, &left_from_right).map_err(|error| error.to_string())?;
    let (width, height) = (clip.width as usize, clip.height as usize);
    // Recorded images, in rollouts too: references do not depend on what a world model made.
    let image = |camera: CameraIndex| {
        let rgb = clip.target(camera, frame).map(Target::rgb);
        Grey::of_rgb(width, height, rgb.unwrap_or_default()).map_err(|error| error.to_string())
    };
    Ok(View {
        eyes: [image(pair.left.0)?, image(pair.right.0)?],
        rig,
    })
}
