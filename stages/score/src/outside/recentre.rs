//! The mean camera frame in which 4DGT sees a stream (`docs/spec/baseline-4dgt.md` section 7).

use glam::DVec3;
use rogs_schemas::RigidPose;

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
