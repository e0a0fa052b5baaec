//! Identity of sources: what the pipeline reads but did not make (episodes, robots, weights).
//!
//! A source is known by its content, never by its place or its times. Plans and stage programs must agree on it, so it
//! is defined here.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rogs_schemas::key::ContentHash;

use crate::error::{Error, Result};

/// Role of the robot model: a URDF whose folder, with its meshes, is the source.
pub const ROBOT_MODEL: &str = "robot-model";

/// More files than this in one source is a mistake (a path that points too high).
const MAX_FILES: usize = 200_000;

/// BLAKE3 of a file's bytes.
///
/// # Errors
/// When it is no file (a folder, a pipe, a device) or cannot be read.
pub fn hash_file(path: &Path) -> Result<ContentHash> {
    let io = |source| Error::Io {
        action: "reading",
        path: path.to_owned(),
        source,
    };
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(rogs_files::open(path).map_err(io)?).map_err(io)?;
    Ok(ContentHash(*hasher.finalize().as_bytes()))
}

/// One hash for named files: over name and content hash of each, in the order of names.
#[must_use]
pub fn combine(files: &BTreeMap<String, ContentHash>) -> ContentHash {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"rogs-source-1");
    for (name, hash) in files {
        hasher.update(&(name.len() as u64).to_le_bytes());
        hasher.update(name.as_bytes());
        hasher.update(&hash.0);
    }
    ContentHash(*hasher.finalize().as_bytes())
}

/// The files that make up a source, by the names they are hashed under: of a folder every file in it but strays
/// ([`rogs_files::is_stray`]), links followed; of a robot model every file in the URDF's folder, which of them is the URDF,
/// and the meshes elsewhere that it refers to; of any other file itself, under an empty name.
///
/// # Errors
/// When something cannot be read or there are absurdly many files.
pub fn source_files(role: &str, path: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let metadata = std::fs::metadata(path);
    let metadata = metadata.map_err(|source| Error::Io {
        action: "reading",
        path: path.to_owned(),
        source,
    })?;
    let mut files = BTreeMap::new();
    if metadata.is_dir() {
        walk(path, path, 0, &mut files)?;
    } else if role == ROBOT_MODEL {
        let folder = path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        walk(folder, folder, 0, &mut files)?;
        refer(path, &mut files);
        files.insert("<model>".to_owned(), path.to_owned());
    } else {
        files.insert(String::new(), path.to_owned());
    }
    Ok(files)
}

/// Content hash of a source: [`source_files`], each by [`hash_file`], put together by [`combine`].
///
/// # Errors
/// When something cannot be read.
pub fn hash_source(role: &str, path: &Path) -> Result<ContentHash> {
    let files = source_files(role, path)?;
    let hashed = files.into_iter().map(|(name, path)| Ok((name, hash_file(&path)?)));
    Ok(combine(&hashed.collect::<Result<_>>()?))
}

/// Files that a URDF refers to outside its folder: those of the packages beside it. What cannot be resolved is left to
/// the stage that reads it, which says so.
fn refer(urdf: &Path, files: &mut BTreeMap<String, PathBuf>) {
    let text = rogs_files::read(urdf).unwrap_or_default();
    let text = String::from_utf8_lossy(&text);
    let Ok(folder) = rogs_robot_files::RobotFolder::of_urdf(urdf) else {
        return;
    };
    for reference in rogs_robot_files::references(&text) {
        let Ok(path) = folder.resolve(&reference) else { continue };
        if path.starts_with(folder.of_text()) {
            continue;
        }
        let is_gltf = path
            .extension()
            .is_some_and(|ending| ending.eq_ignore_ascii_case("gltf"));
        // The buffers of a glTF file lie beside it.
        let beside = path
            .parent()
            .filter(|_| is_gltf)
            .and_then(|folder| std::fs::read_dir(folder).ok());
        for path in beside.into_iter().flatten().flatten().map(|entry| entry.path()) {
            if path.extension().is_some_and(|ending| ending == "bin") {
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                files.insert(format!("<reference>/{reference}/{name}"), path.clone());
            }
        }
        files.insert(format!("<reference>/{reference}"), path);
    }
}

/// Folders within folders that are followed; links can make endless ones.
const MAX_DEPTH: usize = 32;

fn walk(root: &Path, folder: &Path, depth: usize, files: &mut BTreeMap<String, PathBuf>) -> Result<()> {
    let io = |source| Error::Io {
        action: "listing",
        path: folder.to_owned(),
        source,
    };
    if depth > MAX_DEPTH {
        let source = std::io::Error::other("folders are nested without end: does a link lead back?");
        return Err(io(source));
    }
    for entry in rogs_files::entries(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if path.is_dir() {
            walk(root, &path, depth + 1, files)?;
        } else if path.is_file() {
            let name = path
                .strip_prefix(root)
                .unwrap_or(&path)
                .to_string_lossy()
                .replace('\\', "/");
            files.insert(name, path);
        }
        if files.len() > MAX_FILES {
            let source = std::io::Error::other(format!("more than {MAX_FILES} files: is this the right folder?"));
            return Err(Error::Io {
                action: "listing",
                path: root.to_owned(),
                source,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("rogs-source-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(folder.join("meshes")).unwrap();
        folder
    }

    #[test]
    fn a_source_is_its_content_not_its_place() {
        let (a, b) = (folder("a"), folder("b"));
        for root in [&a, &b] {
            std::fs::write(root.join("robot.urdf"), "<mesh filename='meshes/link.stl'/>").unwrap();
            std::fs::write(root.join("meshes/link.stl"), "solid").unwrap();
        }
        let hash = |root: &Path| hash_source(ROBOT_MODEL, &root.join("robot.urdf")).unwrap();
        assert_eq!(hash(&a), hash(&b));
        assert_eq!(hash(&a), hash(&a.join("meshes/..")), "however the place is written");
        let plain = |root: &Path| hash_source("weights", &root.join("robot.urdf")).unwrap();
        assert_eq!(plain(&a), plain(&b));
        let before = hash_source("episode", &b).unwrap();
        std::fs::write(b.join("meshes/link.stl"), "solid!").unwrap();
        assert_ne!(hash(&a), hash(&b));
        assert_ne!(before, hash_source("episode", &b).unwrap());
        assert!(
            hash_source("weights", &b.join("gone"))
                .unwrap_err()
                .to_string()
                .contains("gone")
        );
        let _ = (std::fs::remove_dir_all(a), std::fs::remove_dir_all(b));
    }

    #[cfg(unix)]
    #[test]
    fn strays_are_no_content_and_links_are_followed() {
        let a = folder("strays");
        std::fs::write(a.join("meshes/0.png"), "x").unwrap();
        let before = hash_source("episode", &a).unwrap();
        for stray in ["._0.png", ".DS_Store", "meshes/._0.png", "Thumbs.db"] {
            std::fs::write(a.join(stray), "y").unwrap();
        }
        assert_eq!(hash_source("episode", &a).unwrap(), before);
        let b = folder("linked");
        std::fs::remove_dir(b.join("meshes")).unwrap();
        std::os::unix::fs::symlink(a.join("meshes"), b.join("meshes")).unwrap();
        assert_eq!(hash_source("episode", &b).unwrap(), before);
        std::os::unix::fs::symlink(&b, b.join("again")).unwrap();
        assert!(hash_source("episode", &b).unwrap_err().to_string().contains("listing"));
        let _ = (std::fs::remove_dir_all(a), std::fs::remove_dir_all(b));
    }

    #[test]
    fn meshes_of_packages_beside_the_robot_are_part_of_it() {
        let workspace = folder("packages");
        let put = |file: &str, text: &str| {
            let path = workspace.join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        };
        put("arm/package.xml", "");
        put(
            "arm/urdf/x.urdf",
            "<mesh filename='package://hand/m.stl'/><mesh filename='../own.stl'/>",
        );
        put("arm/own.stl", "1");
        put("hand/package.xml", "");
        let urdf = workspace.join("arm/urdf/x.urdf");
        let hash = || hash_source(ROBOT_MODEL, &urdf).unwrap();
        let without = hash();
        put("hand/m.stl", "1");
        let first = hash();
        assert_ne!(first, without);
        put("hand/m.stl", "2");
        let second = hash();
        assert_ne!(second, first);
        put("arm/own.stl", "2");
        assert_ne!(hash(), second);
        put("hand/other.stl", "what is not referred to does not count");
        put("arm/own.stl", "1");
        assert_eq!(hash(), second);
        let _ = std::fs::remove_dir_all(workspace);
    }

    #[test]
    fn names_and_contents_cannot_be_traded() {
        let of = |entries: &[(&str, u8)]| {
            combine(
                &entries
                    .iter()
                    .map(|&(name, byte)| (name.to_owned(), ContentHash([byte; 32])))
                    .collect(),
            )
        };
        assert_ne!(of(&[("a", 1), ("b", 2)]), of(&[("a", 2), ("b", 1)]));
        assert_ne!(of(&[("ab", 1)]), of(&[("a", 1)]));
    }
}
