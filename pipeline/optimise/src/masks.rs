//! Masks eroded, dilated and told apart: foreground, background and the band between (`docs/spec/baseline-som.md` section 1).

use crate::error::{Result, expect};

/// What a pixel is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// Well inside the mask.
    Foreground,
    /// Well outside of it.
    Background,
    /// Too near to its border to say.
    Band,
}

/// Tells pixels inside a mask that was eroded by so many pixels from those outside of it dilated by others. A structuring
/// element is a square of side `2 n + 1`; beyond the border of the image nothing is eroded. `[height, width]`
///
/// # Errors
/// When the length is wrong.
pub fn sides(mask: &[bool], height: usize, width: usize, erode_px: usize, dilate_px: usize) -> Result<Vec<Side>> {
    expect("pixels of a mask", mask.len(), height * width)?;
    let outside: Vec<bool> = mask.iter().map(|inside| !inside).collect();
    // What is eroded from the inside is what the outside grows by.
    let lost = grown(&outside, height, width, erode_px);
    let taken = grown(mask, height, width, dilate_px);
    let side = |(&lost, &taken): (&bool, &bool)| match (lost, taken) {
        (false, _) => Side::Foreground,
        (true, false) => Side::Background,
        (true, true) => Side::Band,
    };
    Ok(lost.iter().zip(&taken).map(side).collect())
}

/// Pixels that have one of the mask within `reach` rows and columns.
fn grown(mask: &[bool], height: usize, width: usize, reach: usize) -> Vec<bool> {
    let near = |place: usize, length: usize| place.saturating_sub(reach)..(place + reach + 1).min(length);
    let mut rows = vec![false; mask.len()];
    for row in 0..height {
        let from = &mask[row * width..(row + 1) * width];
        for column in 0..width {
            rows[row * width + column] = from[near(column, width)].contains(&true);
        }
    }
    let mut out = vec![false; mask.len()];
    for row in 0..height {
        for column in 0..width {
            out[row * width + column] = near(row, height).any(|other| rows[other * width + column]);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_has_a_core_a_band_and_a_far_side() {
        let (height, width) = (20, 24);
        let inside = |row: usize, column: usize| (6..14).contains(&row) && (8..17).contains(&column);
        let mask: Vec<bool> = (0..height * width).map(|k| inside(k / width, k % width)).collect();
        let found = sides(&mask, height, width, 2, 3).unwrap();
        for row in 0..height {
            for column in 0..width {
                let core = (8..12).contains(&row) && (10..15).contains(&column);
                let near = (3..17).contains(&row) && (5..20).contains(&column);
                let expected = match (core, near) {
                    (true, _) => Side::Foreground,
                    (false, true) => Side::Band,
                    (false, false) => Side::Background,
                };
                assert_eq!(found[row * width + column], expected, "{row} {column}");
            }
        }
        // What fills the image has no border inside of it.
        assert!(
            sides(&[true; 12], 3, 4, 3, 6)
                .unwrap()
                .iter()
                .all(|&s| s == Side::Foreground)
        );
        assert!(sides(&[true; 11], 3, 4, 3, 6).is_err());
    }
}
