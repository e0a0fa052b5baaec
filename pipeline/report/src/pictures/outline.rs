//! The outline of the robot mesh in an image.

use rogs_schemas::records::robot::{NO_LINK, RobotMap};

use super::picture::Picture;

/// How a contour is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Line {
    colour: [u8; 3],
    dashed: bool,
}

impl Line {
    pub(super) const CYAN: Self = Self {
        colour: [0, 255, 255],
        dashed: false,
    };
    pub(super) const GREEN: Self = Self {
        colour: [40, 255, 60],
        dashed: false,
    };
    pub(super) const DASHED_WHITE: Self = Self {
        colour: [255; 3],
        dashed: true,
    };
}

/// Half the period of dashes, pixels along a row.
const DASH: usize = 9;

/// Draws the outline in cyan.
pub(super) fn draw_outline(picture: &mut Picture, map: &RobotMap) {
    for pixel in outline(&map.link, picture.width, picture.height) {
        picture.rgb[pixel * 3..pixel * 3 + 3].copy_from_slice(&Line::CYAN.colour);
    }
}

/// Draws the outline of a silhouette two pixels wide. `link [H, W]` has the size of the picture.
pub(super) fn draw_contour(picture: &mut Picture, link: &[u8], line: Line) {
    let (width, height) = (picture.width, picture.height);
    for pixel in outline(link, width, height) {
        let (column, row) = (pixel % width, pixel / width);
        // Slanted dashes, so that neither upright nor level edges are all or nothing.
        if line.dashed && (column + 2 * row) / DASH % 2 == 1 {
            continue;
        }
        for (column, row) in [
            (column, row),
            (column + 1, row),
            (column, row + 1),
            (column + 1, row + 1),
        ] {
            if column < width && row < height {
                let at = 3 * (row * width + column);
                picture.rgb[at..at + 3].copy_from_slice(&line.colour);
            }
        }
    }
}

/// Pixels of the robot whose right, left, upper or lower neighbour is not robot: the outline of its silhouette.
fn outline(link: &[u8], width: usize, height: usize) -> Vec<usize> {
    let hit = |column: isize, row: isize| {
        let inside = column >= 0 && row >= 0 && column < width as isize && row < height as isize;
        // What leaves the image has no outline there.
        !inside || link[row as usize * width + column as usize] != NO_LINK
    };
    let mut pixels = Vec::new();
    for row in 0..height as isize {
        for column in 0..width as isize {
            if hit(column, row)
                && [(1, 0), (-1, 0), (0, 1), (0, -1)]
                    .iter()
                    .any(|(x, y)| !hit(column + x, row + y))
            {
                pixels.push(row as usize * width + column as usize);
            }
        }
    }
    pixels
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(width: usize, height: usize) -> Vec<u8> {
        let mut link = vec![NO_LINK; width * height];
        for row in 1..5 {
            for column in 2..6 {
                link[row * width + column] = 3;
            }
        }
        link
    }

    #[test]
    fn the_outline_of_a_square_is_its_border() {
        let (width, height) = (7, 6);
        let pixels = outline(&square(width, height), width, height);
        assert_eq!(pixels.len(), 12, "a 4 x 4 square has 12 border pixels");
        assert!(!pixels.contains(&(2 * width + 3)));
    }

    #[test]
    fn a_contour_is_two_pixels_wide_and_a_dashed_one_has_gaps() {
        let drawn = |line: Line| {
            let mut picture = Picture::new(7, 6, 0);
            draw_contour(&mut picture, &square(7, 6), line);
            picture
                .rgb
                .chunks_exact(3)
                .filter(|pixel| *pixel == line.colour)
                .count()
        };
        // The border of 12 and what a brush of 2 x 2 adds to its right and below: 9 outside, 3 of the inner 4 pixels.
        assert_eq!(drawn(Line::GREEN), 24);
        let dashed = drawn(Line::DASHED_WHITE);
        assert!((1..24).contains(&dashed), "{dashed}");
    }
}
