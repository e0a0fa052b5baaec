//! The layouts of episode folders, and telling them apart.

pub(crate) mod agibot;
pub(crate) mod ctrlworld;
pub(crate) mod droid;
pub(crate) mod foreign;
pub(crate) mod lerobot;
mod lerobot_episodes;
mod lerobot_meta;
mod lerobot_share;
mod lerobot_tasks;
mod parquet_table;
pub(crate) mod rogs_episode;

use std::collections::HashMap;
use std::path::Path;

use rogs_schemas::episode::EPISODE_FILE;
use rogs_worker::{StageError, StageResult};

use self::lerobot_meta::Dataset;
use crate::calibration::Calibration;
use crate::params::{LayoutChoice, Params};
use crate::source::{EpisodeOutline, Source};

/// A layout that is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Layout {
    RogsEpisode,
    DroidCtrlworld,
    DroidRaw,
    Lerobot,
    Agibot,
}

/// What is looked for, for those who gave a folder that holds none of it.
pub(crate) const KNOWN: &str = "expected `episode.json` (docs/episode-format.md), `annotation/` and `videos/` (DROID, \
    Ctrl-World), `trajectory.h5` or a tree LAB/success/DATE/TIME (raw DROID, docs/droid.md), \
    `meta/info.json` (LeRobot), or `actions.npy` and `head_color/` (AgiBot)";

/// The layout of a folder, told by the files in it.
pub(crate) fn detect(root: &Path) -> Option<Layout> {
    if root.join(EPISODE_FILE).is_file() {
        Some(Layout::RogsEpisode)
    } else if root.join("meta/info.json").is_file() {
        Some(Layout::Lerobot)
    } else if root.join("annotation").is_dir() {
        Some(Layout::DroidCtrlworld)
    } else if droid::is_episode(root) {
        Some(Layout::DroidRaw)
    } else if agibot::is_sample(root) {
        Some(Layout::Agibot)
    } else {
        None
    }
}

/// Opens an episode.
pub(crate) fn open(root: &Path, calibration: Option<&Path>, params: &Params) -> StageResult<Source> {
    if !root.is_dir() {
        return Err(StageError::bad_input(format!(
            "the episode folder `{}` is missing",
            root.display()
        )));
    }
    let layout = match params.layout {
        LayoutChoice::Auto => detect(root).ok_or_else(|| {
            let known = refusal(root).or_else(|| foreign::refusal(root));
            known.unwrap_or_else(|| {
                StageError::bad_input(format!("not an episode folder of a known layout: `{}`", root.display()))
                    .with_hint(KNOWN)
            })
        })?,
        LayoutChoice::RogsEpisode => Layout::RogsEpisode,
        LayoutChoice::DroidCtrlworld => Layout::DroidCtrlworld,
        LayoutChoice::DroidRaw => Layout::DroidRaw,
        LayoutChoice::Lerobot => Layout::Lerobot,
        LayoutChoice::Agibot => Layout::Agibot,
    };
    let file = || -> StageResult<Option<Calibration>> {
        if let Some(folder) = calibration.filter(|path| path.is_dir()) {
            let text = format!(
                "the calibration `{}` is a folder: only raw DROID takes one",
                folder.display()
            );
            return Err(StageError::bad_input(text).with_hint("docs/calibration-format.md shows the file"));
        }
        calibration.map(Calibration::read).transpose()
    };
    match layout {
        Layout::RogsEpisode => rogs_episode::open(root, file()?.as_ref(), &params.states),
        Layout::DroidCtrlworld => ctrlworld::open(root, file()?, params),
        Layout::DroidRaw => droid::open(root, calibration, params),
        Layout::Lerobot => lerobot::open(root, file()?.as_ref(), params),
        Layout::Agibot => agibot::open(root, file()?.as_ref(), &params.states),
    }
}

/// The error for a folder in a form that is known and not read; `None` for all others.
pub(crate) fn refusal(root: &Path) -> Option<StageError> {
    droid::refusal(root).or_else(|| agibot::refusal(root))
}

/// A LeRobot data set as the listing shows it.
pub(crate) struct LerobotListing {
    /// Layout, as the clip keeps it.
    pub(crate) layout: &'static str,
    /// Every episode that has its table.
    pub(crate) episodes: Vec<LerobotEpisode>,
}

/// One episode of a LeRobot data set.
pub(crate) struct LerobotEpisode {
    pub(crate) selector: String,
    /// Frames, as the metadata say; none where they are damaged.
    pub(crate) frames: Option<u64>,
    pub(crate) files: Vec<String>,
}

/// Lists a LeRobot data set. Episodes whose table is missing are left out: samples of large sets announce all of them.
pub(crate) fn lerobot_dataset(root: &Path) -> StageResult<LerobotListing> {
    let dataset = Dataset::open(root)?;
    // Many episodes share a file: each is looked for once.
    let mut there: HashMap<String, bool> = HashMap::new();
    let mut episodes = Vec::new();
    for listed in dataset.episodes()? {
        let mut files = vec!["meta/info.json".to_owned(), listed.described_by];
        let mut frames = None;
        if let Some(episode) = listed.episode {
            frames = Some(episode.length);
            files.extend(episode.videos.into_values().map(|(file, _)| file));
            let here = there.get(&episode.data).copied();
            let here = here.unwrap_or_else(|| {
                let here = root.join(&episode.data).is_file();
                there.insert(episode.data.clone(), here);
                here
            });
            if !here {
                continue;
            }
            files.push(episode.data);
        }
        episodes.push(LerobotEpisode {
            selector: listed.selector,
            frames,
            files,
        });
    }
    Ok(LerobotListing {
        layout: dataset.version.layout(),
        episodes,
    })
}

/// What a LeRobot data set says of its robot and cameras.
pub(crate) fn lerobot_outline(root: &Path) -> StageResult<EpisodeOutline> {
    let dataset = Dataset::open(root)?;
    let state = dataset.info.features.get("observation.state");
    let calibrated = (dataset.info.features.keys()).any(|name| name.starts_with("camera_extrinsics."));
    Ok(EpisodeOutline {
        cameras: dataset.videos().into_iter().map(str::to_owned).collect(),
        joints: Vec::new(),
        state_entries: state.map(lerobot_meta::Feature::entry_names).unwrap_or_default(),
        robot: dataset.info.robot_type.clone(),
        model: None,
        calibrated,
    })
}

/// The name that a camera of a DROID-like data set has in a clip: `wrist`, `ext1`, `ext2`, and `..._right` for right
/// eyes; other names stay.
pub(crate) fn clip_camera(name: &str) -> String {
    let last = name.rsplit('.').next().unwrap_or(name);
    let (eye, right) = match last.strip_suffix("_right") {
        Some(stem) => (stem, "_right"),
        None => (last.strip_suffix("_left").unwrap_or(last), ""),
    };
    let known = match eye {
        "wrist" | "wrist_image" | "hand" => "wrist",
        "ext1" | "exterior_1" | "exterior_image_1" => "ext1",
        "ext2" | "exterior_2" | "exterior_image_2" => "ext2",
        _ => return last.to_owned(),
    };
    format!("{known}{right}")
}

/// Names under which a calibration file may know a clip camera.
pub(crate) fn calibration_names(id: &str, data_name: &str) -> Vec<String> {
    let mut names = vec![data_name.to_owned(), id.to_owned()];
    let long = id.replace("ext1", "exterior_1").replace("ext2", "exterior_2");
    names.push(format!("{long}_left"));
    names.push(long);
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_every_port_are_known() {
        assert_eq!(clip_camera("observation.images.wrist_left"), "wrist");
        assert_eq!(clip_camera("observation.image.exterior_image_2_left"), "ext2");
        assert_eq!(clip_camera("exterior_1_right"), "ext1_right");
        assert_eq!(clip_camera("observation.images.cam_high"), "cam_high");
        assert!(calibration_names("ext1", "observation.images.x").contains(&"exterior_1".to_owned()));
    }
}
