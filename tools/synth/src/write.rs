//! Episodes on disk, in our own folder format (`docs/episode-format.md`).

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use rayon::prelude::*;
use rogs_arrays::{Scalar, le_bytes, npy_bytes, npy_header};
use rogs_files::{Draft, DraftFile};
use rogs_schemas::EpisodeFrame;
use rogs_schemas::episode as layout;
use rogs_schemas::records::clip::PROCEDURAL_NOTE;
use rogs_schemas::records::origin::ReferenceOrigin;
use schemars::JsonSchema;
use serde::Serialize;

use crate::cameras::{CAMERA_NAMES, CAMERAS, EpisodeCamera, Mount};
use crate::config::SynthConfig;
use crate::episode::{Episode, generate_episode};
use crate::error::{Error, Result};
use crate::render::View;
use crate::robot::{ARM_JOINT_NAMES, FLANGE_LINK, ROBOT_URDF_FILE, Robot, write_robot};
use crate::tracks::EpisodeTracks;

/// Name of the file that says what settings a dataset was made with.
pub const DATASET_FILE: &str = "dataset.json";

/// Folder of the robot model inside a dataset.
pub const ROBOT_FOLDER: &str = "robot";

/// Folder of the episodes inside a dataset.
pub const EPISODES_FOLDER: &str = "episodes";

/// What a dataset holds.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct DatasetSummary {
    /// URDF of the robot.
    pub robot: PathBuf,
    /// Folders of the episodes, in the order of their seeds.
    pub episodes: Vec<PathBuf>,
    /// How many of them this call made; the others were there.
    pub written: usize,
    /// Frames of an episode.
    pub frames: u32,
}

/// Description of a dataset as it lies beside it.
#[derive(Serialize)]
struct Dataset<'a> {
    generator: &'static str,
    version: &'static str,
    first_seed: u64,
    episodes: u32,
    config: &'a SynthConfig,
}

/// Writes a dataset: `robot/`, `episodes/synth-SEED/` for `episodes` seeds from `first_seed` on, `dataset.json`.
///
/// Episodes that are there are left alone when they were made with the same settings; each appears whole or not at all.
///
/// # Errors
/// Wrong settings, seeds without a motion, files that cannot be written, or other settings in the folder.
pub fn write_dataset(folder: &Path, episodes: u32, first_seed: u64, config: &SynthConfig) -> Result<DatasetSummary> {
    write_dataset_with(folder, episodes, first_seed, config, &|_| {})
}

/// [`write_dataset`] that calls `progress` with the folder of each episode when it is done.
///
/// # Errors
/// As [`write_dataset`].
pub fn write_dataset_with(
    folder: &Path,
    episodes: u32,
    first_seed: u64,
    config: &SynthConfig,
    progress: &(dyn Fn(&Path) + Sync),
) -> Result<DatasetSummary> {
    config.check()?;
    let seeds = first_seed..first_seed.saturating_add(u64::from(episodes));
    let root = folder.join(EPISODES_FOLDER);
    std::fs::create_dir_all(&root).map_err(|source| Error::io(&root, source))?;
    for folder in [folder, &root] {
        rogs_files::sweep(folder)?;
    }
    let robot = folder.join(ROBOT_FOLDER);
    write_robot(&Robot::new(), &robot)?;
    let mut summary = DatasetSummary {
        robot: robot.join(ROBOT_URDF_FILE),
        episodes: Vec::new(),
        written: 0,
        frames: config.frames,
    };
    for seed in seeds {
        let place = root.join(format!("synth-{seed:08}"));
        if !holds(&place, seed, config)? {
            write_episode(
                &place,
                &generate_episode(config, seed)?,
                &format!("../../{ROBOT_FOLDER}/{ROBOT_URDF_FILE}"),
            )?;
            summary.written += 1;
        }
        progress(&place);
        summary.episodes.push(place);
    }
    let about = Dataset {
        generator: "rogs-synth",
        version: env!("CARGO_PKG_VERSION"),
        first_seed,
        episodes,
        config,
    };
    rogs_files::write_bytes(&folder.join(DATASET_FILE), &pretty(&about)?)?;
    Ok(summary)
}

/// Provenance inside an episode's folder, so that a resumed run knows what is there.
#[derive(Serialize)]
struct Origin<'a> {
    generator: &'static str,
    version: &'static str,
    seed: u64,
    config: &'a SynthConfig,
}

const ORIGIN_FILE: &str = "synth.json";

fn origin(seed: u64, config: &SynthConfig) -> Result<Vec<u8>> {
    pretty(&Origin {
        generator: "rogs-synth",
        version: env!("CARGO_PKG_VERSION"),
        seed,
        config,
    })
}

/// Whether the folder holds exactly this episode.
fn holds(place: &Path, seed: u64, config: &SynthConfig) -> Result<bool> {
    if !place.exists() {
        return Ok(false);
    }
    match std::fs::read(place.join(ORIGIN_FILE)) {
        Ok(bytes) if bytes == origin(seed, config)? => Ok(true),
        _ => Err(Error::Occupied { path: place.to_owned() }),
    }
}

pub(crate) fn pretty(value: &impl Serialize) -> Result<Vec<u8>> {
    let mut text = serde_json::to_vec_pretty(value).map_err(Error::json)?;
    text.push(b'\n');
    Ok(text)
}

/// Writes one episode folder with images, states, exact depth and tracks; `model` is the path of the robot's URDF from there.
///
/// The folder is filled beside its place and renamed, so that it is whole when it is there.
///
/// # Errors
/// When something is in its place already, or a file cannot be written.
pub fn write_episode(place: &Path, episode: &Episode, model: &str) -> Result<()> {
    if place.exists() {
        return Err(Error::Occupied { path: place.to_owned() });
    }
    let draft = Draft::begin(place)?;
    write_pictures(&draft, episode)?;
    let anchor = episode.config.anchor() as usize;
    let tracks = episode.tracks(&episode.render_cameras(anchor, &[0, 1, 2]));
    write_tracks(&draft, &tracks, episode.frame_count())?;
    draft.write("joints.csv", states_csv(episode).as_bytes())?;
    draft.write(ORIGIN_FILE, &origin(episode.seed, &episode.config)?)?;
    draft.write(layout::EPISODE_FILE, &pretty(&description(episode, model))?)?;
    Ok(draft.publish()?)
}

/// Images, depth and ids; frames are drawn in parallel, files of arrays grow in the order of frames.
fn write_pictures(draft: &Draft, episode: &Episode) -> Result<()> {
    let frames = episode.frame_count();
    let mut depths = create_arrays::<f32>(draft, "depth", episode)?;
    let mut ids = create_arrays::<u8>(draft, "ids", episode)?;
    let batch = 2 * rayon::current_num_threads().max(1);
    for first in (0..frames).step_by(batch) {
        let drawn: Vec<Vec<View>> = (first..(first + batch).min(frames))
            .into_par_iter()
            .map(|frame| {
                let views = episode.render_frame(frame).views;
                for (camera, view) in views.iter().enumerate() {
                    let lens = &episode.cameras[camera].lens;
                    let name = format!("{}/{frame:06}.png", CAMERA_NAMES[camera]);
                    draft.write(name, &png(&view.rgb, lens.width, lens.height)?)?;
                }
                Ok(views)
            })
            .collect::<Result<_>>()?;
        for views in &drawn {
            for (camera, view) in views.iter().enumerate() {
                depths[camera].append(&le_bytes(&view.depth_m))?;
                ids[camera].append(&view.id)?;
            }
        }
    }
    for out in depths.into_iter().chain(ids) {
        out.finish()?;
    }
    Ok(())
}

/// A file `FOLDER/CAMERA.npy` for every camera, for values `[F, H, W]` that follow frame by frame.
fn create_arrays<T: Scalar>(draft: &Draft, folder: &str, episode: &Episode) -> Result<Vec<DraftFile>> {
    let create = |(name, camera): (&str, &EpisodeCamera)| {
        let lens = &camera.lens;
        let shape = [episode.frame_count(), lens.height as usize, lens.width as usize];
        let mut out = draft.create(format!("{folder}/{name}.npy"))?;
        out.append(&npy_header::<T>(&shape))?;
        Ok(out)
    };
    CAMERA_NAMES.into_iter().zip(&episode.cameras).map(create).collect()
}

pub(crate) fn png(rgb: &[u8], width: u32, height: u32) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Sub);
    encoder.write_image(rgb, width, height, ExtendedColorType::Rgb8)?;
    Ok(bytes)
}

fn write_tracks(draft: &Draft, tracks: &EpisodeTracks, frames: usize) -> Result<()> {
    let count = tracks.camera.len();
    let pixels: Vec<f32> = tracks.pixel.iter().flatten().map(|&p| p as f32 + 0.5).collect();
    let files = [
        ("camera", npy_bytes(&[count], &tracks.camera)),
        ("pixel", npy_bytes(&[count, 2], &pixels)),
        ("position", npy_bytes(&[count, frames, 3], &tracks.position_m)),
        ("visible", npy_bytes(&[count, frames], &tracks.visible)),
        ("id", npy_bytes(&[count], &tracks.id)),
    ];
    for (name, bytes) in files {
        draft.write(format!("tracks/{name}.npy"), &bytes)?;
    }
    Ok(())
}

fn states_csv(episode: &Episode) -> String {
    let mut text = format!(
        "{},{},{}\n",
        layout::TIME_COLUMN,
        ARM_JOINT_NAMES.join(","),
        layout::GRIPPER_COLUMN
    );
    for (frame, state) in episode.states.iter().enumerate() {
        // Writing to a string cannot fail.
        let _ = write!(text, "{}", frame as f64 / episode.config.fps);
        for joint in state.joints {
            let _ = write!(text, ",{joint}");
        }
        let _ = writeln!(text, ",{}", state.gripper);
    }
    text
}

/// `episode.json`.
fn description(episode: &Episode, model: &str) -> layout::Episode {
    let camera = |index: usize| {
        let EpisodeCamera {
            recorded_lens: lens,
            recorded_mount,
            ..
        } = &episode.cameras[index];
        let name = CAMERA_NAMES[index].to_owned();
        layout::EpisodeCamera {
            id: name.clone(),
            role: if index < 3 {
                layout::EpisodeCameraRole::Source
            } else {
                layout::EpisodeCameraRole::Evaluation
            },
            partner: (index >= 3).then(|| CAMERA_NAMES[index - 3].to_owned()),
            images: Some(name.clone()),
            width: lens.width,
            height: lens.height,
            intrinsics: lens.intrinsics,
            pixel_centres: layout::PixelCentres::Half,
            mount: match recorded_mount {
                Mount::Fixed(pose) => layout::EpisodeMount::Fixed {
                    base_from_camera: pose.to_rigid().into(),
                },
                Mount::Flange(pose) => layout::EpisodeMount::HandEye {
                    link: format!("panda_link{FLANGE_LINK}"),
                    link_from_camera: pose.to_rigid().into(),
                },
            },
            depth: Some(layout::EpisodeDepth {
                path: format!("depth/{name}.npy"),
                unit_m: None,
                range_m: [0.1, 5.0],
                origin: ReferenceOrigin::Exact,
            }),
        }
    };
    layout::Episode {
        format: layout::EPISODE_FORMAT.into(),
        episode_id: episode.id(),
        fps: episode.config.fps,
        frame_count: episode.frame_count() as u32,
        task: episode.task(),
        calibration_note: match episode.config.calibration_noise {
            None => format!("{PROCEDURAL_NOTE} exact"),
            Some([metres, radians]) => {
                format!(
                    "{PROCEDURAL_NOTE} extrinsics off by {:.1} mm and {:.2} degrees (1 sigma)",
                    1000.0 * metres,
                    radians.to_degrees()
                )
            }
        },
        robot: layout::EpisodeRobot {
            joint_names: ARM_JOINT_NAMES.map(str::to_owned).to_vec(),
            states: "joints.csv".into(),
            model: Some(model.to_owned()),
        },
        cameras: (0..CAMERAS).map(camera).collect(),
        tracks: Some(layout::EpisodeTracks {
            anchor_frame: EpisodeFrame(episode.config.anchor()),
            camera: "tracks/camera.npy".into(),
            pixel: "tracks/pixel.npy".into(),
            position_m: "tracks/position.npy".into(),
            visible: "tracks/visible.npy".into(),
            origin: ReferenceOrigin::Exact,
        }),
    }
}
