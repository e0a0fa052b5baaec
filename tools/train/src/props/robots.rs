//! Other robots for procedural episodes: any URDF with meshes, and what of it is hand, tool and gripper.

use std::sync::Arc;

use glam::DVec3;
use rogs_geometry::{Base, Pose};
use rogs_robot::names::matches_any;
use rogs_robot::{JointState, Mesh, RobotModel};
use rogs_synth::{BodyFrame, GuestArm, GuestMesh, Kinematics};

use super::simplify::simplified;
use crate::error::{Error, Result};
use crate::sources::RobotSettings;

/// Most triangles of a link; larger meshes are simplified.
const MOST_TRIANGLES: usize = 1500;

/// Kinematics of a description.
#[derive(Debug)]
struct Described {
    model: RobotModel,
    /// Joints by index in the model: those that are driven, in order.
    driven: Vec<usize>,
    /// The joint of the gripper, and its value open and closed.
    gripper: Option<(usize, [f64; 2])>,
}

impl Kinematics for Described {
    fn poses(&self, joints: &[f64], gripper: f64) -> Vec<Pose<Base, BodyFrame>> {
        let mut values = vec![0.0; self.model.joints.len()];
        for (&joint, &value) in self.driven.iter().zip(joints) {
            values[joint] = value;
        }
        if let Some((joint, [open, closed])) = self.gripper {
            values[joint] = open + (closed - open) * gripper;
        }
        let mut state = JointState { values };
        self.model.follow_mimics(&mut state);
        self.model.fk(&state).iter().map(Pose::relabelled).collect()
    }
}

/// Reads a robot.
///
/// # Errors
/// When the description or a mesh cannot be read, or has not what the settings name.
pub(super) fn arm(settings: &RobotSettings) -> Result<GuestArm> {
    let wrong = |reason: String| Error::Folder {
        path: settings.urdf.clone(),
        reason,
    };
    let spec = &settings.spec;
    let read = || -> std::result::Result<_, rogs_robot::Error> {
        let model = RobotModel::load(&settings.urdf)?.with_base_link(&spec.base_link)?;
        let hand = model.link_id(&spec.tool_link)?;
        let gripper = if spec.gripper_joint.is_empty() {
            None
        } else {
            let joint = model.joint_index(&spec.gripper_joint)?;
            Some((joint, [spec.gripper_open, spec.gripper_closed]))
        };
        let mut meshes = Vec::new();
        for (link, description) in model.links.iter().enumerate() {
            if matches_any(&spec.exclude_links, &description.name) {
                continue;
            }
            let collision = matches_any(&spec.collision_links, &description.name);
            let shapes = if collision {
                &description.collision
            } else {
                &description.visual
            };
            let mut mesh = Mesh::default();
            for shape in shapes {
                mesh.append(&Mesh::of_shape(shape, &model.folder, spec.mesh_axes)?.mesh);
            }
            if !mesh.triangles.is_empty() {
                let Mesh { positions, triangles } = simplified(mesh, MOST_TRIANGLES);
                meshes.push(GuestMesh {
                    link,
                    positions,
                    triangles,
                });
            }
        }
        Ok((model, hand, gripper, meshes))
    };
    let (model, hand, gripper, meshes) = read().map_err(|error| wrong(error.chain()))?;
    let driven: Vec<usize> = model
        .driven_joints()
        .filter(|joint| gripper.is_none_or(|(its, _)| its != *joint))
        .collect();
    let names = driven.iter().map(|&joint| model.joints[joint].name.clone()).collect();
    let endless = [f64::NEG_INFINITY, f64::INFINITY];
    let limits = driven
        .iter()
        .map(|&joint| model.joints[joint].limits.unwrap_or(endless))
        .collect();
    let kinematics = Arc::new(Described { model, driven, gripper });
    let tool = DVec3::from_array(spec.tool_offset_m);
    GuestArm::new(kinematics, (names, limits), meshes, (hand, tool)).map_err(wrong)
}
