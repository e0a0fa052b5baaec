//! What moves in the images against what should (`docs/spec/agreement.md` section 5).

use rogs_schemas::records::robot::NO_LINK;

use crate::view::Surface;

/// A frame of a camera that stands still.
#[derive(Debug, Clone, Copy)]
pub struct MovingFrame<'a> {
    /// RGB, 8 bit. `[H, W, 3]`
    pub rgb: &'a [u8],
    /// The robot at this time.
    pub surface: Surface<'a>,
}

/// How far the images change where the robot should.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionAgreement {
    /// Mean change of the image where the drawn robot changes, grey values.
    pub inside: f64,
    /// The same elsewhere.
    pub outside: f64,
    /// Share of the image that should change.
    pub area: f64,
}

impl MotionAgreement {
    /// 1 when only the predicted region changes, 0 when it changes no more than the rest, negative when less.
    #[must_use]
    pub fn score(&self) -> f64 {
        (self.inside - self.outside) / (self.inside + self.outside).max(1e-9)
    }
}

/// Compares the difference of two frames of a fixed camera with the region in which the drawn robot changes (another
/// link, another depth by 5 mm, robot or none). `None` when less than 0.2 % of the image should change, or the images do
/// not.
#[must_use]
pub fn motion(first: &MovingFrame<'_>, second: &MovingFrame<'_>) -> Option<MotionAgreement> {
    /// A change of depth that counts, metres.
    const MOVED_M: f32 = 0.005;
    let pixels = first.surface.link.len();
    let same = [
        second.surface.link.len(),
        first.surface.depth_m.len(),
        second.surface.depth_m.len(),
    ];
    if same.iter().any(|&count| count != pixels) || first.rgb.len() != 3 * pixels || second.rgb.len() != 3 * pixels {
        return None;
    }
    let (mut sums, mut counts) = ([0.0; 2], [0.0; 2]);
    for pixel in 0..pixels {
        let (a, b) = (first.surface.link[pixel], second.surface.link[pixel]);
        let moved =
            a != b || (a != NO_LINK && (first.surface.depth_m[pixel] - second.surface.depth_m[pixel]).abs() > MOVED_M);
        let change: u32 = (3 * pixel..3 * pixel + 3)
            .map(|value| u32::from(first.rgb[value].abs_diff(second.rgb[value])))
            .sum();
        let side = usize::from(!moved);
        sums[side] += f64::from(change) / 3.0;
        counts[side] += 1.0;
    }
    let result = MotionAgreement {
        inside: sums[0] / f64::max(counts[0], 1.0),
        outside: sums[1] / f64::max(counts[1], 1.0),
        area: counts[0] / pixels.max(1) as f64,
    };
    (result.area > 0.002 && result.inside + result.outside > 0.5).then_some(result)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_that_moves_as_it_should_scores_higher_than_one_that_moves_elsewhere() {
        let bar = |left: usize| -> Vec<u8> {
            let inside = |i: usize| (left..left + 6).contains(&(i % 40));
            (0..1200).map(|i| if inside(i) { 0 } else { NO_LINK }).collect()
        };
        let image = |left: usize| -> Vec<u8> {
            bar(left)
                .iter()
                .flat_map(|&l| if l == 0 { [200; 3] } else { [50; 3] })
                .collect()
        };
        let score = |lefts: [usize; 2], drawn: [usize; 2]| {
            let (links, images) = (drawn.map(bar), lefts.map(image));
            let depth = [0.0; 1200];
            let frame = |i: usize| MovingFrame {
                rgb: &images[i],
                surface: Surface {
                    depth_m: &depth,
                    link: &links[i],
                },
            };
            motion(&frame(0), &frame(1)).map(|found| found.score())
        };
        assert!(score([10, 13], [10, 13]).unwrap() > 0.99);
        assert!(score([10, 13], [25, 28]).unwrap() < 0.0);
        assert_eq!(score([10, 13], [10, 10]), None);
        assert_eq!(score([10, 10], [10, 13]), None);
    }
}
