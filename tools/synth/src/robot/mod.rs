//! The robot: Panda kinematics (the published joint origins) with shells and a two-finger gripper made here.

mod export;
mod ik;
mod shapes;

use std::sync::Arc;

use glam::{DMat3, DVec3};
use rogs_geometry::{Base, Pose};
use rogs_schemas::records::robot::{MeshAxes, RobotSpec};

use crate::frame::BodyFrame;
use crate::math::{rot_axis, rot_rpy};
use crate::mesh::TriMesh;

pub use export::{ROBOT_SPEC_FILE, ROBOT_URDF_FILE, write_robot};
pub(crate) use ik::solve_tool;

/// Number of arm joints.
pub const ARM_JOINTS: usize = 7;

/// Names of the driven arm joints.
pub const ARM_JOINT_NAMES: [&str; ARM_JOINTS] = [
    "panda_joint1",
    "panda_joint2",
    "panda_joint3",
    "panda_joint4",
    "panda_joint5",
    "panda_joint6",
    "panda_joint7",
];

/// Lower and upper limits of the arm joints, radians.
pub const ARM_LIMITS: [[f64; 2]; ARM_JOINTS] = [
    [-2.8973, 2.8973],
    [-1.7628, 1.7628],
    [-2.8973, 2.8973],
    [-3.0718, -0.0698],
    [-2.8973, 2.8973],
    [-0.0175, 3.7525],
    [-2.8973, 2.8973],
];

/// Index of `panda_link8`, the flange that carries gripper and wrist camera.
pub const FLANGE_LINK: usize = 8;

/// Index of the link that carries the tool frame.
pub(crate) const GRIPPER_LINK: usize = 9;

/// Value of `finger_joint` when the gripper is closed, radians (0 when open).
pub const FINGER_CLOSED: f64 = 0.725;

/// Height of the tool centre above the flange: between the pads, metres.
pub const TOOL_Z: f64 = 0.150;

/// Pivot of the left knuckle in the gripper frame: distance from the middle and height, metres.
const KNUCKLE_PIVOT: [f64; 2] = [0.0317, 0.062];
/// Length of the knuckle bars, metres.
const KNUCKLE_LENGTH: f64 = 0.0606;
/// Lean of the knuckle bars when open, radians from the approach axis.
const KNUCKLE_LEAN: f64 = 0.402;
/// Thickness of a finger from its pivot line to the pad, metres.
const PAD_OFFSET: f64 = 0.0125;

/// How a joint moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Motion {
    Fixed,
    /// Driven arm joint of this index.
    Arm(usize),
    /// `multiplier` times the finger joint; the first one is the driven joint itself.
    Finger(f64),
}

/// One link with the joint that carries it.
#[derive(Debug, Clone)]
pub(crate) struct Link {
    pub name: &'static str,
    pub joint: &'static str,
    /// Index of the parent link; the root names itself.
    pub parent: usize,
    pub xyz: DVec3,
    pub rpy: [f64; 3],
    /// The rotation of `rpy`, from the joint's frame at zero to the parent link's.
    pub turn: DMat3,
    pub axis: DVec3,
    pub motion: Motion,
    pub mesh: Arc<TriMesh>,
}

/// The robot model: links in an order in which parents come first. A link's id is its index.
#[derive(Debug, Clone)]
pub struct Robot {
    pub(crate) links: Vec<Link>,
}

/// Joint positions and gripper state at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotState {
    /// Arm joints, radians.
    pub joints: [f64; ARM_JOINTS],
    /// 0 open, 1 closed.
    pub gripper: f64,
}

/// A comfortable posture with the tool pointing down in front of the robot.
pub(crate) const HOME: [f64; ARM_JOINTS] = {
    const PI: f64 = std::f64::consts::PI;
    [0.0, -PI / 5.0, 0.0, -4.0 * PI / 5.0, 0.0, 3.0 * PI / 5.0, 0.0]
};

impl Default for Robot {
    fn default() -> Self {
        Self::new()
    }
}

impl Robot {
    /// Builds the model with all its meshes.
    #[must_use]
    #[expect(clippy::too_many_lines, reason = "a list of links, joints and sizes")]
    pub fn new() -> Self {
        use Motion::{Arm, Finger, Fixed};
        const H: f64 = std::f64::consts::FRAC_PI_2;
        let [y, z] = KNUCKLE_PIVOT;
        let bar = DVec3::new(
            0.0,
            KNUCKLE_LENGTH * libm::sin(KNUCKLE_LEAN),
            KNUCKLE_LENGTH * libm::cos(KNUCKLE_LEAN),
        );
        let mirrored = DVec3::new(0.0, -bar.y, bar.z);
        let spec: [(&str, &str, usize, DVec3, f64, DVec3, Motion); 17] = [
            ("panda_link0", "", 0, DVec3::ZERO, 0.0, DVec3::Z, Fixed),
            (
                "panda_link1",
                ARM_JOINT_NAMES[0],
                0,
                DVec3::new(0.0, 0.0, 0.333),
                0.0,
                DVec3::Z,
                Arm(0),
            ),
            ("panda_link2", ARM_JOINT_NAMES[1], 1, DVec3::ZERO, -H, DVec3::Z, Arm(1)),
            (
                "panda_link3",
                ARM_JOINT_NAMES[2],
                2,
                DVec3::new(0.0, -0.316, 0.0),
                H,
                DVec3::Z,
                Arm(2),
            ),
            (
                "panda_link4",
                ARM_JOINT_NAMES[3],
                3,
                DVec3::new(0.0825, 0.0, 0.0),
                H,
                DVec3::Z,
                Arm(3),
            ),
            (
                "panda_link5",
                ARM_JOINT_NAMES[4],
                4,
                DVec3::new(-0.0825, 0.384, 0.0),
                -H,
                DVec3::Z,
                Arm(4),
            ),
            ("panda_link6", ARM_JOINT_NAMES[5], 5, DVec3::ZERO, H, DVec3::Z, Arm(5)),
            (
                "panda_link7",
                ARM_JOINT_NAMES[6],
                6,
                DVec3::new(0.088, 0.0, 0.0),
                H,
                DVec3::Z,
                Arm(6),
            ),
            (
                "panda_link8",
                "panda_joint8",
                7,
                DVec3::new(0.0, 0.0, 0.107),
                0.0,
                DVec3::Z,
                Fixed,
            ),
            (
                "gripper_base_link",
                "gripper_joint",
                8,
                DVec3::ZERO,
                0.0,
                DVec3::Z,
                Fixed,
            ),
            (
                "left_knuckle_link",
                "finger_joint",
                9,
                DVec3::new(0.0, y, z),
                0.0,
                DVec3::X,
                Finger(1.0),
            ),
            (
                "left_finger_link",
                "left_finger_joint",
                10,
                bar,
                0.0,
                DVec3::X,
                Finger(-1.0),
            ),
            (
                "left_bar_link",
                "left_bar_joint",
                9,
                DVec3::new(0.0, y - 0.014, z + 0.012),
                0.0,
                DVec3::X,
                Finger(1.0),
            ),
            (
                "right_knuckle_link",
                "right_knuckle_joint",
                9,
                DVec3::new(0.0, -y, z),
                0.0,
                DVec3::X,
                Finger(-1.0),
            ),
            (
                "right_finger_link",
                "right_finger_joint",
                13,
                mirrored,
                0.0,
                DVec3::X,
                Finger(1.0),
            ),
            (
                "right_bar_link",
                "right_bar_joint",
                9,
                DVec3::new(0.0, 0.014 - y, z + 0.012),
                0.0,
                DVec3::X,
                Finger(-1.0),
            ),
            (
                "wrist_camera_link",
                "wrist_camera_joint",
                8,
                DVec3::ZERO,
                0.0,
                DVec3::Z,
                Fixed,
            ),
        ];
        let links = spec
            .into_iter()
            .enumerate()
            .map(|(index, (name, joint, parent, xyz, roll, axis, motion))| Link {
                name,
                joint,
                parent,
                xyz,
                rpy: [roll, 0.0, 0.0],
                turn: rot_rpy([roll, 0.0, 0.0]),
                axis,
                motion,
                mesh: Arc::new(shapes::link_mesh(index)),
            });
        Self { links: links.collect() }
    }

    /// Names of all links; a link id is an index into this list.
    #[must_use]
    pub fn link_names(&self) -> Vec<String> {
        self.links.iter().map(|link| link.name.to_owned()).collect()
    }

    /// The mesh of a link in the link's frame.
    #[must_use]
    pub fn link_mesh(&self, link: usize) -> &TriMesh {
        &self.links[link].mesh
    }

    /// Link-to-base poses of all links.
    #[must_use]
    pub fn fk(&self, state: &RobotState) -> Vec<Pose<Base, BodyFrame>> {
        Self::poses(&self.links, state)
    }

    /// Link-to-base poses of the links up to the flange.
    #[must_use]
    pub(crate) fn arm(&self, joints: &[f64; ARM_JOINTS]) -> Vec<Pose<Base, BodyFrame>> {
        let state = RobotState {
            joints: *joints,
            gripper: 0.0,
        };
        Self::poses(&self.links[..=FLANGE_LINK], &state)
    }

    /// Link-to-base poses of the first links.
    fn poses(links: &[Link], state: &RobotState) -> Vec<Pose<Base, BodyFrame>> {
        let finger = FINGER_CLOSED * state.gripper;
        let mut poses: Vec<Pose<Base, BodyFrame>> = Vec::with_capacity(links.len());
        for (index, link) in links.iter().enumerate() {
            let angle = match link.motion {
                Motion::Fixed => 0.0,
                Motion::Arm(joint) => state.joints[joint],
                Motion::Finger(multiplier) => multiplier * finger,
            };
            let turn = link.turn * rot_axis(link.axis, angle);
            poses.push(match index {
                0 => Pose::new(turn, link.xyz),
                _ => poses[link.parent] * Pose::new(turn, link.xyz),
            });
        }
        poses
    }

    /// Flange-to-base pose only.
    #[must_use]
    pub(crate) fn flange(&self, joints: &[f64; ARM_JOINTS]) -> Pose<Base, BodyFrame> {
        self.arm(joints)[FLANGE_LINK]
    }

    /// What `robot-maps` must know about this model.
    #[must_use]
    pub fn spec(&self) -> RobotSpec {
        RobotSpec {
            base_link: self.links[0].name.into(),
            gripper_joint: "finger_joint".into(),
            gripper_closed: FINGER_CLOSED,
            gripper_open: 0.0,
            tool_link: self.links[GRIPPER_LINK].name.into(),
            tool_offset_m: [0.0, 0.0, TOOL_Z],
            exclude_links: Vec::new(),
            collision_links: Vec::new(),
            mesh_axes: MeshAxes::Viewers,
        }
    }
}

/// Distance between the pads at a gripper state, metres.
#[must_use]
pub fn pad_gap(gripper: f64) -> f64 {
    let lean = KNUCKLE_LEAN - FINGER_CLOSED * gripper;
    2.0 * (KNUCKLE_PIVOT[0] + KNUCKLE_LENGTH * libm::sin(lean) - PAD_OFFSET)
}

/// Gripper state in [0, 1] at which the pads are `gap` metres apart, as near as the gripper can.
#[must_use]
pub fn gripper_for_gap(gap: f64) -> f64 {
    let (mut open, mut closed) = (0.0, 1.0);
    for _ in 0..50 {
        let middle = 0.5 * (open + closed);
        if pad_gap(middle) > gap {
            open = middle
        } else {
            closed = middle
        }
    }
    0.5 * (open + closed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gripper_opens_wide_and_closes_to_nothing() {
        assert!((0.078..0.09).contains(&pad_gap(0.0)), "{}", pad_gap(0.0));
        assert!((-0.001..0.001).contains(&pad_gap(1.0)), "{}", pad_gap(1.0));
        assert!((pad_gap(gripper_for_gap(0.04)) - 0.04).abs() < 1e-9);
    }

    #[test]
    fn pads_stay_parallel_at_the_computed_gap() {
        let robot = Robot::new();
        for gripper in [0.0, 0.3, 1.0] {
            let poses = robot.fk(&RobotState { joints: HOME, gripper });
            let base = poses[GRIPPER_LINK].inverse();
            let (left, right) = (base * poses[11], base * poses[14]);
            assert!((left.rotation.z_axis - DVec3::Z).length() < 1e-12);
            let gap = left.translation.y - right.translation.y - 2.0 * PAD_OFFSET;
            assert!((gap - pad_gap(gripper)).abs() < 1e-12);
        }
    }

    #[test]
    fn home_points_the_tool_down_with_the_camera_side_towards_the_base() {
        let flange = Robot::new().flange(&HOME);
        assert!((flange.rotation.z_axis + DVec3::Z).length() < 1e-9);
        assert!((flange.rotation.x_axis - DVec3::X).length() < 1e-9);
        assert!(flange.translation.x > 0.3);
    }
}
