//! Common arms: how their parts are called, and where their URDFs are to be had.
//!
//! A preset names parts as the usual descriptions of an arm do. Descriptions differ (`lbr_iiwa_link_0`, `iiwa_link_0`), so
//! each part has several names; [`Preset::spec_for`] takes those that a robot has.

use crate::records::robot::RobotSpec;

/// A common arm, with the gripper that it usually carries.
#[derive(Debug)]
pub struct Preset {
    /// Name in manifests: `[robot] preset`.
    pub name: &'static str,
    /// What it is, for people.
    pub title: &'static str,
    /// Where a URDF with meshes is to be had.
    pub source: &'static str,
    /// Joints of the arm by which it is known, each by any of these names.
    joints: &'static [&'static [&'static str]],
    /// Names of the link that poses refer to.
    base: &'static [&'static str],
    /// Joints that a gripper state drives: name, value when open, value when closed (radians or metres).
    grippers: &'static [(&'static str, f64, f64)],
    /// Links that carry the tool centre, and where it is in their frame, metres.
    tools: &'static [(&'static str, [f64; 3])],
}

/// The robot of the paper, which a manifest without a preset has.
pub const DEFAULT_PRESET: &str = "panda-robotiq-2f85";

/// Drivers of the Robotiq 2F-85. `finger_joint` is that of the DROID robot (closed as in the paper); the knuckle that of
/// `robotiq_description` in github.com/PickNikRobotics/ros2_robotiq_gripper: 0 to 0.8 rad, closed at 0.7929 as its driver
/// has it, with `robotiq_85_` before the names in some of its versions. The tool centre is 0.12 m before the base, as in
/// the paper.
const ROBOTIQ: (&str, f64, f64) = ("finger_joint", 0.0, 0.725);
const ROBOTIQ_KNUCKLE: [(&str, f64, f64); 2] = [
    ("robotiq_85_left_knuckle_joint", 0.0, 0.7929),
    ("left_knuckle_joint", 0.0, 0.7929),
];
const ROBOTIQ_TOOL: [(&str, [f64; 3]); 2] = [
    ("robotiq_85_base_link", [0.0, 0.0, 0.12]),
    ("robotiq_base_link", [0.0, 0.0, 0.12]),
];
const HERE: [f64; 3] = [0.0; 3];

/// Every preset; of two that fit a robot the first is meant. Names and ranges are those of the files that each names,
/// read in November 2026; other names are of older versions of them.
pub static PRESETS: [Preset; 8] = [
    Preset {
        name: DEFAULT_PRESET,
        title: "Franka Panda with a Robotiq 2F-85 (DROID)",
        source: "`assets/franka_description` of github.com/NVlabs/PointWorld",
        joints: &[&["panda_joint1"], &["panda_joint7"]],
        base: &["panda_link0"],
        grippers: &[ROBOTIQ],
        tools: &[ROBOTIQ_TOOL[0]],
    },
    // `robots/common/franka_arm.xacro` and `end_effectors/common/franka_hand.xacro`: every name begins with the kind of
    // robot, `fr3_`, `fer_` (the Panda today) or, before, `panda_`; each finger slides from 0 (closed) to 0.04 m, and
    // `hand_tcp` is 0.1034 m before `hand`.
    Preset {
        name: "panda-hand",
        title: "Franka Panda or FR3 with the Franka hand",
        source: "github.com/frankarobotics/franka_description (expand its xacro), or `franka_panda` of `pip download pybullet_data`",
        joints: &[
            &["panda_joint1", "fr3_joint1", "fer_joint1"],
            &["panda_joint7", "fr3_joint7", "fer_joint7"],
        ],
        base: &["panda_link0", "fr3_link0", "fer_link0"],
        grippers: &[
            ("panda_finger_joint1", 0.04, 0.0),
            ("fr3_finger_joint1", 0.04, 0.0),
            ("fer_finger_joint1", 0.04, 0.0),
        ],
        tools: &[
            ("panda_hand_tcp", HERE),
            ("fr3_hand_tcp", HERE),
            ("fer_hand_tcp", HERE),
            ("panda_hand", [0.0, 0.0, 0.1034]),
            ("fr3_hand", [0.0, 0.0, 0.1034]),
            ("fer_hand", [0.0, 0.0, 0.1034]),
            ("panda_link8", HERE),
            ("fr3_link8", HERE),
            ("fer_link8", HERE),
        ],
    },
    // `urdf/ur_macro.xacro`, without `tf_prefix`; `ee_link` is of the descriptions for ROS 1.
    Preset {
        name: "ur5e",
        title: "Universal Robots UR3 to UR20, with or without a Robotiq 2F-85",
        source: "github.com/UniversalRobots/Universal_Robots_ROS2_Description (expand its xacro)",
        joints: &[&["shoulder_pan_joint"], &["wrist_3_joint"]],
        base: &["base_link"],
        grippers: &[ROBOTIQ, ROBOTIQ_KNUCKLE[0], ROBOTIQ_KNUCKLE[1]],
        tools: &[
            ROBOTIQ_TOOL[0],
            ROBOTIQ_TOOL[1],
            ("tool0", HERE),
            ("flange", HERE),
            ("ee_link", HERE),
            ("wrist_3_link", HERE),
        ],
    },
    // `urdf/xarm7/xarm7.urdf.xacro` and `urdf/gripper/xarm_gripper.urdf.xacro`, without prefix: `drive_joint` goes from 0
    // to 0.85 rad, and `link_tcp` is 0.172 m before `xarm_gripper_base_link`.
    Preset {
        name: "xarm7",
        title: "UFACTORY xArm 5, 6 or 7, with or without its gripper",
        source: "github.com/xArm-Developer/xarm_ros2, package `xarm_description` (expand its xacro)",
        joints: &[&["joint1"], &["joint5"]],
        base: &["link_base"],
        grippers: &[("drive_joint", 0.0, 0.85)],
        tools: &[
            ("link_tcp", HERE),
            ("xarm_gripper_base_link", [0.0, 0.0, 0.172]),
            ("link_eef", HERE),
            ("link7", HERE),
            ("link6", HERE),
            ("link5", HERE),
        ],
    },
    // `urdf/iiwa7/iiwa7_description.xacro`: `lbr_A1` to `lbr_A7`, `lbr_link_0` to `lbr_link_7`, `lbr_link_ee` 0.035 m
    // before the last. The names with `joint_` are of github.com/IFL-CAMP/iiwa_stack and of `pybullet_data`.
    Preset {
        name: "iiwa",
        title: "KUKA LBR iiwa 7 or 14",
        source: "github.com/lbr-stack/lbr_fri_ros2_stack, package `lbr_description` (expand its xacro), or `kuka_iiwa` of `pip download pybullet_data`",
        joints: &[
            &["iiwa_joint_1", "lbr_iiwa_joint_1", "lbr_A1", "A1", "J0"],
            &["iiwa_joint_7", "lbr_iiwa_joint_7", "lbr_A7", "A7", "J6"],
        ],
        base: &["iiwa_link_0", "lbr_iiwa_link_0", "lbr_link_0"],
        grippers: &[],
        tools: &[
            ("iiwa_link_ee", HERE),
            ("lbr_link_ee", HERE),
            ("iiwa_link_7", HERE),
            ("lbr_iiwa_link_7", HERE),
        ],
    },
    // `Simulation/SO101/so101_new_calib.urdf` (`base_link`, `gripper_frame_link`; the jaw turns from -0.1745 rad, closed, to
    // 1.7453), `so101_old_calib.urdf` and `Simulation/SO100/so100.urdf` (`base`, `gripper`; -0.2 to 2.0 rad).
    Preset {
        name: "so101",
        title: "SO-100 or SO-101 of LeRobot",
        source: "`Simulation` of github.com/TheRobotStudio/SO-ARM100",
        joints: &[&["shoulder_pan"], &["elbow_flex"], &["wrist_roll"]],
        base: &["base_link", "base"],
        grippers: &[("gripper", 1.745, -0.174)],
        tools: &[
            ("gripper_frame_link", HERE),
            ("gripperframe", HERE),
            ("gripper_link", HERE),
            ("gripper", HERE),
        ],
    },
    // `urdf/vx300s.urdf.xacro`: links begin with the robot's name, joints do not; `left_finger` slides from 0.021 m (closed)
    // to 0.057.
    Preset {
        name: "viperx-300s",
        title: "Trossen ViperX 300 S of ALOHA, one arm",
        source: "github.com/Interbotix/interbotix_ros_manipulators, package `interbotix_xsarm_descriptions` (expand its xacro)",
        joints: &[&["waist"], &["elbow"], &["wrist_rotate"]],
        base: &["vx300s/base_link", "base_link"],
        grippers: &[("left_finger", 0.057, 0.021)],
        tools: &[
            ("vx300s/ee_gripper_link", HERE),
            ("ee_gripper_link", HERE),
            ("vx300s/gripper_link", HERE),
            ("gripper_link", HERE),
        ],
    },
    // `arms/gen3/7dof/urdf/gen3_macro.xacro` and that of `6dof`; the plain URDF beside the first has `Actuator1` to
    // `Actuator7`.
    Preset {
        name: "kinova-gen3",
        title: "Kinova Gen3, with or without a Robotiq 2F-85",
        source: "github.com/Kinovarobotics/ros2_kortex, package `kortex_description` (expand its xacro)",
        joints: &[&["joint_1", "Actuator1"], &["joint_6", "Actuator6"]],
        base: &["base_link"],
        grippers: &[ROBOTIQ, ROBOTIQ_KNUCKLE[0], ROBOTIQ_KNUCKLE[1]],
        tools: &[
            ROBOTIQ_TOOL[0],
            ROBOTIQ_TOOL[1],
            ("end_effector_link", HERE),
            ("EndEffector_Link", HERE),
            ("bracelet_link", HERE),
            ("Bracelet_Link", HERE),
        ],
    },
];

/// The preset of a name.
#[must_use]
pub fn preset(name: &str) -> Option<&'static Preset> {
    PRESETS.iter().find(|preset| preset.name == name)
}

impl Preset {
    /// The spec with the first name of every part.
    #[must_use]
    pub fn spec(&self) -> RobotSpec {
        let gripper = self.grippers.first().copied();
        let (tool, offset) = self.tools.first().copied().unwrap_or(("", HERE));
        self.with(self.base.first().copied().unwrap_or_default(), gripper, tool, offset)
    }

    /// The spec for a robot with these links and joints: of every part the first name that it has; without a gripper where
    /// it has none. `None` when it is another robot.
    pub fn spec_for(&self, has_link: impl Fn(&str) -> bool, has_joint: impl Fn(&str) -> bool) -> Option<RobotSpec> {
        let known = self.joints.iter().all(|names| names.iter().any(|name| has_joint(name)));
        let base = self
            .base
            .iter()
            .copied()
            .find(|name| has_link(name))
            .filter(|_| known)?;
        let (tool, offset) = self.tools.iter().copied().find(|(name, _)| has_link(name))?;
        let gripper = self.grippers.iter().copied().find(|(name, ..)| has_joint(name));
        // The Panda of the paper is known by its gripper; with another one it is another robot.
        if self.name == DEFAULT_PRESET && gripper.is_none() {
            return None;
        }
        Some(self.with(base, gripper, tool, offset))
    }

    fn with(&self, base: &str, gripper: Option<(&str, f64, f64)>, tool: &str, tool_offset_m: [f64; 3]) -> RobotSpec {
        let paper = RobotSpec::default();
        let own = self.name == DEFAULT_PRESET;
        let (joint, open, closed) = gripper.unwrap_or(("", 0.0, 0.0));
        RobotSpec {
            base_link: base.to_owned(),
            gripper_joint: joint.to_owned(),
            gripper_open: open,
            gripper_closed: closed,
            tool_link: tool.to_owned(),
            tool_offset_m,
            exclude_links: if own { paper.exclude_links } else { Vec::new() },
            collision_links: if own { paper.collision_links } else { Vec::new() },
            mesh_axes: paper.mesh_axes,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_preset_is_the_default_spec() {
        assert_eq!(preset(DEFAULT_PRESET).unwrap().spec(), RobotSpec::default());
        let names: std::collections::BTreeSet<&str> = PRESETS.iter().map(|preset| preset.name).collect();
        assert_eq!(names.len(), PRESETS.len());
    }

    #[test]
    fn a_robot_is_known_by_its_names_and_gets_those_that_it_has() {
        let robot = |links: &'static [&'static str], joints: &'static [&'static str]| {
            PRESETS.iter().find_map(|preset| {
                let spec = preset.spec_for(|name| links.contains(&name), |name| joints.contains(&name))?;
                Some((preset.name, spec))
            })
        };
        let (name, spec) = robot(
            &["panda_link0", "panda_hand"],
            &["panda_joint1", "panda_joint7", "panda_finger_joint1"],
        )
        .unwrap();
        assert_eq!(
            (name, spec.tool_link.as_str(), spec.gripper_open),
            ("panda-hand", "panda_hand", 0.04)
        );
        // The same arm without anything on it.
        let (name, spec) = robot(&["panda_link0", "panda_link8"], &["panda_joint1", "panda_joint7"]).unwrap();
        assert_eq!(
            (name, spec.gripper_joint.as_str(), spec.tool_link.as_str()),
            ("panda-hand", "", "panda_link8")
        );
        let (name, spec) = robot(
            &["lbr_iiwa_link_0", "lbr_iiwa_link_7"],
            &["lbr_iiwa_joint_1", "lbr_iiwa_joint_7"],
        )
        .unwrap();
        assert_eq!((name, spec.base_link.as_str()), ("iiwa", "lbr_iiwa_link_0"));
        assert_eq!(robot(&["base_link"], &["a"]), None);
        // The Panda as its makers call it today, and a Gen3 in its plain URDF.
        let (name, spec) = robot(
            &["fer_link0", "fer_hand", "fer_hand_tcp"],
            &["fer_joint1", "fer_joint7", "fer_finger_joint1"],
        )
        .unwrap();
        assert_eq!((name, spec.tool_link.as_str()), ("panda-hand", "fer_hand_tcp"));
        let (name, spec) = robot(&["base_link", "EndEffector_Link"], &["Actuator1", "Actuator6"]).unwrap();
        assert_eq!((name, spec.tool_link.as_str()), ("kinova-gen3", "EndEffector_Link"));
        // A UR with the gripper of `robotiq_description` closes as far as its driver closes it.
        let (name, spec) = robot(
            &["base_link", "tool0", "robotiq_85_base_link"],
            &["shoulder_pan_joint", "wrist_3_joint", "robotiq_85_left_knuckle_joint"],
        )
        .unwrap();
        assert_eq!((name, spec.gripper_closed), ("ur5e", 0.7929));
    }
}
