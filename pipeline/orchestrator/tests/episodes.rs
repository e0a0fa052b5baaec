//! Which episodes a manifest takes, and which clips of them.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod common;

use common::Workspace;
use rogs_orchestrator::{Error, Exit};
use rogs_schemas::selection::{
    CohortCounts, RngNote, SELECTION_ALGORITHM, SELECTION_VERSION, SelectedEpisode, Selection,
};

const BASE: &str = "[run]\nname = \"toy\"\nout = \"run\"\nagreement = false\n[robot]\nurdf = \"robot/robot.urdf\"\n";

/// Ids of the clips of a manifest with this at its end.
fn ids(workspace: &Workspace, more: &str) -> Vec<String> {
    workspace.write("toy.toml", &format!("{BASE}{more}"));
    let plan = workspace.prepare().plan;
    plan.clips.iter().map(|clip| clip.id.to_string()).collect()
}

/// Message and hint for such a manifest.
fn told(workspace: &Workspace, more: &str) -> (String, String) {
    workspace.write("toy.toml", &format!("{BASE}{more}"));
    let error: Error = workspace.try_prepare().unwrap_err();
    assert_eq!(error.exit(), Exit::Usage, "{error}");
    let place = workspace.path("").display().to_string();
    (error.to_string().replace(&place, ""), error.hint().unwrap_or_default())
}

fn long() -> Workspace {
    let workspace = Workspace::new();
    workspace.episode("a", "one frames=40");
    workspace.episode("b", "two frames=9");
    workspace.episode("c", "three");
    workspace
}

#[test]
fn long_episodes_become_as_many_clips_as_asked() {
    let workspace = long();
    let input = "[ingest]\nframes = 10\n[input]\nroot = \"episodes\"\n";
    // One that is too short, or of unknown length, is one clip: it fails by itself and says why.
    let short = ["b-f000000", "c-f000000"];
    let all = ["a-f000000", "a-f000010", "a-f000020", "a-f000030"];
    assert_eq!(
        ids(&workspace, &format!("{input}clips = \"all\"\n")),
        [&all[..], &short].concat()
    );
    assert_eq!(
        ids(&workspace, &format!("{input}clips = 2\n")),
        [&all[..2], &short].concat()
    );
    let dense = [
        "a-f000007",
        "a-f000012",
        "a-f000017",
        "a-f000022",
        "a-f000027",
        "b-f000007",
        "c-f000007",
    ];
    assert_eq!(
        ids(&workspace, &format!("{input}clips = \"all\"\nstride = 5\nstart = 7\n")),
        dense
    );
    // A start alone moves the one clip; its name stays.
    assert_eq!(ids(&workspace, &format!("{input}start = 3\n")), ["a", "b", "c"]);
    assert_eq!(ids(&workspace, input), ["a", "b", "c"]);
    let one = "[[episodes]]\nroot = \"episodes\"\nselect = \"a\"\nid = \"mine\"\nclips = 2\ningest.frames = 20\n";
    assert_eq!(ids(&workspace, one), ["mine-f000000", "mine-f000020"]);
}

#[test]
fn every_clip_is_a_unit_of_its_own_with_its_frames() {
    let workspace = long();
    let more = "[ingest]\nframes = 10\n[input]\nroot = \"episodes\"\ninclude = [\"a\"]\nclips = \"all\"\n";
    workspace.write("toy.toml", &format!("{BASE}{more}"));
    let plan = workspace.prepare().plan;
    let starts: Vec<_> = plan
        .clips
        .iter()
        .map(|clip| clip.ingest["start_frame"].as_u64().unwrap())
        .collect();
    assert_eq!(starts, [0, 10, 20, 30]);
    let keys: std::collections::BTreeSet<_> = (0..4).map(|clip| plan.keys(clip)[0].key).collect();
    assert_eq!(keys.len(), 4);
    let said: Vec<String> = plan.clip_intervals().iter().map(ToString::to_string).collect();
    assert_eq!(said[1], "1 clips of 10 episode frames, 10 to 19");
    // One more clip leaves the names and keys of the others as they are.
    let fewer = more.replace("\"all\"", "3");
    workspace.write("toy.toml", &format!("{BASE}{fewer}"));
    let other = workspace.prepare().plan;
    assert_eq!(other.clips[..], plan.clips[..3]);
}

#[test]
fn the_default_start_is_said() {
    let workspace = long();
    workspace.write("toy.toml", &format!("{BASE}[input]\nroot = \"episodes\"\n"));
    let intervals = workspace.prepare().plan.clip_intervals();
    assert_eq!((intervals.len(), intervals[0].start, intervals[0].clips), (1, None, 3));
    assert!(
        intervals[0]
            .to_string()
            .contains("from frame 7, where the paper's clips start"),
        "{}",
        intervals[0]
    );
}

#[test]
fn impossible_cuts_are_refused_where_they_stand() {
    let workspace = long();
    let input = "[input]\nroot = \"episodes\"\n";
    let (message, _) = told(&workspace, &format!("{input}clips = \"every\"\n"));
    assert!(
        message.contains("expected \"all\" or a number of clips from 1"),
        "{message}"
    );
    let (message, _) = told(&workspace, &format!("{input}clips = 0\n"));
    assert!(
        message.contains("expected \"all\" or a number of clips from 1"),
        "{message}"
    );
    let (message, _) = told(&workspace, &format!("{input}clips = 2\nstride = 0\n"));
    assert!(message.starts_with("toy.toml:10:1: invalid stride 0"), "{message}");
    let (message, hint) = told(&workspace, &format!("{input}stride = 4\n"));
    assert!(
        message.contains("`stride` without `clips`") && hint.contains("clips = \"all\""),
        "{message} {hint}"
    );
    let (message, _) = told(&workspace, &format!("[ingest]\nstart_frame = 2\n{input}clips = 2\n"));
    assert!(message.contains("both say where clips start"), "{message}");
}

/// A selection of some of these clip names as seed 42 draws it; episode ids are the names.
fn selection(eligible: &[&str], take: usize, seed: u64) -> Selection {
    let drawn = rogs_random::Pcg64::from_seed(seed).sorted_sample(eligible.len() as u32, take);
    let selected = |&index: &u32| SelectedEpisode {
        index,
        clip_name: eligible[index as usize].into(),
        episode_id: eligible[index as usize].into(),
        lab: "X".into(),
        scene: None,
    };
    Selection {
        schema_version: SELECTION_VERSION,
        seed,
        source_manifest: None,
        candidates: None,
        counts: CohortCounts {
            eligible: eligible.len(),
            selected: take,
            ..CohortCounts::default()
        },
        exclusions: Default::default(),
        exclusion_counts: Default::default(),
        eligible_sorted: eligible.iter().map(|name| (*name).to_owned()).collect(),
        selected: drawn.iter().map(selected).collect(),
        selected_indices: drawn,
        rng: RngNote {
            algorithm: SELECTION_ALGORITHM.into(),
            version: 1,
        },
    }
}

fn write(workspace: &Workspace, selection: &Selection) {
    workspace.write("selection.json", &serde_json::to_string(selection).unwrap());
}

const SELECTED: &str = "[input]\nroot = \"episodes\"\nselection = \"selection.json\"\n";

#[test]
fn a_run_takes_the_episodes_of_a_selection_in_its_order() {
    let workspace = Workspace::new();
    let mut three = selection(&["a", "b", "c"], 3, 42);
    // Clip names need not be ids, and their order is the selection's.
    for (own, name) in three.selected.iter_mut().zip(["x-third", "y-first", "z-second"]) {
        own.clip_name = name.into();
        own.episode_id = match name {
            "x-third" => "c",
            "y-first" => "a",
            _ => "b",
        }
        .into();
    }
    three.eligible_sorted = vec!["x-third".into(), "y-first".into(), "z-second".into()];
    write(&workspace, &three);
    assert_eq!(ids(&workspace, SELECTED), ["x-third", "y-first", "z-second"]);
    assert_eq!(
        ids(&workspace, &format!("{SELECTED}limit = 2\n")),
        ["x-third", "y-first"]
    );
    let plan = workspace.prepare().plan;
    let said = plan.selection.as_ref().map(|selection| selection.describe());
    assert_eq!(said.unwrap(), "selection.json: 3 of 3 eligible episodes, seed 42");
    plan.freeze().unwrap();
    assert_eq!(rogs_orchestrator::plan::read_plan(&plan.run).unwrap(), plan);
}

#[test]
fn missing_episodes_of_a_selection_are_named() {
    let workspace = Workspace::new();
    write(&workspace, &selection(&["a", "b", "lost", "strayed"], 4, 42));
    let (message, hint) = told(&workspace, SELECTED);
    assert!(
        message.starts_with("toy.toml:9:1: 2 of the 4 selected episodes are not in `episodes`: lost, strayed"),
        "{message}"
    );
    assert!(hint.contains("exclude"), "{hint}");
    assert_eq!(
        ids(&workspace, &format!("{SELECTED}exclude = [\"lost\", \"stray*\"]\n")),
        ["a", "b"]
    );
    std::fs::remove_file(workspace.path("selection.json")).unwrap();
    assert!(told(&workspace, SELECTED).0.contains("the selection is not there"));
}

#[test]
fn a_selection_that_its_seed_does_not_draw_is_refused() {
    let workspace = Workspace::new();
    let names = ["a", "b", "c", "d", "e", "f", "g", "h"];
    let mut other = selection(&names, 3, 7);
    other.seed = 42;
    write(&workspace, &other);
    let (message, hint) = told(&workspace, SELECTED);
    assert!(
        message.contains("are not those that seed 42 draws from its list of 8"),
        "{message}"
    );
    assert!(hint.contains("rogs cohort"), "{hint}");
    // Another list behind the same indices.
    let mut longer = selection(&names, 3, 42);
    longer.eligible_sorted.push("i".into());
    longer.counts.eligible += 1;
    write(&workspace, &longer);
    assert!(told(&workspace, SELECTED).0.contains("draws from its list of 9"));
    let mut edited = selection(&names, 3, 42);
    edited.selected[0].clip_name = "z".into();
    write(&workspace, &edited);
    assert!(told(&workspace, SELECTED).0.contains("differ about `z`"));
    workspace.write("selection.json", "{}");
    assert!(
        told(&workspace, SELECTED)
            .0
            .contains("not a selection of `rogs cohort`")
    );
}

#[test]
fn a_run_folder_keeps_its_selection() {
    let workspace = Workspace::new();
    write(&workspace, &selection(&["a", "b", "c"], 2, 42));
    ids(&workspace, SELECTED);
    workspace.prepare().plan.freeze().unwrap();
    write(&workspace, &selection(&["a", "b", "c"], 2, 7));
    let (message, hint) = told(&workspace, SELECTED);
    assert!(
        message.contains("begun with another selection: selection.json: 2 of 3 eligible episodes, seed 42"),
        "{message}"
    );
    assert!(hint.contains("another `out`"), "{hint}");
}
