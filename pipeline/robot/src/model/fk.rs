//! Joint states and forward kinematics of one state, in f64.

use rogs_geometry::{Base, Link, Pose};
use rogs_schemas::records::robot::RobotSpec;

use super::load::motion;
use super::{JointKind, RobotModel};
use crate::error::{Error, Result};

/// A value for every joint of a model, mimic joints included. Joints that were not set are at 0.
#[derive(Debug, Clone, PartialEq)]
pub struct JointState {
    /// Radians or metres, by joint index; 0 for fixed joints.
    pub values: Vec<f64>,
}

/// A joint outside its limits.
#[derive(Debug, Clone, PartialEq)]
pub struct LimitExcess {
    /// Index of the joint.
    pub joint: usize,
    /// Its value, radians or metres.
    pub value: f64,
    /// The limits it leaves.
    pub limits: [f64; 2],
}

/// How far a given value of a mimic joint may lie from what its driver says.
const MIMIC_TOLERANCE: f64 = 1e-6;

impl RobotModel {
    /// The state with these joint values; mimic joints follow their drivers. A mimic joint may be given too, when its
    /// value agrees.
    ///
    /// # Errors
    /// When a joint does not exist, is fixed, is given twice, has a value that is not finite, or contradicts the joint
    /// it mimics.
    pub fn joint_state<'a>(&self, values: impl IntoIterator<Item = (&'a str, f64)>) -> Result<JointState> {
        let mut given = vec![None; self.joints.len()];
        for (name, value) in values {
            let index = self.joint_index(name)?;
            let refuse = |what: String| Error::Joint {
                joint: name.to_owned(),
                what,
            };
            if self.joints[index].kind == JointKind::Fixed {
                return Err(refuse("it is fixed and takes no value".into()));
            }
            if !value.is_finite() {
                return Err(refuse(format!("its value is {value}")));
            }
            if given[index].replace(value).is_some() {
                return Err(refuse("it is given twice".into()));
            }
        }
        let mut state = JointState {
            values: given.iter().map(|value| value.unwrap_or(0.0)).collect(),
        };
        self.follow_mimics(&mut state);
        for (index, value) in given.iter().enumerate() {
            let followed = state.values[index];
            if let Some(value) = value.filter(|value| (value - followed).abs() > MIMIC_TOLERANCE) {
                let joint = self.joints[index].name.clone();
                return Err(Error::Joint {
                    joint,
                    what: format!("its value {value} contradicts the joint it mimics, which asks for {followed}"),
                });
            }
        }
        Ok(state)
    }

    /// The state of a robot with a gripper: arm joints by name and the normalised gripper state (0 open, 1 closed),
    /// which drives `spec.gripper_joint` between its open and closed value.
    ///
    /// # Errors
    /// As [`RobotModel::joint_state`]; also when the gripper state lies outside [0, 1] by more than 1e-6.
    pub fn robot_state(
        &self,
        spec: &RobotSpec,
        joint_names: &[String],
        positions: &[f64],
        gripper: f64,
    ) -> Result<JointState> {
        if joint_names.len() != positions.len() {
            let what = format!("{} values for {} names", positions.len(), joint_names.len());
            return Err(Error::Joint {
                joint: joint_names.first().cloned().unwrap_or_default(),
                what,
            });
        }
        if !(-1e-6..=1.0 + 1e-6).contains(&gripper) {
            let what = format!("the gripper state is {gripper}, it must lie in [0, 1]");
            return Err(Error::Joint {
                joint: spec.gripper_joint.clone(),
                what,
            });
        }
        let finger = spec.gripper_open + (spec.gripper_closed - spec.gripper_open) * gripper;
        let arm = joint_names.iter().map(String::as_str).zip(positions.iter().copied());
        let with_gripper = (!spec.gripper_joint.is_empty()).then_some((spec.gripper_joint.as_str(), finger));
        self.joint_state(arm.chain(with_gripper))
    }

    /// The driven joints of a state that leave their limits. Mimic joints are not tested: their limits are often those
    /// of the driver and ignore the multiplier.
    #[must_use]
    pub fn limit_excesses(&self, state: &JointState) -> Vec<LimitExcess> {
        let excess = |joint: usize| {
            let (value, limits) = (state.values[joint], self.joints[joint].limits?);
            (value < limits[0] - 1e-9 || value > limits[1] + 1e-9).then_some(LimitExcess { joint, value, limits })
        };
        self.driven_joints().filter_map(excess).collect()
    }

    /// Forward kinematics: the pose of every link in the base link's frame, by link id.
    #[must_use]
    pub fn fk(&self, state: &JointState) -> Vec<Pose<Base, Link>> {
        let mut root_from_link = vec![Pose::IDENTITY; self.links.len()];
        for (joint, &value) in self.joints.iter().zip(&state.values) {
            let origin_from_child = motion(joint.kind, joint.axis, value);
            let parent: Pose<Base, Link> = root_from_link[joint.parent];
            root_from_link[joint.child] = parent * joint.parent_from_origin * origin_from_child;
        }
        if self.base_link == self.root_link {
            return root_from_link;
        }
        let base_from_root: Pose<Base, Base> = root_from_link[self.base_link].inverse().relabelled();
        root_from_link.iter().map(|pose| base_from_root * *pose).collect()
    }

    /// Gives mimic joints what their drivers ask for.
    pub fn follow_mimics(&self, state: &mut JointState) {
        for (index, joint) in self.joints.iter().enumerate() {
            if let Some(mimic) = joint.mimic {
                state.values[index] = mimic.multiplier * state.values[mimic.driver] + mimic.offset;
            }
        }
    }
}
