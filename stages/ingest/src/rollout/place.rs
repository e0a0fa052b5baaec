//! Finding the views of a rollout in its file or folder.

use std::path::{Path, PathBuf};

use rogs_arrays::Png;
use rogs_schemas::EpisodeFrame;
use rogs_worker::{StageError, StageResult};

use super::grid::{Rect, composite, replay};
use crate::fault::{io_error, unreadable, wrong};
use crate::images::{FrameOrder, FrameSource, is_video};
use crate::layouts::clip_camera;
use crate::params::{RolloutLayout, RolloutParams};
use crate::source::SourceCamera;
use crate::video;

/// The views of a composite, in the order of [`composite`] and [`replay`].
const THREE: [&str; 3] = ["wrist", "ext1", "ext2"];
/// Most entries of a rollout's folder that are looked at.
const MAX_ENTRIES: usize = 65_536;

/// Where the views of a rollout are.
pub(crate) struct Place {
    /// Name of the layout, as the clip keeps it.
    pub(crate) layout: &'static str,
    /// Its files.
    pub(crate) footage: Vec<Footage>,
    /// Whether the rate in a header means something.
    pub(crate) rate_is_told: bool,
    /// Episode and first frame that the name of the file states.
    pub(crate) says: Option<(String, EpisodeFrame)>,
}

/// One video or folder of frames, with the views in it.
pub(crate) struct Footage {
    pub(crate) path: PathBuf,
    pub(crate) images: FrameSource,
    /// (width, height)
    pub(crate) size: (u32, u32),
    pub(crate) frames: u64,
    /// What the header says; folders have none.
    pub(crate) fps: Option<f64>,
    /// Index of the source camera and where it lies in the frame.
    pub(crate) views: Vec<(usize, Rect)>,
}

/// Finds the views of all source cameras.
pub(crate) fn find(path: &Path, cameras: &[&SourceCamera], options: &RolloutParams) -> StageResult<Place> {
    let says = replay_name(path);
    let layout = match options.layout {
        RolloutLayout::Auto if says.is_some() => RolloutLayout::CtrlWorld,
        RolloutLayout::Auto if path.is_dir() && !has_frames(path)? => RolloutLayout::Views,
        RolloutLayout::Auto => RolloutLayout::Composite,
        other => other,
    };
    let one = |name, views: &dyn Fn(&Footage) -> StageResult<[Rect; 3]>, rate_is_told, says| {
        let mut footage = Footage::open(path)?;
        let rects = views(&footage).map_err(|error| StageError {
            message: format!("`{}`: {}", path.display(), error.message),
            ..error
        })?;
        footage.views = three(path, cameras)?.into_iter().zip(rects).collect();
        Ok(Place {
            layout: name,
            footage: vec![footage],
            rate_is_told,
            says,
        })
    };
    match layout {
        RolloutLayout::Composite => {
            let aspect = cameras
                .iter()
                .find(|camera| camera.id == THREE[0])
                .map_or(16.0 / 9.0, |camera| f64::from(camera.width) / f64::from(camera.height));
            one(
                "composite",
                &|footage| composite(footage.size, options.image_size, aspect),
                true,
                None,
            )
        }
        // The program that writes these says 4 frames per second whatever the data's rate is.
        RolloutLayout::CtrlWorld => one("ctrl-world", &|footage| replay(footage.size), false, says),
        RolloutLayout::Auto | RolloutLayout::Views => views(path, cameras),
    }
}

/// A video or a folder of frames for every camera.
fn views(path: &Path, cameras: &[&SourceCamera]) -> StageResult<Place> {
    if !path.is_dir() {
        return Err(wrong(
            path,
            "a folder with one video or folder of frames a camera is expected",
        ));
    }
    let mut named: Vec<(String, PathBuf)> = Vec::new();
    for entry in entries(path)? {
        if is_video(&entry) || entry.is_dir() {
            let stem = entry.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            // The order of Ctrl-World's videos.
            let id = match stem.as_str() {
                "0" => "ext1".to_owned(),
                "1" => "ext2".to_owned(),
                "2" => "wrist".to_owned(),
                _ => clip_camera(&stem),
            };
            named.push((id, entry));
        }
    }
    let footage = cameras.iter().enumerate().map(|(index, camera)| {
        let own: Vec<&PathBuf> = named
            .iter()
            .filter(|(id, _)| *id == camera.id)
            .map(|(_, path)| path)
            .collect();
        let [own] = own[..] else {
            let found: Vec<&str> = named.iter().map(|(id, _)| id.as_str()).collect();
            let what = match own.len() {
                0 => format!("it has no view of camera `{}`; it has {}", camera.id, found.join(", ")),
                _ => format!("it has {} views of camera `{}`", own.len(), camera.id),
            };
            return Err(
                wrong(path, what).with_hint("one video or folder of PNG frames a camera, named by it: `wrist.mp4`")
            );
        };
        let mut footage = Footage::open(own)?;
        footage.views = vec![(index, Rect::whole(footage.size))];
        Ok(footage)
    });
    Ok(Place {
        layout: "views",
        footage: footage.collect::<StageResult<_>>()?,
        rate_is_told: true,
        says: None,
    })
}

/// The indices of the cameras of a composite; refuses a clip with other cameras.
fn three(path: &Path, cameras: &[&SourceCamera]) -> StageResult<[usize; 3]> {
    let index = |id: &str| cameras.iter().position(|camera| camera.id == id);
    let found = THREE.map(index);
    match found {
        [Some(wrist), Some(ext1), Some(ext2)] if cameras.len() == 3 => Ok([wrist, ext1, ext2]),
        _ => {
            let ids: Vec<&str> = cameras.iter().map(|camera| camera.id.as_str()).collect();
            let what = format!(
                "it shows wrist, ext1, ext2; the clip's source cameras are {}",
                ids.join(", ")
            );
            Err(wrong(path, what)
                .with_hint("name the clip's cameras with `cameras` under [ingest], or give one video a camera"))
        }
    }
}

impl Footage {
    fn open(path: &Path) -> StageResult<Self> {
        if !path.is_dir() {
            let info = video::probe(path)?;
            return Ok(Self {
                path: path.to_owned(),
                size: (info.width, info.height),
                frames: info.frames,
                fps: Some(info.fps).filter(|&fps| fps > 0.0),
                images: FrameSource::Video {
                    path: path.to_owned(),
                    info,
                    order: FrameOrder::From(0),
                    part: None,
                },
                views: Vec::new(),
            });
        }
        let first = path.join(crate::images::numbered(0, "png"));
        let png = Png::open(&first).map_err(unreadable)?;
        let frames = entries(path)?.iter().filter(|entry| is_png(entry)).count();
        Ok(Self {
            path: path.to_owned(),
            size: (png.width, png.height),
            frames: frames as u64,
            fps: None,
            images: FrameSource::Folder(path.to_owned()),
            views: Vec::new(),
        })
    }
}

/// Whether a folder holds frames itself.
fn has_frames(folder: &Path) -> StageResult<bool> {
    Ok(entries(folder)?.iter().any(|entry| is_png(entry)))
}

fn is_png(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "png")
}

/// The entries of a folder, sorted.
fn entries(folder: &Path) -> StageResult<Vec<PathBuf>> {
    let read = rogs_files::entries(folder).map_err(|error| io_error(folder, &error))?;
    let mut found: Vec<PathBuf> = read
        .filter_map(|entry| Some(entry.ok()?.path()))
        .take(MAX_ENTRIES)
        .collect();
    found.sort();
    Ok(found)
}

/// Episode and first frame in the name of a Ctrl-World replay: `time_20260131_120000_traj_899_8_5_TEXT.mp4`.
fn replay_name(path: &Path) -> Option<(String, EpisodeFrame)> {
    let name = path.file_stem()?.to_str()?;
    let (_, after) = name.split_once("_traj_")?;
    let mut parts = after.split('_');
    let (episode, start) = (parts.next()?, parts.next()?);
    Some((episode.to_owned(), start.parse().ok()?)).filter(|(episode, _)| !episode.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_of_a_replay_says_what_it_is_of() {
        let name = "out/time_20260131_120000_traj_899_8_5_put_the_cup.mp4";
        assert_eq!(replay_name(Path::new(name)), Some(("899".to_owned(), EpisodeFrame(8))));
        for name in [
            "899.mp4",
            "time_1_traj_899.mp4",
            "time_1_traj_899_x_5.mp4",
            "time_1_traj__8_5.mp4",
        ] {
            assert_eq!(replay_name(Path::new(name)), None, "{name}");
        }
    }
}
