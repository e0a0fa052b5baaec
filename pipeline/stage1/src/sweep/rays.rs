//! The rays of cells in the frame of the robot's base, where heights repeat: tables stand about as high as the base of the
//! robot, floors a table's height below.

use rogs_schemas::units::UNITS_PER_METRE;

use super::super::frames::SourceFrames;
use super::{CELL_PIXELS, SweepDepths};

/// Heights above the base, metres: a ray is told at which depth it meets each of them.
const HEIGHTS_M: [f64; 2] = [0.0, -0.75];
/// Numbers of a ray: those of a ray map, and a depth for each height.
pub(super) const NUMBERS: usize = 6 + HEIGHTS_M.len();
/// Places of depths as shares of the sweep, which go from 0 to 1, are kept within these; a height that is never met has the
/// last one.
const PLACES: [f64; 2] = [-0.5, 1.5];

/// Of the ray through the centre of each cell, in the frame of the base: moment and direction, and the places of
/// `HEIGHTS_M` among the depths of the sweep, as shares. `[S, NUMBERS, h, w]`
pub(super) fn rays(frames: &SourceFrames, depths: &SweepDepths, [rows, columns]: [usize; 2]) -> Vec<f32> {
    let [_, _, height, width] = frames.images.dims();
    let cells = rows * columns;
    let mut map = vec![0.0f32; frames.cameras.len() * NUMBERS * cells];
    for (camera, map) in frames.cameras.iter().zip(map.chunks_exact_mut(NUMBERS * cells)) {
        let camera = camera.seen_from(&frames.recon_from_base_iu);
        for cell in 0..cells {
            let centre = |index: usize, side: usize| ((index as f64 + 0.5) * CELL_PIXELS as f64) / side as f64;
            let (u, v) = (centre(cell % columns, width), centre(cell / columns, height));
            let (climb, above) = (camera.ray(u, v).z, camera.world_from_camera_iu.translation.z);
            let met = HEIGHTS_M.map(|height_m| {
                let depth = (height_m * UNITS_PER_METRE - above) / climb;
                if depth > 0.0 && depth.is_finite() {
                    depths.share(depth).clamp(PLACES[0], PLACES[1])
                } else {
                    PLACES[1]
                }
            });
            for (number, value) in camera.plucker(u, v).into_iter().chain(met).enumerate() {
                map[number * cells + cell] = value as f32;
            }
        }
    }
    map
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, Tensor};
    use glam::{DMat3, DVec3};
    use rogs_geometry::Pose;

    use super::super::super::config::Stage1Config;
    use super::super::super::frames::Attention;
    use super::super::super::geometry::NetworkCamera;
    use super::*;

    fn depths() -> SweepDepths {
        SweepDepths::of(&Stage1Config::compact_sweep())
    }

    /// A camera 1 m above the base that looks straight down, in a reconstruction frame that is the camera's own.
    fn looking_down() -> SourceFrames {
        SourceFrames {
            images: Tensor::zeros([1, 3, 16, 32], &Device::flex()),
            cameras: vec![NetworkCamera {
                world_from_camera_iu: Pose::IDENTITY,
                focal_centre: [0.6, 1.2, 0.5, 0.5],
            }],
            recon_from_base_iu: Pose::new(
                DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
                DVec3::new(0.3, 0.2, UNITS_PER_METRE),
            ),
            times: vec![0.0],
            attention: Attention::Joint,
        }
    }

    #[test]
    fn heights_are_met_at_their_depth_and_rays_pass_through_the_camera() {
        let map = rays(&looking_down(), &depths(), [4, 8]);
        let share = |depth_m: f64| libm::log(depth_m / 0.1) / libm::log(40.0);
        // The camera in the frame of the base.
        let origin = [-0.3, 0.2, UNITS_PER_METRE];
        for cell in 0..32 {
            let of = |number: usize| f64::from(map[number * 32 + cell]);
            assert!((of(6) - share(1.0)).abs() < 1e-5 && (of(7) - share(1.75)).abs() < 1e-5);
            let direction: [f64; 3] = std::array::from_fn(|axis| of(3 + axis));
            assert!(direction[2] < -0.5);
            for axis in 0..3 {
                let [next, last] = [(axis + 1) % 3, (axis + 2) % 3];
                let moment = origin[next] * direction[last] - origin[last] * direction[next];
                assert!((of(axis) - moment).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn heights_behind_the_camera_are_never_met() {
        let mut frames = looking_down();
        frames.recon_from_base_iu.translation.z = -UNITS_PER_METRE;
        let map = rays(&frames, &depths(), [4, 8]);
        assert!(map[6 * 32..7 * 32].iter().all(|&place| place == 1.5));
    }
}
