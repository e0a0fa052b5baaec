//! Points followed from image to image: corners, and Lucas and Kanade's search on grey pyramids
//! (`docs/spec/calibration.md` section 5).

use glam::DVec2;

use crate::scaled::Grey;

/// Levels of a pyramid, the full image included.
const LEVELS: usize = 4;
/// Half the side of the window that is compared, pixels.
const HALF: i32 = 4;
/// Pixels of a window.
const WINDOW: usize = ((2 * HALF + 1) * (2 * HALF + 1)) as usize;
/// Corners keep this distance, pixels.
const APART: usize = 7;
/// The smaller eigenvalue of a window's structure must reach this, grey values squared per pixel.
const FLAT: f32 = 12.0;
/// And this share of that of the image's best corner: weaker ones are led astray by noise and compression.
const WEAK: f32 = 0.03;
/// A point followed there and back must come back within this, pixels.
const BACK_PX: f32 = 0.4;

/// An image as a pyramid, fine first.
#[derive(Debug, Clone)]
pub(crate) struct Pyramid(Vec<Grey>);

impl Pyramid {
    pub(crate) fn new(grey: Grey) -> Self {
        let mut levels = vec![grey];
        while levels.len() < LEVELS && levels[levels.len() - 1].width.min(levels[levels.len() - 1].height) >= 40 {
            levels.push(levels[levels.len() - 1].halved());
        }
        Self(levels)
    }

    fn size(&self) -> (usize, usize) {
        (self.0[0].width, self.0[0].height)
    }

    /// At most `most` corners, the strongest first, none where `masked`. Counted from the centre of the first pixel.
    pub(crate) fn corners(&self, masked: &[bool], most: usize) -> Vec<[f32; 2]> {
        let grey = &self.0[0];
        let (width, height) = self.size();
        let margin = HALF as usize + 2;
        if width <= 2 * margin || height <= 2 * margin {
            return Vec::new();
        }
        let strength = strengths(grey);
        let mut places: Vec<usize> = (margin..height - margin)
            .flat_map(|row| (margin..width - margin).map(move |column| row * width + column))
            .filter(|&at| strength[at] >= FLAT && !masked[at])
            .collect();
        places.sort_by(|&a, &b| strength[b].total_cmp(&strength[a]).then(a.cmp(&b)));
        let least = places.first().map_or(0.0, |&best| WEAK * strength[best]);
        places.retain(|&at| strength[at] >= least);
        let mut taken = vec![false; width * height];
        let mut corners = Vec::new();
        for at in places {
            if corners.len() == most {
                break;
            }
            if taken[at] {
                continue;
            }
            let (column, row) = (at % width, at / width);
            corners.push([column as f32, row as f32]);
            for y in row.saturating_sub(APART)..(row + APART + 1).min(height) {
                for x in column.saturating_sub(APART)..(column + APART + 1).min(width) {
                    taken[y * width + x] = true;
                }
            }
        }
        corners
    }

    /// Where a point of this image lies in another; `None` when it is lost or does not lead back.
    pub(crate) fn follow(&self, point: [f32; 2], there: &Self) -> Option<[f32; 2]> {
        let found = self.search(point, there)?;
        let back = there.search(found, self)?;
        (f32::hypot(back[0] - point[0], back[1] - point[1]) <= BACK_PX).then_some(found)
    }

    fn search(&self, point: [f32; 2], there: &Self) -> Option<[f32; 2]> {
        let mut motion = [0.0f32; 2];
        for level in (0..self.0.len().min(there.0.len())).rev() {
            let scale = 1.0 / (1u32 << level) as f32;
            let at = point.map(|value| value * scale);
            if level + 1 < self.0.len().min(there.0.len()) {
                motion = motion.map(|value| 2.0 * value);
            }
            match step(&self.0[level], &there.0[level], at, motion) {
                Some(better) => motion = better,
                // A window that leaves a coarse image may lie inside a finer one.
                None if level > 0 => {}
                None => return None,
            }
        }
        Some([point[0] + motion[0], point[1] + motion[1]])
    }
}

/// Smaller eigenvalue of the structure tensor of the window around every pixel, per pixel of the window.
fn strengths(grey: &Grey) -> Vec<f32> {
    let (width, height) = (grey.width, grey.height);
    let mut sums = vec![[0.0f32; 3]; (width + 1) * (height + 1)];
    for row in 0..height {
        let mut line = [0.0f32; 3];
        for column in 0..width {
            let value = |x: usize, y: usize| grey.values[y * width + x];
            let dx = 0.5 * (value((column + 1).min(width - 1), row) - value(column.saturating_sub(1), row));
            let dy = 0.5 * (value(column, (row + 1).min(height - 1)) - value(column, row.saturating_sub(1)));
            for (sum, product) in line.iter_mut().zip([dx * dx, dx * dy, dy * dy]) {
                *sum += product;
            }
            let above = sums[row * (width + 1) + column + 1];
            sums[(row + 1) * (width + 1) + column + 1] = std::array::from_fn(|i| above[i] + line[i]);
        }
    }
    let half = HALF as usize;
    let mut out = vec![0.0; width * height];
    for row in half..height.saturating_sub(half) {
        for column in half..width.saturating_sub(half) {
            let corner = |x: usize, y: usize| sums[y * (width + 1) + x];
            let (left, right, top, bottom) = (column - half, column + half + 1, row - half, row + half + 1);
            let [a, b, c] = std::array::from_fn(|i| {
                (corner(right, bottom)[i] - corner(left, bottom)[i] - corner(right, top)[i] + corner(left, top)[i])
                    / WINDOW as f32
            });
            let mean = 0.5 * (a + c);
            out[row * width + column] = mean - f32::sqrt((mean * mean - (a * c - b * b)).max(0.0));
        }
    }
    out
}

/// Refines a motion on one level; `None` when the window leaves an image or has no structure.
fn step(here: &Grey, there: &Grey, at: [f32; 2], start: [f32; 2]) -> Option<[f32; 2]> {
    let mut template = [0.0f32; WINDOW];
    let mut slopes = [[0.0f32; 2]; WINDOW];
    let (mut a, mut b, mut c) = (0.0, 0.0, 0.0);
    for (number, (dx, dy)) in window().enumerate() {
        let (x, y) = (at[0] + dx, at[1] + dy);
        template[number] = here.at(x, y)?;
        let slope = [
            0.5 * (here.at(x + 1.0, y)? - here.at(x - 1.0, y)?),
            0.5 * (here.at(x, y + 1.0)? - here.at(x, y - 1.0)?),
        ];
        slopes[number] = slope;
        a += slope[0] * slope[0];
        b += slope[0] * slope[1];
        c += slope[1] * slope[1];
    }
    let determinant = a * c - b * b;
    let smaller = 0.5 * (a + c) - f32::sqrt((0.25 * (a + c) * (a + c) - determinant).max(0.0));
    if smaller < 0.5 * FLAT * WINDOW as f32 {
        return None;
    }
    let mut motion = start;
    for _ in 0..20 {
        let (mut right, mut mean) = ([0.0f32; 2], 0.0);
        let mut differences = [0.0f32; WINDOW];
        for (number, (dx, dy)) in window().enumerate() {
            differences[number] = there.at(at[0] + dx + motion[0], at[1] + dy + motion[1])? - template[number];
            mean += differences[number];
        }
        // Exposure may change: the mean difference does not count.
        mean /= WINDOW as f32;
        for (difference, slope) in differences.iter().zip(&slopes) {
            right[0] += (difference - mean) * slope[0];
            right[1] += (difference - mean) * slope[1];
        }
        let move_x = -(c * right[0] - b * right[1]) / determinant;
        let move_y = -(a * right[1] - b * right[0]) / determinant;
        motion = [motion[0] + move_x, motion[1] + move_y];
        if move_x.abs() < 0.01 && move_y.abs() < 0.01 {
            return Some(motion);
        }
    }
    // What has not settled has not been found; on coarse levels it is a start all the same.
    None
}

fn window() -> impl Iterator<Item = (f32, f32)> {
    (-HALF..=HALF).flat_map(|dy| (-HALF..=HALF).map(move |dx| (dx as f32, dy as f32)))
}

/// The place in image coordinates, pixel centres at `+ 0.5`.
pub(crate) fn pixel([x, y]: [f32; 2]) -> DVec2 {
    DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pattern without period, moved by a fraction of a pixel.
    fn picture(dx: f32, dy: f32, brighter: f32) -> Pyramid {
        let value = |i: usize| {
            let (x, y) = ((i % 160) as f32 - dx, (i / 160) as f32 - dy);
            let wave = |a: f32, b: f32, c: f32| libm::sinf(a * x + b * y + c * libm::sinf(0.05 * x - 0.04 * y));
            120.0
                + brighter
                + 30.0 * wave(0.31, 0.11, 2.0)
                + 30.0 * wave(-0.13, 0.37, 3.0)
                + 25.0 * wave(0.07, -0.05, 1.0)
        };
        Pyramid::new(Grey {
            width: 160,
            height: 120,
            values: (0..160 * 120).map(value).collect(),
        })
    }

    #[test]
    fn points_are_followed_to_a_tenth_of_a_pixel() {
        let (here, there) = (picture(0.0, 0.0, 0.0), picture(5.3, -3.6, 12.0));
        let corners = here.corners(&[false; 160 * 120], 60);
        assert!(corners.len() >= 30, "{}", corners.len());
        let mut found = 0;
        for corner in corners {
            if let Some([x, y]) = here.follow(corner, &there) {
                found += 1;
                let off = f32::hypot(x - corner[0] - 5.3, y - corner[1] + 3.6);
                assert!(off < 0.1, "{corner:?}: {off}");
            }
        }
        assert!(found >= 25, "{found}");
    }

    #[test]
    fn nothing_is_followed_where_nothing_is() {
        let flat = Pyramid::new(Grey {
            width: 64,
            height: 64,
            values: vec![50.0; 64 * 64],
        });
        assert!(flat.corners(&[false; 64 * 64], 10).is_empty());
        assert_eq!(flat.follow([30.0, 30.0], &flat), None);
        let masked = picture(0.0, 0.0, 0.0);
        assert!(masked.corners(&[true; 160 * 120], 10).is_empty());
    }
}
