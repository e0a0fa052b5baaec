//! A run whose episodes have their depth and tracks in caches of PointWorld.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::process::Command;

use rogs_schemas::records::robot::RobotSpec;
use rogs_synth::{
    EPISODES_FOLDER, ROBOT_FOLDER, ROBOT_SPEC_FILE, ROBOT_URDF_FILE, Resolution, SynthConfig, generate_episode,
    write_dataset, write_pointworld,
};
use serde_json::Value;

#[test]
fn a_run_takes_the_caches_of_its_episodes_and_scores_by_them() {
    let config = SynthConfig {
        resolution: Resolution {
            wrist: [84, 140],
            external: [84, 140],
        },
        ..SynthConfig::default()
    };
    let folder = tempfile::tempdir().unwrap();
    write_dataset(folder.path(), 1, 11, &config).unwrap();
    let episode = generate_episode(&config, 11).unwrap();
    write_pointworld(&folder.path().join("cache"), &episode).unwrap();
    let path = |name: &str| folder.path().join(name);
    // What a clip has of depth and tracks is then of the cache.
    let description = path(EPISODES_FOLDER).join(episode.id()).join("episode.json");
    let mut text: Value = serde_json::from_slice(&std::fs::read(&description).unwrap()).unwrap();
    text.as_object_mut().unwrap().remove("tracks");
    for camera in text["cameras"].as_array_mut().unwrap() {
        camera.as_object_mut().unwrap().remove("depth");
    }
    std::fs::write(&description, text.to_string()).unwrap();
    let spec = std::fs::read(path(ROBOT_FOLDER).join(ROBOT_SPEC_FILE)).unwrap();
    let spec: RobotSpec = serde_json::from_slice(&spec).unwrap();
    let text = format!(
        "[run]\nname = \"cached\"\nout = \"run\"\nagreement = false\n[input]\nroot = \"{EPISODES_FOLDER}\"\npointworld = \"cache\"\n\
         [robot]\nurdf = \"{ROBOT_FOLDER}/{ROBOT_URDF_FILE}\"\n[robot.spec]\n{}\n\
         [ingest]\nheight = 84\nwidth = 140\n[refine]\npreset = \"ci\"\nupdates = 1\n",
        toml::to_string(&spec).unwrap()
    );
    std::fs::write(path("manifest.toml"), text).unwrap();
    let rogs = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_rogs"))
            .args(arguments)
            .current_dir(path(""))
            .output();
        let output = output.unwrap();
        let (out, err) = (
            String::from_utf8_lossy(&output.stdout).into_owned(),
            String::from_utf8_lossy(&output.stderr),
        );
        assert!(output.status.success(), "{arguments:?}: {out}{err}");
        out
    };
    let plan = rogs(&["plan", "manifest.toml"]);
    for role in ["cameras", "depth", "flows"] {
        assert!(plan.contains(&format!("pointworld-{role}: 1 of 1 clips")), "{plan}");
    }
    assert!(plan.contains("from frame 7, where the paper's clips start"), "{plan}");
    rogs(&["run", "manifest.toml", "--no-report"]);
    let clip = format!("run/clips/{}/clip.r4c", episode.id());
    assert!(rogs(&["inspect", &clip]).contains("its frames 7 to 23"));
    // Depth errors and end-point errors have values: the references of the cache are what they are measured by.
    let scores = rogs(&["table", "run", "--format", "csv"]);
    let line = scores.lines().find(|line| line.contains("Stage 1)")).unwrap();
    println!("{scores}");
    assert!(
        line.split(',').filter(|cell| cell.parse::<f64>().is_ok()).count() >= 4,
        "{line}"
    );
    // Another file in the cache is another key.
    let before: Value = serde_json::from_str(&rogs(&["plan", "manifest.toml", "--json"])).unwrap();
    assert_eq!(before["nodes"][0]["up_to_date"], 1);
    std::fs::remove_dir_all(path("cache/flows")).unwrap();
    let after: Value = serde_json::from_str(&rogs(&["plan", "manifest.toml", "--json"])).unwrap();
    assert_eq!(
        (
            &after["nodes"][0]["up_to_date"],
            &after["references"]["pointworld-flows"]
        ),
        (&0.into(), &0.into())
    );
}

#[test]
fn a_cohort_of_a_folder_is_drawn_once_and_run() {
    let config = SynthConfig {
        resolution: Resolution {
            wrist: [28, 42],
            external: [28, 42],
        },
        ..SynthConfig::default()
    };
    let folder = tempfile::tempdir().unwrap();
    write_dataset(folder.path(), 2, 11, &config).unwrap();
    let rogs = |arguments: &[&str]| {
        let program = env!("CARGO_BIN_EXE_rogs");
        let output = Command::new(program)
            .args(arguments)
            .current_dir(folder.path())
            .output()
            .unwrap();
        let said = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (output.status.code(), said(&output.stdout) + &said(&output.stderr))
    };
    let draw = ["cohort", "--root", EPISODES_FOLDER, "--lab", "all", "--take", "1"];
    let (code, said) = rogs(&draw);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("2 eligible, 1 selected"), "{said}");
    assert!(
        said.contains("not checked: train_or_val, not_in_test_manifest"),
        "{said}"
    );
    // The same again is the same file; another seed is another cohort and does not replace it unasked.
    let first = std::fs::read(folder.path().join("selection.json")).unwrap();
    assert_eq!(rogs(&draw).0, Some(0));
    let (code, said) = rogs(&[&draw[..], &["--seed", "7"]].concat());
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("holds another selection: seed: 42, now 7"), "{said}");
    assert_eq!(std::fs::read(folder.path().join("selection.json")).unwrap(), first);
    assert_eq!(rogs(&[&draw[..], &["--seed", "7", "--force"]].concat()).0, Some(0));
    // Laboratories are the start of ids; these episodes are of none of the paper's.
    let (code, said) = rogs(&draw[..3]);
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("holds no episode of ILIAD, PennPAL"), "{said}");

    let manifest = format!(
        "[run]\nname = \"cohort\"\nout = \"run\"\nstages = [\"ingest\"]\n[input]\nroot = \"{EPISODES_FOLDER}\"\n\
         selection = \"selection.json\"\n[robot]\nurdf = \"{ROBOT_FOLDER}/{ROBOT_URDF_FILE}\"\n\
         [ingest]\nheight = 28\nwidth = 42\n"
    );
    std::fs::write(folder.path().join("manifest.toml"), manifest).unwrap();
    let (code, said) = rogs(&["plan", "manifest.toml"]);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("cohort: 1 clips, 1 units"), "{said}");
    assert!(
        said.contains("selection.json: 1 of 2 eligible episodes, seed 7"),
        "{said}"
    );
    assert_eq!(rogs(&["run", "manifest.toml", "--no-report"]).0, Some(0));
    // Outputs of one cohort do not become those of another.
    assert_eq!(rogs(&[&draw[..], &["--force"]].concat()).0, Some(0));
    let (code, said) = rogs(&["run", "manifest.toml", "--no-report"]);
    assert_eq!(code, Some(2), "{said}");
    assert!(
        said.contains("begun with another selection: selection.json: 1 of 2 eligible episodes, seed 7"),
        "{said}"
    );
}
