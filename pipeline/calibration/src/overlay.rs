//! Pictures of the drawn robot's outline over the images, before and after.

use rogs_geometry::{Camera, Link, Pinhole, Pose};
use rogs_robot::RenderOptions;
use rogs_robot::outline::link_outlines;
use rogs_robot::raster::Renderer;

use crate::Result;
use crate::correction::Correction;
use crate::edges::mount_from_camera;
use crate::take::Take;

/// Pictures are enlarged by whole factors to at least this many columns.
const COLUMNS: u32 = 560;
/// Pixels between the two pictures of a frame.
const GAP: usize = 6;
/// Colours of the outline before and after.
const COLOURS: [[u8; 3]; 2] = [[255, 70, 40], [60, 255, 90]];

/// A picture, RGB, 8 bit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// `[H, W, 3]`
    pub rgb: Vec<u8>,
}

/// Outlines of the links over some frames of a clip, one frame a row: as given to the left, corrected to the right.
///
/// # Errors
/// When the joints do not fit the robot.
pub fn overlay(take: &Take<'_>, correction: &Correction, frames: &[usize]) -> Result<Picture> {
    let lens = take.filmed().lens;
    let factor = COLUMNS.div_ceil(lens.width).max(1);
    let (width, height) = ((lens.width * factor) as usize, (lens.height * factor) as usize);
    let whole = 2 * width + GAP;
    let rows = frames.len() * (height + GAP);
    let mut rgb = vec![255; 3 * whole * rows];
    let mut renderer = Renderer::new(take.footage.scene);
    for (number, &frame) in frames.iter().enumerate() {
        for (side, correction) in [Correction::NONE, *correction].iter().enumerate() {
            let corner = number * (height + GAP) * whole + side * (width + GAP);
            let image = take.filmed().images[frame];
            for row in 0..height {
                for column in 0..width {
                    let from = 3 * ((row / factor as usize) * lens.width as usize + column / factor as usize);
                    let to = 3 * (corner + row * whole + column);
                    rgb[to..to + 3].copy_from_slice(&image[from..from + 3]);
                }
            }
            let large = correction
                .lens(&lens)
                .resized(lens.width * factor, lens.height * factor);
            for pixel in outline(&mut renderer, take, correction, &large, frame)? {
                let (column, row) = (pixel as usize % width, pixel as usize / width);
                let to = 3 * (corner + row * whole + column);
                rgb[to..to + 3].copy_from_slice(&COLOURS[side]);
            }
        }
    }
    Ok(Picture {
        width: whole as u32,
        height: rows as u32,
        rgb,
    })
}

fn outline(
    renderer: &mut Renderer<'_>,
    take: &Take<'_>,
    correction: &Correction,
    lens: &Pinhole,
    frame: usize,
) -> Result<Vec<u32>> {
    let Some(links) = take.links(frame as f64 + correction.lag_frames)? else {
        return Ok(Vec::new());
    };
    let mount_from_camera = mount_from_camera(&take.filmed().mount) * correction.moved;
    let camera_from_base = (take.base_from_mount(&links) * mount_from_camera).inverse();
    let camera_from_link: Vec<Pose<Camera, Link>> = links.iter().map(|&link| camera_from_base * link).collect();
    let drawn = renderer.render(lens, &camera_from_link, &RenderOptions::default(), 1)?;
    Ok(link_outlines(&drawn.link, lens.width, lens.height))
}
