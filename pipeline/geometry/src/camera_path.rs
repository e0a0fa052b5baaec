//! Ways of a camera: looking at a point, turning about one, and smooth paths through key cameras.

use glam::{DMat3, DVec3};
use rogs_schemas::Intrinsics;

use crate::error::{Error, Result};
use crate::pinhole::Pinhole;
use crate::pose::{Camera, Frame, Pose};
use crate::posed::PosedCamera;
use crate::rotation::rotation_about_axis;

/// Two directions closer than this (sine of their angle) are one.
const PARALLEL: f64 = 1e-6;

impl<W: Frame> Pose<W, Camera> {
    /// A camera at `eye` that looks at `target`, its image upright where `up` is up. Metres, frame `W`; the third axis of the
    /// camera is `(target - eye) / |target - eye|`, the first one `forward x up`, normalised.
    ///
    /// # Errors
    /// When eye and target are one point, or the camera looks along `up`.
    pub fn looking_at(eye: DVec3, target: DVec3, up: DVec3) -> Result<Self> {
        let forward = (target - eye).try_normalize().ok_or_else(|| Error::Path {
            what: format!("the camera at {eye} looks at where it stands"),
        })?;
        let right = forward.cross(up.normalize_or_zero());
        if right.length() <= PARALLEL || !right.is_finite() {
            return Err(Error::Path {
                what: format!("the camera at {eye} looks straight up or down, so that no side of its image is up"),
            });
        }
        let right = right.normalize();
        let rotation = DMat3::from_cols(right, forward.cross(right), forward);
        Ok(Self::new(rotation, eye))
    }

    /// The camera turned, with all that it sees in its image, about an axis through a point: `c + R (t - c)` and `R` times its
    /// rotation. `axis` is a unit vector of frame `W`, the angle is in radians.
    #[must_use]
    pub fn turned_about(&self, centre: DVec3, axis: DVec3, angle: f64) -> Self {
        let turn = rotation_about_axis(axis, angle);
        Self::new(turn * self.rotation, centre + turn * (self.translation - centre))
    }
}

/// A smooth way through key cameras: positions on uniform Catmull-Rom curves, whose tangent at a key is half the difference
/// of its neighbours (at an end, the difference to its only one); rotations on the sphere between the two keys; intrinsics
/// linear. Every key takes the same share of the way.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraPath<W: Frame> {
    keys: Vec<PosedCamera<W>>,
}

impl<W: Frame> CameraPath<W> {
    /// A path through these cameras in their order.
    ///
    /// # Errors
    /// When there are fewer than two, or their image sizes differ.
    pub fn new(keys: Vec<PosedCamera<W>>) -> Result<Self> {
        if keys.len() < 2 {
            return Err(Error::Path {
                what: format!("a path needs two poses or more, this one has {}", keys.len()),
            });
        }
        let size = |key: &PosedCamera<W>| (key.lens.width, key.lens.height);
        if let Some(at) = keys.iter().position(|key| size(key) != size(&keys[0])) {
            return Err(Error::Path {
                what: format!(
                    "the images of a path have one size: pose {at} has {:?}, the first {:?}",
                    size(&keys[at]),
                    size(&keys[0])
                ),
            });
        }
        Ok(Self { keys })
    }

    /// Number of key cameras.
    #[must_use]
    pub fn len(&self) -> usize {
        self.keys.len()
    }

    /// False: a path has two keys at least.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.keys.is_empty()
    }

    /// The camera at a share of the way, 0 the first key, 1 the last; outside it stands at the ends.
    #[must_use]
    pub fn at(&self, share: f64) -> PosedCamera<W> {
        let last = self.keys.len() - 1;
        let way = share.clamp(0.0, 1.0) * last as f64;
        let first = (way.floor() as usize).min(last - 1);
        let u = way - first as f64;
        let (a, b) = (&self.keys[first], &self.keys[first + 1]);
        let position = |key: &PosedCamera<W>| key.world_from_camera.translation;
        let (from, to) = (position(a), position(b));
        let before = first
            .checked_sub(1)
            .map_or(2.0 * from - to, |at| position(&self.keys[at]));
        let after = self.keys.get(first + 2).map_or(2.0 * to - from, position);
        let rotations = (a.world_from_camera.quaternion(), b.world_from_camera.quaternion());
        let rotation = DMat3::from_quat(rotations.0.slerp(rotations.1, u).normalize());
        let mix = |a: f64, b: f64| a + (b - a) * u;
        let (p, q) = (a.lens.intrinsics, b.lens.intrinsics);
        let intrinsics = Intrinsics {
            fx: mix(p.fx, q.fx),
            fy: mix(p.fy, q.fy),
            cx: mix(p.cx, q.cx),
            cy: mix(p.cy, q.cy),
        };
        let lens = Pinhole { intrinsics, ..a.lens };
        PosedCamera::new(lens, Pose::new(rotation, catmull_rom([before, from, to, after], u)))
    }
}

/// The curve between the middle two of four points, at `u` from 0 to 1.
fn catmull_rom([a, b, c, d]: [DVec3; 4], u: f64) -> DVec3 {
    let (linear, square, cube) = (c - a, 2.0 * a - 5.0 * b + 4.0 * c - d, 3.0 * (b - c) + d - a);
    b + 0.5 * u * (linear + u * (square + u * cube))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::Base;

    fn lens(fx: f64) -> Pinhole {
        let intrinsics = Intrinsics {
            fx,
            fy: 50.0,
            cx: 32.0,
            cy: 20.0,
        };
        Pinhole {
            intrinsics,
            width: 64,
            height: 40,
        }
    }

    fn key(position: [f64; 3], turn: f64) -> PosedCamera<Base> {
        PosedCamera::new(lens(50.0 + turn), Pose::from_xyz_euler(position, [0.0, 0.0, turn]))
    }

    #[test]
    fn who_looks_at_a_point_sees_it_in_the_middle_and_upright() {
        let (eye, target) = (DVec3::new(1.0, -0.4, 0.9), DVec3::new(0.2, 0.3, 0.1));
        let pose: Pose<Base, Camera> = Pose::looking_at(eye, target, DVec3::Z).unwrap();
        pose.check_rigid().unwrap();
        let in_camera = |point: DVec3| pose.inverse().point(point);
        let seen = in_camera(target);
        assert!(seen.truncate().length() < 1e-12 && (seen.z - (target - eye).length()).abs() < 1e-12);
        let above = in_camera(target + DVec3::Z * 0.1);
        assert!(above.y < -0.01 && above.x.abs() < 1e-12, "up is up: {above}");
        assert!(Pose::<Base, Camera>::looking_at(eye, eye, DVec3::Z).is_err());
        assert!(Pose::<Base, Camera>::looking_at(eye, eye - DVec3::Z, DVec3::Z).is_err());
    }

    #[test]
    fn who_turns_about_a_point_sees_it_where_it_was() {
        let pose: Pose<Base, Camera> = Pose::from_xyz_euler([1.0, 2.0, 0.5], [0.3, -1.0, 2.0]);
        let centre = DVec3::new(0.1, 0.2, 0.3);
        let turned = pose.turned_about(centre, DVec3::Z, 1.2);
        let before = pose.inverse().point(centre);
        assert!((turned.inverse().point(centre) - before).length() < 1e-12);
        assert!((turned.translation.z - pose.translation.z).abs() < 1e-15);
        let back = turned.turned_about(centre, DVec3::Z, -1.2);
        assert!((back.translation - pose.translation).length() < 1e-12);
    }

    #[test]
    fn a_path_meets_its_keys_and_is_smooth_between_them() {
        let keys = vec![
            key([0.0, 0.0, 0.0], 0.0),
            key([1.0, 0.0, 0.5], 0.4),
            key([1.5, 1.0, 0.5], 1.0),
            key([0.0, 2.0, 1.0], 1.4),
        ];
        let path = CameraPath::new(keys.clone()).unwrap();
        assert_eq!(path.len(), 4);
        for (index, key) in keys.iter().enumerate() {
            let found = path.at(index as f64 / 3.0);
            assert!((found.world_from_camera.translation - key.world_from_camera.translation).length() < 1e-12);
            let turned = found.world_from_camera.rotation - key.world_from_camera.rotation;
            assert!(turned.to_cols_array().iter().all(|entry| entry.abs() < 1e-12));
        }
        // No jump of the speed at an inner key; the tangent there is half the difference of its neighbours.
        let at = |share: f64| path.at(share).world_from_camera.translation;
        let step = 1e-6;
        for inner in [1usize, 2] {
            let share = inner as f64 / 3.0;
            let (left, right) = (
                (at(share) - at(share - step)) / step,
                (at(share + step) - at(share)) / step,
            );
            let position = |index: usize| keys[index].world_from_camera.translation;
            let tangent = 3.0 * 0.5 * (position(inner + 1) - position(inner - 1));
            assert!(
                (left - right).length() < 1e-3 && (left - tangent).length() < 1e-3,
                "{left} {right} {tangent}"
            );
        }
        let half = path.at(0.5);
        assert!((half.lens.intrinsics.fx - 50.7).abs() < 1e-12);
        let expected: Pose<Base, Camera> = Pose::from_xyz_euler([0.0; 3], [0.0, 0.0, 0.7]);
        let off = half.world_from_camera.rotation - expected.rotation;
        assert!(off.to_cols_array().iter().all(|entry| entry.abs() < 1e-12));
        assert_eq!(path.at(7.0), path.at(1.0));
    }

    #[test]
    fn two_keys_make_a_straight_line_and_one_makes_none() {
        let path = CameraPath::new(vec![key([0.0; 3], 0.0), key([2.0, 0.0, -4.0], 0.0)]).unwrap();
        let quarter = path.at(0.25).world_from_camera.translation;
        assert!((quarter - DVec3::new(0.5, 0.0, -1.0)).length() < 1e-12, "{quarter}");
        let one = CameraPath::new(vec![key([0.0; 3], 0.0)]).unwrap_err().to_string();
        assert!(one.contains("two poses or more, this one has 1"), "{one}");
        let mut other = key([0.0; 3], 0.0);
        other.lens.width = 65;
        assert!(CameraPath::new(vec![key([0.0; 3], 0.0), other]).is_err());
    }
}
