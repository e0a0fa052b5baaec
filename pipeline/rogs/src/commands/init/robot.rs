//! Finding the robot's URDF, and how its parts are called.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use rogs_ingest::EpisodeOutline;
use rogs_robot::model::{JointKind, RobotModel};
use rogs_schemas::ids::did_you_mean;
use rogs_schemas::records::robot::RobotSpec;
use rogs_schemas::robots::{DEFAULT_PRESET, PRESETS, Preset};
use rogs_synth::ROBOT_SPEC_FILE;

use super::{MOST_FOLDERS, entries, files};

/// The robot of a manifest, as far as it was found.
#[derive(Default)]
pub(in crate::commands) struct FoundRobot {
    /// Its URDF as the manifest writes it; none where none was found.
    pub(in crate::commands) urdf: Option<String>,
    /// The preset that fits it.
    pub(in crate::commands) preset: Option<&'static Preset>,
    /// How its parts are called.
    pub(in crate::commands) spec: RobotSpec,
    /// Whether parts of the spec are guessed from the URDF alone.
    pub(in crate::commands) guessed: bool,
    /// Its joints that can be set, for who has to name those of the data.
    pub(in crate::commands) driven: Vec<String>,
    /// What does not fit, or is missing.
    pub(in crate::commands) problems: Vec<String>,
}

/// Most URDFs that are read to find the one that fits.
const MOST_URDFS: usize = 32;
/// How deep below the folder URDFs are looked for.
const DEPTH: usize = 3;

/// Finds a robot for the episodes: the one that is named, that which they bring along, or that which lies in the folder or
/// beside it and has their joints.
pub(in crate::commands) fn find(
    named: Option<&Path>,
    folder: &Path,
    outline: &EpisodeOutline,
    written: &dyn Fn(&Path) -> String,
) -> anyhow::Result<FoundRobot> {
    if let Some(path) = named {
        let model = RobotModel::load(path).with_context(|| format!("cannot read the robot `{}`", path.display()))?;
        return Ok(described(&model, path, outline, written));
    }
    let brought = outline
        .model
        .as_ref()
        .map(|model| folder.join(model))
        .filter(|path| path.is_file());
    let mut candidates: Vec<PathBuf> = brought.into_iter().chain(urdfs(folder, DEPTH)).collect();
    if let Some(above) = folder.parent() {
        candidates.extend(urdfs(above, DEPTH));
    }
    let mut fits = None;
    for path in candidates.into_iter().take(MOST_URDFS) {
        let Ok(model) = RobotModel::load(&path) else { continue };
        if outline.joints.iter().all(|joint| model.joint_index(joint).is_ok()) {
            return Ok(described(&model, &path, outline, written));
        }
        fits.get_or_insert((model, path));
    }
    Ok(match fits {
        Some((model, path)) => described(&model, &path, outline, written),
        None => FoundRobot {
            problems: vec![no_urdf(outline)],
            ..FoundRobot::default()
        },
    })
}

/// What to do where no URDF is found, by what the data says of its robot.
fn no_urdf(outline: &EpisodeOutline) -> String {
    let called = outline.robot.as_deref().unwrap_or_default().to_lowercase();
    let has = |joint: &str| {
        outline
            .joints
            .iter()
            .chain(&outline.state_entries)
            .any(|name| name == joint)
    };
    let words = |preset: &Preset| {
        let first = preset.name.split('-').next().unwrap_or_default();
        let short = first.trim_end_matches(|c: char| c.is_ascii_digit());
        // `so100` is of the family of `so101`: the same letters before a number.
        let family = |word: &str| word != short && word.trim_end_matches(|c: char| c.is_ascii_digit()) == short;
        let by_word = called.split(|c: char| !c.is_ascii_alphanumeric()).any(family);
        called.contains(first) || (short.len() > 2 && called.contains(short)) || (short != first && by_word)
    };
    let panda = ["panda", "franka", "droid"].iter().any(|word| called.contains(word)) || has("panda_joint1");
    let meant = PRESETS.iter().find(|preset| {
        if preset.name == DEFAULT_PRESET {
            panda
        } else {
            words(preset)
        }
    });
    match meant {
        Some(preset) => format!(
            "no URDF was found; {}: {}. Name it with --robot, or in the manifest",
            preset.title, preset.source
        ),
        None => "no URDF was found: name the robot's with --robot, or in the manifest (docs/robots.md says where to get those of common arms)".to_owned(),
    }
}

/// URDFs below a folder, nearest first.
fn urdfs(folder: &Path, depth: usize) -> Vec<PathBuf> {
    let is_urdf = |path: &Path| {
        path.extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("urdf"))
    };
    let (mut found, mut level) = (Vec::new(), vec![folder.to_owned()]);
    for _ in 0..depth {
        let mut next = Vec::new();
        for folder in level.iter().take(MOST_FOLDERS) {
            found.extend(files(folder, &is_urdf));
            let mut below: Vec<PathBuf> = entries(folder).map(|entry| entry.path()).collect();
            below.retain(|path| path.is_dir() && !path.is_symlink());
            below.sort();
            // Episodes have many folders and no robots: a folder that is called so comes first.
            below.sort_by_key(|path| {
                let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
                !["robot", "urdf", "description"].iter().any(|word| name.contains(word))
            });
            next.append(&mut below);
        }
        level = next;
    }
    found
}

/// What a manifest says of a robot.
fn described(
    model: &RobotModel,
    path: &Path,
    outline: &EpisodeOutline,
    written: &dyn Fn(&Path) -> String,
) -> FoundRobot {
    let has_joint = |name: &str| model.joint_index(name).is_ok();
    let known = PRESETS.iter().find_map(|preset| {
        let spec = preset.spec_for(|name| model.link_id(name).is_ok(), has_joint)?;
        Some((preset, spec))
    });
    let missing = outline.joints.iter().filter(|joint| !has_joint(joint));
    let names = || model.driven_joints().map(|index| model.joints[index].name.as_str());
    let told = |joint: &String| match did_you_mean(joint, names()) {
        Some(meant) => format!("`{joint}` (`{meant}`?)"),
        None => format!("`{joint}`"),
    };
    let missing: Vec<String> = missing.map(told).collect();
    let problem = (!missing.is_empty()).then(|| {
        format!(
            "`{}` has no joint {}, which the episodes name; is it another robot? --robot names a URDF",
            path.display(),
            missing.join(", ")
        )
    });
    // Who made the URDF may have said how its parts are called; a known arm may carry a gripper that its preset does not know.
    let told = path.with_file_name(ROBOT_SPEC_FILE);
    let told = rogs_files::read_to_string(&told)
        .ok()
        .and_then(|text| serde_json::from_str(&text).ok());
    let guessed = guess(model, &outline.joints);
    let other_gripper = |spec: &RobotSpec| spec.gripper_joint.is_empty() && !guessed.gripper_joint.is_empty();
    let preset = known.as_ref().map(|(preset, _)| *preset).filter(|_| told.is_none());
    let (spec, guessed) = match (told, known) {
        (Some(told), _) => (told, false),
        (None, Some((_, spec))) if other_gripper(&spec) => {
            let RobotSpec { base_link, .. } = spec;
            (RobotSpec { base_link, ..guessed }, true)
        }
        (None, Some((_, spec))) => (spec, false),
        (None, None) => (guessed, true),
    };
    FoundRobot {
        urdf: Some(written(path)),
        guessed,
        preset,
        spec,
        driven: names().map(str::to_owned).collect(),
        problems: problem.into_iter().collect(),
    }
}

/// A spec from the URDF alone: poses refer to its root, the tool is what the last joint of the arm carries, and a gripper is
/// driven by a joint that is called like one.
fn guess(model: &RobotModel, arm: &[String]) -> RobotSpec {
    let called_like_gripper = |name: &str| {
        let name = name.to_lowercase();
        ["finger", "grip", "knuckle", "drive", "jaw"]
            .iter()
            .any(|word| name.contains(word))
    };
    let driven: Vec<usize> = model.driven_joints().collect();
    let gripper = driven.iter().map(|&index| &model.joints[index]);
    let gripper = gripper
        .clone()
        .find(|joint| called_like_gripper(&joint.name) && !arm.contains(&joint.name));
    let last = arm.iter().filter_map(|name| model.joint_index(name).ok()).next_back();
    let last = last.or_else(|| {
        let of_arm = driven.iter().rev();
        of_arm
            .copied()
            .find(|&index| !called_like_gripper(&model.joints[index].name))
    });
    let tool = last.map_or(model.root_link(), |index| model.joints[index].child);
    let [lower, upper] = gripper.and_then(|joint| joint.limits).unwrap_or_default();
    // Fingers that slide are open when they are apart, those that turn when they are not turned.
    let slides = gripper.is_some_and(|joint| joint.kind == JointKind::Linear);
    let [open, closed] = if slides { [upper, lower] } else { [lower, upper] };
    RobotSpec {
        base_link: model.links[model.root_link()].name.clone(),
        gripper_joint: gripper.map(|joint| joint.name.clone()).unwrap_or_default(),
        gripper_open: open,
        gripper_closed: closed,
        tool_link: model.links[tool].name.clone(),
        tool_offset_m: [0.0; 3],
        exclude_links: Vec::new(),
        collision_links: Vec::new(),
        ..RobotSpec::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An arm of two joints with sliding fingers, under names that no preset has.
    const ARM: &str = r#"<robot name="r"><link name="plate"/><link name="upper"/><link name="hand"/><link name="left"/>
        <joint name="turn" type="revolute"><parent link="plate"/><child link="upper"/><axis xyz="0 0 1"/>
            <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
        <joint name="lift" type="revolute"><parent link="upper"/><child link="hand"/><axis xyz="0 1 0"/>
            <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
        <joint name="left_finger_slide" type="prismatic"><parent link="hand"/><child link="left"/><axis xyz="1 0 0"/>
            <limit lower="0" upper="0.05" effort="1" velocity="1"/></joint></robot>"#;

    fn found(outline: &EpisodeOutline) -> FoundRobot {
        let place = tempfile::tempdir().unwrap();
        let episodes = place.path().join("episodes");
        std::fs::create_dir_all(place.path().join("robot/urdf")).unwrap();
        std::fs::create_dir_all(&episodes).unwrap();
        rogs_files::write_bytes(&place.path().join("robot/urdf/arm.urdf"), ARM.as_bytes()).unwrap();
        let written = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
        find(None, &episodes, outline, &written).unwrap()
    }

    #[test]
    fn a_urdf_beside_the_episodes_is_found_and_its_parts_are_named() {
        let joints = ["turn", "lift"].map(str::to_owned).to_vec();
        let robot = found(&EpisodeOutline {
            joints,
            ..EpisodeOutline::default()
        });
        assert_eq!(robot.urdf.as_deref(), Some("arm.urdf"));
        assert!(robot.guessed && robot.problems.is_empty(), "{:?}", robot.problems);
        let spec = robot.spec;
        assert_eq!((spec.base_link.as_str(), spec.tool_link.as_str()), ("plate", "hand"));
        assert_eq!(spec.gripper_joint, "left_finger_slide");
        assert_eq!((spec.gripper_open, spec.gripper_closed), (0.05, 0.0));
    }

    #[test]
    fn joints_that_the_robot_lacks_are_told_all_at_once() {
        let joints = ["turns", "lift", "elbow"].map(str::to_owned).to_vec();
        let robot = found(&EpisodeOutline {
            joints,
            ..EpisodeOutline::default()
        });
        assert_eq!(robot.problems.len(), 1);
        assert!(
            robot.problems[0].contains("`turns` (`turn`?), `elbow`"),
            "{:?}",
            robot.problems
        );
    }

    #[test]
    fn where_no_robot_is_found_it_is_said_where_one_is_to_be_had() {
        let called = |robot: &str| {
            no_urdf(&EpisodeOutline {
                robot: Some(robot.to_owned()),
                ..EpisodeOutline::default()
            })
        };
        assert!(called("so101_follower").contains("SO-ARM100"));
        assert!(called("so100").contains("SO-ARM100"));
        assert!(called("Franka Panda").contains("PointWorld"));
        assert!(called("unheard").contains("docs/robots.md"));
    }
}
