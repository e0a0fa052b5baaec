//! Position embeddings: those of rotary tables, and the sine map of the dense heads.

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
