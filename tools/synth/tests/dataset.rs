//! Datasets on disk: same bytes for any number of threads, resumed where they stopped, never half an episode.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::collections::BTreeMap;
use std::path::Path;

use rogs_schemas::episode::{EPISODE_FILE, Episode, EpisodeMount};
use rogs_synth::{DATASET_FILE, EPISODES_FOLDER, Error, Resolution, SynthConfig, write_dataset};

fn tiny() -> SynthConfig {
    SynthConfig {
        frames: 6,
        resolution: Resolution {
            wrist: [44, 80],
            external: [22, 40],
        },
        tracks_per_camera: [12, 6],
        ..SynthConfig::default()
    }
}

fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap()
        .install(work)
}

fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(place) = open.pop() {
        for entry in std::fs::read_dir(place).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                files.insert(
                    path.strip_prefix(folder).unwrap().display().to_string(),
                    std::fs::read(&path).unwrap(),
                );
            }
        }
    }
    files
}

#[test]
fn bytes_do_not_depend_on_threads_or_on_an_interruption() {
    let folder = tempfile::tempdir().unwrap();
    let (one, three, again) = (
        folder.path().join("one"),
        folder.path().join("three"),
        folder.path().join("again"),
    );
    with_threads(1, || write_dataset(&one, 2, 40, &tiny())).unwrap();
    with_threads(3, || write_dataset(&three, 2, 40, &tiny())).unwrap();
    // An earlier run that was killed: one episode done, half of another.
    with_threads(2, || write_dataset(&again, 1, 40, &tiny())).unwrap();
    let half = again.join(EPISODES_FOLDER).join(".synth-00000041.4294967295.tmp");
    std::fs::create_dir_all(half.join("wrist")).unwrap();
    std::fs::write(half.join("wrist/000099.png"), b"half").unwrap();
    // Of a writer elsewhere, so long ago that it is gone.
    let long_ago = std::time::UNIX_EPOCH + std::time::Duration::from_secs(1);
    std::fs::File::open(&half).unwrap().set_modified(long_ago).unwrap();
    let summary = with_threads(2, || write_dataset(&again, 2, 40, &tiny())).unwrap();
    assert_eq!((summary.written, summary.episodes.len()), (1, 2));
    let expected = contents(&one);
    assert!(expected.len() > 2 * 6 * 6);
    assert!(expected.contains_key(DATASET_FILE));
    assert!(expected == contents(&three), "threads change bytes");
    assert!(expected == contents(&again), "resuming changes bytes");
}

#[test]
fn the_description_has_six_cameras_with_images_of_the_right_size() {
    let folder = tempfile::tempdir().unwrap();
    let summary = write_dataset(folder.path(), 1, 3, &tiny()).unwrap();
    let place = &summary.episodes[0];
    let text = std::fs::read_to_string(place.join(EPISODE_FILE)).unwrap();
    let episode: Episode = serde_json::from_str(&text).unwrap();
    assert_eq!(episode.frame_count, 6);
    assert_eq!(episode.cameras.len(), 6);
    assert!(matches!(episode.cameras[0].mount, EpisodeMount::HandEye { .. }));
    assert!(place.join(episode.robot.model.unwrap()).exists());
    for camera in &episode.cameras {
        let size = if camera.id.starts_with("wrist") {
            (80, 44)
        } else {
            (40, 22)
        };
        assert_eq!((camera.width, camera.height), size);
        let images = place.join(camera.images.as_ref().unwrap());
        let image = image::open(images.join("000005.png")).unwrap();
        assert_eq!((image.width(), image.height()), size);
        let depth = std::fs::read(place.join(&camera.depth.as_ref().unwrap().path)).unwrap();
        assert_eq!(
            (depth.len() - 128) % 64,
            (4 * 6 * size.0 as usize * size.1 as usize) % 64
        );
    }
    let rows = std::fs::read_to_string(place.join("joints.csv")).unwrap();
    assert_eq!(rows.lines().count(), 7);
}

#[test]
fn other_settings_in_the_same_folder_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    write_dataset(folder.path(), 1, 3, &tiny()).unwrap();
    let other = SynthConfig {
        sensor_noise: false,
        ..tiny()
    };
    assert!(matches!(
        write_dataset(folder.path(), 1, 3, &other),
        Err(Error::Occupied { .. })
    ));
}

#[test]
fn wrong_settings_are_named() {
    let folder = tempfile::tempdir().unwrap();
    for (config, name) in [
        (SynthConfig { frames: 0, ..tiny() }, "frames"),
        (
            SynthConfig {
                fps: f64::NAN,
                ..tiny()
            },
            "fps",
        ),
        (
            SynthConfig {
                objects: [5, 2],
                ..tiny()
            },
            "objects",
        ),
        (
            SynthConfig {
                anchor_frame: Some(6),
                ..tiny()
            },
            "anchor_frame",
        ),
        (
            SynthConfig {
                calibration_noise: Some([f64::NAN, 0.0]),
                ..tiny()
            },
            "calibration_noise",
        ),
    ] {
        let error = write_dataset(folder.path(), 1, 0, &config).unwrap_err();
        assert!(error.to_string().starts_with(name), "{error}");
    }
}
