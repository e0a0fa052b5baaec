//! A raw-DROID tree of procedural episodes (`docs/droid.md`): six of three laboratories, in both spellings of their
//! folders, each with a peculiarity that recorded episodes have, and published calibrations beside them.

mod trajectory;
mod video;

use std::path::{Path, PathBuf};

use rogs_files::Draft;
use rogs_geometry::{Base, Camera, Pose, euler_xyz_from_rotation};
use rogs_schemas::Intrinsics;
use serde_json::{Map, Value, json};

use crate::cameras::{EpisodeCamera, Mount, Resolution};
use crate::config::SynthConfig;
use crate::episode::{Episode, generate_episode};
use crate::error::{Error, Result};
use crate::robot::{ROBOT_URDF_FILE, Robot, write_robot};
use crate::write::{ROBOT_FOLDER, pretty};

/// Folder of the laboratories inside the tree's folder.
pub const DROID_FOLDER: &str = "droid_raw";
/// Folder of the published calibrations.
pub const DROID_CALIBRATION_FOLDER: &str = "calibration";
/// Image size that DROID's intrinsics belong to, width and height.
const NATIVE: [f64; 2] = [1280.0, 720.0];

/// What is peculiar about an episode of the tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Peculiar {
    /// Nothing: left eyes, stereo videos, intrinsics in the HDF5.
    Whole,
    /// Stereo videos only.
    StereoOnly,
    /// No video of `ext2`.
    MissingCamera,
    /// Intrinsics in the HDF5 are zeros.
    ZeroIntrinsics,
    /// No intrinsics in the HDF5; states are two steps late, one image is missing at the end, two steps are idle.
    Late,
    /// Left eyes only, and no poses in the metadata.
    MonoOnly,
}

/// One episode of the tree, with its truth.
#[derive(Debug)]
pub struct DroidEpisode {
    /// What is peculiar about it.
    pub peculiar: Peculiar,
    /// Its uuid.
    pub uuid: String,
    /// Its folder.
    pub place: PathBuf,
    /// Serials of wrist, ext1 and ext2.
    pub serials: [&'static str; 3],
    /// What was drawn: image k shows frame k.
    pub truth: Episode,
}

/// Laboratory, outcome, day, folder of the time, uuid's time, serials.
struct Place {
    lab: &'static str,
    outcome: &'static str,
    date: &'static str,
    time: &'static str,
    stamp: &'static str,
    serials: [&'static str; 3],
    peculiar: Peculiar,
}

const PLACES: [Place; 6] = [
    Place {
        lab: "AUTOLab",
        outcome: "success",
        date: "2023-07-07",
        time: "Fri_Jul__7_09:42:23_2023",
        stamp: "09h-42m-23s",
        serials: ["18026681", "22008760", "24400334"],
        peculiar: Peculiar::Whole,
    },
    Place {
        lab: "AUTOLab",
        outcome: "failure",
        date: "2023-07-18",
        time: "Tue_Jul_18_10_01_05_2023",
        stamp: "10h-01m-05s",
        serials: ["18026681", "22008760", "24400334"],
        peculiar: Peculiar::StereoOnly,
    },
    Place {
        lab: "IRIS",
        outcome: "success",
        date: "2023-04-20",
        time: "Thu_Apr_20_18:11:36_2023",
        stamp: "18h-11m-36s",
        serials: ["13062452", "20521388", "23404442"],
        peculiar: Peculiar::MissingCamera,
    },
    Place {
        lab: "IRIS",
        outcome: "success",
        date: "2023-05-02",
        time: "Tue_May__2_16_20_44_2023",
        stamp: "16h-20m-44s",
        serials: ["13062452", "20521388", "23404442"],
        peculiar: Peculiar::ZeroIntrinsics,
    },
    Place {
        lab: "TRI",
        outcome: "success",
        date: "2023-11-09",
        time: "Thu_Nov__9_08:15:01_2023",
        stamp: "08h-15m-01s",
        serials: ["16787047", "25047636", "28451778"],
        peculiar: Peculiar::Late,
    },
    Place {
        lab: "TRI",
        outcome: "failure",
        date: "2023-11-21",
        time: "Tue_Nov_21_13_33_59_2023",
        stamp: "13h-33m-59s",
        serials: ["16787047", "25047636", "28451778"],
        peculiar: Peculiar::MonoOnly,
    },
];

/// Settings of the tree's episodes: exact calibration, all images of one size (height, width).
#[must_use]
pub fn droid_config(frames: u32, size: [u32; 2]) -> SynthConfig {
    SynthConfig {
        frames,
        resolution: Resolution {
            wrist: size,
            external: size,
        },
        objects: [3, 6],
        sensor_noise: false,
        anchor_frame: Some(0),
        ..SynthConfig::default()
    }
}

/// Writes the tree: `droid_raw/LAB/OUTCOME/DATE/TIME/`, `robot/`, `calibration/`. Needs the program `ffmpeg` with x264.
///
/// The seeds of the episodes are the six from `first_seed` on.
///
/// # Errors
/// Wrong settings, seeds without a motion, something in the way, or files and videos that cannot be written.
pub fn write_droid(folder: &Path, first_seed: u64, config: &SynthConfig) -> Result<Vec<DroidEpisode>> {
    write_robot(&Robot::new(), &folder.join(ROBOT_FOLDER))?;
    let mut episodes = Vec::new();
    for (place, seed) in PLACES.iter().zip(first_seed..) {
        let truth = generate_episode(config, seed)?;
        let uuid = format!(
            "{}+{:08x}+{}-{}",
            place.lab,
            0x5d05_c5aa_u32 ^ seed as u32,
            place.date,
            place.stamp
        );
        let parts = [place.lab, place.outcome, place.date, place.time];
        let relative: PathBuf = parts.iter().collect();
        let episode = DroidEpisode {
            peculiar: place.peculiar,
            uuid,
            place: folder.join(DROID_FOLDER).join(&relative),
            serials: place.serials,
            truth,
        };
        write_episode(place, &episode)?;
        episodes.push(episode);
    }
    write_published(&folder.join(DROID_CALIBRATION_FOLDER), &episodes)?;
    Ok(episodes)
}

/// URDF of the robot in the tree's folder.
#[must_use]
pub fn droid_robot(folder: &Path) -> PathBuf {
    folder.join(ROBOT_FOLDER).join(ROBOT_URDF_FILE)
}

fn write_episode(place: &Place, episode: &DroidEpisode) -> Result<()> {
    let root = &episode.place;
    if root.exists() {
        return Err(Error::Occupied { path: root.clone() });
    }
    if let Some(day) = root.parent() {
        std::fs::create_dir_all(day).map_err(|source| Error::io(day, source))?;
    }
    let draft = Draft::begin(root)?;
    draft.write("trajectory.h5", &trajectory::encode(episode)?)?;
    let name = format!("metadata_{}.json", episode.uuid);
    draft.write(name, &pretty(&metadata(place, episode))?)?;
    video::write(&draft, episode)?;
    Ok(draft.publish()?)
}

impl DroidEpisode {
    /// Camera-to-base pose of a camera at step 0, by its place in [`crate::CAMERA_NAMES`].
    pub(crate) fn at_step_0(&self, camera: usize) -> Pose<Base, Camera> {
        self.truth.base_from_camera(camera, 0)
    }

    /// The frame whose state is in a row of the trajectory.
    pub(crate) fn state_of_row(&self, row: usize) -> usize {
        row.saturating_sub(self.late())
    }

    /// Steps by which the states are late.
    pub(crate) fn late(&self) -> usize {
        if self.peculiar == Peculiar::Late { 2 } else { 0 }
    }
}

/// `[x, y, z, a, b, c]` as DROID writes poses.
pub(crate) fn six<A, B>(pose: &Pose<A, B>) -> [f64; 6] {
    let [x, y, z] = pose.translation.to_array();
    let [a, b, c] = euler_xyz_from_rotation(&pose.rotation);
    [x, y, z, a, b, c]
}

/// fx, fy, cx, cy at 1280 x 720 with integer pixel centres.
pub(crate) fn native_lens(camera: &EpisodeCamera) -> Intrinsics {
    let lens = &camera.lens;
    let (sx, sy) = (NATIVE[0] / f64::from(lens.width), NATIVE[1] / f64::from(lens.height));
    let Intrinsics { fx, fy, cx, cy } = lens.intrinsics;
    Intrinsics {
        fx: fx * sx,
        fy: fy * sy,
        cx: cx * sx - 0.5,
        cy: cy * sy - 0.5,
    }
}

fn metadata(place: &Place, episode: &DroidEpisode) -> Value {
    let Place {
        lab,
        outcome,
        date,
        time,
        stamp,
        ..
    } = place;
    let folder = format!("{outcome}/{date}/{time}");
    let mut entries = Map::new();
    let mut put = |key: &str, value: Value| {
        entries.insert(key.to_owned(), value);
    };
    put("uuid", json!(episode.uuid));
    put("lab", json!(lab));
    put("user", json!("synth"));
    put("user_id", json!(episode.uuid.split('+').nth(1)));
    put("date", json!(date));
    put("timestamp", json!(format!("{date}-{stamp}")));
    put("hdf5_path", json!(format!("{folder}/trajectory.h5")));
    put("building", json!("none"));
    put("scene_id", json!(episode.truth.seed));
    put("success", json!(*outcome == "success"));
    put("robot_serial", json!("panda-synth"));
    put("droid_version", json!("1.3"));
    put("current_task", json!(episode.truth.task()));
    put("trajectory_length", json!(episode.truth.frame_count()));
    for (index, (name, serial)) in ["wrist", "ext1", "ext2"].into_iter().zip(episode.serials).enumerate() {
        put(&format!("{name}_cam_serial"), json!(serial));
        let pose = match episode.peculiar {
            Peculiar::MonoOnly => [0.0; 6],
            _ => six(&episode.at_step_0(index)),
        };
        put(&format!("{name}_cam_extrinsics"), json!(pose));
        put(
            &format!("{name}_mp4_path"),
            json!(format!("{folder}/recordings/MP4/{serial}.mp4")),
        );
    }
    Value::Object(entries)
}

/// The files of the annotation release, in both forms of intrinsics, and a factory calibration of every camera.
fn write_published(folder: &Path, episodes: &[DroidEpisode]) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|source| Error::io(folder, source))?;
    let by_uuid = |entry: &dyn Fn(&DroidEpisode) -> Value| -> Value {
        episodes
            .iter()
            .map(|episode| (episode.uuid.clone(), entry(episode)))
            .collect::<Map<_, _>>()
            .into()
    };
    let serials = |episode: &DroidEpisode| {
        let [wrist, ext1, ext2] = episode.serials;
        json!({"wrist_cam_serial": wrist, "ext1_cam_serial": ext1, "ext2_cam_serial": ext2})
    };
    let paths = |episode: &DroidEpisode| {
        let parts: Vec<_> = episode
            .place
            .iter()
            .rev()
            .take(4)
            .map(|part| part.to_string_lossy())
            .collect();
        json!(parts.iter().rev().map(AsRef::as_ref).collect::<Vec<&str>>().join("/"))
    };
    let intrinsics = |episode: &DroidEpisode| -> Value {
        let lens = |(index, serial): (usize, &str)| {
            let Intrinsics { fx, fy, cx, cy } = native_lens(&episode.truth.cameras[index]);
            let four = json!([fx, cx, fy, cy]);
            let entry = match index {
                0 => json!({"cameraMatrix": four, "width": 1280, "height": 720}),
                _ => four,
            };
            (serial.to_owned(), entry)
        };
        episode
            .serials
            .into_iter()
            .enumerate()
            .map(lens)
            .collect::<Map<_, _>>()
            .into()
    };
    let poses = |episode: &DroidEpisode| -> Value {
        let pose = |index: usize| (episode.serials[index].to_owned(), json!(six(&episode.at_step_0(index))));
        let mut entry: Map<String, Value> = [pose(1), pose(2)].into_iter().collect();
        entry.insert("relative_path".to_owned(), paths(episode));
        entry.into()
    };
    let files = [
        ("camera_serials.json", by_uuid(&serials)),
        ("episode_id_to_path.json", by_uuid(&paths)),
        ("intrinsics.json", by_uuid(&intrinsics)),
        ("cam2base_extrinsic_superset.json", by_uuid(&poses)),
    ];
    for (name, value) in files {
        rogs_files::write_bytes(&folder.join(name), &pretty(&value)?)?;
    }
    for episode in episodes {
        for (index, serial) in episode.serials.iter().enumerate() {
            let conf = factory(&episode.truth.cameras[index], &episode.truth.cameras[index + 3]);
            rogs_files::write_bytes(&folder.join(format!("SN{serial}.conf")), conf.as_bytes())?;
        }
    }
    Ok(())
}

/// A factory calibration: values before rectification, 1 % longer.
fn factory(left: &EpisodeCamera, right: &EpisodeCamera) -> String {
    let Intrinsics { fx, fy, cx, cy } = native_lens(left);
    let mount = |camera: &EpisodeCamera| match camera.mount {
        Mount::Fixed(pose) => pose.translation,
        Mount::Flange(pose) => pose.translation,
    };
    let millimetres = 1000.0 * (mount(right) - mount(left)).length();
    let eye = |name: &str| {
        format!(
            "[{name}_CAM_HD]\nfx={}\nfy={}\ncx={cx}\ncy={cy}\n\n",
            1.01 * fx,
            1.01 * fy
        )
    };
    format!(
        "{}{}[STEREO]\nBaseline={millimetres}\nTY=0\nTZ=0\n",
        eye("LEFT"),
        eye("RIGHT")
    )
}
