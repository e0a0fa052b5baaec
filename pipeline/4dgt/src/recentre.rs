//! The mean camera frame in which 4DGT sees a stream, and the way back (`docs/spec/baseline-4dgt.md` section 7).

use glam::DVec3;
use rogs_geometry::{Base, Camera, Pose, quaternion_product, wxyz_f32};
use rogs_schemas::RigidPose;
use rogs_schemas::records::polynomial::Polynomials;

use crate::rays::Mean;

/// Where the mean frame of a stream's cameras stands.
#[derive(Debug, Clone, Copy)]
pub struct Recentring {
    base_from_mean: Pose<Base, Mean>,
}

impl Recentring {
    /// About the mean frame of these cameras; `None` where they have none.
    #[must_use]
    pub fn of(base_from_camera: &[Pose<Base, Camera>]) -> Option<Self> {
        let poses: Vec<RigidPose> = base_from_camera.iter().map(Pose::to_rigid).collect();
        let base_from_mean = Pose::from_rigid(&mean_frame(&poses)?).ok()?;
        Some(Self { base_from_mean })
    }

    /// A camera in the mean frame.
    #[must_use]
    pub fn apply(&self, base_from_camera: &Pose<Base, Camera>) -> Pose<Mean, Camera> {
        base_from_camera.seen_from(&self.base_from_mean)
    }

    /// Brings a field from the mean frame to the base: centres are moved, rotations and velocities turned. Angular velocities
    /// are of the Gaussians' own frames and stay.
    pub fn undo(&self, field: &mut Polynomials) {
        let vector = |values: &[f32]| glam::Vec3::from_slice(values).as_dvec3();
        for centre in field.centre_m.chunks_exact_mut(3) {
            let moved = self.base_from_mean.point(vector(centre));
            centre.copy_from_slice(&moved.as_vec3().to_array());
        }
        for velocity in field.velocity.chunks_exact_mut(3) {
            let turned = self.base_from_mean.direction(vector(velocity));
            velocity.copy_from_slice(&turned.as_vec3().to_array());
        }
        let turn = wxyz_f32(self.base_from_mean.quaternion());
        for rotation in field.rotation.chunks_exact_mut(4) {
            let own = [rotation[0], rotation[1], rotation[2], rotation[3]];
            rotation.copy_from_slice(&quaternion_product(turn, own));
        }
    }
}

/// The mean frame A of camera poses (`world_from_camera`, OpenCV axes); a camera is recentred as `A^-1 * pose`. `None` for
/// no poses or axes that are all parallel.
///
/// It looks from the mean centre to the point the cameras attend to, which for parallel cameras is the world's origin.
#[must_use]
pub fn mean_frame(poses: &[RigidPose]) -> Option<RigidPose> {
    if poses.is_empty() {
        return None;
    }
    let count = poses.len() as f64;
    let axis = |pose: &RigidPose, k: usize| DVec3::new(pose.rotation[k], pose.rotation[3 + k], pose.rotation[6 + k]);
    let origins: Vec<DVec3> = poses.iter().map(|pose| DVec3::from_array(pose.translation)).collect();
    let forwards: Vec<DVec3> = poses.iter().map(|pose| axis(pose, 2).normalize_or_zero()).collect();
    let centre = origins.iter().sum::<DVec3>() / count;
    let (mut weighted, mut total) = (DVec3::ZERO, 0.0);
    for (oa, fa) in origins.iter().zip(&forwards) {
        for (ob, fb) in origins.iter().zip(&forwards) {
            let cross = fa.cross(*fb);
            let weight = cross.length_squared();
            let offset = *ob - *oa;
            let sa = determinant(offset, *fb, cross) / (weight + 1e-8);
            let sb = determinant(offset, *fa, cross) / (weight + 1e-8);
            weighted += weight * ((*oa + sa * *fa) + (*ob + sb * *fb)) / 2.0;
            total += weight;
        }
    }
    let attention = weighted / (total + 1e-8);
    let forward = forwards.iter().sum::<DVec3>() / count;
    let forward = forward / (forward.length() + 1e-13);
    let to_attention = attention - centre;
    let mut z = to_attention / (to_attention.length() + 1e-13);
    if z.dot(forward) < 0.0 || z.length() < 0.5 {
        z = forward;
    }
    let down = poses.iter().map(|pose| axis(pose, 1)).sum::<DVec3>() / count;
    let x = down.cross(z).try_normalize()?;
    let y = z.cross(x);
    Some(RigidPose {
        rotation: [x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z],
        translation: centre.to_array(),
    })
}

fn determinant(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    a.dot(b.cross(c))
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DQuat};

    use super::*;

    fn cameras() -> Vec<Pose<Base, Camera>> {
        let camera = |k: usize| {
            let turn = DQuat::from_euler(glam::EulerRot::XYZ, -1.9, 0.1 * k as f64, 0.05 * k as f64);
            Pose::new(DMat3::from_quat(turn), DVec3::new(0.5, 0.1 * k as f64, 0.7))
        };
        (0..5).map(camera).collect()
    }

    #[test]
    fn a_field_comes_back_to_where_its_cameras_stand() {
        let cameras = cameras();
        let recentring = Recentring::of(&cameras).unwrap();
        for camera in &cameras {
            // A Gaussian one metre in front of the recentred camera, turned like it, moving along its axis.
            let own = recentring.apply(camera);
            let mut field = Polynomials {
                centre_m: own.point(DVec3::Z).as_vec3().to_array().to_vec(),
                velocity: own.direction(DVec3::Z).as_vec3().to_array().repeat(4),
                rotation: wxyz_f32(own.quaternion()).to_vec(),
                angular: vec![1.0; 6],
                ..Polynomials::default()
            };
            recentring.undo(&mut field);
            let close = |found: &[f32], expected: &[f32]| found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6);
            assert!(close(&field.centre_m, &camera.point(DVec3::Z).as_vec3().to_array()));
            assert!(close(
                &field.velocity[9..],
                &camera.direction(DVec3::Z).as_vec3().to_array()
            ));
            let expected = wxyz_f32(camera.quaternion());
            let negative = expected.map(|value| -value);
            assert!(close(&field.rotation, &expected) || close(&field.rotation, &negative));
            assert_eq!(field.angular, [1.0; 6]);
        }
    }

    #[test]
    fn a_camera_at_the_origin_looks_along_its_own_axis() {
        let one = Pose::new(DMat3::from_rotation_x(-2.0), DVec3::ZERO);
        let found = Recentring::of(&[one; 3]).unwrap().apply(&one);
        assert!(
            (found.rotation - DMat3::IDENTITY)
                .to_cols_array()
                .iter()
                .all(|value| value.abs() < 1e-9)
        );
        assert!(Recentring::of(&[]).is_none());
    }
}
