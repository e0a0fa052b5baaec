//! Depths, links and errors as colours.

use rogs_schemas::records::robot::{NO_LINK, RobotMap};

use super::picture::Picture;

/// Error, of 255, from which on error maps have their brightest colour.
pub(super) const FULL_ERROR: u8 = 64;
/// Mean absolute difference of the channels as a colour ramp.
pub(super) fn error_map(reference: &Picture, render: &Picture) -> Option<Picture> {
    (reference.rgb.len() == render.rgb.len()).then(|| {
        let mut picture = Picture::new(reference.width, reference.height, 0);
        let pixels = reference.rgb.chunks_exact(3).zip(render.rgb.chunks_exact(3));
        for (out, (a, b)) in picture.rgb.chunks_exact_mut(3).zip(pixels) {
            let sum: u32 = a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
            let share = (sum as f32 / 3.0 / f32::from(FULL_ERROR)).min(1.0);
            out.copy_from_slice(&heat(share));
        }
        picture
    })
}

/// Black over red to yellow.
fn heat(x: f32) -> [u8; 3] {
    let channel = |value: f32| (255.0 * value.clamp(0.0, 1.0)) as u8;
    [channel(2.0 * x), channel(2.0 * x - 1.0), 0]
}

/// 2 % and 98 % quantiles of the positive depths, metres.
pub(super) fn depth_range(depths: impl Iterator<Item = f32>) -> Option<(f32, f32)> {
    let mut depths: Vec<f32> = depths.filter(|depth| depth.is_finite() && *depth > 0.0).collect();
    if depths.is_empty() {
        return None;
    }
    depths.sort_unstable_by(f32::total_cmp);
    let at = |quantile: f64| depths[((depths.len() - 1) as f64 * quantile) as usize];
    let (near, far) = (at(0.02), at(0.98));
    Some((near, far.max(near + 1e-3)))
}

/// Depth as a ramp between two depths, black where there is none.
pub(super) fn depth_picture(width: usize, height: usize, depth_m: &[f32], (near, far): (f32, f32)) -> Picture {
    let mut picture = Picture::new(width, height, 0);
    for (pixel, &depth) in picture.rgb.chunks_exact_mut(3).zip(depth_m) {
        if depth > 0.0 {
            pixel.copy_from_slice(&ramp(((depth - near) / (far - near)).clamp(0.0, 1.0)));
        }
    }
    picture
}

/// A ramp of rising brightness from blue over red to yellow.
fn ramp(x: f32) -> [u8; 3] {
    let channel = |value: f32| (255.0 * value.clamp(0.0, 1.0)) as u8;
    [
        channel(1.8 * x),
        channel(1.9 * x - 0.75),
        channel(0.35 + 0.9 * x - 2.6 * (x - 0.35).max(0.0) + 1.6 * (x - 0.75).max(0.0)),
    ]
}

/// Link ids by colour.
pub(super) fn link_picture(width: usize, height: usize, map: &RobotMap) -> Picture {
    let mut picture = Picture::new(width, height, 0);
    for ((pixel, &link), &support) in picture.rgb.chunks_exact_mut(3).zip(&map.link).zip(&map.support) {
        if link != NO_LINK {
            // A fixed colour per link, dimmer where the pixel is not valid support.
            let hash = u32::from(link).wrapping_add(1).wrapping_mul(0x9e37_79b1);
            let scale = if support != 0 { 1.0 } else { 0.55 };
            for (channel, value) in pixel.iter_mut().enumerate() {
                let byte = 70 + (hash >> (8 * channel)) as u8 % 186;
                *value = (f32::from(byte) * scale) as u8;
            }
        }
    }
    picture
}

/// Absolute difference of the channels, times 2.
pub(super) fn error_picture(reference: &Picture, render: &Picture) -> Option<Picture> {
    (reference.rgb.len() == render.rgb.len()).then(|| {
        let mut picture = Picture::new(reference.width, reference.height, 0);
        for ((out, a), b) in picture.rgb.iter_mut().zip(&reference.rgb).zip(&render.rgb) {
            *out = a.abs_diff(*b).saturating_mul(2);
        }
        picture
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_maps_grow_with_the_error() {
        let grey = |value| Picture::new(2, 1, value);
        let colour = |error: u8| error_map(&grey(100), &grey(100 + error)).unwrap().rgb[..3].to_vec();
        assert_eq!(colour(0), [0, 0, 0]);
        assert_eq!(colour(FULL_ERROR / 2), [255, 0, 0]);
        assert_eq!(colour(FULL_ERROR), [255, 255, 0]);
        assert_eq!(colour(150), [255, 255, 0]);
        assert!(error_map(&grey(0), &Picture::new(3, 1, 0)).is_none());
    }
}
