//! A throw-away folder with procedural episodes and a manifest, and the program to run on it.
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
#![allow(dead_code)] // Every test program takes what it needs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

/// The program under test.
pub(crate) const ROGS: &str = env!("CARGO_BIN_EXE_rogs");

/// A folder that goes away with the value.
pub(crate) struct Workspace {
    folder: tempfile::TempDir,
}

impl Workspace {
    /// `episodes` procedural episodes in `episodes/`, their robot in `robot/`, and a manifest at a small size.
    pub(crate) fn with_episodes(episodes: usize) -> Self {
        Self::of_size(episodes, "140x84", "33")
    }

    /// The same as small and short as they can be: for tests that are not about what is in the outputs.
    pub(crate) fn small(episodes: usize) -> Self {
        Self::of_size(episodes, "56x42", "17")
    }

    /// An empty folder.
    pub(crate) fn empty() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
        }
    }

    fn of_size(episodes: usize, size: &str, frames: &str) -> Self {
        let workspace = Self::empty();
        let dataset = workspace.path("data");
        let made = Command::new(ROGS)
            .args([
                "synth",
                "--episodes",
                &episodes.to_string(),
                "--seed",
                "11",
                "--size",
                size,
                "--frames",
                frames,
                "--out",
            ])
            .arg(&dataset)
            .output()
            .unwrap();
        assert!(
            made.status.success(),
            "synth failed: {}",
            String::from_utf8_lossy(&made.stderr)
        );
        workspace.manifest("manifest.toml", "run");
        workspace
    }

    /// Writes a manifest `name` over the procedural episodes with the run folder `out`.
    pub(crate) fn manifest(&self, name: &str, out: &str) {
        let written = std::fs::read_to_string(self.path("data/manifest.toml")).unwrap();
        // The stage that checks calibrations has tests of its own.
        let out = format!("out = {:?}\nagreement = false", self.path(out));
        let mut lines: Vec<String> = written
            .lines()
            .map(|line| line.replace("\"episodes\"", "\"data/episodes\""))
            .collect();
        for line in &mut lines {
            if line.starts_with("out = ") {
                line.clone_from(&out);
            }
            *line = line
                .replace("urdf = \"", "urdf = \"data/")
                // One update of an untrained refiner: the tests are about files, not about quality, and about the warning.
                .replace("refine = \"builtin\"", "refine = \"seeded\"");
        }
        self.write(name, &(lines.join("\n").replace("updates = 4", "updates = 1") + "\n"));
    }

    /// A path inside.
    pub(crate) fn path(&self, relative: &str) -> PathBuf {
        self.folder.path().join(relative)
    }

    /// Writes a text file.
    pub(crate) fn write(&self, relative: &str, text: &str) {
        std::fs::write(self.path(relative), text).unwrap();
    }

    /// Runs the program in the folder.
    pub(crate) fn rogs(&self, arguments: &[&str]) -> Output {
        Command::new(ROGS)
            .args(arguments)
            .current_dir(self.folder.path())
            .output()
            .unwrap()
    }

    /// Runs the program and reads its one JSON value.
    pub(crate) fn rogs_json(&self, arguments: &[&str]) -> (Option<i32>, Value) {
        let output = self.rogs(arguments);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        let value = serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|error| panic!("`rogs {}` printed no JSON ({error}): {stderr}", arguments.join(" ")));
        (output.status.code(), value)
    }

    /// Every output file of a run with its bytes, by path.
    pub(crate) fn outputs(&self, run: &str) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut files = BTreeMap::new();
        collect(&self.path(run).join("clips"), &self.path(run), &mut files);
        files
    }

    /// Names of temporary files left anywhere in a run.
    pub(crate) fn leftovers(&self, run: &str) -> Vec<PathBuf> {
        let mut all = Vec::new();
        names(&self.path(run), &mut all);
        all.retain(|path| path.extension().is_some_and(|extension| extension == "tmp"));
        all
    }
}

fn names(folder: &Path, out: &mut Vec<PathBuf>) {
    // A folder that is not there yet holds nothing; files may come and go during a run.
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            names(&path, out);
        } else {
            out.push(path);
        }
    }
}

fn collect(folder: &Path, root: &Path, files: &mut BTreeMap<PathBuf, Vec<u8>>) {
    let mut all = Vec::new();
    names(folder, &mut all);
    for path in all {
        if path.extension().is_some_and(|extension| extension == "r4c") {
            files.insert(
                path.strip_prefix(root).unwrap().to_path_buf(),
                std::fs::read(&path).unwrap(),
            );
        }
    }
}
