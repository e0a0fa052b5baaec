//! A picture of several episodes, a row each: all six cameras at the frame in the middle.
//! `cargo run -p rogs-synth --example contact_sheet OUT.jpg [SEED [EPISODES]]`
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use image::RgbImage;
use rogs_synth::{CAMERAS, Resolution, SynthConfig, generate_episode};

const SIZE: [u32; 2] = [126, 224];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let out = arguments.next().ok_or("which file shall be written?")?;
    let seed: u64 = arguments.next().map_or(Ok(1), |text| text.parse())?;
    let episodes: u32 = arguments.next().map_or(Ok(8), |text| text.parse())?;
    let config = SynthConfig {
        resolution: Resolution {
            wrist: SIZE,
            external: SIZE,
        },
        ..SynthConfig::default()
    };
    let [height, width] = SIZE;
    let mut sheet = RgbImage::new(CAMERAS as u32 * width, episodes * height);
    for row in 0..episodes {
        let episode = generate_episode(&config, seed + u64::from(row))?;
        let frame = episode.render_frame(config.frames as usize / 2);
        for (column, view) in frame.views.into_iter().enumerate() {
            let view = RgbImage::from_raw(width, height, view.rgb).ok_or("a view has another size")?;
            let place = (i64::from(column as u32 * width), i64::from(row * height));
            image::imageops::replace(&mut sheet, &view, place.0, place.1);
        }
    }
    sheet.save(out)?;
    Ok(())
}
