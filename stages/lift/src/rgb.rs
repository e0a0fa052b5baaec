//! Source images as the network takes them, and the low-resolution intervention.

use rogs_schemas::records::clip::Observation;

/// RGB in [0, 1], planar, of one interleaved 8-bit image. `[H, W, 3] -> [3, H, W]`
pub(crate) fn planar(image: Observation<'_>) -> Vec<f32> {
    interleaved_to_planar(image.rgb())
}

fn interleaved_to_planar(rgb: &[u8]) -> Vec<f32> {
    let channel = |index: usize| rgb.iter().skip(index).step_by(3).map(|&value| f32::from(value) / 255.0);
    (0..3).flat_map(channel).collect()
}

/// One plane, area-averaged to 1 / `factor` of its size (rounded up) and bilinearly restored. Pixel centres at + 0.5.
pub(crate) fn degrade(plane: &[f32], height: usize, width: usize, factor: usize) -> Vec<f32> {
    let (rows, columns) = (height.div_ceil(factor), width.div_ceil(factor));
    let (row_cells, column_cells) = (area_taps(height, rows), area_taps(width, columns));
    let narrow = apply(plane, height, width, &column_cells);
    let small = transpose(
        &apply(&transpose(&narrow, height, columns), columns, height, &row_cells),
        columns,
        rows,
    );
    let (row_taps, column_taps) = (linear_taps(rows, height), linear_taps(columns, width));
    let wide = apply(&small, rows, columns, &column_taps);
    transpose(
        &apply(&transpose(&wide, rows, width), width, rows, &row_taps),
        width,
        height,
    )
}

/// First input and weights of each output.
type Taps = Vec<(usize, Vec<f32>)>;

/// Shares of the inputs that each of `outputs` equal cells covers.
fn area_taps(inputs: usize, outputs: usize) -> Taps {
    let cell = inputs as f64 / outputs as f64;
    let taps = |index: usize| {
        let (start, end) = (index as f64 * cell, (index + 1) as f64 * cell);
        let first = start.floor() as usize;
        let last = (end.ceil() as usize).min(inputs);
        let share = |input: usize| (end.min((input + 1) as f64) - start.max(input as f64)) / cell;
        (first, (first..last).map(|input| share(input).max(0.0) as f32).collect())
    };
    (0..outputs).map(taps).collect()
}

/// Bilinear weights, half-pixel centres, clamped at the borders.
fn linear_taps(inputs: usize, outputs: usize) -> Taps {
    let taps = |index: usize| {
        let place = ((index as f64 + 0.5) * inputs as f64 / outputs as f64 - 0.5).clamp(0.0, (inputs - 1) as f64);
        let first = (place.floor() as usize).min(inputs.saturating_sub(2));
        let share = (place - first as f64) as f32;
        if inputs == 1 {
            (0, vec![1.0])
        } else {
            (first, vec![1.0 - share, share])
        }
    };
    (0..outputs).map(taps).collect()
}

/// Resamples the rows of a plane.
fn apply(plane: &[f32], rows: usize, columns: usize, taps: &Taps) -> Vec<f32> {
    let mut out = Vec::with_capacity(rows * taps.len());
    for row in plane.chunks_exact(columns) {
        out.extend(
            taps.iter()
                .map(|(first, weights)| weights.iter().zip(&row[*first..]).map(|(w, v)| w * v).sum::<f32>()),
        );
    }
    out
}

/// `[rows, columns] -> [columns, rows]`
fn transpose(plane: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    (0..columns)
        .flat_map(|column| (0..rows).map(move |row| plane[row * columns + column]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degrading_keeps_a_flat_image_and_the_mean_of_any() {
        let flat = degrade(&[0.25; 154 * 28], 154, 28, 8);
        assert!(flat.iter().all(|value| (value - 0.25).abs() < 1e-6));
        let (rows, columns) = (16, 24);
        let image: Vec<f32> = (0..rows * columns).map(|k| ((k * 37) % 11) as f32).collect();
        let small = apply(&image, rows, columns, &area_taps(columns, 3));
        assert_eq!(small[0], image[..8].iter().sum::<f32>() / 8.0);
        let detail = degrade(&image, rows, columns, 8);
        let spread = |v: &[f32]| v.iter().fold(0.0f32, |m, &x| m.max(x)) - v.iter().fold(f32::MAX, |m, &x| m.min(x));
        assert!(spread(&detail) < 0.5 * spread(&image), "detail is gone");
    }

    #[test]
    fn planes_are_red_green_blue() {
        assert_eq!(
            interleaved_to_planar(&[255, 0, 51, 0, 255, 0]),
            [1.0, 0.0, 0.0, 1.0, 0.2, 0.0]
        );
    }
}
