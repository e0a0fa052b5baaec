//! The images of a clip at the size of the network, with their cameras.

use rogs_geometry::Pinhole;
use rogs_schemas::Intrinsics;

/// A lens for images of another size: focal length and principal point are scaled, axis by axis
/// (`docs/spec/baseline-4dgt.md` section 2).
pub(crate) fn resized_lens(lens: &Pinhole, [height, width]: [u32; 2]) -> Pinhole {
    let (x, y) = (
        f64::from(width) / f64::from(lens.width),
        f64::from(height) / f64::from(lens.height),
    );
    let Intrinsics { fx, fy, cx, cy } = lens.intrinsics;
    Pinhole {
        intrinsics: Intrinsics {
            fx: fx * x,
            fy: fy * y,
            cx: cx * x,
            cy: cy * y,
        },
        width,
        height,
    }
}

/// An 8-bit image at another size, planar in 0 to 1: bilinear, pixel centres at + 0.5, without antialiasing.
/// `[h, w, 3] -> [3, H, W]`
pub(crate) fn resized(rgb: &[u8], from: [usize; 2], to: [usize; 2]) -> Vec<f32> {
    let [rows, columns] = [0, 1].map(|axis| taps(from[axis], to[axis]));
    let mut planes = Vec::with_capacity(3 * to[0] * to[1]);
    for channel in 0..3 {
        let value = |row: usize, column: usize| f32::from(rgb[(row * from[1] + column) * 3 + channel]) / 255.0;
        for &(top, bottom, down) in &rows {
            for &(left, right, across) in &columns {
                let along = |row: usize| value(row, left) * (1.0 - across) + value(row, right) * across;
                planes.push(along(top) * (1.0 - down) + along(bottom) * down);
            }
        }
    }
    planes
}

/// The two samples around each output sample, and the share of the second.
fn taps(from: usize, to: usize) -> Vec<(usize, usize, f32)> {
    let scale = from as f64 / to as f64;
    let tap = |index: usize| {
        let place = ((index as f64 + 0.5) * scale - 0.5).clamp(0.0, (from - 1) as f64);
        let first = place as usize;
        (first, (first + 1).min(from - 1), (place - first as f64) as f32)
    };
    (0..to).map(tap).collect()
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::*;

    #[test]
    fn a_ramp_stays_a_ramp_and_pixels_stay_where_the_lens_sees_them() {
        let (from, to) = ([6, 10], [14, 28]);
        let rgb: Vec<u8> = (0..60)
            .flat_map(|pixel| [(pixel % 10 * 20) as u8, (pixel / 10 * 30) as u8, 7])
            .collect();
        let planes = resized(&rgb, from, to);
        for row in 2..12 {
            for column in 2..26 {
                let x = (column as f32 + 0.5) * 10.0 / 28.0 - 0.5;
                let y = (row as f32 + 0.5) * 6.0 / 14.0 - 0.5;
                let at = |channel: usize| planes[(channel * 14 + row) * 28 + column] * 255.0;
                assert!((at(0) - 20.0 * x).abs() < 1e-3 && (at(1) - 30.0 * y).abs() < 1e-3);
                assert!((at(2) - 7.0).abs() < 1e-3);
            }
        }
        let lens = Pinhole::centred(9.0, 10, 6);
        let other = resized_lens(&lens, [14, 28]);
        // The same ray goes through the same place of the image.
        let ray = |lens: &Pinhole, x: f64, y: f64| lens.unproject(DVec2::new(x, y), 1.0);
        let (a, b) = (ray(&lens, 3.0, 2.0), ray(&other, 3.0 * 2.8, 2.0 * 14.0 / 6.0));
        assert!((a - b).length() < 1e-12);
    }
}
