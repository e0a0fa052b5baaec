//! A picture of the first clips of a settings file, a row each: images of the source cameras at their first time, reference
//! depth, the robot's mesh, and what a held-out camera sees. Says how long a clip takes.
//! `cargo run -p rogs-train --example contact_sheet SETTINGS.toml OUT.png [CLIPS [FIRST_UPDATE]]`
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use std::path::Path;
use std::time::Instant;

use image::{Rgb, RgbImage};
use rogs_train::Stage1Training;
use rogs_train::sample::Sample;
use rogs_train::stream::batches;

/// Height and width of a picture.
const CELL: [u32; 2] = [84, 154];
/// Most cameras of a row.
const CAMERAS: usize = 4;
/// Brightest depth, internal units.
const FAR_IU: f32 = 17.5;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let settings = arguments.next().ok_or("which settings?")?;
    let out = arguments.next().ok_or("which file shall be written?")?;
    let wanted: usize = arguments.next().map_or(Ok(12), |text| text.parse())?;
    let first: u64 = arguments.next().map_or(Ok(0), |text| text.parse())?;
    let settings = Stage1Training::read(Path::new(&settings))?;
    let [height, width] = CELL;
    let mut sheet = RgbImage::new((3 * CAMERAS as u32 - 3) * width, wanted as u32 * height);
    let mut stream = batches(&settings, first);
    let (mut clips, start) = (0usize, Instant::now());
    while clips < wanted {
        let batch = stream.next_item().ok_or("the run has fewer clips")??;
        for clip in batch.clips {
            println!(
                "{clips:3} {}x{} {} views, {}",
                clip.size[1],
                clip.size[0],
                clip.views.len(),
                clip.origin
            );
            if clips < wanted {
                row(&mut sheet, clips as u32 * height, &clip);
            }
            clips += 1;
        }
    }
    println!("{:.0} ms a clip", 1000.0 * start.elapsed().as_secs_f64() / clips as f64);
    sheet.save(out)?;
    Ok(())
}

fn row(sheet: &mut RgbImage, top: u32, clip: &Sample) {
    let area = clip.size[0] * clip.size[1];
    let first_views = (0..clip.views.len()).filter(|&view| view == 0 || clip.views[view].0 != clip.views[view - 1].0);
    for (place, view) in first_views.take(CAMERAS).enumerate() {
        paint(sheet, [top, place as u32], clip.size, |pixel| {
            let channel = |k: usize| clip.images[(3 * view + k) * area + pixel];
            [channel(0), channel(1), channel(2)]
        });
        if place + 1 < CAMERAS {
            paint(sheet, [top, (CAMERAS + place) as u32], clip.size, |pixel| {
                let at = view * area + pixel;
                let shade = libm::sqrtf(clip.depth_iu[at] / FAR_IU).min(1.0);
                // The mesh where it anchors.
                if clip.mesh_depth_iu[at] > 0.0 {
                    [1.0 - shade, 0.3, 0.2]
                } else {
                    [shade; 3]
                }
            });
        }
    }
    let held_out = clip
        .queries
        .iter()
        .flat_map(|query| &query.targets)
        .find(|target| target.right);
    if let Some(target) = held_out {
        let size = clip.size;
        paint(sheet, [top, 2 * CAMERAS as u32 - 1], size, |pixel| {
            [0, 1, 2].map(|channel: usize| target.rgb[3 * pixel + channel])
        });
        paint(sheet, [top, 2 * CAMERAS as u32], size, |pixel| {
            [libm::sqrtf(target.depth_iu[pixel] / FAR_IU).min(1.0); 3]
        });
    }
}

fn paint(sheet: &mut RgbImage, [top, column]: [u32; 2], size: [usize; 2], colour: impl Fn(usize) -> [f32; 3]) {
    let [height, width] = CELL;
    for y in 0..height {
        for x in 0..width {
            let row = y as usize * size[0] / height as usize;
            let from = x as usize * size[1] / width as usize;
            let value = colour(row * size[1] + from).map(|v| (v.clamp(0.0, 1.0) * 255.0) as u8);
            sheet.put_pixel(column * width + x, top + y, Rgb(value));
        }
    }
}
