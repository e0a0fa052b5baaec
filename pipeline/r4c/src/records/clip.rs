//! How a clip lies in its container.

use rogs_schemas::records::check::{area, count, product};
use rogs_schemas::records::clip::{
    CameraMount, CameraRole, Clip, ClipCamera, DepthReference, RobotStates, Rollout, Tracks,
};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::{CameraIndex, ClipId, EpisodeFrame, FrameIndex, Intrinsics, SchemaId};
use serde::{Deserialize, Serialize};

use crate::error::Result;
use crate::reader::Reader;
use crate::record::Record;
use crate::stream::{Codec, Dtype, Frame, StreamSpec, Unit};
use crate::writer::Writer;

/// Recorded images, one chunk per (camera, frame).
const RGB: StreamSpec = StreamSpec {
    name: "rgb",
    dtype: Dtype::U8,
    unit: Unit::One,
    frame: Frame::None,
    codec: Codec::Zstd,
    fill: "",
};
/// Generated images of the source cameras, one chunk per (camera, frame); in rollouts only.
const GENERATED: StreamSpec = StreamSpec {
    name: "generated_rgb",
    ..RGB
};
/// Head of what a rollout has more; in rollouts only.
const ROLLOUT_HEAD: &str = "rollout";
/// Reference depth, one chunk per (camera, frame).
pub(super) const DEPTH: StreamSpec = StreamSpec {
    name: "depth_m",
    dtype: Dtype::F32,
    unit: Unit::Metre,
    frame: Frame::Camera,
    codec: Codec::PlanesZstd,
    fill: "NaN: unknown",
};
const TRACK_CAMERA: StreamSpec = StreamSpec {
    name: "track_camera",
    dtype: Dtype::U32,
    unit: Unit::One,
    frame: Frame::None,
    codec: Codec::DeltaShuffleZstd,
    fill: "",
};
const TRACK_PIXEL: StreamSpec = StreamSpec {
    name: "track_pixel",
    dtype: Dtype::F32,
    unit: Unit::Pixel,
    frame: Frame::None,
    codec: Codec::PlanesZstd,
    fill: "",
};
const TRACK_POSITION: StreamSpec = StreamSpec {
    name: "track_position_m",
    dtype: Dtype::F32,
    unit: Unit::Metre,
    frame: Frame::RobotBase,
    codec: Codec::PlanesZstd,
    fill: "NaN: undefined",
};
const TRACK_VISIBLE: StreamSpec = StreamSpec {
    name: "track_visible",
    dtype: Dtype::U8,
    unit: Unit::One,
    frame: Frame::None,
    codec: Codec::Zstd,
    fill: "",
};

/// What is small.
#[derive(Serialize, Deserialize)]
struct Head {
    clip_id: ClipId,
    episode_id: String,
    layout: String,
    task: String,
    calibration_note: String,
    fps: f64,
    episode_frames: Vec<EpisodeFrame>,
    source_frames: Vec<FrameIndex>,
    query_frames: Vec<FrameIndex>,
    anchor_frame: FrameIndex,
    height: u32,
    width: u32,
    cameras: Vec<CameraHead>,
    robot: RobotStates,
    tracks: Option<TracksHead>,
}

#[derive(Serialize, Deserialize)]
struct CameraHead {
    id: String,
    role: CameraRole,
    partner: Option<CameraIndex>,
    intrinsics: Intrinsics,
    mount: CameraMount,
    has_rgb: bool,
    depth_range_m: Option<[f32; 2]>,
}

/// What made the references; absent before version 1.1.
#[derive(Default, Serialize, Deserialize)]
struct Origins {
    /// Name of an origin for every camera with depth, in order.
    depth: Vec<String>,
    tracks: Option<String>,
}

/// Name of the stream of [`Origins`].
const ORIGINS: &str = "reference_origins";

#[derive(Serialize, Deserialize)]
pub(super) struct TracksHead {
    anchor_frame: FrameIndex,
    count: u32,
}

impl TracksHead {
    pub(super) fn of(tracks: &Tracks) -> Self {
        Self {
            anchor_frame: tracks.anchor_frame,
            count: tracks.camera.len() as u32,
        }
    }
}

impl Record for Clip {
    const SCHEMA: SchemaId = SchemaId {
        name: "rogs.clip",
        major: 1,
        minor: 2,
    };

    fn encode(&self, writer: &mut Writer) -> Result<()> {
        self.check().map_err(|what| writer.inconsistent(what))?;
        let camera = |camera: &ClipCamera| CameraHead {
            id: camera.id.clone(),
            role: camera.role,
            partner: camera.partner,
            intrinsics: camera.intrinsics,
            mount: camera.mount.clone(),
            has_rgb: camera.recorded.is_some(),
            depth_range_m: camera.depth.as_ref().map(|depth| depth.range_m),
        };
        let head = Head {
            clip_id: self.clip_id.clone(),
            episode_id: self.episode_id.clone(),
            layout: self.layout.clone(),
            task: self.task.clone(),
            calibration_note: self.calibration_note.clone(),
            fps: self.fps,
            episode_frames: self.episode_frames.clone(),
            source_frames: self.source_frames.clone(),
            query_frames: self.query_frames.clone(),
            anchor_frame: self.anchor_frame,
            height: self.height,
            width: self.width,
            cameras: self.cameras.iter().map(camera).collect(),
            robot: self.robot.clone(),
            tracks: self.tracks.as_ref().map(TracksHead::of),
        };
        writer.value("clip", &head)?;
        let depths = self.cameras.iter().filter_map(|camera| camera.depth.as_ref());
        let origins = Origins {
            depth: depths.map(|depth| depth.origin.to_string()).collect(),
            tracks: self.tracks.as_ref().map(|tracks| tracks.origin.to_string()),
        };
        writer.value(ORIGINS, &origins)?;
        if let Some(rollout) = &self.rollout {
            writer.value(ROLLOUT_HEAD, rollout)?;
        }
        let area = self.height as usize * self.width as usize;
        let (mut images, mut generated, mut depths) = (Vec::new(), Vec::new(), Vec::new());
        for (index, camera) in self.cameras.iter().enumerate() {
            for (rgb, chunks) in [(&camera.recorded, &mut images), (&camera.generated, &mut generated)] {
                let frames = rgb.iter().flat_map(|rgb| rgb.chunks_exact(3 * area).enumerate());
                chunks.extend(frames.map(|(f, image)| ([index as u32, f as u32, 0, 0], image)));
            }
            if let Some(depth) = &camera.depth {
                let maps = depth.depth_m.chunks_exact(area).enumerate();
                depths.extend(maps.map(|(f, map)| ([index as u32, f as u32, 0, 0], map)));
            }
        }
        writer.stream(&RGB, &[self.height, self.width, 3], &images)?;
        if self.rollout.is_some() {
            writer.stream(&GENERATED, &[self.height, self.width, 3], &generated)?;
        }
        writer.stream(&DEPTH, &[self.height, self.width], &depths)?;
        let Some(tracks) = &self.tracks else { return Ok(()) };
        let frames = self.frame_count() as u32;
        write_tracks(writer, tracks, frames)
    }

    fn decode(reader: &Reader) -> Result<Self> {
        let head: Head = reader.value("clip")?;
        let wrong = |what: String| reader.inconsistent(what);
        let area = area(head.height, head.width).map_err(wrong)?;
        let frames = head.episode_frames.len();
        let mut rgb = reader.stream::<u8>(&RGB, &[head.height, head.width, 3])?;
        let (rollout, mut generated) = read_rollout(reader, &head)?;
        let mut depth = reader.stream::<f32>(&DEPTH, &[head.height, head.width])?;
        let mut origins = if reader.has(ORIGINS) {
            reader.value::<Origins>(ORIGINS)?
        } else {
            Origins::default()
        };
        // Split off the back, so that each camera keeps its own allocation and nothing is copied twice.
        let rgb_length = product("rgb", &[frames, area, 3]).map_err(wrong)?;
        let depth_length = product("depth", &[frames, area]).map_err(wrong)?;
        let mut cameras = Vec::with_capacity(head.cameras.len());
        for camera in head.cameras.into_iter().rev() {
            let recorded = camera
                .has_rgb
                .then(|| take_back(&mut rgb, rgb_length, "rgb"))
                .transpose()
                .map_err(wrong)?;
            let generated = (rollout.is_some() && camera.role == CameraRole::Source)
                .then(|| take_back(&mut generated, rgb_length, "generated_rgb"))
                .transpose()
                .map_err(wrong)?;
            let depth = match camera.depth_range_m {
                None => None,
                Some(range_m) => {
                    let depth_m = take_back(&mut depth, depth_length, "depth").map_err(wrong)?;
                    let origin = origin(origins.depth.pop()).map_err(wrong)?;
                    Some(DepthReference {
                        depth_m,
                        range_m,
                        origin,
                    })
                }
            };
            let CameraHead {
                id,
                role,
                partner,
                intrinsics,
                mount,
                ..
            } = camera;
            cameras.push(ClipCamera {
                id,
                role,
                partner,
                intrinsics,
                mount,
                recorded,
                generated,
                depth,
            });
        }
        cameras.reverse();
        count("rgb beyond its cameras", rgb.len(), 0).map_err(wrong)?;
        count("generated rgb beyond its cameras", generated.len(), 0).map_err(wrong)?;
        count("depth beyond its cameras", depth.len(), 0).map_err(wrong)?;
        count("origins beyond the depth", origins.depth.len(), 0).map_err(wrong)?;
        let tracks = match head.tracks {
            None => None,
            Some(tracks) => {
                let origin = origin(origins.tracks.take()).map_err(wrong)?;
                Some(read_tracks(reader, &tracks, frames as u32, origin)?)
            }
        };
        let clip = Self {
            clip_id: head.clip_id,
            episode_id: head.episode_id,
            layout: head.layout,
            task: head.task,
            calibration_note: head.calibration_note,
            fps: head.fps,
            episode_frames: head.episode_frames,
            source_frames: head.source_frames,
            query_frames: head.query_frames,
            anchor_frame: head.anchor_frame,
            height: head.height,
            width: head.width,
            cameras,
            robot: head.robot,
            tracks,
            rollout,
        };
        clip.check().map_err(wrong)?;
        Ok(clip)
    }
}

/// The origin of this name; not stated where there is none.
pub(super) fn origin(name: Option<String>) -> std::result::Result<ReferenceOrigin, String> {
    name.map_or(Ok(ReferenceOrigin::NotStated), |name| name.parse())
}

/// What a rollout has more, and its images; nothing of a recorded clip.
fn read_rollout(reader: &Reader, head: &Head) -> Result<(Option<Rollout>, Vec<u8>)> {
    if !reader.has(ROLLOUT_HEAD) {
        return Ok((None, Vec::new()));
    }
    let rollout = reader.value(ROLLOUT_HEAD)?;
    let generated = reader.stream::<u8>(&GENERATED, &[head.height, head.width, 3])?;
    Ok((Some(rollout), generated))
}

/// The streams of tracks over so many frames.
pub(super) fn write_tracks(writer: &mut Writer, tracks: &Tracks, frames: u32) -> Result<()> {
    let cameras: Vec<u32> = tracks.camera.iter().map(|camera| camera.0).collect();
    writer.stream(&TRACK_CAMERA, &[], &[([0; 4], cameras.as_slice())])?;
    writer.stream(&TRACK_PIXEL, &[2], &[([0; 4], tracks.pixel.as_slice())])?;
    writer.stream(&TRACK_POSITION, &[frames, 3], &[([0; 4], tracks.position_m.as_slice())])?;
    writer.stream(&TRACK_VISIBLE, &[frames], &[([0; 4], tracks.visible.as_slice())])
}

/// The tracks that a head announces.
pub(super) fn read_tracks(reader: &Reader, head: &TracksHead, frames: u32, origin: ReferenceOrigin) -> Result<Tracks> {
    let read = Tracks {
        anchor_frame: head.anchor_frame,
        camera: reader
            .stream::<u32>(&TRACK_CAMERA, &[])?
            .into_iter()
            .map(CameraIndex)
            .collect(),
        pixel: reader.stream(&TRACK_PIXEL, &[2])?,
        position_m: reader.stream(&TRACK_POSITION, &[frames, 3])?,
        visible: reader.stream(&TRACK_VISIBLE, &[frames])?,
        origin,
    };
    count("tracks", read.camera.len(), head.count as usize).map_err(|what| reader.inconsistent(what))?;
    Ok(read)
}

fn take_back<T>(values: &mut Vec<T>, length: usize, what: &str) -> std::result::Result<Vec<T>, String> {
    let start = values
        .len()
        .checked_sub(length)
        .ok_or_else(|| format!("{what} has too few chunks for its cameras"))?;
    if start == 0 {
        return Ok(std::mem::take(values));
    }
    Ok(values.split_off(start))
}
