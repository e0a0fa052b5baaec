//! Depths, links and errors as colours.

use rogs_pages::colours;
pub(super) use rogs_pages::colours::{FULL_ERROR, depth_range};
use rogs_schemas::records::robot::{NO_LINK, RobotMap};

use super::picture::Picture;

/// Mean absolute difference of the channels as a colour ramp.
pub(super) fn error_map(reference: &Picture, render: &Picture) -> Option<Picture> {
    (reference.rgb.len() == render.rgb.len()).then(|| {
        let mut picture = Picture::new(reference.width, reference.height, 0);
        let pixels = reference.rgb.chunks_exact(3).zip(render.rgb.chunks_exact(3));
        for (out, (a, b)) in picture.rgb.chunks_exact_mut(3).zip(pixels) {
            out.copy_from_slice(&colours::error(a, b));
        }
        picture
    })
}

/// Depth as a ramp between two depths, black where there is none.
pub(super) fn depth_picture(width: usize, height: usize, depth_m: &[f32], range: (f32, f32)) -> Picture {
    let mut picture = Picture::new(width, height, 0);
    for (pixel, &depth) in picture.rgb.chunks_exact_mut(3).zip(depth_m) {
        pixel.copy_from_slice(&colours::depth(depth, range));
    }
    picture
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
    fn pictures_of_two_sizes_have_no_error_map() {
        let grey = |width| Picture::new(width, 1, 100);
        assert_eq!(error_map(&grey(2), &grey(2)).unwrap().rgb, [0; 6]);
        assert!(error_map(&grey(2), &grey(3)).is_none());
    }
}
