//! The outline of the robot mesh in an image.

use rogs_schemas::records::robot::{NO_LINK, RobotMap};

use super::picture::Picture;

/// Draws the outline in cyan.
pub(super) fn draw_outline(picture: &mut Picture, map: &RobotMap) {
    for pixel in outline(map, picture.width, picture.height) {
        picture.rgb[pixel * 3..pixel * 3 + 3].copy_from_slice(&[0, 255, 255]);
    }
}

/// Pixels of the robot whose right, left, upper or lower neighbour is not robot: the outline of its silhouette.
fn outline(map: &RobotMap, width: usize, height: usize) -> Vec<usize> {
    let hit = |column: isize, row: isize| {
        let inside = column >= 0 && row >= 0 && column < width as isize && row < height as isize;
        // What leaves the image has no outline there.
        !inside || map.link[row as usize * width + column as usize] != NO_LINK
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
    use rogs_schemas::{CameraIndex, FrameIndex};

    use super::*;

    #[test]
    fn the_outline_of_a_square_is_its_border() {
        let (width, height) = (7, 6);
        let mut link = vec![NO_LINK; width * height];
        for row in 1..5 {
            for column in 2..6 {
                link[row * width + column] = 3;
            }
        }
        let map = RobotMap {
            camera: CameraIndex(0),
            frame: FrameIndex(0),
            depth_m: vec![1.0; 42],
            link,
            support: vec![1; 42],
        };
        let pixels = outline(&map, width, height);
        assert_eq!(pixels.len(), 12, "a 4 x 4 square has 12 border pixels");
        assert!(!pixels.contains(&(2 * width + 3)));
    }
}
