//! Caches of PointWorld as references: a cache made of procedural episodes goes in, the exact truth comes out; and every
//! way of getting one wrong is told by name.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod wrong;

use std::path::{Path, PathBuf};

use rogs_ingest::{Params, PointWorldFiles, list_references, read_joined_clip};
use rogs_schemas::EpisodeFrame;
use rogs_schemas::records::clip::{CameraMount, Clip, ClipCamera};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_synth::{
    EPISODES_FOLDER, Episode, Mount, Resolution, SynthConfig, generate_episode, write_dataset, write_pointworld,
    write_pointworld_shard,
};
use serde_json::Value;

pub(crate) const SEED: u64 = 11;
/// Height and width of the images.
const SIZE: [u32; 2] = [42, 70];

/// A data set without references and with noisy poses, and a cache that has both.
pub(crate) struct Cached {
    folder: tempfile::TempDir,
    pub(crate) episode: Episode,
}

impl Cached {
    pub(crate) fn new() -> Self {
        let config = SynthConfig {
            resolution: Resolution {
                wrist: SIZE,
                external: SIZE,
            },
            calibration_noise: Some([0.01, 0.02]),
            ..SynthConfig::default()
        };
        let folder = tempfile::tempdir().unwrap();
        write_dataset(folder.path(), 1, SEED, &config).unwrap();
        let episode = generate_episode(&config, SEED).unwrap();
        write_pointworld(&folder.path().join("cache"), &episode).unwrap();
        let cached = Self { folder, episode };
        cached.without_references();
        cached
    }

    /// Takes depth and tracks out of the episode's description: what a clip has of them is then of the cache.
    fn without_references(&self) {
        let path = self.root().join("episode.json");
        let mut text: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        text.as_object_mut().unwrap().remove("tracks");
        for camera in text["cameras"].as_array_mut().unwrap() {
            camera.as_object_mut().unwrap().remove("depth");
        }
        std::fs::write(&path, text.to_string()).unwrap();
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn root(&self) -> PathBuf {
        self.path(EPISODES_FOLDER).join(self.episode.id())
    }

    /// The files of the cache, as the listing finds them.
    pub(crate) fn files(&self) -> PointWorldFiles {
        let cache = self.path("cache");
        let found = list_references(&cache).unwrap();
        assert_eq!(found.keys().collect::<Vec<_>>(), [&self.episode.id()]);
        let file = |role: &str| found[&self.episode.id()].get(role).map(|file| cache.join(file));
        PointWorldFiles {
            cameras: file("pointworld-cameras"),
            depth: file("pointworld-depth"),
            flows: file("pointworld-flows"),
        }
    }

    pub(crate) fn params(&self) -> Params {
        Params {
            height: SIZE[0],
            width: SIZE[1],
            ..Params::default()
        }
    }

    pub(crate) fn read(&self, files: &PointWorldFiles) -> Result<(Clip, Vec<String>), String> {
        read_joined_clip(&self.root(), None, files, &self.params(), "clip").map_err(|error| {
            let hint = error.hint.as_deref().unwrap_or_default();
            format!("{error} | {hint}").replace(&self.path("").display().to_string(), "")
        })
    }
}

fn camera<'a>(clip: &'a Clip, id: &str) -> &'a ClipCamera {
    clip.cameras.iter().find(|camera| camera.id == id).unwrap()
}

#[test]
fn poses_depth_and_tracks_are_those_of_the_truth() {
    let cached = Cached::new();
    let (clip, warnings) = cached.read(&cached.files()).unwrap();
    assert_eq!(clip.episode_frames.first(), Some(&EpisodeFrame(7)));
    // Poses: the episode's own are off by centimetres, the refined ones are those of the images.
    for (index, id) in [(1, "ext1"), (2, "ext2")] {
        let Mount::Fixed(truth) = &cached.episode.cameras[index].mount else {
            unreachable!()
        };
        let CameraMount::Fixed { base_from_camera } = &camera(&clip, id).mount else {
            panic!("{id}")
        };
        let truth = truth.to_rigid();
        let off = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off(&truth.translation, &base_from_camera.translation) < 1e-6);
        assert!(off(&truth.rotation, &base_from_camera.rotation) < 1e-6);
        let Mount::Fixed(recorded) = &cached.episode.cameras[index].recorded_mount else {
            unreachable!()
        };
        assert!(
            off(&truth.translation, &recorded.to_rigid().translation) > 1e-3,
            "the noise does nothing"
        );
    }
    assert!(
        clip.calibration_note
            .contains("poses of 2 external cameras refined by PointWorld (loss 0.01)")
    );
    // Depth: half a millimetre of rounding.
    for (index, id) in [(0, "wrist"), (1, "ext1"), (2, "ext2")] {
        let depth = camera(&clip, id).depth.as_ref().unwrap();
        assert_eq!(depth.origin, ReferenceOrigin::Exact);
        let area = (SIZE[0] * SIZE[1]) as usize;
        for (at, map) in depth.depth_m.chunks_exact(area).enumerate() {
            let truth = &cached.episode.render_cameras(7 + at, &[0, 1, 2])[index].depth_m;
            for (cached, truth) in map.iter().zip(truth) {
                assert!(cached.is_nan() == truth.is_nan(), "{id}");
                assert!(
                    truth.is_nan() || (cached - truth).abs() <= 0.000_501,
                    "{id}: {cached} {truth}"
                );
            }
        }
    }
    // Tracks: canonical frames are the even ones, so that a clip from 7 on begins with one frame without.
    let tracks = clip.tracks.as_ref().unwrap();
    assert_eq!((tracks.anchor_frame.0, clip.anchor_frame.0), (1, 1));
    let count = tracks.camera.len();
    assert!(count > 50, "{count} tracks");
    for track in 0..count {
        for frame in 0..17 {
            let position = &tracks.position_m[3 * (17 * track + frame)..][..3];
            // Canonical frames 4 to 10 of the clip 0:11.
            let known = frame % 2 == 1 && frame <= 13;
            assert_eq!(position[0].is_nan(), !known, "track {track}, frame {frame}");
            assert!(position[0].is_nan() || position.iter().all(|value| value.abs() < 5.0));
        }
    }
    assert!(
        warnings
            .iter()
            .any(|warning| warning.contains("tracks are known at 7 of the 17 frames")),
        "{warnings:?}"
    );
}

#[test]
fn tracks_follow_the_surface_that_is_seen() {
    // A point at its anchor pixel has the depth that the image has there. Points that have not moved since their pixel was
    // drawn are at its centre, where only half precision is left; the others meet a slanted surface half a pixel off.
    let cached = Cached::new();
    let (clip, _) = cached.read(&cached.files()).unwrap();
    let tracks = clip.tracks.as_ref().unwrap();
    let mut errors: Vec<f64> = Vec::new();
    for track in 0..tracks.camera.len() {
        let camera = &clip.cameras[tracks.camera[track].at()];
        let CameraMount::Fixed { base_from_camera: pose } = &camera.mount else {
            panic!()
        };
        let at = 17 * track + tracks.anchor_frame.at();
        if tracks.visible[at] == 0 {
            continue;
        }
        let point: Vec<f64> = tracks.position_m[3 * at..][..3]
            .iter()
            .map(|&value| f64::from(value))
            .collect();
        // Third row of camera-from-base: the third column of the rotation.
        let z: f64 = (0..3)
            .map(|axis| pose.rotation[3 * axis + 2] * (point[axis] - pose.translation[axis]))
            .sum();
        let pixel = [0, 1].map(|axis| (tracks.pixel[2 * track + axis] + 0.5).floor() as usize);
        let map = &camera.depth.as_ref().unwrap().depth_m[tracks.anchor_frame.at() * (42 * 70)..];
        errors.push((z - f64::from(map[pixel[1] * 70 + pixel[0]])).abs());
    }
    errors.sort_by(f64::total_cmp);
    let (quarter, half) = (errors[errors.len() / 4], errors[errors.len() / 2]);
    assert!(
        errors.len() > 50 && quarter < 0.0015 && half < 0.01,
        "{} errors, {quarter}, {half}",
        errors.len()
    );
}

#[test]
fn a_shard_gives_the_same_tracks() {
    let cached = Cached::new();
    let shard = cached.path("cache/shards/000000.tar");
    std::fs::create_dir_all(shard.parent().unwrap()).unwrap();
    write_pointworld_shard(&shard, &cached.episode).unwrap();
    // A file of tracks of its own comes first.
    let files = cached.files();
    assert!(files.flows.as_ref().unwrap().ends_with("synth-00000011_flows.h5"));
    let (own, _) = cached.read(&files).unwrap();
    std::fs::remove_file(files.flows.unwrap()).unwrap();
    let files = cached.files();
    assert_eq!(files.flows.as_ref(), Some(&shard));
    let (shared, warnings) = cached.read(&files).unwrap();
    let (own, shared) = (own.tracks.unwrap(), shared.tracks.unwrap());
    // What made them stands in the one and not in the other.
    assert_eq!(
        (own.origin, shared.origin),
        (ReferenceOrigin::Exact, ReferenceOrigin::PointTracker)
    );
    // NaN is where no position is known.
    let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&own.position_m), bits(&shared.position_m));
    assert_eq!(
        (own.anchor_frame, own.camera, own.pixel, own.visible),
        (shared.anchor_frame, shared.camera, shared.pixel, shared.visible)
    );
    assert!(
        warnings.iter().any(|warning| warning.contains("at 7 of the 17 frames")),
        "{warnings:?}"
    );
}

/// Copies a file of the cache to a place beside it and hands its bytes to `change`.
pub(crate) fn changed(path: &Path, change: impl FnOnce(&mut Vec<u8>)) -> PathBuf {
    let mut bytes = std::fs::read(path).unwrap();
    change(&mut bytes);
    let cache = path.ancestors().find(|path| path.ends_with("cache")).unwrap();
    let folder = cache.with_file_name("changed");
    std::fs::create_dir_all(&folder).unwrap();
    let copy = folder.join(path.file_name().unwrap());
    std::fs::write(&copy, bytes).unwrap();
    copy
}

/// Camera-to-base of a fixed camera, rows.
pub(crate) fn camera_pose(cached: &Cached, index: usize) -> [[f64; 4]; 4] {
    let Mount::Fixed(pose) = &cached.episode.cameras[index].mount else {
        panic!("not fixed")
    };
    rows(&pose.to_matrix4())
}

/// Base-to-camera of a fixed camera, rows.
pub(crate) fn inverse_pose(cached: &Cached, index: usize) -> [[f64; 4]; 4] {
    let Mount::Fixed(pose) = &cached.episode.cameras[index].mount else {
        panic!("not fixed")
    };
    rows(&pose.inverse().to_matrix4())
}

fn rows(matrix: &[f64; 16]) -> [[f64; 4]; 4] {
    [0, 4, 8, 12].map(|row| [matrix[row], matrix[row + 1], matrix[row + 2], matrix[row + 3]])
}

#[test]
fn caches_in_the_place_of_episodes_are_refused_by_name() {
    let cached = Cached::new();
    let error = rogs_ingest::list_episodes(&cached.path("cache")).unwrap_err();
    assert!(
        error.message.contains("caches of PointWorld and no episodes") && error.hint.unwrap().contains("`pointworld`"),
        "{}",
        error.message
    );
}
