//! The camera to calibrate in the clips that it filmed.

use glam::DQuat;
use rogs_agreement::audit::{Filmed, Footage, Mount};
use rogs_geometry::{Base, Link, Pose};

use crate::{Error, Result};

/// A clip, and which of its cameras is calibrated.
#[derive(Debug, Clone, Copy)]
pub struct Take<'a> {
    /// Images, states, robot.
    pub footage: &'a Footage<'a>,
    /// Index of the camera.
    pub camera: usize,
}

impl<'a> Take<'a> {
    /// The camera in this clip.
    pub(crate) fn filmed(&self) -> &'a Filmed<'a> {
        &self.footage.cameras[self.camera]
    }

    /// Link-to-base poses at a time counted in frames: joints and gripper are interpolated linearly. `None` before the
    /// first and after the last state.
    pub(crate) fn links(&self, time: f64) -> Result<Option<Vec<Pose<Base, Link>>>> {
        let footage = self.footage;
        let last = footage.frames().saturating_sub(1) as f64;
        // A hundredth of a frame beyond the ends is the end.
        if !(-0.01..=last + 0.01).contains(&time) {
            return Ok(None);
        }
        let time = time.clamp(0.0, last);
        let (before, after) = (time.floor() as usize, time.ceil() as usize);
        let share = time - time.floor();
        let joints = footage.joint_names.len();
        let mix = |a: f64, b: f64| a + (b - a) * share;
        let values: Vec<f64> = (0..joints)
            .map(|joint| {
                mix(
                    footage.positions[before * joints + joint],
                    footage.positions[after * joints + joint],
                )
            })
            .collect();
        let gripper = mix(footage.gripper[before], footage.gripper[after]);
        let state = footage
            .model
            .robot_state(footage.spec, footage.joint_names, &values, gripper)
            .map_err(|error| Error::Input {
                what: format!("frame {before}: {}", error.chain()),
            })?;
        Ok(Some(footage.model.fk(&state)))
    }

    /// Mount-to-base at these link poses: where the camera's mount (the base itself, or its link) stands.
    pub(crate) fn base_from_mount(&self, links: &[Pose<Base, Link>]) -> Pose<Base, Link> {
        match &self.filmed().mount {
            Mount::Hand { link, .. } => links[*link],
            Mount::Fixed(_) | Mount::Path(_) => Pose::IDENTITY,
        }
    }
}

/// The pose between two others: translation linear, rotation on the sphere.
pub(crate) fn between(a: &Pose<Base, Link>, b: &Pose<Base, Link>, share: f64) -> Pose<Base, Link> {
    let rotation: DQuat = a.quaternion().slerp(b.quaternion(), share).normalize();
    Pose::new(
        glam::DMat3::from_quat(rotation),
        a.translation.lerp(b.translation, share),
    )
}

/// Frames of all clips, evenly chosen: `(clip, frame)`, `most` of them at most.
pub(crate) fn chosen_frames(takes: &[Take<'_>], most: usize) -> Vec<(usize, usize)> {
    let all: Vec<(usize, usize)> = takes
        .iter()
        .enumerate()
        .flat_map(|(clip, take)| (0..take.footage.frames()).map(move |frame| (clip, frame)))
        .collect();
    let count = most.clamp(1, all.len().max(1));
    if count >= all.len() {
        return all;
    }
    (0..count)
        .map(|i| all[i * (all.len() - 1) / (count - 1).max(1)])
        .collect()
}
