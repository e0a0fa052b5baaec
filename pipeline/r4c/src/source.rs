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
/// When the file cannot be read.
pub fn hash_file(path: &Path) -> Result<ContentHash> {
    let io = |source| Error::Io {
        action: "reading",
        path: path.to_owned(),
        source,
    };
    let mut hasher = blake3::Hasher::new();
    hasher
        .update_reader(std::fs::File::open(path).map_err(io)?)
        .map_err(io)?;
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

/// The files that make up a source, by the names they are hashed under: of a folder every file in it; of a robot model
/// every file in the URDF's folder, and which of them is the URDF; of any other file itself, under an empty name.
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
        walk(path, path, &mut files)?;
    } else if role == ROBOT_MODEL {
        let folder = path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        walk(folder, folder, &mut files)?;
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

fn walk(root: &Path, folder: &Path, files: &mut BTreeMap<String, PathBuf>) -> Result<()> {
    let io = |source| Error::Io {
        action: "listing",
        path: folder.to_owned(),
        source,
    };
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let entry = entry.map_err(io)?;
        let (kind, path) = (entry.file_type().map_err(io)?, entry.path());
        if kind.is_dir() {
            walk(root, &path, files)?;
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
            std::fs::write(root.join("robot.urdf"), "<robot/>").unwrap();
            std::fs::write(root.join("meshes/link.stl"), "solid").unwrap();
        }
        let hash = |root: &Path| hash_source(ROBOT_MODEL, &root.join("robot.urdf")).unwrap();
        assert_eq!(hash(&a), hash(&b));
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
