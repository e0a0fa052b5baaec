//! Copies of a good episode with a damage each, and what must be said about them.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::Workspace;

/// The one episode that `synth` makes with this seed.
pub(crate) const GOOD: &str = "synth-00000011";

/// What a damaged episode leads to.
pub(crate) enum Said {
    /// The clip fails; message and hint contain these words.
    Failure(&'static str, &'static str),
    /// The clip is made, with a warning that contains these words.
    Warning(&'static str),
    /// The clip is made, and nothing is said.
    Nothing,
}

pub(crate) use Said::{Failure, Nothing, Warning};

/// Copies of the good episode, each with its damage and what must be said about it; all go through one run.
pub(crate) struct Cases {
    pub(crate) workspace: Workspace,
    expected: BTreeMap<String, Said>,
}

impl Cases {
    /// The run stops behind the robot's maps.
    pub(crate) fn new() -> Self {
        let workspace = Workspace::small(1);
        let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
        let manifest = manifest.replacen("[run]\n", "[run]\nstages = [\"robot-maps\"]\n", 1);
        workspace.write("manifest.toml", &manifest);
        Self {
            workspace,
            expected: BTreeMap::from([(GOOD.to_owned(), Nothing)]),
        }
    }

    /// A copy of the good episode under another name, to be damaged.
    pub(crate) fn add(&mut self, name: &str, said: Said) -> PathBuf {
        let episodes = self.workspace.path("data/episodes");
        let (from, to) = (episodes.join(GOOD), episodes.join(name));
        // Neither of these is read by the stages of these tests.
        copy(&from, &to, &["ids", "tracks", "synth.json"]);
        edit(&to, |episode| {
            episode["episode_id"] = name.into();
            episode.as_object_mut().unwrap().remove("tracks");
        });
        assert!(self.expected.insert(name.to_owned(), said).is_none());
        to
    }

    pub(crate) fn edited(&mut self, name: &str, said: Said, change: impl FnOnce(&mut Value)) {
        edit(&self.add(name, said), change);
    }

    /// Changes the table of states; the first line is the header.
    pub(crate) fn states(&mut self, name: &str, said: Said, change: impl FnOnce(&mut Vec<Vec<String>>)) {
        let path = self.add(name, said).join("joints.csv");
        let text = std::fs::read_to_string(&path).unwrap();
        let mut rows: Vec<Vec<String>> = text
            .lines()
            .map(|line| line.split(',').map(String::from).collect())
            .collect();
        change(&mut rows);
        let lines: Vec<String> = rows.iter().map(|row| row.join(",")).collect();
        std::fs::write(path, lines.join("\n") + "\n").unwrap();
    }

    /// Runs everything and compares.
    pub(crate) fn check(&self) {
        let (code, summary) = self
            .workspace
            .rogs_json(&["run", "manifest.toml", "--no-report", "--json"]);
        let failures = summary["failures"].as_array().unwrap();
        let warnings: Vec<&str> = summary["warnings"]
            .as_array()
            .unwrap()
            .iter()
            .map(|text| text.as_str().unwrap())
            .collect();
        let expected = self
            .expected
            .values()
            .filter(|said| matches!(said, Failure(..)))
            .count();
        assert_eq!(code, Some(if expected > 0 { 3 } else { 0 }), "{summary:#}");
        for (clip, said) in &self.expected {
            let failure = failures.iter().find(|failure| failure["clip"] == clip.as_str());
            let of_clip: Vec<&&str> = warnings
                .iter()
                .filter(|text| text.starts_with(&format!("{clip} ")))
                .collect();
            match said {
                Failure(message, hint) => {
                    let failure = failure.unwrap_or_else(|| panic!("`{clip}` did not fail: {of_clip:?}"));
                    let text = |key: &str| failure[key].as_str().unwrap_or_default().to_owned();
                    assert!(text("message").contains(message), "{clip}: {failure:#}");
                    assert!(text("hint").contains(hint), "{clip}: {failure:#}");
                    assert_eq!(failure["code"], "bad_input", "{clip}");
                }
                Warning(words) => {
                    assert!(failure.is_none(), "{clip}: {failure:?}");
                    assert!(of_clip.iter().any(|text| text.contains(words)), "{clip}: {of_clip:?}");
                }
                Nothing => assert!(
                    failure.is_none() && of_clip.is_empty(),
                    "{clip}: {failure:?} {of_clip:?}"
                ),
            }
        }
        assert_eq!(failures.len(), expected, "{summary:#}");
    }
}

pub(crate) fn copy(from: &Path, to: &Path, without: &[&str]) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap();
        if without.iter().any(|left_out| name == *left_out) {
            continue;
        }
        if path.is_dir() {
            copy(&path, &to.join(name), without);
        } else {
            std::fs::copy(&path, to.join(name)).unwrap();
        }
    }
}

/// Changes the description of an episode.
pub(crate) fn edit(folder: &Path, change: impl FnOnce(&mut Value)) {
    let path = folder.join("episode.json");
    let mut value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    change(&mut value);
    std::fs::write(path, value.to_string()).unwrap();
}

/// The camera-to-base matrix of the first fixed camera.
pub(crate) fn fixed(episode: &mut Value) -> &mut Value {
    let cameras = episode["cameras"].as_array_mut().unwrap();
    let camera = cameras.iter_mut().find(|camera| camera["id"] == "ext1").unwrap();
    &mut camera["mount"]["fixed"]["base_from_camera"]
}

pub(crate) fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

/// Runs a manifest with something replaced in it, and returns exit code and what was said.
pub(crate) fn altered(workspace: &Workspace, from: &str, to: &str) -> (Option<i32>, String) {
    let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    assert!(manifest.contains(from), "`{from}` is not in the manifest");
    workspace.write("altered.toml", &manifest.replacen(from, to, 1));
    let output = workspace.rogs(&["run", "altered.toml", "--no-report"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(!text.contains("panicked"), "{text}");
    (output.status.code(), text)
}
