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

/// The pose at a time counted in frames, from those of all frames: cubic (Catmull and Rom) in translation and rotation
/// vector, so that the speed has no steps at the frames; the first one before, the last one after all.
pub(crate) fn between(poses: &[Pose<Base, Link>], time: f64) -> Pose<Base, Link> {
    let last = poses.len() - 1;
    let time = time.clamp(0.0, last as f64);
    let (here, u) = (time.floor() as usize, time - time.floor());
    if u == 0.0 {
        return poses[here];
    }
    let own = &poses[here];
    let inverse = own.quaternion().inverse();
    let seen = |pose: &Pose<Base, Link>| {
        let turn: DQuat = inverse * pose.quaternion();
        // One of the two quaternions of a rotation: the shorter way.
        let turn = if turn.w < 0.0 { -turn } else { turn };
        [turn.to_scaled_axis(), pose.translation - own.translation]
    };
    let [before, next, after] = [here.saturating_sub(1), here + 1, (here + 2).min(last)].map(|at| seen(&poses[at]));
    let [turn, shift] = std::array::from_fn(|k| {
        let speeds = [0.5 * (next[k] - before[k]), 0.5 * after[k]];
        let (square, cube) = (u * u, u * u * u);
        speeds[0] * (cube - 2.0 * square + u) + next[k] * (3.0 * square - 2.0 * cube) + speeds[1] * (cube - square)
    });
    let rotation = own.quaternion() * DQuat::from_scaled_axis(turn);
    Pose::new(glam::DMat3::from_quat(rotation.normalize()), own.translation + shift)
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

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use rogs_geometry::rotation_about_axis;

    #[test]
    fn between_frames_a_pose_goes_on_smoothly() {
        // A turn that speeds up, about one axis, on a parabola: cubics are exact.
        let pose = |time: f64| -> Pose<Base, Link> {
            let turn = 0.1 * time + 0.02 * time * time;
            Pose::new(
                rotation_about_axis(DVec3::new(0.6, 0.0, 0.8), turn),
                DVec3::new(0.3 * time, 0.01 * time * time, -0.1),
            )
        };
        let poses: Vec<Pose<Base, Link>> = (0..8).map(|frame| pose(f64::from(frame))).collect();
        for time in [1.25, 2.5, 3.0, 5.9] {
            let off = pose(time).inverse() * between(&poses, time);
            assert!(off.translation.length() < 1e-12, "{time}: {off:?}");
            assert!(off.quaternion().to_scaled_axis().length() < 1e-7, "{time}: {off:?}");
        }
        assert_eq!(between(&poses, -3.0), poses[0]);
        assert_eq!(between(&poses, 7.4), poses[7]);
    }
}
