//! Position embeddings: the learned grid of the image encoder, rotary tables, and the sine map of the dense heads.

/// Resamples the learned position embedding of a square grid to `rows x columns` with antialiased bicubic weights
/// (kernel parameter -0.5). `table` is `[1 + side^2, width]`, row 0 (class token) passes through.
#[must_use]
pub fn resample_positions(table: &[f32], side: usize, width: usize, [rows, columns]: [usize; 2]) -> Vec<f32> {
    if rows == side && columns == side {
        return table.to_vec();
    }
    let (class, grid) = table.split_at(width);
    let (row_taps, column_taps) = (axis_taps(side, rows), axis_taps(side, columns));
    // Columns first: [side, columns, width].
    let mut narrowed = vec![0.0f32; side * columns * width];
    for row in 0..side {
        for (column, (first, weights)) in column_taps.iter().enumerate() {
            let out = &mut narrowed[(row * columns + column) * width..][..width];
            for (tap, &weight) in weights.iter().enumerate() {
                let source = &grid[(row * side + first + tap) * width..][..width];
                out.iter_mut()
                    .zip(source)
                    .for_each(|(sum, &value)| *sum += weight * value);
            }
        }
    }
    let mut result = class.to_vec();
    result.resize((1 + rows * columns) * width, 0.0);
    for (row, (first, weights)) in row_taps.iter().enumerate() {
        for column in 0..columns {
            let out = &mut result[(1 + row * columns + column) * width..][..width];
            for (tap, &weight) in weights.iter().enumerate() {
                let source = &narrowed[((first + tap) * columns + column) * width..][..width];
                out.iter_mut()
                    .zip(source)
                    .for_each(|(sum, &value)| *sum += weight * value);
            }
        }
    }
    result
}

/// Resampling weights as a matrix, so that gradients reach the learned grid: `[rows * columns, side^2]`.
#[must_use]
pub fn resampling_matrix(side: usize, [rows, columns]: [usize; 2]) -> Vec<f32> {
    let (row_taps, column_taps) = (axis_taps(side, rows), axis_taps(side, columns));
    let mut matrix = vec![0.0f32; rows * columns * side * side];
    for (row, (row_first, row_weights)) in row_taps.iter().enumerate() {
        for (column, (column_first, column_weights)) in column_taps.iter().enumerate() {
            let out = &mut matrix[(row * columns + column) * side * side..][..side * side];
            for (i, &row_weight) in row_weights.iter().enumerate() {
                for (j, &column_weight) in column_weights.iter().enumerate() {
                    out[(row_first + i) * side + column_first + j] = row_weight * column_weight;
                }
            }
        }
    }
    matrix
}

/// First tap and normalised weights of each output sample of one axis.
fn axis_taps(inputs: usize, outputs: usize) -> Vec<(usize, Vec<f32>)> {
    let step = inputs as f32 / outputs as f32;
    let stretch = step.max(1.0);
    let radius = 2.0 * stretch;
    let taps_of = |index: usize| {
        let centre = step * (index as f32 + 0.5);
        let first = (centre - radius + 0.5).trunc().max(0.0) as usize;
        let end = ((centre + radius + 0.5).trunc() as usize).min(inputs);
        let raw: Vec<f32> = (first..end)
            .map(|tap| cubic((tap as f32 - centre + 0.5) / stretch))
            .collect();
        let sum: f32 = raw.iter().sum();
        (first, raw.iter().map(|weight| weight / sum).collect())
    };
    (0..outputs).map(taps_of).collect()
}

/// The bicubic kernel with a = -0.5.
fn cubic(offset: f32) -> f32 {
    const A: f32 = -0.5;
    let t = offset.abs();
    if t < 1.0 {
        ((A + 2.0) * t - (A + 3.0)) * t * t + 1.0
    } else if t < 2.0 {
        ((A * t - 5.0 * A) * t + 8.0 * A) * t - 4.0 * A
    } else {
        0.0
    }
}

/// Positions of a frame's tokens: (0, 0) for the special ones, (row + 1, column + 1) for patches.
#[must_use]
pub fn token_positions(special: usize, [rows, columns]: [usize; 2]) -> Vec<[usize; 2]> {
    let patches = (0..rows * columns).map(|patch| [patch / columns + 1, patch % columns + 1]);
    std::iter::repeat_n([0, 0], special).chain(patches).collect()
}

/// Sine and cosine position map of the dense heads, `[channels, rows, columns]`, for images of aspect width / height.
#[must_use]
pub fn head_positions(channels: usize, [rows, columns]: [usize; 2], aspect: f64) -> Vec<f32> {
    let diagonal = (1.0 + aspect * aspect).sqrt();
    let (span_x, span_y) = (aspect / diagonal, 1.0 / diagonal);
    let coordinate = |index: usize, count: usize, span: f64| {
        let end = span * (count - 1) as f64 / count as f64;
        if count == 1 {
            -end
        } else {
            -end + 2.0 * end * index as f64 / (count - 1) as f64
        }
    };
    let (area, quarter) = (rows * columns, channels / 4);
    let mut map = vec![0.0f32; channels * area];
    for m in 0..quarter {
        let frequency = libm::pow(100.0, -(m as f64) / quarter as f64);
        for column in 0..columns {
            let angle = coordinate(column, columns, span_x) * frequency;
            let (s, c) = (libm::sin(angle) as f32, libm::cos(angle) as f32);
            for row in 0..rows {
                map[m * area + row * columns + column] = s;
                map[(quarter + m) * area + row * columns + column] = c;
            }
        }
        for row in 0..rows {
            let angle = coordinate(row, rows, span_y) * frequency;
            let (s, c) = (libm::sin(angle) as f32, libm::cos(angle) as f32);
            for column in 0..columns {
                map[(2 * quarter + m) * area + row * columns + column] = s;
                map[(3 * quarter + m) * area + row * columns + column] = c;
            }
        }
    }
    map
}
