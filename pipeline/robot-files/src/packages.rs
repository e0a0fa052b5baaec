//! Where ROS packages are looked for.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use super::LEVELS;

/// Environment variables that name folders of packages, as ROS 1, ROS 2 and Gazebo set them.
pub const SEARCH_VARIABLES: [&str; 4] = [
    "ROS_PACKAGE_PATH",
    "AMENT_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
    "GAZEBO_MODEL_PATH",
];

/// Most folders that are looked into for a package of a search path.
const MOST_FOLDERS: usize = 4000;

/// The folders of the environment.
pub(super) fn search_path() -> Vec<PathBuf> {
    let values = SEARCH_VARIABLES.iter().filter_map(std::env::var_os);
    values
        .flat_map(|value| std::env::split_paths(&value).collect::<Vec<_>>())
        .filter(|folder| folder.is_absolute() && folder.is_dir())
        .collect()
}

pub(super) fn is_package(folder: &Path) -> bool {
    folder.join("package.xml").is_file()
}

/// The package in a folder whose `package.xml` has a name, whatever its own folder is called; the first by name.
fn called(folder: &Path, name: &str) -> Option<PathBuf> {
    let entries = std::fs::read_dir(folder).ok()?.take(MOST_FOLDERS);
    let mut folders: Vec<PathBuf> = entries
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| is_package(path))
        .collect();
    folders.sort();
    let has_name = |folder: &PathBuf| {
        let text = describes(&folder.join("package.xml")).unwrap_or_default();
        let own = text
            .split_once("<name>")
            .and_then(|(_, rest)| rest.split_once("</name>"));
        own.is_some_and(|(own, _)| own.trim() == name)
    };
    folders.into_iter().find(has_name)
}

/// The beginning of a `package.xml`, where names stand.
fn describes(path: &Path) -> Option<String> {
    const LONGEST: u64 = 64 << 10;
    let mut bytes = Vec::new();
    rogs_files::open(path)
        .ok()?
        .take(LONGEST)
        .read_to_end(&mut bytes)
        .ok()?;
    Some(String::from_utf8_lossy(&bytes).into_owned())
}

/// The folders that a package may be, the likeliest first.
pub(super) fn folders(name: &str, here: &Path, root: &Path, search: &[PathBuf]) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = Vec::new();
    for above in here.ancestors().take(LEVELS) {
        // The top of a file system holds no packages.
        if above.parent().is_none() {
            break;
        }
        if above.file_name().is_some_and(|own| own == name) {
            found.push(above.to_owned());
        }
        let beside = above.join(name);
        // Packages right beside the robot's own need no `package.xml`.
        let near = Some(above) == root.parent() || above.starts_with(root);
        if is_package(&beside) || (near && beside.is_dir()) {
            found.push(beside);
        }
        // A workspace of ROS 2 installs every package below a folder of its own.
        let installed = above.join(name).join("share").join(name);
        if is_package(&installed) {
            found.push(installed);
        }
        // A clone may be called otherwise than the package in it.
        if Some(above) == root.parent() {
            found.extend(called(above, name));
        }
        if above.file_name().is_some_and(|own| own == "src") {
            found.extend(below(above, name));
        }
    }
    for folder in search {
        if folder.file_name().is_some_and(|own| own == name) {
            found.push(folder.clone());
        }
        let direct = [folder.join(name), folder.join("share").join(name)];
        match direct.into_iter().find(|folder| folder.is_dir()) {
            Some(direct) => found.push(direct),
            None => found.extend(below(folder, name)),
        }
    }
    found
}

/// A package of a name some levels below a folder, as ROS 1 crawls its search path; the nearest, then the first by name.
fn below(folder: &Path, name: &str) -> Option<PathBuf> {
    let mut level = vec![folder.to_owned()];
    let mut looked = 0;
    for _ in 0..3 {
        let mut next = Vec::new();
        for folder in &level {
            let Ok(entries) = std::fs::read_dir(folder) else {
                continue;
            };
            let folders = entries.flatten().map(|entry| entry.path()).filter(|path| path.is_dir());
            next.extend(folders.filter(|path| {
                path.file_name()
                    .is_some_and(|own| !own.to_string_lossy().starts_with('.'))
            }));
            looked += 1;
            if looked > MOST_FOLDERS {
                return None;
            }
        }
        next.sort();
        let found = next
            .iter()
            .map(|folder| folder.join(name))
            .find(|folder| is_package(folder));
        if found.is_some() {
            return found;
        }
        level = next;
    }
    None
}
