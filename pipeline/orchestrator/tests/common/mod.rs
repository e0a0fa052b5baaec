//! A folder with toy episodes and a manifest, and ways to run it, see `examples/toy_pipeline.rs`.
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
#![allow(dead_code, unreachable_pub)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rogs_orchestrator::Prepared;
use rogs_orchestrator::executor::{ProgressMode, RunSummary};
use rogs_orchestrator::programs::StagePrograms;

/// `cargo test` builds examples beside the tests.
pub fn example(name: &str) -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let path = test.ancestors().nth(2).unwrap().join("examples").join(name);
    assert!(
        path.exists(),
        "run all targets of the crate (`cargo test -p rogs-orchestrator`), so that examples are built"
    );
    path
}

pub fn programs() -> StagePrograms {
    StagePrograms::Embedded {
        program: example("toy_pipeline"),
        prefix: vec!["stage".into()],
    }
}

pub struct Workspace {
    folder: tempfile::TempDir,
    /// Below the folder.
    name: &'static str,
}

impl Workspace {
    /// Three good episodes.
    pub fn new() -> Self {
        Self::below("")
    }

    /// The same in a folder of this name.
    pub fn below(name: &'static str) -> Self {
        let workspace = Self {
            folder: tempfile::tempdir().unwrap(),
            name,
        };
        for (name, text) in [("a", "one"), ("b", "two"), ("c", "three")] {
            workspace.episode(name, text);
        }
        workspace.write("robot/robot.urdf", "<robot/>");
        workspace.manifest("");
        workspace
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(self.name).join(name)
    }

    pub fn run_folder(&self) -> PathBuf {
        self.path("run")
    }

    pub fn write(&self, name: &str, text: &str) {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }

    /// Writes a program.
    pub fn script(&self, name: &str, text: &str) {
        self.write(name, text);
        let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
        std::fs::set_permissions(self.path(name), mode).unwrap();
    }

    pub fn episode(&self, name: &str, text: &str) {
        self.write(&format!("episodes/{name}.txt"), text);
    }

    /// A manifest with more at its end.
    pub fn manifest(&self, more: &str) {
        let text = "[run]\nname = \"toy\"\nout = \"run\"\nagreement = false\n[input]\nroot = \"episodes\"\n\n[robot]\nurdf = \"robot/robot.urdf\"\n\n";
        self.write("toy.toml", &format!("{text}{more}"));
    }

    pub fn try_prepare(&self) -> rogs_orchestrator::Result<Prepared> {
        let mut prepared = Prepared::load(&self.path("toy.toml"), programs())?;
        prepared.options.progress = ProgressMode::Silent;
        prepared.options.workers = 2;
        prepared.options.threads = 1;
        Ok(prepared)
    }

    pub fn prepare(&self) -> Prepared {
        self.try_prepare().unwrap()
    }

    pub fn run(&self) -> RunSummary {
        self.prepare().run().unwrap()
    }

    /// Every output of the run by its path below the run folder.
    pub fn outputs(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut outputs = BTreeMap::new();
        collect(&self.run_folder(), &self.run_folder(), &mut outputs);
        outputs
    }

    /// Fails with the names of files that writers left behind.
    #[track_caller]
    pub fn assert_no_temporaries(&self) {
        let found = self.temporaries();
        assert!(found.is_empty(), "left behind: {found:?}");
    }

    /// Files that writers left behind.
    pub fn temporaries(&self) -> Vec<PathBuf> {
        let mut found = Vec::new();
        walk(&self.run_folder(), &mut |path| {
            if path.extension().is_some_and(|extension| extension == "tmp") {
                found.push(path.to_owned());
            }
        });
        found
    }
}

fn collect(root: &Path, folder: &Path, outputs: &mut BTreeMap<PathBuf, Vec<u8>>) {
    walk(folder, &mut |path| {
        if path.extension().is_some_and(|extension| extension == "r4c") {
            outputs.insert(
                path.strip_prefix(root).unwrap().to_owned(),
                std::fs::read(path).unwrap(),
            );
        }
    });
}

pub fn walk(folder: &Path, visit: &mut dyn FnMut(&Path)) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            walk(&path, visit)
        } else {
            visit(&path)
        }
    }
}
