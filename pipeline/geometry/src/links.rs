//! How the links of a robot move between two times (paper, FK displacement; `docs/spec/conditioning.md`).

use glam::DVec3;
use rogs_schemas::records::conditioning::{ViewConditioning, plane};
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::units::UNITS_PER_METRE;
use rogs_schemas::{FrameIndex, RigidPose};

use crate::error::{Error, Result};
use crate::pose::{Base, Link, Pose, Recon};
use crate::rotation::wxyz_f32;

/// Where every link is at one time: recon_from_link, metres, by link id.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkPoses(Vec<Pose<Recon, Link>>);

impl LinkPoses {
    /// The poses at a clip frame.
    ///
    /// # Errors
    /// When the robot maps do not have the frame, or a stored pose is not rigid.
    pub fn at_frame(robot: &RobotMaps, frame: FrameIndex) -> Result<Self> {
        let recon_from_base: Pose<Recon, Base> = Pose::from_rigid(&robot.recon_from_base)?;
        let in_recon = |stored| Ok(recon_from_base * Pose::<Base, Link>::from_rigid(stored)?);
        stored(robot, frame)?
            .iter()
            .map(in_recon)
            .collect::<Result<_>>()
            .map(Self)
    }

    /// The poses at a place between clip frames, counted in frames: translations are interpolated linearly, rotations on
    /// the sphere.
    ///
    /// # Errors
    /// As [`Self::at_frame`].
    pub fn between_frames(robot: &RobotMaps, position: f64) -> Result<Self> {
        let recon_from_base: Pose<Recon, Base> = Pose::from_rigid(&robot.recon_from_base)?;
        let (before, after) = (position.floor(), position.ceil());
        let at = |position: f64| stored(robot, FrameIndex(position as u32));
        let ends = at(before)?.iter().zip(at(after)?);
        ends.map(|(a, b)| Ok(recon_from_base * interpolated(a, b, position - before)?))
            .collect::<Result<_>>()
            .map(Self)
    }

    /// How the links move from another time to this one.
    #[must_use]
    pub fn motion_from(&self, source: &Self) -> LinkMotions {
        let pairs = self.0.iter().zip(&source.0);
        LinkMotions(pairs.map(|(query, source)| *query * source.inverse()).collect())
    }
}

/// `T(t) T(s)^-1` of every link in the reconstruction frame, metres, by link id.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkMotions(Vec<Pose<Recon, Recon>>);

impl LinkMotions {
    /// How the links turn: unit quaternions (w, x, y, z) in the reconstruction frame.
    #[must_use]
    pub fn rotations(&self) -> Vec<[f32; 4]> {
        self.0.iter().map(|motion| wxyz_f32(motion.quaternion())).collect()
    }

    /// The moved position of a point of a link, reconstruction frame, metres; `None` for an unknown link.
    #[must_use]
    pub fn moved(&self, link: usize, point: DVec3) -> Option<DVec3> {
        self.0.get(link).map(|motion| motion.point(point))
    }

    /// Puts the FK displacement `motion(p) - p` of the supported pixels of a view into its dense conditioning map, taken at
    /// the positions `p` that the pixels have in the field. `position_m [H W, 3]`, reconstruction frame;
    /// `kappa [KAPPA_CHANNELS, H, W]`
    pub fn displace(&self, maps: &ViewConditioning, position_m: &[f32], kappa: &mut [f32]) {
        let area = position_m.len() / 3;
        for (&pixel, &link) in maps.pixels.iter().zip(&maps.link) {
            let Some(motion) = self.0.get(usize::from(link)) else {
                continue;
            };
            let pixel = pixel as usize;
            let point = DVec3::from_array(std::array::from_fn(|axis| f64::from(position_m[3 * pixel + axis])));
            let moved = motion.point(point) - point;
            for axis in 0..3 {
                kappa[(plane::DISPLACEMENT + axis) * area + pixel] = (moved[axis] * UNITS_PER_METRE) as f32;
            }
        }
    }
}

/// The stored base_from_link of all links at a frame.
fn stored(robot: &RobotMaps, frame: FrameIndex) -> Result<&[RigidPose]> {
    let links = robot.link_names.len();
    robot
        .base_from_link
        .get(frame.at() * links..(frame.at() + 1) * links)
        .ok_or(Error::MissingLinkPoses { frame })
}

/// The pose at `share` of the way from one pose to another.
fn interpolated(a: &RigidPose, b: &RigidPose, share: f64) -> Result<Pose<Base, Link>> {
    let pose = Pose::from_rigid(a)?.towards(&Pose::from_rigid(b)?, share);
    pose.check_rigid()?;
    Ok(pose)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halfway_between_two_poses_is_halfway() {
        let a: Pose<Base, Link> = Pose::from_xyz_euler([0.0, 0.0, 0.0], [0.0, 0.0, 0.2]);
        let b: Pose<Base, Link> = Pose::from_xyz_euler([1.0, 2.0, -4.0], [0.0, 0.0, 1.0]);
        let half = interpolated(&a.to_rigid(), &b.to_rigid(), 0.5).unwrap();
        let expected: Pose<Base, Link> = Pose::from_xyz_euler([0.5, 1.0, -2.0], [0.0, 0.0, 0.6]);
        for (found, expected) in half.to_matrix4().iter().zip(expected.to_matrix4()) {
            assert!((found - expected).abs() < 1e-12, "{found} is not {expected}");
        }
    }
}
