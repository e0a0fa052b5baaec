//! What is not kept of the winners: surfaces that only one eye sees, guesses of the sums alone, specks.

use rayon::prelude::*;

/// Pixels on either side of the window that disparities are averaged over.
const SMOOTH_RADIUS: usize = 2;
/// Pixels on either side of the window that evidence is averaged over.
const EVIDENCE_RADIUS: usize = 2;
/// Largest difference of neighbouring disparities within one patch, pixels.
const PATCH_STEP_PX: f32 = 1.0;

/// The left disparities whose partner in the right eye has the same within `tolerance`; NaN where not. `[H, W]`
pub(crate) fn consistent(left: &[f32], right: &[f32], width: usize, tolerance: f32) -> Vec<f32> {
    let check = |(at, &disparity): (usize, &f32)| {
        let agrees = |partner: usize| (right[partner] - disparity).abs() <= tolerance;
        let agrees = partner(at, -disparity, width).is_some_and(agrees);
        if agrees { disparity } else { f32::NAN }
    };
    left.par_iter().enumerate().map(check).collect()
}

/// The right disparities whose partner in the left eye was kept with the same within `tolerance`, which they take over with
/// its fraction; NaN where not. `[H, W]`
pub(crate) fn confirmed(right: &[f32], kept_left: &[f32], width: usize, tolerance: f32) -> Vec<f32> {
    let check = |(at, &disparity): (usize, &f32)| {
        let partner = partner(at, disparity, width).map_or(f32::NAN, |partner| kept_left[partner]);
        // Half a pixel of fraction may lie on top.
        if (partner - disparity).abs() <= tolerance + 0.5 {
            partner
        } else {
            f32::NAN
        }
    };
    right.par_iter().enumerate().map(check).collect()
}

/// The pixel of the other eye `shift` columns away in the same row.
fn partner(at: usize, shift: f32, width: usize) -> Option<usize> {
    let column = ((at % width) as f32 + shift).round();
    (column >= 0.0 && column < width as f32).then(|| at - at % width + column as usize)
}

/// Removes disparities for which the images themselves do not speak: the mean evidence of the window is below `least` bits.
/// There the sums only carry on what lies around.
pub(crate) fn remove_unsupported(disparity: &mut [f32], evidence: &[f32], width: usize, least: f32) {
    let height = disparity.len() / width;
    let side = EVIDENCE_RADIUS;
    disparity.par_chunks_mut(width).enumerate().for_each(|(row, out)| {
        let rows = row.saturating_sub(side)..(row + side + 1).min(height);
        // Column sums first: every window of the row uses them.
        let mut sums = vec![0.0f32; width];
        for row in rows.clone() {
            for (sum, value) in sums.iter_mut().zip(&evidence[row * width..]) {
                *sum += value;
            }
        }
        for (column, out) in out.iter_mut().enumerate() {
            let columns = column.saturating_sub(side)..(column + side + 1).min(width);
            let count = (rows.len() * columns.len()) as f32;
            if sums[columns].iter().sum::<f32>() < least * count {
                *out = f32::NAN;
            }
        }
    });
}

/// Removes connected patches (four neighbours, steps of at most a pixel) of fewer than `smallest` pixels.
pub(crate) fn remove_specks(disparity: &mut [f32], width: usize, smallest: usize) {
    let mut seen = vec![false; disparity.len()];
    let (mut patch, mut open) = (Vec::new(), Vec::new());
    for start in 0..disparity.len() {
        if seen[start] || disparity[start].is_nan() {
            continue;
        }
        seen[start] = true;
        patch.clear();
        open.push(start);
        while let Some(at) = open.pop() {
            patch.push(at);
            let column = at % width;
            let neighbours = [
                (column > 0).then(|| at - 1),
                (column + 1 < width).then(|| at + 1),
                at.checked_sub(width),
                (at + width < disparity.len()).then(|| at + width),
            ];
            for next in neighbours.into_iter().flatten() {
                if !seen[next] && (disparity[next] - disparity[at]).abs() <= PATCH_STEP_PX {
                    seen[next] = true;
                    open.push(next);
                }
            }
        }
        if patch.len() < smallest {
            for &at in &patch {
                disparity[at] = f32::NAN;
            }
        }
    }
}

/// The mean of the known disparities of the 5x5 window that lie within a pixel of the known one in its middle. `[H, W]`
pub(crate) fn smoothed(disparity: &[f32], width: usize) -> Vec<f32> {
    let height = disparity.len() / width;
    let one = |at: usize| {
        let middle = disparity[at];
        if middle.is_nan() {
            return middle;
        }
        let (row, column) = (at / width, at % width);
        let (mut sum, mut count) = (0.0f32, 0.0f32);
        for row in row.saturating_sub(SMOOTH_RADIUS)..(row + SMOOTH_RADIUS + 1).min(height) {
            let columns = column.saturating_sub(SMOOTH_RADIUS)..(column + SMOOTH_RADIUS + 1).min(width);
            for &value in &disparity[row * width..][columns] {
                if (value - middle).abs() <= PATCH_STEP_PX {
                    sum += value - middle;
                    count += 1.0;
                }
            }
        }
        middle + sum / count
    };
    (0..disparity.len()).into_par_iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_surface_that_the_other_eye_does_not_see_is_dropped() {
        let own = [5.0, 1.0, 1.0, 2.0];
        let other = [1.0, 1.0, f32::NAN, 0.0];
        let kept = consistent(&own, &other, 4, 0.5);
        assert!(kept[0].is_nan(), "its partner lies outside");
        assert_eq!(kept[1..3], [1.0, 1.0]);
        assert!(kept[3].is_nan(), "its partner has another disparity");
        let back = confirmed(&other, &kept, 4, 0.5);
        assert_eq!(back[..2], [1.0, 1.0]);
        assert!(back[2].is_nan() && back[3].is_nan());
    }

    #[test]
    fn what_the_images_do_not_say_is_unknown() {
        let (width, height) = (20, 6);
        let evidence: Vec<f32> = (0..width * height)
            .map(|at| if at % width < 10 { 8.0 } else { 0.0 })
            .collect();
        let mut disparity = vec![3.0; width * height];
        remove_unsupported(&mut disparity, &evidence, width, 4.0);
        let known = (0..width)
            .filter(|&column| !disparity[2 * width + column].is_nan())
            .collect::<Vec<_>>();
        assert_eq!(
            known,
            (0..10).collect::<Vec<_>>(),
            "windows with at least half of their evidence"
        );
    }

    #[test]
    fn specks_go_and_patches_stay() {
        let mut disparity = vec![1.0; 25];
        disparity[12] = 9.0;
        disparity[24] = f32::NAN;
        remove_specks(&mut disparity, 5, 2);
        assert!(disparity[12].is_nan() && disparity[24].is_nan());
        assert_eq!(disparity.iter().filter(|value| **value == 1.0).count(), 23);
    }

    #[test]
    fn smoothing_neither_fills_holes_nor_crosses_edges() {
        let mut disparity = vec![2.0; 25];
        disparity[12] = 2.5;
        disparity[13] = 8.0;
        disparity[0] = f32::NAN;
        let smooth = smoothed(&disparity, 5);
        assert!(smooth[0].is_nan());
        assert_eq!(smooth[13], 8.0);
        assert!((smooth[12] - (2.0 + 0.5 / 23.0)).abs() < 1e-6, "{}", smooth[12]);
    }
}
