//! Sensors of wide worlds.

use super::{World, within};
use crate::cameras::CAMERAS;
use crate::math::Draw;
use crate::render::{Finish, Sensor};

/// The sensors of the cameras; both eyes of a pair have the same.
pub(crate) fn draw_wide_sensors(draw: &mut Draw, world: &World) -> [Sensor; CAMERAS] {
    let ranges = &world.sensor;
    // Exposure and balance are those of the place, and of each camera's own automatic.
    let place = within(draw, ranges.exposure);
    let warmth = draw.range(-ranges.balance, ranges.balance);
    let pairs: Vec<Sensor> = (0..3)
        .map(|_| {
            let own = draw.range(0.85, 1.18);
            let [red, blue] = [1.0, -1.0].map(|side| 1.0 + side * warmth * draw.range(0.5, 1.0));
            let clean = draw.chance(1.0 - ranges.compressed);
            let quality = within(draw, ranges.quality);
            Sensor {
                exposure: (place * own) as f32,
                balance: [red as f32, 1.0, blue as f32],
                vignette: within(draw, ranges.vignette) as f32,
                noise: within(draw, ranges.noise) as f32,
                finish: Some(Finish {
                    contrast: within(draw, ranges.contrast) as f32,
                    blur: [0, 1].map(|_| (within(draw, ranges.blur) / 1000.0) as f32),
                    quality: (!clean).then_some(quality as f32),
                }),
            }
        })
        .collect();
    std::array::from_fn(|camera| pairs[camera % 3])
}
