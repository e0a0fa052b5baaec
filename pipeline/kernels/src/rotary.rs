//! Rotary position embedding: x * cos + swap(x) * sin, where `swap` exchanges the two quarters of each half of a head.

use rayon::prelude::*;

/// Base of the rotary frequencies.
const ROTARY_BASE: f64 = 100.0;

/// Cosines and sines of the rotary embedding for a list of positions. `[T, head_size]` each, laid out so that
/// `y = x * cos + swap(x) * sin` where `swap` exchanges the two quarters of each half and the sine of the first quarter
/// carries the minus sign (`docs/spec/stage1.md` section 5).
#[derive(Debug, Clone, PartialEq)]
pub struct RotaryTable {
    /// Cosines. `[T, head_size]`
    pub cosine: Vec<f32>,
    /// Signed sines. `[T, head_size]`
    pub sine: Vec<f32>,
    /// Channels of one head.
    pub head_size: usize,
}

impl RotaryTable {
    /// The table of `(row, column)` positions.
    #[must_use]
    pub fn new(positions: &[[usize; 2]], head_size: usize) -> Self {
        let (half, quarter) = (head_size / 2, head_size / 4);
        let mut cosine = vec![0.0f32; positions.len() * head_size];
        let mut sine = cosine.clone();
        for (token, position) in positions.iter().enumerate() {
            for (axis, &place) in position.iter().enumerate() {
                for m in 0..quarter {
                    let frequency = libm::pow(ROTARY_BASE, -(2.0 * m as f64) / half as f64) as f32;
                    let angle = place as f32 * frequency;
                    let (c, s) = (libm::cosf(angle), libm::sinf(angle));
                    let first = token * head_size + axis * half + m;
                    cosine[first] = c;
                    cosine[first + quarter] = c;
                    sine[first] = -s;
                    sine[first + quarter] = s;
                }
            }
        }
        Self {
            cosine,
            sine,
            head_size,
        }
    }

    /// Number of positions.
    #[must_use]
    pub fn len(&self) -> usize {
        self.cosine.len() / self.head_size
    }

    /// True for no positions.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.cosine.is_empty()
    }

    /// Rotates the rows of heads; the table repeats after its last position. `[.., T, head_size]`
    #[must_use]
    pub fn rotated(&self, values: &[f32]) -> Vec<f32> {
        self.run(values, |x, cosine, sine| {
            [x[0] * cosine[0] + x[1] * sine[0], x[1] * cosine[1] + x[0] * sine[1]]
        })
    }

    /// The gradient of the input of [`Self::rotated`], given that of its result.
    #[must_use]
    pub fn rotated_back(&self, gradient: &[f32]) -> Vec<f32> {
        self.run(gradient, |g, cosine, sine| {
            [g[0] * cosine[0] + g[1] * sine[1], g[1] * cosine[1] + g[0] * sine[0]]
        })
    }

    /// Runs `turn(out, values, cosine, sine)` on the quarters of all rows; `tokens` lie one after another.
    fn run(&self, values: &[f32], turn: impl Fn([f32; 2], [f32; 2], [f32; 2]) -> [f32; 2] + Sync) -> Vec<f32> {
        let (size, period) = (self.head_size, self.len());
        let quarter = size / 4;
        let mut out = vec![0.0f32; values.len()];
        out.par_chunks_mut(period * size)
            .zip(values.par_chunks(period * size))
            .for_each(|(out, values)| {
                for (token, (out, row)) in out.chunks_exact_mut(size).zip(values.chunks_exact(size)).enumerate() {
                    let (cosine, sine) = (&self.cosine[token * size..][..size], &self.sine[token * size..][..size]);
                    for half in [0, 2 * quarter] {
                        for k in half..half + quarter {
                            let other = k + quarter;
                            let turned = turn([row[k], row[other]], [cosine[k], cosine[other]], [sine[k], sine[other]]);
                            [out[k], out[other]] = turned;
                        }
                    }
                }
            });
        out
    }
}
