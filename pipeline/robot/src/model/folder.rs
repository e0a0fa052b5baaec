//! The robot's folder: the only place from which meshes are read.

use std::io::Read as _;
use std::path::{Component, Path, PathBuf};

use crate::error::{Error, Result};

/// Resolves file references of a robot description and confines them to one folder.
#[derive(Debug, Clone)]
pub struct RobotFolder {
    /// Canonical path of the folder nothing leaves.
    root: PathBuf,
    /// Canonical folder that plain relative references start from.
    here: PathBuf,
}

impl RobotFolder {
    /// The folder of a URDF file: its own directory, or one of the two directories above it when that one holds a
    /// `package.xml` (the layout of a ROS package).
    ///
    /// # Errors
    /// When the directory does not exist.
    pub fn of_urdf(urdf: &Path) -> Result<Self> {
        let parent = urdf
            .parent()
            .filter(|parent| !parent.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        let here = canonical(parent)?;
        let package = here
            .ancestors()
            .take(3)
            .find(|folder| folder.join("package.xml").is_file());
        Ok(Self {
            root: package.unwrap_or(&here).to_owned(),
            here,
        })
    }

    /// The folder nothing leaves.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The file a reference of the URDF means: a relative path from the URDF's directory, or
    /// `package://NAME/PATH`, which is `PATH` under the robot's folder or under its subfolder `NAME`.
    ///
    /// # Errors
    /// When the reference is an absolute path, another URL, has `..`, leads out of the folder (also through a symbolic
    /// link) or to nothing.
    pub fn resolve(&self, reference: &str) -> Result<PathBuf> {
        self.resolve_from(&self.here, reference)
    }

    /// The same for a reference written in a file of the folder, for example a buffer of a glTF file.
    ///
    /// # Errors
    /// As [`RobotFolder::resolve`].
    pub fn resolve_beside(&self, file: &Path, reference: &str) -> Result<PathBuf> {
        self.resolve_from(file.parent().unwrap_or(&self.here), reference)
    }

    fn resolve_from(&self, start: &Path, reference: &str) -> Result<PathBuf> {
        let refuse = |what: &str| Error::Reference {
            reference: shorten(reference),
            what: what.to_owned(),
        };
        let (candidates, path) = if let Some(rest) = reference.strip_prefix("package://") {
            let (package, path) = rest
                .split_once('/')
                .ok_or_else(|| refuse("has no path after the package name"))?;
            check_components(Path::new(package)).map_err(refuse)?;
            (vec![self.root.clone(), self.root.join(package), start.to_owned()], path)
        } else if reference.contains("://") || reference.starts_with("data:") {
            return Err(refuse("only relative paths and `package://` references are read"));
        } else {
            (vec![start.to_owned()], reference)
        };
        if path.is_empty() || path.contains(['\0', '\\']) {
            return Err(refuse("is not a plain relative path"));
        }
        check_components(Path::new(path)).map_err(refuse)?;
        let found = candidates
            .iter()
            .map(|folder| folder.join(path))
            .find(|candidate| candidate.is_file());
        let found = found.ok_or_else(|| refuse("no such file in the robot's folder"))?;
        let resolved = canonical(&found)?;
        if resolved.starts_with(&self.root) {
            Ok(resolved)
        } else {
            Err(refuse("leads out of the robot's folder"))
        }
    }
}

fn check_components(path: &Path) -> std::result::Result<(), &'static str> {
    for component in path.components() {
        match component {
            Component::Normal(_) | Component::CurDir => {}
            Component::ParentDir => return Err("`..` is not allowed"),
            Component::RootDir | Component::Prefix(_) => return Err("absolute paths are not allowed"),
        }
    }
    Ok(())
}

fn shorten(reference: &str) -> String {
    let mut short: String = reference.chars().take(120).collect();
    if short.len() < reference.len() {
        short.push_str("...");
    }
    short
}

fn canonical(path: &Path) -> Result<PathBuf> {
    path.canonicalize().map_err(|source| Error::Io {
        action: "opening",
        path: path.to_owned(),
        source,
    })
}

/// Reads a file of at most `limit` bytes.
///
/// # Errors
/// When it cannot be read or is larger.
pub(crate) fn read_capped(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let failed = |source| Error::Io {
        action: "reading",
        path: path.to_owned(),
        source,
    };
    let file = std::fs::File::open(path).map_err(failed)?;
    let length = file.metadata().map_err(failed)?.len();
    let too_large = || Error::Reference {
        reference: path.display().to_string(),
        what: format!("larger than the limit of {} MiB", limit >> 20),
    };
    if length > limit {
        return Err(too_large());
    }
    let mut bytes = Vec::with_capacity(length as usize);
    file.take(limit + 1).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > limit {
        Err(too_large())
    } else {
        Ok(bytes)
    }
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
mod tests {
    use super::*;

    #[test]
    fn references_stay_in_the_folder() {
        let outer = tempfile::tempdir().unwrap();
        let robot = outer.path().join("robot");
        std::fs::create_dir_all(robot.join("meshes")).unwrap();
        std::fs::write(outer.path().join("secret.stl"), b"x").unwrap();
        std::fs::write(robot.join("meshes/a.stl"), b"x").unwrap();
        let folder = RobotFolder::of_urdf(&robot.join("robot.urdf")).unwrap();
        assert!(folder.resolve("meshes/a.stl").is_ok());
        assert!(folder.resolve("./meshes/a.stl").is_ok());
        assert!(folder.resolve("package://anything/meshes/a.stl").is_ok());
        let absolute = outer.path().join("secret.stl").display().to_string();
        let refused = [
            "../secret.stl",
            "meshes/../../secret.stl",
            "package://robot/../secret.stl",
            "package://../secret.stl",
            "file:///etc/passwd",
            "https://example.org/a.stl",
            "meshes/none.stl",
            "package://robot",
            "",
            "meshes",
            absolute.as_str(),
            "meshes\\a.stl",
        ];
        for reference in refused {
            assert!(folder.resolve(reference).is_err(), "{reference}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_symbolic_link_out_of_the_folder_is_refused() {
        let outer = tempfile::tempdir().unwrap();
        let robot = outer.path().join("robot");
        std::fs::create_dir_all(&robot).unwrap();
        std::fs::write(outer.path().join("secret.stl"), b"x").unwrap();
        std::os::unix::fs::symlink("../secret.stl", robot.join("a.stl")).unwrap();
        let folder = RobotFolder::of_urdf(&robot.join("robot.urdf")).unwrap();
        assert!(folder.resolve("a.stl").unwrap_err().to_string().contains("leads out"));
    }

    #[test]
    fn a_package_above_the_urdf_is_the_folder() {
        let outer = tempfile::tempdir().unwrap();
        let package = outer.path().join("panda_description");
        std::fs::create_dir_all(package.join("urdf")).unwrap();
        std::fs::create_dir_all(package.join("meshes")).unwrap();
        std::fs::write(package.join("package.xml"), b"<package/>").unwrap();
        std::fs::write(package.join("meshes/a.stl"), b"x").unwrap();
        let folder = RobotFolder::of_urdf(&package.join("urdf/robot.urdf")).unwrap();
        assert!(folder.resolve("package://panda_description/meshes/a.stl").is_ok());
    }

    #[test]
    fn large_files_are_refused_before_they_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.stl");
        std::fs::write(&path, vec![0; 2000]).unwrap();
        assert!(read_capped(&path, 1999).unwrap_err().to_string().contains("larger"));
        assert_eq!(read_capped(&path, 2000).unwrap().len(), 2000);
    }
}
