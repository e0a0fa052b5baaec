//! The committed episode and outputs in `tests/golden`, and a run folder made of them.
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
#![allow(dead_code)] // Every test program takes what it needs.

use std::path::{Path, PathBuf};
use std::process::Command;

/// The program under test.
pub(crate) const ROGS: &str = env!("CARGO_BIN_EXE_rogs");

/// The committed episode.
pub(crate) const CLIP: &str = "synth-00000011";

/// The bundled weights as the manifest names them.
pub(crate) const LIFT_WEIGHTS: (&str, &[u8]) = ("compact-stage1.safetensors", rogs_lift::COMPACT_WEIGHTS);
pub(crate) const REFINE_WEIGHTS: (&str, &[u8]) = ("ci-stage2.safetensors", rogs_refine::CI_WEIGHTS);

/// `tests/golden`.
pub(crate) fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden")
}

/// The committed outputs of the stages.
pub(crate) fn outputs() -> PathBuf {
    folder().join("outputs")
}

/// Whether expectations are written instead of checked: the variable of `expect-test`, for everything.
pub(crate) fn updating() -> bool {
    std::env::var_os("UPDATE_EXPECT").is_some()
}

/// A copy of the committed episode with its manifest, and of the outputs in a run folder.
pub(crate) struct GoldenRun {
    folder: tempfile::TempDir,
}

impl GoldenRun {
    /// With the committed outputs in place.
    pub(crate) fn new() -> Self {
        let run = Self::without_outputs();
        std::fs::create_dir_all(run.clip_folder()).unwrap();
        for entry in std::fs::read_dir(outputs()).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|extension| extension == "r4c") {
                std::fs::copy(&path, run.clip_folder().join(path.file_name().unwrap())).unwrap();
            }
        }
        run
    }

    /// With nothing made.
    pub(crate) fn without_outputs() -> Self {
        let run = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        copy(&folder().join("data"), run.folder.path());
        for (file, weights) in [LIFT_WEIGHTS, REFINE_WEIGHTS] {
            std::fs::write(run.folder.path().join(file), weights).unwrap();
        }
        run
    }

    /// Where `manifest.toml` lies.
    pub(crate) fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Where the outputs of the clip lie.
    pub(crate) fn clip_folder(&self) -> PathBuf {
        self.path().join("run/clips").join(CLIP)
    }

    /// Runs the program beside the manifest; its standard output.
    pub(crate) fn rogs(&self, arguments: &[&str]) -> String {
        let output = Command::new(ROGS)
            .args(arguments)
            .current_dir(self.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "rogs {}: {said}", arguments.join(" "));
        String::from_utf8(output.stdout).unwrap()
    }
}

/// Copies a folder; the copies are writable.
fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &target);
        } else {
            std::fs::write(target, std::fs::read(path).unwrap()).unwrap();
        }
    }
}
