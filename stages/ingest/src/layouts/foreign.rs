//! Layouts of others that are not read: known by what lies in the folder, and refused by name with the way on.

use std::path::Path;

use rogs_worker::StageError;

/// Entries of a folder that are looked at.
const MOST: usize = 4096;
/// Folders below that are looked into.
const BELOW: usize = 64;

/// What lies in a folder, and in the folders in it.
#[derive(Default)]
struct Seen {
    /// Names of files.
    files: Vec<String>,
    /// Folders with the names of what is in them.
    folders: Vec<(String, Vec<String>)>,
}

impl Seen {
    fn of(root: &Path) -> Self {
        let names = |folder: &Path| -> Vec<String> {
            let entries = rogs_files::entries(folder).into_iter().flatten().take(MOST);
            let mut names: Vec<String> = entries
                .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
                .collect();
            names.sort();
            names
        };
        let mut seen = Self::default();
        for name in names(root) {
            let path = root.join(&name);
            if !path.is_dir() {
                seen.files.push(name);
            } else if seen.folders.len() < BELOW {
                let inside = names(&path);
                seen.folders.push((name, inside));
            }
        }
        seen
    }

    /// Whether a file here or in a folder below has one of these endings.
    fn has(&self, endings: &[&str]) -> bool {
        let below = self.folders.iter().flat_map(|(_, names)| names);
        self.files.iter().chain(below).any(|name| ends(name, endings))
    }

    /// Folders that hold nothing but images, or videos.
    fn by_camera(&self) -> Vec<&str> {
        let is_camera = |names: &[String]| !names.is_empty() && names.iter().all(|name| ends(name, &PICTURES));
        let folders = self.folders.iter().filter(|(_, names)| is_camera(names));
        folders.map(|(name, _)| name.as_str()).collect()
    }
}

/// Endings of images and videos.
const PICTURES: [&str; 8] = [".png", ".jpg", ".jpeg", ".bmp", ".mp4", ".mkv", ".avi", ".webm"];

/// Whether a name has one of these endings, in any capitals.
fn ends(name: &str, endings: &[&str]) -> bool {
    let name = name.to_lowercase();
    endings.iter().any(|ending| name.ends_with(ending))
}

/// The way on from any of them.
const WAY: &str = "write each episode as a folder with `episode.json`, a table of joints, and a video or PNG files a camera \
                   (docs/episode-format.md has twenty lines of Python that do)";

/// The error for a layout that many have and that is not read; `None` for all other folders. Asked last.
pub(crate) fn refusal(root: &Path) -> Option<StageError> {
    let seen = Seen::of(root);
    let what = named(&seen)?;
    Some(StageError::bad_input(format!("`{}` holds {what}", root.display())).with_hint(WAY))
}

/// What the folder holds, in words.
fn named(seen: &Seen) -> Option<String> {
    let cameras = seen.by_camera();
    let zarr = |(name, names): &(String, Vec<String>)| {
        name.ends_with(".zarr") || names.iter().any(|name| name == ".zgroup" || name == "zarr.json")
    };
    let has_file = |wanted: &[&str]| seen.files.iter().any(|name| wanted.contains(&name.as_str()));
    Some(if seen.has(&[".bag", ".mcap", ".db3"]) {
        "recordings of ROS (bags), which are not read: export images, joint states and poses of the cameras".to_owned()
    } else if seen.folders.iter().any(zarr) || seen.has(&[".zarr.zip"]) || has_file(&[".zgroup", "zarr.json"]) {
        "arrays in Zarr (as of Diffusion Policy and UMI), which are not read".to_owned()
    } else if seen.has(&[".hdf5", ".h5"]) {
        "HDF5 files of a layout that is not known (as of robomimic, LIBERO, ALOHA, ManiSkill): of HDF5, raw DROID and caches \
         of PointWorld are read"
            .to_owned()
    } else if seen.has(&[".pkl", ".pickle"]) {
        "pickled Python objects (as of BridgeData), which are not read".to_owned()
    } else if seen.has(&[".parquet"]) {
        "parquet files without `meta/info.json`, which says what they hold: fetch the whole LeRobot data set".to_owned()
    } else if has_file(&["transforms.json", "transforms_train.json", "cameras.txt", "cameras.bin"]) {
        "a scene of nerfstudio or COLMAP, which has neither a robot nor times".to_owned()
    } else if let [first, ..] = cameras[..] {
        let more = match cameras.len() {
            1 => String::new(),
            count => format!(" and {} more", count - 1),
        };
        format!("images by camera (`{first}`{more}), and nothing that says times, joints and cameras")
    } else if seen.has(&PICTURES) {
        "images or videos alone, and nothing that says times, joints and cameras".to_owned()
    } else {
        return None;
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layouts_of_others_are_refused_by_name() {
        for (places, words) in [
            (
                &["cam_left/000000.jpg", "cam_right/000000.jpg", "states.csv"][..],
                "images by camera (`cam_left` and 1 more)",
            ),
            (&["front/0.png", "front/1.png"], "images by camera (`front`)"),
            (&["rec.mcap"], "recordings of ROS"),
            (&["run/rec_0.db3", "run/metadata.yaml"], "recordings of ROS"),
            (&["replay_buffer.zarr/.zgroup"], "Zarr"),
            (&["replay_buffer/zarr.json"], "Zarr"),
            (&["data.zarr.zip"], "Zarr"),
            (&["episode_0.hdf5"], "robomimic"),
            (&["task/demo.H5"], "robomimic"),
            (&["traj0/obs_dict.pkl"], "BridgeData"),
            (&["data/chunk-000.parquet"], "without `meta/info.json`"),
            (&["transforms.json", "images/0.png"], "nerfstudio or COLMAP"),
            (&["video.mp4"], "images or videos alone"),
        ] {
            let folder = tempfile::tempdir().unwrap();
            for place in places {
                let path = folder.path().join(place);
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                rogs_files::write_bytes(&path, b"").unwrap();
            }
            let error = refusal(folder.path()).unwrap();
            assert!(error.message.contains(words), "{places:?}: {error}");
            assert!(error.hint.unwrap().contains("docs/episode-format.md"));
        }
        let folder = tempfile::tempdir().unwrap();
        rogs_files::write_bytes(&folder.path().join("notes.txt"), b"").unwrap();
        assert!(refusal(folder.path()).is_none(), "nothing that anybody knows");
    }
}
