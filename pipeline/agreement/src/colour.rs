//! Colour statistics inside and outside of the silhouette (`docs/spec/agreement.md` section 2).

use rogs_schemas::records::robot::NO_LINK;

/// Levels of brightness and of each of two colour differences.
const LUMA: usize = 16;
const CHROMA: usize = 12;
const BINS: usize = LUMA * CHROMA * CHROMA;

/// Bin of a colour, grey values 0 to 255: brightness, red less green, blue less yellow.
fn bin(rgb: [f32; 3]) -> usize {
    let [r, g, b] = rgb;
    let luma = (r + g + b) / 3.0;
    // Most colours are near grey, so bins there are finer: the square root of the difference counts.
    let level = |difference: f32| {
        let root = libm::sqrtf((difference.abs() / 160.0).min(1.0)).copysign(difference);
        (((root + 1.0) * 0.5 * CHROMA as f32) as usize).min(CHROMA - 1)
    };
    let brightness = ((luma / 256.0 * LUMA as f32) as usize).min(LUMA - 1);
    (brightness * CHROMA + level(r - g)) * CHROMA + level(b - 0.5 * (r + g))
}

/// How much more a colour belongs to the robot than to what surrounds it.
#[derive(Debug, Clone)]
pub(crate) struct ColourModel {
    // Natural logarithm of the ratio of the two shares, limited. `[BINS]`
    ratio: Vec<f32>,
    /// How well colours tell robot and surroundings apart: 0 not at all, 1 entirely (half the sum of absolute
    /// differences of the shares).
    pub separation: f64,
}

impl ColourModel {
    /// From the pixels of the robot and those within `ring` pixels of it (in rows and columns); `None` when one of them
    /// has fewer than 30.
    pub(crate) fn new(rgb: &[u8], link: &[u8], width: usize, height: usize, ring: usize) -> Option<Self> {
        let near = dilated(link, width, height, ring);
        let mut counts = [vec![0.0f32; BINS], vec![0.0f32; BINS]];
        let mut totals = [0.0f32; 2];
        for (pixel, colour) in rgb.chunks_exact(3).enumerate() {
            if link[pixel] != NO_LINK || near[pixel] {
                let side = usize::from(link[pixel] == NO_LINK);
                counts[side][bin([f32::from(colour[0]), f32::from(colour[1]), f32::from(colour[2])])] += 1.0;
                totals[side] += 1.0;
            }
        }
        if totals[0] < 30.0 || totals[1] < 30.0 {
            return None;
        }
        let mut separation = 0.0;
        let shares = counts[0].iter().zip(&counts[1]);
        let ratio = shares
            .map(|(inside, outside)| {
                let (p, q) = (inside / totals[0], outside / totals[1]);
                separation += f64::from((p - q).abs());
                // A colour seen in less than a thousandth of both says nothing.
                libm::logf((p + 1e-3) / (q + 1e-3)).clamp(-2.5, 2.5)
            })
            .collect();
        Some(Self {
            ratio,
            separation: 0.5 * separation,
        })
    }

    /// Logarithm of the ratio for one colour, -2.5 to 2.5: positive for colours of the robot.
    pub(crate) fn ratio(&self, rgb: [f32; 3]) -> f32 {
        self.ratio[bin(rgb)]
    }
}

/// Pixels within `radius` rows and columns of the robot, itself included.
fn dilated(link: &[u8], width: usize, height: usize, radius: usize) -> Vec<bool> {
    let spread = |input: &[bool], count: usize, stride: usize, starts: &mut dyn Iterator<Item = usize>| {
        let mut output = vec![false; input.len()];
        for start in starts {
            let mut last: Option<usize> = None;
            for i in 0..count + radius {
                if i < count && input[start + i * stride] {
                    last = Some(i);
                }
                if i >= radius && last.is_some_and(|last| i - last <= 2 * radius) {
                    output[start + (i - radius) * stride] = true;
                }
            }
        }
        output
    };
    let robot: Vec<bool> = link.iter().map(|&link| link != NO_LINK).collect();
    let rows = spread(&robot, width, 1, &mut (0..height).map(|row| row * width));
    spread(&rows, height, width, &mut (0..width))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dilation_is_a_square() {
        let mut link = vec![NO_LINK; 11 * 9];
        link[4 * 11 + 5] = 0;
        let near = dilated(&link, 11, 9, 2);
        for (pixel, &found) in near.iter().enumerate() {
            let (column, row) = ((pixel % 11) as i32, (pixel / 11) as i32);
            assert_eq!(found, (column - 5).abs() <= 2 && (row - 4).abs() <= 2, "{column} {row}");
        }
    }

    #[test]
    fn colours_of_the_robot_have_a_positive_ratio() {
        let link: Vec<u8> = (0..900).map(|i| if i % 30 < 12 { 0 } else { NO_LINK }).collect();
        let rgb: Vec<u8> = link
            .iter()
            .flat_map(|&l| if l == 0 { [200, 190, 180] } else { [60, 90, 40] })
            .collect();
        let model = ColourModel::new(&rgb, &link, 30, 30, 8).unwrap();
        assert!(model.ratio([200.0, 190.0, 180.0]) > 2.0 && model.ratio([60.0, 90.0, 40.0]) < -2.0);
        assert!(model.separation > 0.99);
        let blank = ColourModel::new(&[90; 2700], &link, 30, 30, 8).unwrap();
        assert!(blank.separation < 1e-6 && blank.ratio([90.0; 3]).abs() < 1e-6);
        assert!(ColourModel::new(&rgb, &[NO_LINK; 900], 30, 30, 8).is_none());
    }
}
