//! Structural similarity with its gradient: 11-tap Gaussian window of deviation 1.5, windows that lie within the image.

use rayon::prelude::*;

use crate::error::{OptimiseError, Result, expect};
use crate::losses::Loss;

const TAPS: usize = 11;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Mean structural similarity of two images over channels and windows, and its gradient with respect to the first.
/// `[height, width, 3]`
///
/// # Errors
/// When the lengths differ or the image is smaller than the window.
pub fn ssim(image: &[f32], target: &[f32], height: usize, width: usize) -> Result<Loss> {
    expect("pixels of the image", image.len(), 3 * height * width)?;
    expect("pixels of the target", target.len(), image.len())?;
    if height < TAPS || width < TAPS {
        return Err(OptimiseError::TooSmall {
            what: "structural similarity",
            least: TAPS,
            width,
            height,
        });
    }
    let window = Window::new(height, width);
    let channels: Vec<(f64, Vec<f64>)> = (0..3usize)
        .into_par_iter()
        .map(|channel| {
            let plane =
                |values: &[f32]| -> Vec<f64> { values.iter().skip(channel).step_by(3).map(|&v| v.into()).collect() };
            window.channel(&plane(image), &plane(target))
        })
        .collect();
    let scale = 1.0 / (3 * window.out_height * window.out_width) as f64;
    let mut gradient = vec![0.0; image.len()];
    for (channel, (_, own)) in channels.iter().enumerate() {
        for (to, from) in gradient.iter_mut().skip(channel).step_by(3).zip(own) {
            *to = (from * scale) as f32;
        }
    }
    Ok(Loss {
        value: channels.iter().map(|(sum, _)| sum).sum::<f64>() * scale,
        gradient,
    })
}

struct Window {
    height: usize,
    width: usize,
    out_height: usize,
    out_width: usize,
    taps: [f64; TAPS],
}

impl Window {
    fn new(height: usize, width: usize) -> Self {
        let weight = |k: usize| {
            let off = k as f64 - (TAPS / 2) as f64;
            libm::exp(-off * off / (2.0 * SIGMA * SIGMA))
        };
        let total: f64 = (0..TAPS).map(weight).sum();
        Self {
            height,
            width,
            out_height: height + 1 - TAPS,
            out_width: width + 1 - TAPS,
            taps: std::array::from_fn(|k| weight(k) / total),
        }
    }

    /// Sum of the similarities of one channel, and its gradient.
    fn channel(&self, x: &[f64], y: &[f64]) -> (f64, Vec<f64>) {
        let product = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a * b).collect() };
        let (mean_x, mean_y) = (self.blur(x), self.blur(y));
        let (xx, yy, xy) = (
            self.blur(&product(x, x)),
            self.blur(&product(y, y)),
            self.blur(&product(x, y)),
        );
        let count = mean_x.len();
        let (mut by_mean, mut by_xx, mut by_xy) = (vec![0.0; count], vec![0.0; count], vec![0.0; count]);
        let mut sum = 0.0;
        for k in 0..count {
            let (mx, my) = (mean_x[k], mean_y[k]);
            let a1 = 2.0 * mx * my + C1;
            let a2 = 2.0 * (xy[k] - mx * my) + C2;
            let b1 = mx * mx + my * my + C1;
            let b2 = (xx[k] - mx * mx) + (yy[k] - my * my) + C2;
            let inverse = 1.0 / (b1 * b2);
            let similarity = a1 * a2 * inverse;
            sum += similarity;
            by_mean[k] = 2.0 * my * (a2 - a1) * inverse - 2.0 * mx * similarity * (1.0 / b1 - 1.0 / b2);
            by_xx[k] = -similarity / b2;
            by_xy[k] = 2.0 * a1 * inverse;
        }
        let mut gradient = self.spread(&by_mean);
        let (by_xx, by_xy) = (self.spread(&by_xx), self.spread(&by_xy));
        for (k, to) in gradient.iter_mut().enumerate() {
            *to += 2.0 * x[k] * by_xx[k] + y[k] * by_xy[k];
        }
        (sum, gradient)
    }

    /// Windowed means: `[height, width]` to `[out_height, out_width]`.
    fn blur(&self, image: &[f64]) -> Vec<f64> {
        let mut rows = vec![0.0; self.height * self.out_width];
        for (row, to) in image
            .chunks_exact(self.width)
            .zip(rows.chunks_exact_mut(self.out_width))
        {
            for (k, &tap) in self.taps.iter().enumerate() {
                for (to, from) in to.iter_mut().zip(&row[k..]) {
                    *to += tap * from;
                }
            }
        }
        let mut out = vec![0.0; self.out_height * self.out_width];
        for (row, to) in out.chunks_exact_mut(self.out_width).enumerate() {
            for (k, &tap) in self.taps.iter().enumerate() {
                for (to, from) in to.iter_mut().zip(&rows[(row + k) * self.out_width..]) {
                    *to += tap * from;
                }
            }
        }
        out
    }

    /// The transpose of [`Self::blur`].
    fn spread(&self, image: &[f64]) -> Vec<f64> {
        let mut rows = vec![0.0; self.height * self.out_width];
        for (row, from) in image.chunks_exact(self.out_width).enumerate() {
            for (k, &tap) in self.taps.iter().enumerate() {
                for (to, from) in rows[(row + k) * self.out_width..].iter_mut().zip(from) {
                    *to += tap * from;
                }
            }
        }
        let mut out = vec![0.0; self.height * self.width];
        for (row, to) in rows.chunks_exact(self.out_width).zip(out.chunks_exact_mut(self.width)) {
            for (k, &tap) in self.taps.iter().enumerate() {
                for (to, from) in to[k..].iter_mut().zip(row) {
                    *to += tap * from;
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::losses::differences::{check, numbers};

    #[test]
    fn gradients_are_those_of_central_differences() {
        let image = |seed: u32| -> Vec<f32> { numbers(12 * 13 * 3, seed).iter().map(|v| 0.5 + 0.4 * v).collect() };
        let target = image(2);
        check(&image(1), 2e-3, 2e-5, |v| ssim(v, &target, 12, 13).unwrap());
    }

    #[test]
    fn an_image_is_like_itself() {
        let image: Vec<f32> = numbers(20 * 15 * 3, 5).iter().map(|v| 0.5 + 0.5 * v).collect();
        let found = ssim(&image, &image, 15, 20).unwrap();
        assert!((found.value - 1.0).abs() < 1e-6, "{}", found.value);
        assert!(found.gradient.iter().all(|g| g.abs() < 1e-5));
        assert!(ssim(&image[..270], &image[..270], 9, 10).is_err());
    }
}
