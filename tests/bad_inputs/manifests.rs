//! Manifests, names of clips and paths in episodes.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::process::Command;

use crate::cases::{Cases, Failure, GOOD, Nothing, altered};
use crate::support::{ROGS, Workspace};

#[test]
fn manifests() {
    let workspace = Workspace::small(1);
    let refused = |from: &str, to: &str, words: &str| {
        let (code, text) = altered(&workspace, from, to);
        assert_eq!(code, Some(2), "{to}: {text}");
        assert!(text.contains(words), "{to}: {text}");
        assert!(!workspace.path("run").exists(), "{to}: something was written");
    };
    let episode = |more: &str| format!("[[episodes]]\nroot = \"data/episodes/{GOOD}\"\n{more}\n[robot]\n");
    for id in ["../../etc", "/etc/passwd", "..", ".", "-rf", "a\\nb", "a b", "", "c:d"] {
        refused("[robot]\n", &episode(&format!("id = \"{id}\"")), "invalid clip name");
    }
    let long = "x".repeat(129);
    refused("[robot]\n", &episode(&format!("id = \"{long}\"")), "1 to 128");
    refused(
        "[robot]\n",
        &(episode("") + &episode("")).replacen("[robot]\n", "", 1),
        "is named twice",
    );
    let two = episode("id = \"Clip\"") + &episode("id = \"clip\"");
    refused(
        "[robot]\n",
        &two.replacen("[robot]\n", "", 1),
        "two episodes have the id `clip`",
    );
    refused("[input]\n", "[input]\nrot = \"x\"\n", "did you mean `root`?");
    refused("[run]\n", "[run]\nstages = [\"lifft\"]\n", "did you mean `lift`?");
    // Everything that is not there, at once.
    let workspace_text = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    workspace.write(
        "gone.toml",
        &workspace_text
            .replace("panda_synth.urdf", "gone.urdf")
            .replace("data/episodes", "nowhere"),
    );
    let output = workspace.rogs(&["plan", "gone.toml"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(
        said.contains("gone.urdf` is not there, nor `") && said.contains("nowhere` (input.root)"),
        "{said}"
    );
    // All parameters that no stage knows, at once.
    let both = "[ingest]\nhieght = 84\nwidht = 154\n";
    refused("[ingest]\n", both, "unknown parameter `hieght` of `ingest`");
    refused(
        "[ingest]\n",
        both,
        "also: unknown parameter `widht` of `ingest` (did you mean `width`?)",
    );
    refused("[run]\n", "[run]\n\"\\u0000\" = 1\n", "altered.toml:");
    refused("[run]\n", "[run\n", "altered.toml:2");
    refused("data/episodes", "nowhere", "is not a folder");
    refused("panda_synth.urdf", "gone.urdf", "gone.urdf");
    refused("lift = \"builtin\"", "lift = \"nowhere/lift\"", "nowhere/");
    // A link that leads to something else; a text that leads out of the episode.
    let mut cases = Cases::new();
    let folder = cases.add("link", Failure("there is no column", ""));
    std::fs::remove_file(folder.join("joints.csv")).unwrap();
    std::os::unix::fs::symlink("/etc/passwd", folder.join("joints.csv")).unwrap();
    cases.edited("up", Failure("does not stay inside the folder", ""), |episode| {
        episode["robot"]["states"] = "../../../secret.csv".into();
    });
    cases.edited("control", Failure("no control characters", ""), |episode| {
        episode["episode_id"] = "a\nb".into()
    });
    cases.edited("unknown", Failure("frame_rate", ""), |episode| {
        episode["frame_rate"] = 15.into()
    });
    // Two ids that are one file on some disks, and one that is not a file name: each clip has its own folder.
    cases.edited("first", Nothing, |episode| {
        episode["episode_id"] = "LAB+One+12h:00m".into()
    });
    cases.edited("second", Nothing, |episode| {
        episode["episode_id"] = "lab+one+12h:00m".into()
    });
    cases.check();
    let clips: Vec<String> = std::fs::read_dir(cases.workspace.path("run/clips"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap().to_lowercase())
        .filter(|name| name.starts_with("lab+one+12h_00m"))
        .collect();
    assert_eq!(clips.len(), 2, "{clips:?}");
    assert_ne!(clips[0], clips[1]);
}

/// What `rogs plan` says of a manifest with 2 GiB to live in, and its exit code.
fn planned(workspace: &Workspace, manifest: &str) -> (Option<i32>, String) {
    let limited = format!("ulimit -v {}; exec '{ROGS}' plan '{manifest}'", 2 << 20);
    let output = Command::new("sh")
        .args(["-c", &limited])
        .current_dir(workspace.path("."))
        .env("RAYON_NUM_THREADS", "2")
        .output()
        .unwrap();
    (
        output.status.code(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

#[test]
#[cfg(target_os = "linux")]
fn manifests_of_any_size_take_little_memory() {
    let workspace = Workspace::small(1);
    let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    let (input, rest) = manifest.split_once("[input]\n").unwrap();
    let rest = rest.split_once("[robot]\n").unwrap().1;
    let with = |count: usize, more: &str| {
        let mut text = format!("{input}[robot]\n{rest}\n");
        for index in 0..count {
            text += &format!("[[episodes]]\nroot = \"data/episodes\"\nid = \"e{index}\"\n");
        }
        workspace.write("many.toml", &(text + more));
        planned(&workspace, "many.toml")
    };
    // A million entries are more than a manifest holds: refused before anything is made of them.
    let (code, said) = with(1_000_000, "");
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("many.toml` is larger than 16 MiB"), "{said}");
    assert!(said.contains("name a folder of episodes under `[input]`"), "{said}");
    // A hundred thousand: what is wrong with the last one is found.
    let (code, said) = with(100_000, "[[episodes]]\nrot = \"x\"\n");
    assert_eq!(code, Some(2), "{said}");
    assert!(
        said.contains("many.toml:300") && said.contains("did you mean `root`?"),
        "{said}"
    );
    let (code, said) = with(100_000, "[[episodes]]\nroot = \"data/episodes\"\nid = \"E7\"\n");
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("two episodes have the id `E7`"), "{said}");
    // No end of it, and no text.
    let (code, said) = planned(&workspace, "/dev/zero");
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("/dev/zero`: it is a device"), "{said}");
    std::fs::write(workspace.path("latin.toml"), b"[run]\nname = \"caf\xe9\"\n").unwrap();
    let (code, said) = planned(&workspace, "latin.toml");
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("latin.toml` line 2: not UTF-8 text"), "{said}");
}
