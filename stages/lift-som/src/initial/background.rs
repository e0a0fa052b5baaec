//! What stands still: pixels outside of the robot with their depth.

use glam::{DMat3, DQuat, DVec2, DVec3};
use rogs_geometry::wxyz_f32;
use rogs_optimise::depth_maps::normals;
use rogs_optimise::masks::Side;
use rogs_worker::{StageError, StageResult};

use super::{cloud, draw, purpose};
use crate::internal;
use crate::observed::Observed;
use crate::params::LiftSomParams;
use crate::scene::Cloud;

/// Of the pixels of a frame that may be taken every so many are, and no fewer than [`LEAST`].
const ONE_IN: usize = 8;
const LEAST: usize = 64;

/// Gaussians of the background: of every frame some pixels that lie outside of the box of those of the frames before.
///
/// # Errors
/// When there is no such pixel.
pub(super) fn background(observed: &Observed, params: &LiftSomParams, camera: u64) -> StageResult<Cloud> {
    let (height, width) = (observed.height, observed.width);
    let (mut points, mut colours, mut quats) = (Vec::<DVec3>::new(), Vec::new(), Vec::new());
    for (number, frame) in observed.frames.iter().enumerate() {
        let pose = &frame.base_from_camera;
        let point = |pixel: usize| {
            let place = DVec2::new((pixel % width) as f64, (pixel / width) as f64);
            pose.point(observed.lens.unproject(place, frame.depth_m[pixel].into()))
        };
        let limits = limits(&points);
        let may = |pixel: &usize| {
            let own = point(*pixel);
            let inside = limits.is_some_and(|[low, high]| own.cmpge(low).all() && own.cmple(high).all());
            frame.sides[*pixel] == Side::Background && frame.depth_m[*pixel] > 0.0 && !inside
        };
        let pixels: Vec<usize> = (0..height * width).filter(may).collect();
        let room = (params.background as usize).saturating_sub(points.len());
        let wanted = (pixels.len() / ONE_IN).max(LEAST).min(room);
        let mut random = draw(params, &[camera, purpose::BACKGROUND, number as u64]);
        let drawn = random.sorted_sample(pixels.len() as u32, wanted);
        if drawn.is_empty() {
            continue;
        }
        let turned = normals(&frame.depth_m, height, width, &observed.lens, &pose.rotation).map_err(internal)?;
        for pixel in drawn.into_iter().map(|at| pixels[at as usize]) {
            points.push(point(pixel));
            colours.push([0, 1, 2].map(|channel| frame.image[3 * pixel + channel]));
            quats.extend(towards(turned[pixel]));
        }
    }
    if points.is_empty() {
        return Err(StageError::bad_input(format!(
            "no pixel of camera `{}` is background at any frame: the robot, dilated by {} pixels, fills its images",
            observed.id, params.dilate_px
        ))
        .with_hint("Shape of Motion needs a background; the clip counts as failed"));
    }
    Ok(cloud(&points, &colours, quats))
}

/// The box of some points.
fn limits(points: &[DVec3]) -> Option<[DVec3; 2]> {
    let first = *points.first()?;
    let grow = |[low, high]: [DVec3; 2], point: &DVec3| [low.min(*point), high.max(*point)];
    Some(points.iter().fold([first, first], grow))
}

/// The shortest turn (w, x, y, z) that takes z to a direction; none where there is no direction.
fn towards(normal: DVec3) -> [f32; 4] {
    if normal.length_squared() < 0.5 {
        return wxyz_f32(DQuat::from_mat3(&DMat3::IDENTITY));
    }
    wxyz_f32(DQuat::from_rotation_arc(DVec3::Z, normal.normalize()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn z_is_turned_to_the_normal() {
        for normal in [DVec3::Z, -DVec3::Z, DVec3::X, DVec3::new(0.6, 0.0, -0.8)] {
            let [w, x, y, z] = towards(normal).map(f64::from);
            let turned = DQuat::from_xyzw(x, y, z, w) * DVec3::Z;
            assert!(turned.abs_diff_eq(normal, 1e-6), "{normal}: {turned}");
        }
        assert_eq!(towards(DVec3::ZERO), [1.0, 0.0, 0.0, 0.0]);
    }
}
