//! Finding episodes in a tree `LAB/{success,failure}/DATE/TIME/` by names alone: no file is opened, every folder is
//! listed once, and many days at a time, since a folder that is not in memory is waited for.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use rogs_worker::StageResult;

use crate::fault::io_error;

/// The states and calibration of an episode.
pub(super) const TRAJECTORY: &str = "trajectory.h5";
/// Where its videos are.
pub(super) const VIDEOS: &str = "recordings/MP4";
/// How to get what is missing of an episode.
pub(super) const RELEASE: &str =
    "the raw release has it: `gsutil -m cp -r gs://gresearch/robotics/droid_raw/1.0.1/LAB/OUTCOME/DATE/TIME .`";
/// What the outcome folders of a laboratory are called.
const OUTCOMES: [&str; 2] = ["success", "failure"];
/// Levels above a laboratory's folder that are looked through: a tree may lie in a folder of a release.
const LEVELS: usize = 3;
/// More folders than this on the way to the first laboratory are no DROID tree.
const MAX_FOLDERS: usize = 4096;

/// Days that are listed at a time: more than there are cores, since they wait for the disk.
const READERS: usize = 16;

/// An episode in a tree.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Found {
    /// The uuid, from the name of the metadata file; the folder's name where there is none.
    pub(crate) id: String,
    /// Its folder, relative to the root; empty for the root itself.
    pub(crate) folder: String,
    /// Files that ingest may read, relative to the episode's folder.
    pub(crate) files: Vec<String>,
}

/// Whether a folder is a raw episode.
pub(crate) fn is_episode(folder: &Path) -> bool {
    folder.join(TRAJECTORY).is_file() || (folder.join("recordings").is_dir() && metadata_name(folder).is_some())
}

/// Name of an episode's metadata file; the first by name where there are several.
pub(super) fn metadata_name(folder: &Path) -> Option<String> {
    let names = rogs_files::entries(folder).ok()?;
    let names = names.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    names.filter(|name| uuid_of(name).is_some()).min()
}

/// The uuid in the name `metadata_UUID.json`.
pub(super) fn uuid_of(name: &str) -> Option<&str> {
    name.strip_prefix("metadata_")?.strip_suffix(".json")
}

/// The episodes of a tree in the order of their folders; `root` may be an episode, a day, an outcome, a laboratory, or
/// a folder of laboratories. Empty when it is none of these.
pub(crate) fn episodes(root: &Path) -> StageResult<Vec<Found>> {
    let mut found = Vec::new();
    let here = Here {
        path: root.to_owned(),
        relative: String::new(),
    };
    if is_episode(root) {
        found.push(episode(&here)?);
    } else {
        let (mut left, mut days) = (MAX_FOLDERS, Vec::new());
        look(here, LEVELS, &mut left, &mut days)?;
        let list = || -> Vec<StageResult<Vec<Found>>> { days.par_iter().map(episodes_of_day).collect() };
        let listed = match rayon::ThreadPoolBuilder::new()
            .num_threads(READERS.min(days.len().max(1)))
            .build()
        {
            Ok(pool) => pool.install(list),
            Err(_) => list(),
        };
        for day in listed {
            found.extend(day?);
        }
    }
    found.sort_by(|a, b| a.folder.cmp(&b.folder));
    Ok(found)
}

/// A folder on the way.
struct Here {
    path: PathBuf,
    relative: String,
}

impl Here {
    fn below(&self, name: &str) -> Self {
        let relative = match self.relative.as_str() {
            "" => name.to_owned(),
            before => format!("{before}/{name}"),
        };
        Self {
            path: self.path.join(name),
            relative,
        }
    }

    /// Names of the folders in it, and of the files.
    fn list(&self) -> StageResult<(Vec<String>, Vec<String>)> {
        let (mut folders, mut files) = (Vec::new(), Vec::new());
        let io = |error| io_error(&self.path, &error);
        for entry in rogs_files::entries(&self.path).map_err(io)? {
            let entry = entry.map_err(io)?;
            let Ok(name) = entry.file_name().into_string() else {
                continue;
            };
            let kind = entry.file_type().map_err(io)?;
            let folder = kind.is_dir() || (kind.is_symlink() && entry.path().is_dir());
            let names = if folder { &mut folders } else { &mut files };
            names.push(name);
        }
        folders.sort();
        files.sort();
        Ok((folders, files))
    }
}

/// Looks for laboratories, outcomes and days from an unknown level on; gives the days.
fn look(here: Here, levels: usize, left: &mut usize, days: &mut Vec<Here>) -> StageResult<()> {
    let name = here.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    if is_date(&name) {
        days.push(here);
        return Ok(());
    }
    let (folders, _) = here.list()?;
    if OUTCOMES.contains(&&*name) {
        days.extend(folders.iter().map(|day| here.below(day)));
        return Ok(());
    }
    if folders.iter().any(|folder| OUTCOMES.contains(&folder.as_str())) {
        for outcome in folders.iter().filter(|folder| OUTCOMES.contains(&folder.as_str())) {
            let outcome = here.below(outcome);
            days.extend(outcome.list()?.0.iter().map(|day| outcome.below(day)));
        }
        return Ok(());
    }
    for folder in &folders {
        if levels == 0 || *left == 0 {
            return Ok(());
        }
        if days.is_empty() {
            *left -= 1;
        }
        look(here.below(folder), levels - 1, left, days)?;
    }
    Ok(())
}

fn episodes_of_day(day: &Here) -> StageResult<Vec<Found>> {
    let mut found = Vec::new();
    for time in day.list()?.0 {
        let episode = episode(&day.below(&time))?;
        if !episode.files.is_empty() {
            found.push(episode);
        }
    }
    Ok(found)
}

/// What the folder of an episode holds; other folders have no files.
fn episode(here: &Here) -> StageResult<Found> {
    let (folders, names) = here.list()?;
    let metadata = names.iter().find(|name| uuid_of(name).is_some());
    let mut files: Vec<String> = metadata.cloned().into_iter().collect();
    files.extend(names.iter().find(|name| *name == TRAJECTORY).cloned());
    if folders.iter().any(|folder| folder == "recordings") && !files.is_empty() {
        let videos = here.below("recordings").below("MP4");
        // Without a look before: one question less to the disk.
        let videos = match videos.list() {
            Ok((_, names)) => names,
            Err(_) if !videos.path.is_dir() => Vec::new(),
            Err(error) => return Err(error),
        };
        let videos = videos.into_iter().filter(|name| name.ends_with(".mp4"));
        files.extend(videos.map(|name| format!("{VIDEOS}/{name}")));
    }
    let time = || here.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok(Found {
        id: metadata.and_then(|name| uuid_of(name)).map_or_else(time, str::to_owned),
        folder: here.relative.clone(),
        files,
    })
}

/// `2023-07-08`
fn is_date(name: &str) -> bool {
    let parts: Vec<&str> = name.split('-').collect();
    let digits = |part: &str, count: usize| part.len() == count && part.bytes().all(|byte| byte.is_ascii_digit());
    matches!(parts[..], [year, month, day] if digits(year, 4) && digits(month, 2) && digits(day, 2))
}

/// The last four parts of an episode's place, `LAB/OUTCOME/DATE/TIME`, in the one spelling that all spellings share: the
/// time's colons, blanks and doubled underscores become single underscores.
pub(super) fn place(path: &Path) -> Option<String> {
    let parts: Vec<String> = path.iter().map(|part| part.to_string_lossy().into_owned()).collect();
    let [.., lab, outcome, date, time] = &parts[..] else {
        return None;
    };
    (OUTCOMES.contains(&outcome.as_str()) && is_date(date)).then(|| format!("{lab}/{outcome}/{date}/{}", spelled(time)))
}

/// The place of the episode in a path that goes on below it, such as that of its videos or its trajectory.
pub(super) fn place_within(path: &str) -> Option<String> {
    let path = Path::new(path.trim_end_matches('/'));
    path.ancestors().take(4).find_map(place)
}

fn spelled(time: &str) -> String {
    let parts = time.split([':', ' ', '_']).filter(|part| !part.is_empty());
    parts.collect::<Vec<_>>().join("_")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_spellings_of_a_time_are_one() {
        let of = |time: &str| place(Path::new("/x/AUTOLab/success/2023-07-07").join(time).as_path()).unwrap();
        let one = "AUTOLab/success/2023-07-07/Fri_Jul_7_09_42_23_2023";
        for time in [
            "Fri_Jul__7_09:42:23_2023",
            "Fri_Jul_7_09:42:23_2023",
            "Fri_Jul__7_09_42_23_2023",
            "Fri_Jul_7_09_42_23_2023",
            "Fri Jul  7 09:42:23 2023",
        ] {
            assert_eq!(of(time), one);
        }
        assert_eq!(place(Path::new("/x/episodes/one")), None);
        let below = "gs://bucket/r2d2/AUTOLab/success/2023-07-07/Fri_Jul__7_09:42:23_2023/recordings/MP4/";
        assert_eq!(place_within(below).as_deref(), Some(one));
        assert_eq!(place_within("recordings/MP4"), None);
    }

    #[test]
    fn uuids_are_in_names() {
        let name = "metadata_AUTOLab+5d05c5aa+2023-07-07-09h-42m-23s.json";
        assert_eq!(uuid_of(name), Some("AUTOLab+5d05c5aa+2023-07-07-09h-42m-23s"));
        assert_eq!(uuid_of("metadata.json"), None);
        assert!(is_date("2023-07-08") && !is_date("2023-7-8") && !is_date("success"));
    }
}
