//! Robot and camera when an image was taken.

use glam::DVec3;
use rogs_geometry::{Base, Camera, Link, Pose};
use rogs_robot::RobotModel;
use rogs_robot::model::JointKind;

use crate::Result;
use crate::correction::Correction;
use crate::take::Take;

/// Part of a frame over which the speed of the robot is taken.
const HALF_STEP: f64 = 0.5;

/// The robot and the camera when an image was taken.
pub(crate) struct Moment {
    /// Link-to-base poses.
    pub links: Vec<Pose<Base, Link>>,
    pub base_from_camera: Pose<Base, Camera>,
    mount_from_base: Pose<Link, Base>,
    /// Mount from link and link from base, a little earlier and later, by link.
    around: [Vec<Pose<Link, Link>>; 2],
    /// Time between the two, frames.
    span: f64,
}

impl Moment {
    /// `None` before the first and after the last state.
    pub(crate) fn new(
        take: &Take<'_>,
        frame: usize,
        mount_from_given: &Pose<Link, Camera>,
        correction: &Correction,
    ) -> Result<Option<Self>> {
        let time = frame as f64 + correction.lag_frames;
        let Some(links) = take.links(time)? else {
            return Ok(None);
        };
        let base_from_mount = take.base_from_mount(&links);
        let mut span = 0.0;
        let mut at = |time: f64| -> Result<Vec<Pose<Link, Link>>> {
            let there = take.links(time)?;
            span += if there.is_some() { HALF_STEP } else { 0.0 };
            let there = there.unwrap_or_else(|| links.clone());
            let mount_from_base = take.base_from_mount(&there).inverse();
            Ok(there.iter().map(|&link| mount_from_base * link).collect())
        };
        let around = [at(time - HALF_STEP)?, at(time + HALF_STEP)?];
        Ok(Some(Self {
            base_from_camera: base_from_mount * *mount_from_given * correction.moved,
            mount_from_base: base_from_mount.inverse(),
            around,
            span: f64::max(HALF_STEP, span),
            links,
        }))
    }

    pub(crate) fn camera_from_link(&self) -> Vec<Pose<Camera, Link>> {
        let camera_from_base = self.base_from_camera.inverse();
        self.links.iter().map(|&link| camera_from_base * link).collect()
    }

    /// A point of the base frame that moves with a link: in the mount's frame, metres, and its speed there, metres a frame.
    pub(crate) fn tied(&self, base_point: DVec3, link: usize) -> [DVec3; 2] {
        let link_point = self.links[link].inverse().point(base_point);
        let [before, after] = self.around.each_ref().map(|poses| poses[link].point(link_point));
        [self.mount_from_base.point(base_point), (after - before) / self.span]
    }
}

/// Which links are rigid to the base.
pub(crate) fn standing(model: &RobotModel) -> Vec<bool> {
    let mut standing = vec![false; model.links.len()];
    standing[model.base_link()] = true;
    // Joints may lead away from the base or towards it.
    for _ in 0..model.joints.len() {
        for joint in model.joints.iter().filter(|joint| joint.kind == JointKind::Fixed) {
            if standing[joint.parent] || standing[joint.child] {
                (standing[joint.parent], standing[joint.child]) = (true, true);
            }
        }
    }
    standing
}
