//! The toy stages: real records, small, with pictures in them.

mod clip;
mod field;

pub(crate) use self::clip::{Ingest, Kappa, Maps};
pub(crate) use self::field::{Lift, Refine, Score};

/// Size of every image, pixels.
const HEIGHT: usize = 22;
const WIDTH: usize = 40;
/// Frames of every clip.
const FRAMES: usize = 3;

/// A toy picture: a gradient whose phase depends on the content.
fn picture(seed: u64, frame: usize) -> Vec<u8> {
    let pixel = |index: usize| {
        let (row, column) = (index / WIDTH, index % WIDTH);
        [
            (column * 6) as u8,
            (row * 11) as u8,
            (seed as usize * 37 + frame * 60) as u8,
        ]
    };
    (0..HEIGHT * WIDTH).flat_map(pixel).collect()
}

fn disc(row: usize, column: usize, frame: usize) -> bool {
    let (dy, dx) = (row as f64 - 11.0, column as f64 - 14.0 - 5.0 * frame as f64);
    dx * dx + dy * dy < 49.0
}

fn seed_of(text: &str) -> u64 {
    text.bytes()
        .fold(7_u64, |seed, byte| seed.wrapping_mul(31).wrapping_add(u64::from(byte)))
        % 251
}
