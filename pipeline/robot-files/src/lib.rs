//! Which files belong to a robot: the folder of a URDF, the packages that it names, and what a reference in it means.
//!
//! A robot is read by what its text says and hashed by it too, so the rule lives here, once. Plain references start from
//! the folder of the file that has them. `package://NAME/PATH` means a ROS package: a folder above the URDF of that name,
//! a package beside one of these folders, or one on the search path of ROS ([`SEARCH_VARIABLES`]). What the person named
//! may be made of links, and these are followed; only the text of a file may not lead out: after `..` is resolved, a
//! reference must lie in the robot's folder or in the package that it names.

mod packages;

use std::path::{Component, Path, PathBuf};

use packages::{is_package, search_path};

pub use packages::SEARCH_VARIABLES;

/// A reference that means no file of the robot.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("file reference `{reference}`: {what}")]
pub struct ReferenceError {
    /// The reference as written, perhaps shortened.
    pub reference: String,
    /// What is wrong, and what to do.
    pub what: String,
}

/// Resolves the file references of a robot description.
#[derive(Debug, Clone)]
pub struct RobotFolder {
    /// The robot's own folder, absolute.
    root: PathBuf,
    /// The folder of the URDF, absolute; relative references start from it.
    here: PathBuf,
    /// Folders that hold packages, by the environment.
    search: Vec<PathBuf>,
}

/// Folders that describe parts of a robot and lie in the robot's folder, by custom.
const PARTS: [&str; 5] = ["urdf", "urdfs", "robots", "robot", "xacro"];

/// Folders above the URDF that are looked at.
const LEVELS: usize = 6;

impl RobotFolder {
    /// The folder of a URDF file: the nearest of its directory and the three above that holds a `package.xml` (a ROS
    /// package); without one its directory, or the one above where it is called `urdf` or alike.
    ///
    /// # Errors
    /// When the path has no absolute form.
    pub fn of_urdf(urdf: &Path) -> std::io::Result<Self> {
        Self::with_search_path(urdf, search_path())
    }

    /// The same with folders that hold packages, instead of those of the environment.
    ///
    /// # Errors
    /// As [`RobotFolder::of_urdf`].
    pub fn with_search_path(urdf: &Path, search: Vec<PathBuf>) -> std::io::Result<Self> {
        let here = normalise(&std::path::absolute(urdf)?);
        let here = here.parent().map_or_else(|| PathBuf::from("/"), Path::to_owned);
        let package = here.ancestors().take(4).find(|folder| is_package(folder));
        let named_part = here
            .file_name()
            .is_some_and(|name| PARTS.iter().any(|part| name == *part));
        let custom = here.parent().filter(|above| named_part && above.parent().is_some());
        let root = package.or(custom).unwrap_or(&here).to_owned();
        Ok(Self { root, here, search })
    }

    /// The robot's own folder.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The folder of the URDF, absolute and without `..`.
    #[must_use]
    pub fn of_text(&self) -> &Path {
        &self.here
    }

    /// The file a reference of the URDF means: a path, from the URDF's directory or the robot's folder, or
    /// `package://NAME/PATH` (also `model://`), which is `PATH` in that package, else in the robot's folder or in its
    /// subfolder `NAME`. Percent signs may be escapes, and backslashes separators.
    ///
    /// # Errors
    /// When the reference leads out of the robot's folder and the package it names, to nothing, or to another place than a
    /// file of this machine.
    pub fn resolve(&self, reference: &str) -> Result<PathBuf, ReferenceError> {
        self.resolve_from(&self.here, reference)
    }

    /// The same for a reference written in a file of the robot, for example a buffer of a glTF file.
    ///
    /// # Errors
    /// As [`RobotFolder::resolve`].
    pub fn resolve_beside(&self, file: &Path, reference: &str) -> Result<PathBuf, ReferenceError> {
        self.resolve_from(file.parent().unwrap_or(&self.here), reference)
    }

    fn resolve_from(&self, start: &Path, written: &str) -> Result<PathBuf, ReferenceError> {
        let refuse = |what: String| ReferenceError {
            reference: shorten(written),
            what,
        };
        let reference = written.trim().replace('\\', "/");
        let of_package = ["package://", "model://"]
            .iter()
            .find_map(|scheme| reference.strip_prefix(scheme));
        let (package, path, bases) = if let Some(rest) = of_package {
            let (package, path) = rest
                .trim_start_matches('/')
                .split_once('/')
                .ok_or_else(|| refuse("it has no path after the package's name".into()))?;
            if matches!(package, "" | "." | "..") {
                return Err(refuse("it names no package".into()));
            }
            let mut bases = packages::folders(package, &self.here, &self.root, &self.search);
            bases.extend([self.root.clone(), self.root.join(package), start.to_owned()]);
            (Some(package), path.to_owned(), bases)
        } else if let Some(path) = reference.strip_prefix("file://") {
            (None, path.to_owned(), vec![start.to_owned()])
        } else if reference.contains("://") || reference.starts_with("data:") {
            return Err(refuse(
                "only files of this machine are read: a path or `package://NAME/PATH`".into(),
            ));
        } else {
            (None, reference.clone(), vec![start.to_owned(), self.root.clone()])
        };
        let is_drive = path.as_bytes().get(1) == Some(&b':') && path.as_bytes()[0].is_ascii_alphabetic();
        if path.is_empty() || path.contains('\0') || is_drive {
            return Err(refuse("it is no path on this machine".into()));
        }
        let mut looked: Vec<PathBuf> = Vec::new();
        let mut outside = false;
        for spelling in spellings(&path) {
            for base in &bases {
                let candidate = normalise(&base.join(&spelling));
                let allowed = [&self.root, &self.here, base].into_iter().chain(&self.search);
                if !allowed.into_iter().any(|folder| candidate.starts_with(folder)) {
                    outside = true;
                } else if candidate.is_file() {
                    return Ok(candidate);
                } else if !looked.contains(&candidate) {
                    looked.push(candidate);
                }
            }
        }
        Err(refuse(self.not_found(package, &looked, outside)))
    }

    fn not_found(&self, package: Option<&str>, looked: &[PathBuf], outside: bool) -> String {
        let shown: Vec<String> = looked
            .iter()
            .take(4)
            .map(|path| format!("`{}`", path.display()))
            .collect();
        if outside && shown.is_empty() {
            return format!(
                "it leads out of the robot's folder `{}`; put the file there, or the URDF into a folder above both, or refer \
                 to it as `package://NAME/PATH`",
                self.root.display()
            );
        }
        let shown = shown.join(", ");
        if let Some(near) = looked.iter().find_map(|path| other_case(path)) {
            return format!("no such file, looked for {shown}; there is `{near}`: capitals must agree");
        }
        match package {
            Some(package) => format!(
                "no such file, looked for {shown}; put the package `{package}` beside `{}`, or add the folder that holds it \
                 to ROS_PACKAGE_PATH",
                self.root.display()
            ),
            None => format!("no such file, looked for {shown}"),
        }
    }
}

/// What a text refers to: the value of every attribute `filename`, each once.
#[must_use]
pub fn references(urdf: &str) -> Vec<String> {
    let mut found = Vec::new();
    for rest in urdf.split("filename").skip(1) {
        let value = rest.trim_start().strip_prefix('=').map(str::trim_start);
        let Some(quote) = value
            .and_then(|value| value.chars().next())
            .filter(|c| matches!(c, '"' | '\''))
        else {
            continue;
        };
        let value = value
            .and_then(|value| value[1..].split(quote).next())
            .unwrap_or_default();
        let value = value
            .replace("&amp;", "&")
            .replace("&apos;", "'")
            .replace("&quot;", "\"");
        if !found.contains(&value) {
            found.push(value);
        }
    }
    found
}

/// A path as written, and with its percent escapes resolved where it has some.
fn spellings(path: &str) -> Vec<String> {
    let decoded = unescape(path);
    let mut spellings = vec![path.to_owned()];
    spellings.extend(decoded.filter(|decoded| decoded != path && !decoded.contains('\0')));
    spellings
}

fn unescape(text: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let [first, after @ ..] = rest {
        let escaped = (*first == b'%')
            .then(|| std::str::from_utf8(after.get(..2)?).ok())
            .flatten()
            .and_then(|digits| u8::from_str_radix(digits, 16).ok());
        bytes.push(escaped.unwrap_or(*first));
        rest = if escaped.is_some() { &after[2..] } else { after };
    }
    String::from_utf8(bytes).ok()
}

/// The name of a file that differs from a path in capitals alone.
fn other_case(path: &Path) -> Option<String> {
    let wanted = path.file_name()?.to_string_lossy().to_lowercase();
    let entries = std::fs::read_dir(path.parent()?).ok()?.take(2000);
    let names = entries.filter_map(|entry| Some(entry.ok()?.file_name().to_string_lossy().into_owned()));
    names.into_iter().find(|name| name.to_lowercase() == wanted)
}

/// Resolves `.` and `..` by the text alone: links above are the person's, and a reference is text.
fn normalise(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for component in path.components() {
        match component {
            Component::CurDir => {}
            Component::ParentDir => {
                out.pop();
            }
            other => out.push(other),
        }
    }
    out
}

fn shorten(reference: &str) -> String {
    let mut short: String = reference.chars().take(120).collect();
    if short.len() < reference.len() {
        short.push_str("...");
    }
    short
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
mod tests {
    use super::*;

    /// A folder with these files.
    fn tree(files: &[&str]) -> tempfile::TempDir {
        let outer = tempfile::tempdir().unwrap();
        for file in files {
            let path = outer.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"x").unwrap();
        }
        outer
    }

    fn folder(outer: &tempfile::TempDir, urdf: &str) -> RobotFolder {
        RobotFolder::with_search_path(&outer.path().join(urdf), Vec::new()).unwrap()
    }

    #[test]
    fn references_stay_in_the_folder() {
        let outer = tree(&["secret.stl", "robot_1/meshes/a b.stl", "robot_1/meshes/A.stl"]);
        let folder = folder(&outer, "robot_1/robot.urdf");
        let inside = outer.path().join("robot_1/meshes/A.stl").display().to_string();
        for reference in [
            "meshes/A.stl",
            " ./meshes/../meshes/A.stl",
            "package://anything/meshes/A.stl",
            "package:///anything/meshes/A.stl",
            "model://robot_1/meshes/A.stl",
            "meshes\\A.stl",
            "meshes/a b.stl",
            "meshes/a%20b.stl",
            inside.as_str(),
            &format!("file://{inside}"),
        ] {
            assert!(folder.resolve(reference).is_ok(), "{:?}", folder.resolve(reference));
        }
        let outside = outer.path().join("secret.stl").display().to_string();
        for (reference, words) in [
            ("../secret.stl", "leads out of the robot's folder"),
            ("meshes/../../secret.stl", "leads out"),
            ("%2e%2e/secret.stl", "no such file"),
            ("package://robot_1/../secret.stl", "no such file"),
            ("package://../secret.stl", "names no package"),
            (outside.as_str(), "leads out"),
            ("file:///etc/passwd", "leads out"),
            ("https://example.org/a.stl", "only files of this machine"),
            ("data:model/stl;base64,AAAA", "only files of this machine"),
            ("C:/robot/a.stl", "no path on this machine"),
            ("meshes/none.stl", "looked for"),
            ("meshes/a.stl", "capitals must agree"),
            ("package://robot_1", "no path after"),
            ("package://other_description/a.stl", "ROS_PACKAGE_PATH"),
            ("", "no path"),
            ("meshes", "no such file"),
        ] {
            let error = folder.resolve(reference).unwrap_err();
            assert!(error.what.contains(words), "{reference}: {error}");
        }
    }

    #[test]
    fn packages_of_clones_and_installed_workspaces_are_found() {
        let outer = tree(&[
            "ws/src/arm-main/package.xml",
            "ws/src/arm-main/urdf/x.urdf",
            "ws/src/gripper-fork/package.xml",
            "ws/src/gripper-fork/meshes/a.stl",
            "ws/install/arm/share/arm/package.xml",
            "ws/install/arm/share/arm/urdf/x.urdf",
            "ws/install/hand/share/hand/package.xml",
            "ws/install/hand/share/hand/meshes/a.stl",
        ]);
        let described = "<?xml version=\"1.0\"?><package format=\"3\">\n  <name> gripper_description </name></package>";
        std::fs::write(outer.path().join("ws/src/gripper-fork/package.xml"), described).unwrap();
        for (urdf, reference, place) in [
            (
                "ws/src/arm-main/urdf/x.urdf",
                "package://gripper_description/meshes/a.stl",
                "ws/src/gripper-fork/meshes/a.stl",
            ),
            (
                "ws/install/arm/share/arm/urdf/x.urdf",
                "package://hand/meshes/a.stl",
                "ws/install/hand/share/hand/meshes/a.stl",
            ),
        ] {
            let folder = RobotFolder::with_search_path(&outer.path().join(urdf), Vec::new()).unwrap();
            assert!(folder.resolve(reference).unwrap().ends_with(place), "{reference}");
            assert!(folder.resolve("package://gripper/meshes/a.stl").is_err());
        }
    }

    #[test]
    fn packages_are_found_where_ros_tools_find_them() {
        let outer = tree(&[
            "ws/src/arm/arm_description/package.xml",
            "ws/src/arm/arm_description/urdf/x.urdf",
            "ws/src/arm/arm_description/meshes/own.stl",
            "ws/src/arm/beside_description/meshes/a.stl",
            "ws/src/hand_description/package.xml",
            "ws/src/hand_description/meshes/a.stl",
            "ws/src/camera/camera_description/package.xml",
            "ws/src/camera/camera_description/meshes/a.stl",
            "opt/share/base_description/meshes/a.stl",
            "more/deep/down/lift_description/package.xml",
            "more/deep/down/lift_description/meshes/a.stl",
            "etc/passwd",
        ]);
        let search = vec![outer.path().join("opt"), outer.path().join("more")];
        let urdf = outer.path().join("ws/src/arm/arm_description/urdf/x.urdf");
        let folder = RobotFolder::with_search_path(&urdf, search).unwrap();
        assert!(folder.root().ends_with("arm_description"));
        for (reference, place) in [
            (
                "package://arm_description/meshes/own.stl",
                "arm_description/meshes/own.stl",
            ),
            (
                "package://src/arm/arm_description/meshes/own.stl",
                "arm_description/meshes/own.stl",
            ),
            ("../meshes/own.stl", "arm_description/meshes/own.stl"),
            (
                "package://beside_description/meshes/a.stl",
                "arm/beside_description/meshes/a.stl",
            ),
            (
                "package://hand_description/meshes/a.stl",
                "src/hand_description/meshes/a.stl",
            ),
            (
                "package://camera_description/meshes/a.stl",
                "camera/camera_description/meshes/a.stl",
            ),
            (
                "package://base_description/meshes/a.stl",
                "share/base_description/meshes/a.stl",
            ),
            (
                "package://lift_description/meshes/a.stl",
                "down/lift_description/meshes/a.stl",
            ),
        ] {
            assert!(folder.resolve(reference).unwrap().ends_with(place), "{reference}");
        }
        assert!(
            folder.resolve("package://etc/passwd").is_err(),
            "a folder far above is no package"
        );
    }

    #[test]
    fn the_folder_above_one_called_urdf_is_the_robot() {
        let outer = tree(&["xarm/urdf/x.urdf", "xarm/meshes/a.stl", "xarm/other/x.urdf"]);
        assert!(folder(&outer, "xarm/urdf/x.urdf").resolve("../meshes/a.stl").is_ok());
        assert!(folder(&outer, "xarm/urdf/x.urdf").resolve("meshes/a.stl").is_ok());
        assert!(folder(&outer, "xarm/other/x.urdf").resolve("../meshes/a.stl").is_err());
    }

    #[cfg(unix)]
    #[test]
    fn links_of_the_person_are_followed() {
        let outer = tree(&["blobs/1", "blobs/2"]);
        let robot = outer.path().join("snapshot/robot");
        std::fs::create_dir_all(robot.join("meshes")).unwrap();
        std::os::unix::fs::symlink("../../blobs/1", robot.join("x.urdf")).unwrap();
        std::os::unix::fs::symlink("../../../blobs/2", robot.join("meshes/a.stl")).unwrap();
        let folder = folder(&outer, "snapshot/robot/x.urdf");
        assert!(folder.resolve("meshes/a.stl").is_ok());
        assert!(folder.resolve("../../blobs/2").is_err());
    }

    #[test]
    fn references_are_found_in_text() {
        let text = "<mesh filename=\"a.stl\"/><texture filename = 'b&amp;c.png'/><mesh filename=\"a.stl\"/> filename <x filename=";
        assert_eq!(references(text), ["a.stl", "b&c.png"]);
    }
}
