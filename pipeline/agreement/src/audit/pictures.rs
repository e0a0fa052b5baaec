//! Images made of those of the clip: of half the size, and steady ones of cameras on the hand.

use super::footage::{Filmed, Footage, Mount};
use super::trial::halved;

/// Images by camera and frame.
pub(super) type Pictures = Vec<Vec<Vec<u8>>>;

/// Every image at half its size: means of 2 x 2 pixels.
pub(super) fn half_size(footage: &Footage<'_>) -> Pictures {
    let half = |rgb: &[u8], width: usize, height: usize| {
        let mut out = Vec::with_capacity(3 * (width / 2) * (height / 2));
        for row in 0..height / 2 {
            for column in 0..width / 2 {
                let first = 3 * (2 * row * width + 2 * column);
                for channel in first..first + 3 {
                    let sum: u16 = [channel, channel + 3, channel + 3 * width, channel + 3 * width + 3]
                        .map(|value| u16::from(rgb[value]))
                        .iter()
                        .sum();
                    out.push((sum / 4) as u8);
                }
            }
        }
        out
    };
    let of_camera = |camera: &Filmed<'_>| {
        let (width, height) = (camera.lens.width as usize, camera.lens.height as usize);
        camera.images.iter().map(|rgb| half(rgb, width, height)).collect()
    };
    footage.cameras.iter().map(of_camera).collect()
}

/// Whether images of half the size still show a robot.
pub(super) fn can_be_halved(footage: &Footage<'_>) -> bool {
    let small = |camera: &Filmed<'_>| camera.lens.width.min(camera.lens.height) < 100;
    !footage.cameras.iter().any(small)
}

/// For cameras on the hand, the mean of all images: the hand stays in its place, all else is blurred. Others have none.
pub(super) fn steady(footage: &Footage<'_>) -> Pictures {
    let of_camera = |camera: &Filmed<'_>| {
        if !matches!(camera.mount, Mount::Hand { .. }) {
            return Vec::new();
        }
        let mut sums = vec![0u32; camera.images.first().map_or(0, |rgb| rgb.len())];
        for image in &camera.images {
            for (sum, &value) in sums.iter_mut().zip(*image) {
                *sum += u32::from(value);
            }
        }
        let count = camera.images.len().max(1) as u32;
        vec![sums.iter().map(|sum| (sum / count) as u8).collect()]
    };
    footage.cameras.iter().map(of_camera).collect()
}

/// The same clip with other images of half the size.
pub(super) fn with_half_size<'a>(footage: &Footage<'a>, pictures: &'a Pictures) -> Footage<'a> {
    let cameras = footage.cameras.iter().zip(pictures).map(|(camera, images)| Filmed {
        lens: halved(&camera.lens),
        images: images.iter().map(Vec::as_slice).collect(),
        ..camera.clone()
    });
    Footage {
        cameras: cameras.collect(),
        ..footage.clone()
    }
}

/// The same clip with the steady images of those cameras that have some, at every frame.
pub(super) fn with_steady<'a>(footage: &Footage<'a>, pictures: &'a Pictures) -> Footage<'a> {
    let cameras = footage
        .cameras
        .iter()
        .zip(pictures)
        .map(|(camera, images)| match images.first() {
            None => camera.clone(),
            Some(image) => Filmed {
                images: vec![image.as_slice(); camera.images.len()],
                ..camera.clone()
            },
        });
    Footage {
        cameras: cameras.collect(),
        ..footage.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lenses_of_half_the_size_see_the_same_rays() {
        let lens = rogs_geometry::Pinhole::centred(100.0, 40, 20);
        let half = halved(&lens);
        assert_eq!((half.width, half.height), (20, 10));
        // The corner between four pixels is the middle of one.
        let a = lens.unproject(glam::DVec2::new(12.0, 6.0), 1.0);
        let b = half.unproject(glam::DVec2::new(6.0, 3.0), 1.0);
        assert!((a - b).length() < 1e-12);
    }
}
