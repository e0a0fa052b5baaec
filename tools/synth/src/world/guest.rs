//! Other arms: links and kinematics that somebody else read, and motions for them.

use std::sync::Arc;

use glam::{DMat3, DVec3};
use rogs_geometry::{Base, Pose};

use crate::frame::BodyFrame;
use crate::math::{Draw, minimum_jerk};
use crate::mesh::TriMesh;
use crate::render::PreparedMesh;

/// The kinematics of an arm with a gripper.
pub trait Kinematics: Send + Sync + std::fmt::Debug {
    /// Link-to-base poses of all links at these joint positions (radians, or metres of sliding joints) and this gripper
    /// state, 0 open, 1 closed.
    fn poses(&self, joints: &[f64], gripper: f64) -> Vec<Pose<Base, BodyFrame>>;
}

/// An arm that is not the generator's own.
#[derive(Debug, Clone)]
pub struct GuestArm {
    kinematics: Arc<dyn Kinematics>,
    joint_names: Vec<String>,
    limits: Vec<[f64; 2]>,
    /// Links with a mesh: their number and the mesh, with how many parts.
    links: Vec<(usize, Arc<PreparedMesh>, usize)>,
    hand: usize,
    tool: DVec3,
}

/// The mesh of a link of a [`GuestArm`].
#[derive(Debug, Clone, Default)]
pub struct GuestMesh {
    /// Number of the link.
    pub link: usize,
    /// Vertices in the link's frame, metres.
    pub positions: Vec<[f32; 3]>,
    /// Corners of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// Most links of an arm that have meshes.
pub const MOST_LINKS: usize = 63;
/// Most parts of a link with colours of their own.
const MOST_PARTS: usize = 3;
/// Joints without limits turn within these, radians.
const FULL_TURN: f64 = 2.9;

impl GuestArm {
    /// An arm of driven joints with their limits, and the meshes of all links that have any; `hand` is the link that carries gripper and wrist camera, `tool` the place between the fingers in
    /// its frame, metres.
    ///
    /// # Errors
    /// What is wrong, in words: no joints, as many limits as names, more than 63 meshes, a tool at the hand's own origin.
    pub fn new(
        kinematics: Arc<dyn Kinematics>,
        (joint_names, limits): (Vec<String>, Vec<[f64; 2]>),
        meshes: Vec<GuestMesh>,
        (hand, tool): (usize, DVec3),
    ) -> std::result::Result<Self, String> {
        if joint_names.is_empty() || joint_names.len() != limits.len() {
            return Err(format!(
                "{} driven joints with {} limits",
                joint_names.len(),
                limits.len()
            ));
        }
        if tool.length() < 0.01 {
            return Err("the tool is less than 1 cm from the hand, so that nobody knows where it points".into());
        }
        let links: Vec<_> = meshes
            .into_iter()
            .map(|own| {
                let mesh = TriMesh::two_sided(&own.positions, &own.triangles, MOST_PARTS);
                let parts = mesh.materials.iter().copied().max().unwrap_or(0) as usize + 1;
                (own.link, mesh, parts)
            })
            .filter(|(_, mesh, _)| !mesh.triangles.is_empty())
            .map(|(link, mesh, parts)| (link, Arc::new(PreparedMesh::new(mesh)), parts))
            .collect();
        if links.is_empty() || links.len() > MOST_LINKS {
            return Err(format!("{} links with meshes, expected 1 to {MOST_LINKS}", links.len()));
        }
        let within = |[low, high]: [f64; 2]| [low.max(-FULL_TURN), high.min(FULL_TURN)];
        Ok(Self {
            kinematics,
            joint_names,
            limits: limits.into_iter().map(within).collect(),
            links,
            hand,
            tool,
        })
    }

    /// Meshes of the links that have any, with the numbers of their parts.
    pub(crate) fn meshes(&self) -> impl Iterator<Item = (Arc<PreparedMesh>, usize)> + '_ {
        self.links.iter().map(|(_, mesh, parts)| (mesh.clone(), *parts))
    }

    /// Names of the driven joints.
    pub(crate) fn joint_names(&self) -> &[String] {
        &self.joint_names
    }

    /// The frame of the hand with z towards the tool: flange-to-hand, as the generator's own flange has it.
    fn hand_from_flange(&self) -> Pose<BodyFrame, BodyFrame> {
        let z = self.tool.normalize();
        let x = if z.x.abs() < 0.9 { DVec3::X } else { DVec3::Y };
        let x = (x - z * z.dot(x)).normalize();
        Pose::new(DMat3::from_cols(x, z.cross(x), z), DVec3::ZERO)
    }

    fn at(&self, joints: &[f64], gripper: f64) -> Option<Posture> {
        let all = self.kinematics.poses(joints, gripper);
        let hand = *all.get(self.hand)?;
        let links = self.links.iter().map(|(link, ..)| all.get(*link).copied());
        Some(Posture {
            links: links.collect::<Option<_>>()?,
            tool: hand.point(self.tool),
            flange: hand * self.hand_from_flange(),
        })
    }
}

/// An arm at one time.
struct Posture {
    /// Poses of the links with meshes.
    links: Vec<Pose<Base, BodyFrame>>,
    flange: Pose<Base, BodyFrame>,
    tool: DVec3,
}

/// A motion of another arm.
#[derive(Debug, Clone)]
pub(crate) struct GuestMotion {
    /// Joint positions. `[F][J]`
    pub(crate) joints: Vec<Vec<f64>>,
    /// 0 open, 1 closed. `[F]`
    pub(crate) gripper: Vec<f64>,
    /// Whether the gripper holds something all the time; it does not move then.
    pub(crate) holds: bool,
    /// Poses of the links with meshes. `[F][link]`
    pub(crate) links: Vec<Vec<Pose<Base, BodyFrame>>>,
    /// The frame that carries the wrist camera, its z towards the tool. `[F]`
    pub(crate) flange: Vec<Pose<Base, BodyFrame>>,
    /// The place between the fingers, base frame, metres. `[F]`
    pub(crate) tool: Vec<DVec3>,
}

/// Postures that are tried for the first one of a motion.
const FIRST_TRIES: usize = 4000;
/// Postures that are tried for each other one.
const NEXT_TRIES: usize = 80;
/// Whole motions that are tried.
const MOTIONS: usize = 6;
/// Deviation of joints from one posture to the next, radians.
const STEP: f64 = 0.22;
/// Links keep this far from the table, metres; those within this distance of the base's axis stand on it.
const CLEAR_M: f64 = 0.03;
const FOOT_M: f64 = 0.2;

/// Draws a motion over the table from one posture to another and on to a third. `None` where none is found.
pub(crate) fn draw_guest_motion(draw: &mut Draw, arm: &GuestArm, table_z: f64, frames: usize) -> Option<GuestMotion> {
    (0..MOTIONS).find_map(|_| {
        let first = (0..FIRST_TRIES).find_map(|_| {
            let joints: Vec<f64> = arm.limits.iter().map(|[low, high]| draw.range(*low, *high)).collect();
            let posture = arm.at(&joints, 0.0)?;
            let t = posture.tool;
            let reaches = (0.25..0.8).contains(&t.x) && t.y.abs() < 0.45 && (0.02..0.45).contains(&(t.z - table_z));
            (reaches && posture.flange.rotation.z_axis.z < -0.35 && posture.is_clear(table_z)).then_some(joints)
        })?;
        let mut next = |from: &[f64]| {
            (0..NEXT_TRIES).find_map(|_| {
                let moved = from.iter().zip(&arm.limits).map(|(joint, [low, high])| {
                    let to = joint + STEP * draw.normal();
                    to.clamp(*low, (*high).max(*low))
                });
                let joints: Vec<f64> = moved.collect();
                arm.at(&joints, 0.0)?.is_clear(table_z).then_some(joints)
            })
        };
        let second = next(&first)?;
        let third = next(&second)?;
        let turn = draw.range(0.3, 0.7);
        let [first_grip, last_grip] = [draw.unit(), draw.unit()];
        // A gripper that would open holds on instead.
        let grip = [first_grip, last_grip.max(first_grip)];
        follow(arm, [&first, &second, &third], turn, grip, (table_z, frames))
    })
}

fn follow(
    arm: &GuestArm,
    path: [&[f64]; 3],
    turn: f64,
    grip: [f64; 2],
    (table_z, frames): (f64, usize),
) -> Option<GuestMotion> {
    let mut motion = GuestMotion {
        joints: Vec::new(),
        gripper: Vec::new(),
        holds: grip[1] <= grip[0],
        links: Vec::new(),
        flange: Vec::new(),
        tool: Vec::new(),
    };
    for frame in 0..frames {
        let time = frame as f64 / (frames.max(2) - 1) as f64;
        let (from, to, share) = if time < turn {
            (path[0], path[1], time / turn)
        } else {
            (path[1], path[2], (time - turn) / (1.0 - turn))
        };
        let s = minimum_jerk(share);
        let joints: Vec<f64> = from.iter().zip(to).map(|(a, b)| a + (b - a) * s).collect();
        let gripper = grip[0] + (grip[1] - grip[0]) * minimum_jerk(time);
        let posture = arm.at(&joints, gripper)?;
        if !posture.is_clear(table_z) {
            return None;
        }
        motion.joints.push(joints);
        motion.gripper.push(gripper);
        motion.links.push(posture.links);
        motion.flange.push(posture.flange);
        motion.tool.push(posture.tool);
    }
    Some(motion)
}

impl Posture {
    /// Whether links beyond the foot and the tool are above the table.
    fn is_clear(&self, table_z: f64) -> bool {
        let above = |p: DVec3| p.z > table_z + CLEAR_M || p.truncate().length() < FOOT_M;
        self.links.iter().all(|link| above(link.translation)) && self.tool.z > table_z + 0.01
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{ARM_JOINT_NAMES, ARM_LIMITS, FLANGE_LINK, Robot, RobotState, TOOL_Z};

    /// The generator's own arm as a guest.
    #[derive(Debug)]
    struct Own(Robot);

    impl Kinematics for Own {
        fn poses(&self, joints: &[f64], gripper: f64) -> Vec<Pose<Base, BodyFrame>> {
            let joints = std::array::from_fn(|joint| joints[joint]);
            self.0.fk(&RobotState { joints, gripper })
        }
    }

    pub(in super::super) fn own() -> GuestArm {
        let robot = Robot::new();
        let meshes = (0..robot.link_names().len())
            .map(|link| {
                let mesh = robot.link_mesh(link);
                GuestMesh {
                    link,
                    positions: mesh.positions.iter().map(|p| p.to_array()).collect(),
                    triangles: mesh.triangles.clone(),
                }
            })
            .collect();
        let joints = (ARM_JOINT_NAMES.map(str::to_owned).to_vec(), ARM_LIMITS.to_vec());
        GuestArm::new(Arc::new(Own(robot)), joints, meshes, (FLANGE_LINK, DVec3::Z * TOOL_Z)).unwrap()
    }

    #[test]
    fn guests_move_smoothly_over_the_table_with_the_hand_down() {
        let arm = own();
        let mut found = 0;
        for seed in 0..6 {
            let Some(motion) = draw_guest_motion(&mut Draw::new(seed, 0), &arm, -0.05, 33) else {
                continue;
            };
            found += 1;
            assert!(motion.flange[0].rotation.z_axis.z < -0.3);
            for frame in 1..33 {
                let step = motion.tool[frame].distance(motion.tool[frame - 1]);
                assert!(step < 0.1 && motion.tool[frame].z > -0.05, "{seed} {frame}: {step}");
                let tool = motion.flange[frame].point(DVec3::Z * TOOL_Z);
                assert!(tool.distance(motion.tool[frame]) < 1e-9);
            }
            assert!(motion.tool[0].distance(motion.tool[32]) > 0.01);
        }
        assert!(found >= 4, "{found}");
    }

    #[test]
    fn an_arm_without_joints_or_tool_is_refused() {
        let robot = || Arc::new(Own(Robot::new()));
        let refused =
            |joints: (Vec<String>, Vec<[f64; 2]>), tool| GuestArm::new(robot(), joints, Vec::new(), (8, tool));
        assert!(
            refused((Vec::new(), Vec::new()), DVec3::Z)
                .unwrap_err()
                .contains("0 driven joints")
        );
        let one = (vec!["a".to_owned()], vec![[0.0, 1.0]]);
        assert!(refused(one.clone(), DVec3::ZERO).unwrap_err().contains("1 cm"));
        assert!(refused(one, DVec3::Z).unwrap_err().contains("0 links"));
    }
}
