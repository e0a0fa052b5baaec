//! The invariants of ARCHITECTURE.md that can be read off the source tree.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod circles;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .nth(2)
        .unwrap()
        .to_path_buf()
}

/// Crate folders below the root, with the names of our crates in their `[dependencies]` (not dev-dependencies).
fn own_dependencies() -> BTreeMap<String, Vec<String>> {
    let root = root();
    let mut manifests = vec![root.join("schemas/Cargo.toml")];
    for group in ["pipeline", "stages", "tools"] {
        for entry in std::fs::read_dir(root.join(group)).unwrap() {
            let manifest = entry.unwrap().path().join("Cargo.toml");
            if manifest.exists() {
                manifests.push(manifest);
            }
        }
    }
    let read = |manifest: PathBuf| {
        let text = std::fs::read_to_string(&manifest).unwrap();
        let table: toml::Table = text.parse().unwrap();
        let name = table["package"]["name"].as_str().unwrap().to_owned();
        let dependencies = table.get("dependencies").and_then(toml::Value::as_table);
        let ours = dependencies
            .into_iter()
            .flatten()
            .map(|(name, _)| name.clone())
            .filter(|name| name.starts_with("rogs"));
        (name, ours.collect())
    };
    manifests.into_iter().map(read).collect()
}

/// Every Rust source of our crates outside tests, benches and examples.
fn sources() -> Vec<PathBuf> {
    fn walk(folder: &Path, out: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                if !["tests", "benches", "examples", "target", "fuzz"].contains(&name.as_str()) {
                    walk(&path, out);
                }
            } else if name.ends_with(".rs") {
                out.push(path);
            }
        }
    }
    let mut out = Vec::new();
    for group in ["schemas", "pipeline", "stages", "tools"] {
        walk(&root().join(group), &mut out);
    }
    out.sort();
    out
}

/// Lines of code: what comes before a `#[cfg(test)]` module, without comments.
fn code_lines(path: &Path) -> Vec<(usize, String)> {
    let text = std::fs::read_to_string(path).unwrap();
    let before_tests = text.split("#[cfg(test)]").next().unwrap();
    let strip = |(index, line): (usize, &str)| (index + 1, line.split("//").next().unwrap().to_owned());
    before_tests.lines().enumerate().map(strip).collect()
}

#[test]
fn dependencies_point_one_way() {
    let stages = [
        "ingest",
        "robot-maps",
        "conditioning",
        "agreement-stage",
        "references",
        "lift",
        "lift-4dgt",
        "lift-som",
        "refine",
        "fit",
        "score",
    ];
    let is_stage = |name: &str| name.strip_prefix("rogs-").is_some_and(|name| stages.contains(&name));
    let allowed = |name: &str| -> &[&str] {
        match name {
            "rogs-files" | "rogs-robot-files" | "rogs-schemas" | "rogs-arrays" | "rogs-random" | "rogs-pages"
            | "rogs-kernels" | "rogs-weights" => &[],
            "rogs-geometry" => &["rogs-schemas"],
            "rogs-r4c" => &["rogs-schemas", "rogs-robot-files"],
            "rogs-worker" => &["rogs-schemas", "rogs-r4c"],
            "rogs-robot" => &["rogs-schemas", "rogs-geometry", "rogs-robot-files"],
            "rogs-splat" => &["rogs-schemas", "rogs-geometry"],
            "rogs-field" => &["rogs-schemas", "rogs-geometry", "rogs-splat"],
            "rogs-video" => &["rogs-arrays"],
            "rogs-tensors" => &["rogs-schemas", "rogs-kernels", "rogs-weights", "rogs-splat"],
            "rogs-vit" => &["rogs-kernels", "rogs-tensors"],
            "rogs-4dgt" => &[
                "rogs-schemas",
                "rogs-geometry",
                "rogs-kernels",
                "rogs-weights",
                "rogs-tensors",
                "rogs-vit",
            ],
            "rogs-stage1" => &[
                "rogs-vit",
                "rogs-schemas",
                "rogs-geometry",
                "rogs-field",
                "rogs-kernels",
                "rogs-weights",
                "rogs-tensors",
            ],
            "rogs-stage2" => &[
                "rogs-schemas",
                "rogs-field",
                "rogs-kernels",
                "rogs-weights",
                "rogs-tensors",
            ],
            "rogs-agreement" => &["rogs-schemas", "rogs-geometry", "rogs-robot"],
            "rogs-calibration" => &["rogs-schemas", "rogs-geometry", "rogs-robot", "rogs-agreement"],
            "rogs-stereo" => &["rogs-schemas", "rogs-geometry", "rogs-kernels"],
            "rogs-optimise" => &["rogs-schemas", "rogs-geometry"],
            "rogs-lpips" => &["rogs-kernels", "rogs-weights", "rogs-tensors"],
            "rogs-orchestrator" => &["rogs-schemas", "rogs-r4c", "rogs-random"],
            "rogs-report" => &[
                "rogs-schemas",
                "rogs-r4c",
                "rogs-orchestrator",
                "rogs-pages",
                "rogs-score",
                "rogs-geometry",
                "rogs-robot",
                "rogs-field",
                "rogs-splat",
                "rogs-export",
            ],
            _ => &[
                "rogs-schemas",
                "rogs-r4c",
                "rogs-random",
                "rogs-arrays",
                "rogs-pages",
                "rogs-geometry",
                "rogs-robot",
                "rogs-splat",
                "rogs-field",
                "rogs-kernels",
                "rogs-weights",
                "rogs-tensors",
                "rogs-vit",
                "rogs-4dgt",
                "rogs-stage1",
                "rogs-stage2",
                "rogs-lpips",
                "rogs-optimise",
                "rogs-stereo",
                "rogs-agreement",
                "rogs-video",
                "rogs-export",
                "rogs-worker",
            ],
        }
    };
    for (name, dependencies) in own_dependencies() {
        if name == "rogs" {
            continue; // the command line carries everything
        }
        for dependency in dependencies {
            // Whoever writes files writes them whole.
            if dependency == "rogs-files" && !["rogs-schemas", "rogs-random", "rogs-pages"].contains(&name.as_str()) {
                continue;
            }
            // The report shows the tables that scoring makes.
            if name == "rogs-report" && dependency == "rogs-score" {
                continue;
            }
            // The Python package gives the metrics of scoring.
            if name == "rogs-python" && dependency == "rogs-score" {
                continue;
            }
            // The benchmark judges fields by the metrics of scoring, and writes the generator's robot beside real rooms.
            if name == "rogs-benchmark" && ["rogs-score", "rogs-synth"].contains(&dependency.as_str()) {
                continue;
            }
            // Training runs the generator and the stages up to refinement in memory.
            if name == "rogs-train" && (dependency == "rogs-synth" || is_stage(&dependency)) {
                continue;
            }
            assert!(!is_stage(&dependency), "`{name}` depends on the stage `{dependency}`");
            assert!(
                allowed(&name).contains(&dependency.as_str()),
                "`{name}` must not depend on `{dependency}`"
            );
        }
    }
}

#[test]
fn only_the_table_names_stages() {
    let table = root().join("pipeline/orchestrator/src/stage.rs");
    for path in sources() {
        let held = ["pipeline/orchestrator/src", "pipeline/rogs/src"];
        if path == table || !held.iter().any(|folder| path.starts_with(root().join(folder))) {
            continue;
        }
        for (line, code) in code_lines(&path) {
            for name in [
                "ingest",
                "robot-maps",
                "conditioning",
                "agreement",
                "references",
                "lift",
                "lift-4dgt",
                "lift-som",
                "refine",
                "fit",
                "score",
            ] {
                let quoted = format!("\"{name}\"");
                assert!(
                    !code.contains(&quoted),
                    "{}:{line} names a stage: use `StageId`",
                    path.display()
                );
            }
        }
    }
}

#[test]
fn only_the_codec_names_bincode() {
    for path in sources() {
        if path.ends_with("pipeline/r4c/src/codec.rs") {
            continue;
        }
        for (line, code) in code_lines(&path) {
            assert!(!code.contains("bincode::"), "{}:{line} names bincode", path.display());
        }
    }
}

/// What a name stands for may be a pipe, a device or a pointer to a file that was not fetched: `rogs_files` alone opens
/// files that people name.
#[test]
fn only_rogs_files_opens_files_for_reading() {
    // The first may be `/dev/stdin`, the second asks the system; tools are run by hand on files of their own.
    let free = [
        "pipeline/worker/src/params.rs",
        "pipeline/orchestrator/src/sys.rs",
        "pipeline/files",
        "tools",
    ];
    for path in sources() {
        let place = path.strip_prefix(root()).unwrap();
        // Tests that are files of their own.
        let of_tests = path
            .file_stem()
            .is_some_and(|stem| stem.to_string_lossy().ends_with("tests"));
        if of_tests || free.iter().any(|free| place.starts_with(free)) {
            continue;
        }
        for (line, code) in code_lines(&path) {
            for call in ["File::open(", "fs::read(", "fs::read_to_string("] {
                let begins =
                    |at: usize| !code[..at].ends_with(|before: char| before.is_alphanumeric() || before == '_');
                let found = code.match_indices(call).any(|(at, _)| begins(at));
                // Places of the system have names in the program.
                let of_system = ["\"/proc", "\"/sys"].iter().any(|place| code.contains(place));
                assert!(
                    !found || of_system,
                    "{}:{line} opens a file itself: use rogs_files",
                    place.display()
                );
            }
        }
    }
}

/// What is reconstructed is not what is scored: a stage asks the clip for the one or the other, and gets two types.
#[test]
fn stages_ask_a_clip_for_observations_or_targets() {
    let stages = [
        "robot-maps",
        "conditioning",
        "agreement",
        "lift",
        "lift-4dgt",
        "lift-som",
        "refine",
        "fit",
        "score",
    ]
    .map(|name| root().join("stages").join(name).join("src"));
    for path in sources()
        .into_iter()
        .filter(|path| stages.iter().any(|stage| path.starts_with(stage)))
    {
        for (line, code) in code_lines(&path) {
            for field in [".recorded", ".generated"] {
                assert!(
                    !code.contains(field),
                    "{}:{line} takes images from `{field}`: use Clip::observation or Clip::target",
                    path.display()
                );
            }
        }
    }
}

/// Whoever reads a record from elsewhere (another format, a socket, a test) can use `schemas` without a file.
#[test]
fn schemas_are_plain_data() {
    let folder = root().join("schemas/src");
    for path in sources().into_iter().filter(|path| path.starts_with(&folder)) {
        for (line, code) in code_lines(&path) {
            for place in [
                "fs::",
                "File",
                "std::io",
                "std::env",
                "std::process",
                "std::time",
                "std::net",
            ] {
                let found = code.match_indices(place).any(|(at, _)| {
                    let before = code[..at].chars().next_back();
                    let after = code[at + place.len()..].chars().next();
                    let word = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
                    !word(before) && (place.ends_with(':') || !word(after))
                });
                assert!(
                    !found,
                    "{}:{line} reaches outside (`{place}`): that is for rogs_r4c",
                    path.display()
                );
            }
        }
    }
}

#[test]
fn only_units_knows_the_scale() {
    let scale = |code: &str| {
        // A literal 3.5 that is a number of its own, not part of 13.5 or 3.54.
        code.match_indices("3.5").any(|(at, _)| {
            let before = code[..at].chars().next_back();
            let after = code[at + 3..].chars().next();
            let digit = |c: Option<char>| c.is_some_and(|c| c.is_ascii_digit() || c == '.' || c == '_');
            !digit(before) && !digit(after)
        })
    };
    for path in sources() {
        // Procedural scenes have lengths of their own, in metres.
        if path.ends_with("schemas/src/units.rs") || path.starts_with(root().join("tools/synth")) {
            continue;
        }
        for (line, code) in code_lines(&path) {
            let quoted = code.contains('"');
            assert!(
                quoted || !scale(&code),
                "{}:{line} writes the internal scale again: {code}",
                path.display()
            );
        }
    }
}

#[test]
fn files_do_not_import_each_other_in_circles() {
    let mut folders = vec![root().join("schemas/src")];
    for group in ["pipeline", "stages", "tools"] {
        let crates = std::fs::read_dir(root().join(group)).unwrap();
        folders.extend(
            crates
                .map(|entry| entry.unwrap().path().join("src"))
                .filter(|src| src.is_dir()),
        );
    }
    let circles = folders.iter().flat_map(|src| {
        let own = circles::Crate::read(src).circles().into_iter();
        own.map(move |files| format!("{}: {}", src.display(), files.join(", ")))
    });
    let circles: Vec<String> = circles.collect();
    assert!(circles.is_empty(), "circles:\n{}", circles.join("\n"));
}
