//! The manifest's text.

use std::fmt::Write as _;
use std::path::Path;

use rogs_lift::BUILTIN_SIZE;
use rogs_orchestrator::quote::shell_word;
use rogs_schemas::robots::{DEFAULT_PRESET, PRESETS};

use super::{Found, how_to_calibrate};

/// The manifest for what was found; `path` is where it will lie.
pub(super) fn manifest(found: &Found, path: &Path) -> String {
    let file = shell_word(&path.file_name().unwrap_or_default().to_string_lossy());
    let mut text = format!(
        "# {} episodes ({}), written by `rogs init`.\n#\n\
         #   rogs plan {file}     what will be made, with which weights, how long it takes\n\
         #   rogs run {file}      makes it; the same command goes on after a stop\n#\n\
         # Paths are relative to this file. `rogs schema manifest` describes every key.\n\n\
         [run]\nname = {}\n",
        found.episodes.len(),
        found.layouts().join(", "),
        quoted(&found.name)
    );
    text += &input(found);
    text += &robot(found);
    let [height, width] = BUILTIN_SIZE;
    let _ = write!(
        text,
        "\n# The built-in networks for robots have seen procedural clips only. A checkpoint of your own: lift = \"FILE\".\n\
         [weights]\nlift = \"builtin\"\nrefine = \"builtin\"\n\n\
         # Images are brought to this size, for which the built-in networks are made.\n\
         [ingest]\nheight = {height}\nwidth = {width}\n"
    );
    text += &states(found);
    text += "\n[refine]\nupdates = 4\n";
    text
}

/// A TOML string.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

fn list(names: &[String]) -> String {
    let names: Vec<String> = names.iter().map(|name| quoted(name)).collect();
    format!("[{}]", names.join(", "))
}

fn input(found: &Found) -> String {
    let frames = found.episodes.iter().filter_map(|episode| episode.frames);
    let longest = frames.max().map_or_else(String::new, |frames| {
        format!(" (the longest episode has {frames} frames)")
    });
    let example = found.episodes.first().map_or("*", |episode| &episode.episode_id);
    let mut text = format!(
        "\n[input]\nroot = {}\n\
         # limit = 1                # take only the first episode\n\
         # include = [{}]           # take only these (`*` stands for anything)\n\
         # Each episode gives one clip of 17 frames, from its frame 7 where it is long enough.\n\
         # clips = \"all\"            # whole episodes, clip after clip{longest}\n",
        quoted(&found.root),
        quoted(example),
    );
    match (&found.calibration, found.outline.calibrated) {
        (Some(file), _) => {
            let _ = writeln!(text, "calibration = {}", quoted(file));
        }
        (None, false) => {
            let _ = write!(
                text,
                "# MISSING where the cameras are: {}.\n# calibration = \"calibration.json\"\n",
                how_to_calibrate()
            );
        }
        (None, true) => {}
    }
    if let Some(folder) = &found.pointworld {
        let _ = writeln!(text, "pointworld = {}", quoted(folder));
    }
    text
}

fn robot(found: &Found) -> String {
    let robot = &found.robot;
    let mut text = "\n[robot]\n".to_owned();
    for problem in &robot.problems {
        let _ = writeln!(text, "# MISSING: {problem}.");
    }
    let urdf = robot.urdf.as_deref().unwrap_or("robot/robot.urdf");
    let _ = writeln!(text, "urdf = {}", quoted(urdf));
    if robot.urdf.is_none() {
        let names: Vec<&str> = PRESETS.iter().map(|preset| preset.name).collect();
        let _ = writeln!(
            text,
            "# preset = {}      # known: {}",
            quoted(DEFAULT_PRESET),
            names.join(", ")
        );
        return text;
    }
    if let Some(preset) = robot.preset {
        let _ = writeln!(text, "preset = {}", quoted(preset.name));
        if robot.spec == preset.spec() {
            return text;
        }
    }
    let spec = &robot.spec;
    text += if robot.guessed {
        "\n# Guessed from the URDF: check all of it. The outline of the robot in the report shows whether it is right.\n"
    } else {
        "\n# As this URDF calls them.\n"
    };
    let _ = write!(
        text,
        "[robot.spec]\n\
         base_link = {}           # poses of cameras are relative to it\n\
         tool_link = {}           # carries the tool centre\n\
         tool_offset_m = {:?}\n\
         gripper_joint = {}       # driven by the gripper state; \"\" for a robot without gripper\n\
         gripper_open = {:?}\n\
         gripper_closed = {:?}\n\
         exclude_links = {}\n\
         collision_links = {}\n",
        quoted(&spec.base_link),
        quoted(&spec.tool_link),
        spec.tool_offset_m,
        quoted(&spec.gripper_joint),
        spec.gripper_open,
        spec.gripper_closed,
        list(&spec.exclude_links),
        list(&spec.collision_links),
    );
    text
}

/// Where joints and gripper are, for layouts that do not say: LeRobot.
fn states(found: &Found) -> String {
    let outline = &found.outline;
    let mut text = String::new();
    if outline.state_entries.is_empty() && found.layouts().iter().all(|layout| !layout.starts_with("lerobot")) {
        return text;
    }
    let mut cameras: Vec<&String> = outline.cameras.iter().collect();
    cameras.sort_by_key(|name| !["wrist", "hand", "gripper"].iter().any(|word| name.contains(word)));
    let cameras: Vec<String> = cameras
        .into_iter()
        .enumerate()
        .map(|(index, name)| {
            let id = if index == 0 {
                "wrist".to_owned()
            } else {
                format!("ext{index}")
            };
            format!("{{ id = {}, from = {} }}", quoted(&id), quoted(name))
        })
        .collect();
    let _ = writeln!(
        text,
        "# Which cameras to take, the one on the wrist first; leave one out by leaving it out here.\n# cameras = [{}]",
        cameras.join(", ")
    );
    let entries = &outline.state_entries;
    let is_gripper = |name: &&String| name.contains("gripper");
    let joints: Vec<String> = entries.iter().filter(|name| !is_gripper(name)).cloned().collect();
    let gripper = entries.iter().find(is_gripper);
    let mut driven = found.robot.driven.clone();
    driven.retain(|name| *name != found.robot.spec.gripper_joint);
    let _ = write!(
        text,
        "\n# Where the data has the robot's states. Entries of `observation.state`: {}.\n[ingest.states]\n\
         # joints = {}\n\
         # joint_names = {}       # how the URDF calls them\n\
         # gripper = {}           # \"\" for a robot without gripper\n\
         # gripper_range = [100, 0]     # values of the data that mean open and closed\n\
         # unit = \"degrees\"\n",
        if entries.is_empty() {
            "not named".to_owned()
        } else {
            entries.join(", ")
        },
        list(&joints),
        list(&driven),
        quoted(gripper.map_or("", String::as_str)),
    );
    text
}

#[cfg(test)]
mod tests {
    use rogs_ingest::{EpisodeListing, EpisodeOutline};
    use rogs_orchestrator::manifest::Manifest;
    use rogs_schemas::robots::preset;

    use super::super::robot::FoundRobot;
    use super::*;

    fn found(layout: &str, robot: FoundRobot) -> Found {
        let episode = EpisodeListing {
            episode_id: "a \"b\"".into(),
            name: "a".into(),
            layout: layout.into(),
            folder: ".".into(),
            selector: String::new(),
            frames: Some(40),
            files: Vec::new(),
        };
        Found {
            name: "kitchen".into(),
            root: "episodes".into(),
            episodes: vec![episode],
            outline: EpisodeOutline {
                cameras: vec!["observation.images.top".into(), "observation.images.side".into()],
                state_entries: vec!["shoulder_pan.pos".into(), "gripper.pos".into()],
                ..EpisodeOutline::default()
            },
            robot,
            calibration: None,
            pointworld: Some("../pointworld".into()),
        }
    }

    /// What `rogs init` writes is read; so are its comments, once their `#` is gone.
    #[test]
    fn what_is_written_is_a_manifest_and_so_are_its_proposals() {
        let ur5e = preset("ur5e").unwrap();
        let known = || FoundRobot {
            urdf: Some("robot/ur5e.urdf".into()),
            preset: Some(ur5e),
            spec: rogs_schemas::records::robot::RobotSpec {
                gripper_joint: String::new(),
                ..ur5e.spec()
            },
            ..FoundRobot::default()
        };
        for layout in ["rogs-episode", "lerobot-v3.0"] {
            for robot in [known(), FoundRobot::default()] {
                let text = manifest(&found(layout, robot), Path::new("kitchen.toml"));
                let read = |text: &str| {
                    Manifest::parse(text, Path::new("kitchen.toml"), Path::new("/work"))
                        .unwrap()
                        .0
                };
                let plain = read(&text);
                assert_eq!(plain.ingest["height"], BUILTIN_SIZE[0]);
                let proposals = text.lines().map(|line| {
                    let proposal = line.strip_prefix("# ").filter(|rest| {
                        let key = rest.split_once(" = ").map(|(key, _)| key);
                        key.is_some_and(|key| key.chars().all(|c| c.is_ascii_lowercase() || c == '_'))
                    });
                    proposal.unwrap_or(line)
                });
                let all = read(&(proposals.collect::<Vec<_>>().join("\n") + "\n"));
                assert_eq!(all.input.unwrap().limit, Some(1));
            }
        }
    }
}
