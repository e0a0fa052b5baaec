//! Depth maps: the median filter and the normals of `docs/spec/baseline-som.md` sections 1 and 4.

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use rogs_geometry::Pinhole;

use crate::error::{OptimiseError, Result, expect};

/// Lower medians of the `side` x `side` windows around every pixel; the image is reflected at its borders without doubling
/// the border pixel. `depth [height, width]`, `side` odd
///
/// # Errors
/// When the length is wrong, or the image is too small to be reflected.
pub fn median_filter(depth: &[f32], height: usize, width: usize, side: usize) -> Result<Vec<f32>> {
    expect("depths", depth.len(), height * width)?;
    let radius = side / 2;
    if height <= radius || width <= radius {
        return Err(OptimiseError::TooSmall {
            what: "the median filter",
            least: radius + 1,
            width,
            height,
        });
    }
    let reflected = |place: isize, length: usize| {
        let last = length as isize - 1;
        let inside = if place < 0 { -place } else { place };
        (if inside > last { 2 * last - inside } else { inside }) as usize
    };
    let mut out = vec![0.0; depth.len()];
    out.par_chunks_mut(width).enumerate().for_each(|(row, to)| {
        let mut window = Vec::with_capacity(side * side);
        let reach = -(radius as isize)..=radius as isize;
        for (column, to) in to.iter_mut().enumerate() {
            window.clear();
            for down in reach.clone() {
                let from = &depth[reflected(row as isize + down, height) * width..][..width];
                window.extend(
                    reach
                        .clone()
                        .map(|across| from[reflected(column as isize + across, width)]),
                );
            }
            let middle = (window.len() - 1) / 2;
            *to = *window.select_nth_unstable_by(middle, f32::total_cmp).1;
        }
    });
    Ok(out)
}

/// Unit normals of a depth map in the world: `cross(right - left, top - bottom)` of the neighbouring points; 0 at the
/// border and where the points span no plane. Depths lie at integer pixel coordinates of `camera`, which counts pixel
/// centres at integers; `world_from_camera` turns directions. `[height, width]`
///
/// # Errors
/// When the length is wrong.
pub fn normals(
    depth: &[f32],
    height: usize,
    width: usize,
    camera: &Pinhole,
    world_from_camera: &DMat3,
) -> Result<Vec<DVec3>> {
    expect("depths", depth.len(), height * width)?;
    let point = |row: usize, column: usize| {
        let place = glam::DVec2::new(column as f64, row as f64);
        camera.unproject(place, depth[row * width + column].into())
    };
    let normal = |index: usize| {
        let (row, column) = (index / width, index % width);
        if row == 0 || column == 0 || row + 1 >= height || column + 1 >= width {
            return DVec3::ZERO;
        }
        let across = point(row, column + 1) - point(row, column - 1);
        let up = point(row - 1, column) - point(row + 1, column);
        *world_from_camera * across.cross(up).normalize_or_zero()
    };
    Ok((0..depth.len()).map(normal).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn borders_are_reflected() {
        let depth = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0];
        assert_eq!(
            median_filter(&depth, 3, 3, 3).unwrap(),
            [4.0, 4.0, 5.0, 5.0, 5.0, 5.0, 5.0, 6.0, 6.0]
        );
        assert_eq!(median_filter(&depth, 3, 3, 1).unwrap(), depth);
        assert!(median_filter(&depth, 3, 3, 7).is_err());
    }
}
