//! Procedural episodes as a cache of PointWorld (`docs/spec/data.md` section 3): refined cameras, depth and tracks of an
//! episode, exact but for how the format rounds them (millimetres, half precision).

use std::path::Path;

use half::f16;
use rayon::prelude::*;
use rogs_arrays::le_bytes;
use rogs_schemas::records::origin::ReferenceOrigin;
use serde_json::json;

use crate::cameras::{CAMERA_NAMES, Mount};
use crate::episode::Episode;
use crate::error::{Error, Result};
use crate::hdf5::{Hdf5Group, Hdf5Kind};
use crate::robot::FINGER_CLOSED;

/// Folders of a cache, for tracks, depth and cameras.
pub const POINTWORLD_FOLDERS: [&str; 3] = ["flows", "depth_320x180", "cameras"];
/// Recorded frames of a canonical frame.
const CANONICAL_STEP: usize = 2;
/// Canonical frames of a clip, and from the start of one to the next.
const CLIP: (usize, usize) = (11, 5);
/// The external cameras, which alone have tracks.
const EXTERNAL: [usize; 2] = [1, 2];

/// Writes the files of an episode below a folder. Cameras have their names for serials.
///
/// # Errors
/// When a file cannot be written.
pub fn write_pointworld(folder: &Path, episode: &Episode) -> Result<()> {
    let id = episode.id();
    let [flows, depth, cameras] = POINTWORLD_FOLDERS.map(|name| folder.join(name));
    for folder in [&flows, &depth, &cameras] {
        std::fs::create_dir_all(folder).map_err(|source| Error::io(folder, source))?;
    }
    rogs_files::write_bytes(&depth.join(format!("{id}_depth.h5")), &depth_file(episode).file())?;
    rogs_files::write_bytes(&flows.join(format!("{id}_flows.h5")), &flows_file(episode).file())?;
    let mut text = serde_json::to_vec_pretty(&cameras_file(episode)).map_err(Error::json)?;
    text.push(b'\n');
    rogs_files::write_bytes(&cameras.join(format!("{id}_cameras.json")), &text)?;
    Ok(())
}

/// Writes the tracks of an episode as a WebDataset shard, as PointWorld's own converter makes one of its files of tracks.
///
/// # Errors
/// When the file cannot be written.
pub fn write_pointworld_shard(path: &Path, episode: &Episode) -> Result<()> {
    Ok(rogs_files::write_bytes(path, &shard(episode))?)
}

/// When a frame was taken, whole milliseconds.
fn time_ms(episode: &Episode, frame: usize) -> i64 {
    (1000.0 * frame as f64 / episode.config.fps).round() as i64
}

/// Millimetres as little-endian u16, 0 where nothing is seen.
fn millimetres(depth_m: &[f32]) -> Vec<u8> {
    let one = |&metres: &f32| {
        let millimetres = (1000.0 * f64::from(metres)).round();
        let kept = (1.0..=65535.0).contains(&millimetres).then_some(millimetres as u16);
        kept.unwrap_or(0).to_le_bytes()
    };
    depth_m.iter().flat_map(one).collect()
}

/// Base-to-camera of a fixed camera, row-major, as it truly stands.
fn base_to_camera(episode: &Episode, camera: usize) -> Option<[f64; 16]> {
    match &episode.cameras[camera].mount {
        Mount::Fixed(pose) => Some(pose.inverse().to_matrix4()),
        Mount::Flange(_) => None,
    }
}

fn depth_file(episode: &Episode) -> Hdf5Group {
    let frames = episode.frame_count();
    let cameras = [0, 1, 2];
    let draw = |frame: usize| episode.render_cameras(frame, &cameras);
    let drawn: Vec<_> = (0..frames).into_par_iter().map(draw).collect();
    let mut root = Hdf5Group::default();
    let metadata = root.group("metadata");
    metadata
        .text("uuid", &episode.id())
        .integer("camera_count", 3)
        .truth("write_complete", true);
    metadata.text("origin", ReferenceOrigin::Exact.name());
    let times: Vec<u8> = (0..frames)
        .flat_map(|frame| time_ms(episode, frame).to_le_bytes())
        .collect();
    for camera in cameras {
        let kind = if camera == 0 { "wrist" } else { "ext" };
        let group = root.group(&format!("{}+{kind}", CAMERA_NAMES[camera]));
        let maps: Vec<u8> = drawn
            .iter()
            .flat_map(|views| millimetres(&views[camera].depth_m))
            .collect();
        let lens = &episode.cameras[camera].lens;
        let shape = [frames, lens.height as usize, lens.width as usize];
        group.dataset("depth", &shape, Hdf5Kind::U16, maps, Some(true));
        group.dataset("timestamps", &[frames], Hdf5Kind::I64, times.clone(), Some(true));
    }
    root
}

/// First canonical frames of the clips of an episode.
fn clip_starts(episode: &Episode) -> impl Iterator<Item = usize> {
    let canonical = episode.frame_count().div_ceil(CANONICAL_STEP);
    (0..canonical)
        .step_by(CLIP.1)
        .filter(move |start| start + CLIP.0 <= canonical)
}

fn flows_file(episode: &Episode) -> Hdf5Group {
    let canonical = episode.frame_count().div_ceil(CANONICAL_STEP);
    let clock: Vec<i64> = (0..canonical)
        .map(|frame| time_ms(episode, CANONICAL_STEP * frame))
        .collect();
    let mut root = Hdf5Group::default();
    root.text("uuid", &episode.id()).text("domain", "droid");
    root.text("canonical_timestamps", &format!("{clock:?}"));
    root.text("origin", ReferenceOrigin::Exact.name());
    for start in clip_starts(episode) {
        let clip = root.group(&format!("{start}:{}", start + CLIP.0));
        clip.integer("demo_length", CLIP.0 as i64);
        for array in clip_arrays(episode, start) {
            let group = match &array.camera {
                Some(camera) => clip.group(camera),
                None => &mut *clip,
            };
            group.dataset(array.name, &array.shape, array.kind, array.bytes, Some(true));
        }
    }
    root
}

/// The tracks of an episode as a WebDataset shard: a tar archive with a sample a clip.
fn shard(episode: &Episode) -> Vec<u8> {
    let mut out = Vec::new();
    for start in clip_starts(episode) {
        let key = format!("{}-{start}:{}", episode.id(), start + CLIP.0);
        for array in clip_arrays(episode, start) {
            let camera = array
                .camera
                .as_ref()
                .map_or(String::new(), |camera| format!("{camera}_"));
            tar_file(&mut out, &format!("{key}.{camera}{}.npy", array.name), &array.npy());
        }
    }
    out.resize(out.len() + 1024, 0);
    out
}

/// Appends a file to an archive. Names have at most 100 bytes here.
fn tar_file(out: &mut Vec<u8>, name: &str, bytes: &[u8]) {
    let mut header = vec![0_u8; 512];
    header[..name.len()].copy_from_slice(name.as_bytes());
    let mut put = |at: usize, text: String| header[at..at + text.len()].copy_from_slice(text.as_bytes());
    put(100, "0000644\0".to_owned());
    put(124, format!("{:011o}\0", bytes.len()));
    put(136, format!("{:011o}\0", 0));
    put(148, " ".repeat(8));
    put(156, "0".to_owned());
    put(257, "ustar\x0000".to_owned());
    let sum: u32 = header.iter().map(|&byte| u32::from(byte)).sum();
    header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
    out.extend(header);
    out.extend(bytes);
    out.resize(out.len().next_multiple_of(512), 0);
}

/// An array of a clip.
struct ClipArray {
    /// Group of the camera it is of.
    camera: Option<String>,
    name: &'static str,
    shape: Vec<usize>,
    kind: Hdf5Kind,
    bytes: Vec<u8>,
}

impl ClipArray {
    /// As a numpy file.
    fn npy(&self) -> Vec<u8> {
        let kind = match self.kind {
            Hdf5Kind::Truth => "|b1",
            Hdf5Kind::U16 => "<u2",
            Hdf5Kind::I64 => "<i8",
            Hdf5Kind::F16 => "<f2",
            Hdf5Kind::F32 => "<f4",
            Hdf5Kind::F64 => "<f8",
        };
        let shape: Vec<String> = self.shape.iter().map(|side| format!("{side},")).collect();
        let text = format!(
            "{{'descr': '{kind}', 'fortran_order': False, 'shape': ({}), }}",
            shape.join(" ")
        );
        let padded = (10 + text.len() + 1).next_multiple_of(64) - 10;
        let mut bytes = b"\x93NUMPY\x01\0".to_vec();
        bytes.extend((padded as u16).to_le_bytes());
        bytes.extend(text.as_bytes());
        bytes.resize(10 + padded - 1, b' ');
        bytes.push(b'\n');
        bytes.extend(&self.bytes);
        bytes
    }
}

/// What a clip holds that starts at this canonical frame.
fn clip_arrays(episode: &Episode, start: usize) -> Vec<ClipArray> {
    let recorded: Vec<usize> = (start..start + CLIP.0).map(|frame| CANONICAL_STEP * frame).collect();
    let states: Vec<_> = recorded.iter().map(|&frame| &episode.states[frame]).collect();
    let joints: Vec<f32> = states
        .iter()
        .flat_map(|state| state.joints)
        .map(|joint| joint as f32)
        .collect();
    let gripper: Vec<f32> = states
        .iter()
        .map(|state| (FINGER_CLOSED * state.gripper) as f32)
        .collect();
    let own = |name, shape: &[usize], bytes| ClipArray {
        camera: None,
        name,
        shape: shape.to_vec(),
        kind: Hdf5Kind::F32,
        bytes,
    };
    let mut arrays = vec![
        own("joint_positions", &[CLIP.0, joints.len() / CLIP.0], le_bytes(&joints)),
        own("gripper_positions", &[CLIP.0], le_bytes(&gripper)),
    ];
    let mut anchored = episode.clone();
    anchored.config.anchor_frame = Some(recorded[0] as u32);
    let views = episode.render_cameras(recorded[0], &[0, 1, 2]);
    let tracks = anchored.tracks(&views);
    for camera in EXTERNAL {
        let own: Vec<usize> = (0..tracks.camera.len())
            .filter(|&at| tracks.camera[at] == camera as u32)
            .collect();
        let frames = episode.frame_count();
        let (mut flows, mut visible) = (Vec::new(), Vec::new());
        for &frame in &recorded {
            for &track in &own {
                let at = track * frames + frame;
                let position = &tracks.position_m[3 * at..3 * at + 3];
                flows.extend(position.iter().flat_map(|&value| f16::from_f32(value).to_le_bytes()));
                visible.push(tracks.visible[at]);
            }
        }
        let points = own.len();
        let mut add = |name, shape: &[usize], kind, bytes| {
            arrays.push(ClipArray {
                camera: Some(format!("camera_{}_ext", CAMERA_NAMES[camera])),
                name,
                shape: shape.to_vec(),
                kind,
                bytes,
            });
        };
        let valid = vec![1; visible.len()];
        add("scene_flows", &[CLIP.0, points, 3], Hdf5Kind::F16, flows);
        add("scene_visibility", &[CLIP.0, points], Hdf5Kind::Truth, visible);
        add("scene_depth_valid_mask", &[CLIP.0, points], Hdf5Kind::Truth, valid);
        let lens = &episode.cameras[camera].lens;
        let maps = millimetres(&views[camera].depth_m);
        add(
            "initial_depth",
            &[lens.height as usize, lens.width as usize],
            Hdf5Kind::U16,
            maps,
        );
        let k = lens.intrinsics;
        // Pixel centres at whole numbers.
        let intrinsic = [k.fx, 0.0, k.cx - 0.5, 0.0, k.fy, k.cy - 0.5, 0.0, 0.0, 1.0].map(|value| value as f32);
        add("intrinsic", &[3, 3], Hdf5Kind::F32, le_bytes(&intrinsic));
        let extrinsic = base_to_camera(episode, camera)
            .unwrap_or_default()
            .map(|value| value as f32);
        add("extrinsic", &[4, 4], Hdf5Kind::F32, le_bytes(&extrinsic));
    }
    arrays
}

fn cameras_file(episode: &Episode) -> serde_json::Value {
    let mut file = json!({
        "uuid": episode.id(),
        "scene_path": episode.id(),
        "optimization_success": true,
        "optimization_summary": { "final_loss": 0.01 },
    });
    for camera in EXTERNAL {
        let rows = base_to_camera(episode, camera).unwrap_or_default();
        let rows: Vec<&[f64]> = rows.chunks_exact(4).collect();
        file[CAMERA_NAMES[camera]] = json!({ "optimized_extrinsics": rows });
    }
    file
}
