//! Depth maps: alignment, median filter and normals of `docs/spec/baseline-som.md` sections 1 and 4.

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use rogs_geometry::Pinhole;

use crate::error::{OptimiseError, Result, expect};
use crate::statistics::{lower_median, quantile};

/// Depths and disparities are kept between these.
const NEAREST: f64 = 1e-6;
const FARTHEST: f64 = 1e6;

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

/// Depth of a relative disparity map (0 to 1) that was brought to the metric depth of the same image by one factor and one
/// offset: `s = median((d - median d + 1e-8) / (m - median m + 1e-8))`, `o = median(d - s m)` with `d = 1 / depth`; what is then
/// below 1e-6 and below the 1 % quantile counts as infinitely far, depth 1e6. `[height, width]`
///
/// # Errors
/// When the lengths differ.
pub fn aligned_depth(relative: &[f32], metric_m: &[f32]) -> Result<Vec<f32>> {
    expect("relative disparities", relative.len(), metric_m.len())?;
    let disparity = |depth: &f32| 1.0 / f64::from(*depth).clamp(NEAREST, FARTHEST);
    let wanted: Vec<f64> = metric_m.iter().map(disparity).collect();
    let given: Vec<f64> = relative.iter().map(|&value| f64::from(value)).collect();
    let median = |values: &[f64]| lower_median(values).unwrap_or(0.0);
    let (middle, own_middle) = (median(&wanted), median(&given));
    let ratios = wanted.iter().zip(&given);
    let ratios: Vec<f64> = ratios
        .map(|(d, m)| (d - middle + 1e-8) / (m - own_middle + 1e-8))
        .collect();
    let scale = median(&ratios);
    let offsets: Vec<f64> = wanted.iter().zip(&given).map(|(d, m)| d - scale * m).collect();
    let offset = median(&offsets);
    let aligned: Vec<f64> = given.iter().map(|m| scale * m + offset).collect();
    let least = quantile(&aligned, 0.01).unwrap_or(0.0).min(NEAREST);
    let depth = |&value: &f64| {
        let value = if value < least { 0.0 } else { value };
        (1.0 / value.clamp(NEAREST, FARTHEST)) as f32
    };
    Ok(aligned.iter().map(depth).collect())
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
    fn relative_disparity_takes_the_metres_of_metric_depth() {
        let metric: Vec<f32> = (0..99).map(|k| 0.5 + (k * 37 % 99) as f32 * 0.03).collect();
        let relative: Vec<f32> = metric.iter().map(|depth| (1.0 / depth - 0.2) / 3.0).collect();
        let found = aligned_depth(&relative, &metric).unwrap();
        for (found, expected) in found.iter().zip(&metric) {
            assert!((found - expected).abs() < 1e-4 * expected, "{found} {expected}");
        }
        // An estimator that is wrong in a fifth of the image does not move the others.
        let mut outliers = metric.clone();
        outliers.iter_mut().step_by(5).for_each(|depth| *depth *= 3.0);
        let found = aligned_depth(&relative, &outliers).unwrap();
        let off = found
            .iter()
            .zip(&metric)
            .map(|(a, b)| (a / b - 1.0).abs())
            .fold(0.0, f32::max);
        assert!(off < 0.3, "{off}");
        assert!(aligned_depth(&relative[1..], &metric).is_err());
    }

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
