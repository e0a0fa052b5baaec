//! What pictures and depth of recordings become in a sample.

use rogs_schemas::records::robot::RobotMap;
use rogs_schemas::units::iu_from_m;

/// RGB in 0..1, planar. `[H, W, 3] -> [3, H, W]`
pub(super) fn planar(rgb: &[u8]) -> Vec<f32> {
    (0..3)
        .flat_map(|channel| rgb[channel..].iter().step_by(3))
        .map(|&value| f32::from(value) / 255.0)
        .collect()
}

/// Depth in internal units and whether it counts; what is unknown or outside the open interval does not.
pub(super) fn reference_depth(depth_m: &[f32], [nearest, farthest]: [f32; 2]) -> (Vec<f32>, Vec<f32>) {
    let one = |&depth: &f32| {
        if depth > nearest && depth < farthest {
            (iu_from_m(depth), 1.0)
        } else {
            (0.0, 0.0)
        }
    };
    depth_m.iter().map(one).unzip()
}

/// Depth of the robot's mesh at its support in internal units, and whether it counts: there alone.
pub(super) fn mesh_reference(map: &RobotMap) -> (Vec<f32>, Vec<f32>) {
    let one = |(&depth, &supported): (&f32, &u8)| {
        if supported != 0 {
            (iu_from_m(depth), 1.0)
        } else {
            (0.0, 0.0)
        }
    };
    map.depth_m.iter().zip(&map.support).map(one).unzip()
}
