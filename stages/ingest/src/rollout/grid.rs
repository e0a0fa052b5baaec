//! Several views in one frame: where each lies.

use rogs_worker::{StageError, StageResult};

/// Part of an image, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Rect {
    pub(crate) left: u32,
    pub(crate) top: u32,
    pub(crate) width: u32,
    pub(crate) height: u32,
}

impl Rect {
    /// A whole image.
    pub(crate) fn whole((width, height): (u32, u32)) -> Self {
        Self {
            left: 0,
            top: 0,
            width,
            height,
        }
    }

    /// This part of an image of the given width. `[h, w, 3]`
    pub(crate) fn cut(&self, image: &[u8], image_width: u32) -> Vec<u8> {
        let line = image_width as usize * 3;
        let columns = self.left as usize * 3..(self.left + self.width) as usize * 3;
        let rows = self.top as usize..(self.top + self.height) as usize;
        rows.flat_map(|row| &image[row * line..][columns.clone()])
            .copied()
            .collect()
    }
}

/// Height and width of the composite that Cosmos 3 is given for DROID: views of 360x640, half of it below.
const COMPOSITE: (f64, f64) = (540.0, 640.0);

/// Where the views of a composite lie: the wrist on top, the two external cameras side by side below it at half its
/// size. Outside of the content, right and below, the frame is padding.
///
/// `size` is (width, height) of the frames; `image_size` is what Cosmos 3 calls so: target height and width, content height
/// and width. Without it the frame is all content when that gives views of a usual shape, and otherwise what is left of
/// a 540x640 composite that was scaled down until it fitted (`docs/spec/data.md` section 6).
pub(crate) fn composite(size: (u32, u32), image_size: Option<[u32; 4]>, aspect: f64) -> StageResult<[Rect; 3]> {
    let (width, height) = size;
    let (content_width, content_height) = match image_size {
        Some([target_height, target_width, content_height, content_width]) => {
            if (target_width, target_height) != size {
                return Err(StageError::bad_input(format!(
                    "its frames are {height}x{width}, `image-size` says {target_height}x{target_width} (height x width)"
                )));
            }
            if content_width > width || content_height > height {
                return Err(StageError::bad_params(format!(
                    "the content {content_height}x{content_width} of `image-size` is larger than its frame"
                )));
            }
            (content_width, content_height)
        }
        None if is_all_content(size, aspect) => size,
        None => {
            let scale = (f64::from(height) / COMPOSITE.0)
                .min(f64::from(width) / COMPOSITE.1)
                .min(1.0);
            let side = |whole: f64| (whole * scale).round() as u32;
            (side(COMPOSITE.1), side(COMPOSITE.0))
        }
    };
    let top = (f64::from(content_height) * 2.0 / 3.0).round() as u32;
    let half = content_width / 2;
    if top == 0 || half == 0 || top >= content_height {
        return Err(StageError::bad_input(format!(
            "its frames of {height}x{width} pixels are too small for three views"
        )));
    }
    let below = |left: u32, width: u32| Rect {
        left,
        top,
        width,
        height: content_height - top,
    };
    Ok([
        Rect::whole((content_width, top)),
        below(0, half),
        below(half, content_width - half),
    ])
}

/// Joins three views of equal size as a world model is given them: the wrist on top, the external cameras below at half
/// their size, each pixel the mean of four. Sides are even. `[h, w, 3]` each; gives (width, height) and the image.
#[must_use]
pub fn compose([wrist, ext1, ext2]: [&[u8]; 3], (width, height): (u32, u32)) -> ((u32, u32), Vec<u8>) {
    let line = width as usize * 3;
    let mut image = wrist.to_vec();
    for row in 0..height as usize / 2 {
        for view in [ext1, ext2] {
            let [above, below] = [2 * row, 2 * row + 1].map(|row| &view[row * line..(row + 1) * line]);
            for column in 0..width as usize / 2 {
                for channel in 0..3 {
                    let at = 6 * column + channel;
                    let sum: u16 = [above[at], above[at + 3], below[at], below[at + 3]]
                        .map(u16::from)
                        .iter()
                        .sum();
                    image.push(((sum + 2) / 4) as u8);
                }
            }
        }
    }
    ((width, height / 2 * 3), image)
}

/// Whether a frame without padding has views of the camera's shape or of 16:9, as 528x640 and 540x640 have.
fn is_all_content((width, height): (u32, u32), aspect: f64) -> bool {
    // Sides are multiples of 16 after the model: 640x352 is 2.3 % wider than 16:9.
    const TOLERANCE: f64 = 0.05;
    let own = f64::from(width) / (f64::from(height) * 2.0 / 3.0);
    height.is_multiple_of(3)
        && [aspect, 16.0 / 9.0]
            .iter()
            .any(|known| (own / known - 1.0).abs() <= TOLERANCE)
}

/// Where the views of a Ctrl-World replay lie: recorded above generated; from left to right ext1, ext2, wrist. Given
/// back in the order wrist, ext1, ext2.
pub(crate) fn replay((width, height): (u32, u32)) -> StageResult<[Rect; 3]> {
    if !width.is_multiple_of(3) || !height.is_multiple_of(2) || width == 0 || height == 0 {
        return Err(StageError::bad_input(format!(
            "its frames are {height}x{width}, two rows of three views expected (such as 384x960)"
        )));
    }
    let view = |column: u32| Rect {
        left: column * width / 3,
        top: height / 2,
        width: width / 3,
        height: height / 2,
    };
    Ok([view(2), view(0), view(1)])
}

/// Peak signal-to-noise ratio of two 8-bit images, dB; infinite where they are equal.
pub(crate) fn psnr(a: &[u8], b: &[u8]) -> f64 {
    let squares = a.iter().zip(b).map(|(&a, &b)| u64::from(a.abs_diff(b)).pow(2));
    let sum: u64 = squares.sum();
    10.0 * (255.0f64.powi(2) * a.len().max(1) as f64 / sum as f64).log10()
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDE: f64 = 16.0 / 9.0;

    fn sides(size: (u32, u32), image_size: Option<[u32; 4]>) -> [(u32, u32, u32, u32); 3] {
        composite(size, image_size, WIDE)
            .unwrap()
            .map(|rect| (rect.left, rect.top, rect.width, rect.height))
    }

    #[test]
    fn a_served_rollout_is_split_as_its_makers_join_it() {
        let served = [(0, 0, 640, 352), (0, 352, 320, 176), (320, 352, 320, 176)];
        assert_eq!(sides((640, 528), None), served);
        let joined = [(0, 0, 640, 360), (0, 360, 320, 180), (320, 360, 320, 180)];
        assert_eq!(sides((640, 540), None), joined);
    }

    #[test]
    fn padding_of_the_resolution_tiers_is_left_out() {
        let joined = [(0, 0, 640, 360), (0, 360, 320, 180), (320, 360, 320, 180)];
        for size in [(736, 544), (640, 640)] {
            assert_eq!(sides(size, None), joined, "{size:?}");
            assert_eq!(sides(size, Some([size.1, size.0, 540, 640])), joined);
        }
        // A smaller tier: 540x640 scaled by 256/540 is 256x303.
        let small = [(0, 0, 303, 171), (0, 171, 151, 85), (151, 171, 152, 85)];
        assert_eq!(sides((320, 256), None), small);
    }

    #[test]
    fn views_lie_in_their_frame_whatever_its_size() {
        let sides = (1..40).chain((40..2000).step_by(37)).chain([8192]);
        for width in sides.clone() {
            for height in sides.clone() {
                let found = [composite((width, height), None, WIDE), replay((width, height))];
                for rect in found.into_iter().flatten().flatten() {
                    let Rect { left, top, .. } = rect;
                    assert!(rect.width > 0 && rect.height > 0, "{width}x{height}: {rect:?}");
                    assert!(
                        left + rect.width <= width && top + rect.height <= height,
                        "{width}x{height}: {rect:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn what_contradicts_its_frame_is_refused() {
        let error = |size, image_size| composite(size, image_size, WIDE).unwrap_err().message;
        assert!(error((640, 528), Some([544, 736, 540, 640])).contains("528x640, `image-size` says 544x736"));
        assert!(error((640, 528), Some([528, 640, 540, 640])).contains("larger than its frame"));
        assert!(error((1, 1), None).contains("too small"));
        assert!(
            replay((961, 384))
                .unwrap_err()
                .message
                .contains("two rows of three views")
        );
    }

    #[test]
    fn a_replay_shows_the_generated_views_below() {
        let [wrist, ext1, _] = replay((960, 384)).unwrap();
        assert_eq!((wrist.left, wrist.top, wrist.width, wrist.height), (640, 192, 320, 192));
        assert_eq!((ext1.left, ext1.top), (0, 192));
    }

    #[test]
    fn a_part_is_cut_out() {
        let image: Vec<u8> = (0..4 * 3).flat_map(|pixel| [pixel; 3]).collect();
        let part = Rect {
            left: 1,
            top: 1,
            width: 2,
            height: 2,
        };
        assert_eq!(
            part.cut(&image, 4).iter().step_by(3).copied().collect::<Vec<u8>>(),
            [5, 6, 9, 10]
        );
    }

    #[test]
    fn what_is_joined_is_split_again() {
        let flat = |value: u8| vec![value; 8 * 4 * 3];
        let wrist: Vec<u8> = (0..8 * 4 * 3).map(|at| at as u8).collect();
        let (size, image) = compose([&wrist, &flat(40), &flat(90)], (8, 4));
        assert_eq!((size, image.len()), ((8, 6), 8 * 6 * 3));
        let [top, left, right] = composite(size, Some([6, 8, 6, 8]), WIDE)
            .unwrap()
            .map(|rect| rect.cut(&image, 8));
        assert_eq!(top, wrist);
        assert!(left.iter().all(|&value| value == 40) && right.iter().all(|&value| value == 90));
        assert_eq!((left.len(), right.len()), (4 * 2 * 3, 4 * 2 * 3));
        let steps: Vec<u8> = (0..8 * 4 * 3).map(|at| if at / 3 % 2 == 0 { 10 } else { 13 }).collect();
        let (_, image) = compose([&wrist, &steps, &steps], (8, 4));
        assert!(
            image[8 * 4 * 3..].iter().all(|&value| value == 12),
            "the mean of 10, 13, 10, 13 is 11.5"
        );
    }

    #[test]
    fn equal_images_are_infinitely_close() {
        assert_eq!(psnr(&[1, 2], &[1, 2]), f64::INFINITY);
        assert!((psnr(&[0; 4], &[255; 4])).abs() < 1e-12);
        assert!((psnr(&[10; 4], &[20; 4]) - 28.130_8).abs() < 1e-3);
    }
}
