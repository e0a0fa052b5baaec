//! Images as the metrics see them, mean squared error and PSNR.

/// Value reported for images that are equal up to rounding, dB.
pub const PSNR_CEILING_DB: f64 = 100.0;
/// Mean squared errors below this count as equality.
const EQUAL_MSE: f64 = 1e-10;

/// Why two images cannot be compared.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MetricError {
    /// The buffer is not `height * width * 3` long.
    #[error("an image of {height} x {width} pixels has {expected} values, found {found}")]
    BufferSize {
        /// Height, pixels.
        height: usize,
        /// Width, pixels.
        width: usize,
        /// `height * width * 3`.
        expected: usize,
        /// Length of the buffer.
        found: usize,
    },
    /// The two images have different sizes.
    #[error("the prediction is {}x{} pixels, the reference {}x{} (height x width)", prediction[0], prediction[1], reference[0], reference[1])]
    SizeMismatch {
        /// Height and width of the prediction.
        prediction: [usize; 2],
        /// Height and width of the reference.
        reference: [usize; 2],
    },
    /// The image is smaller than the metric's window.
    #[error("an image of {height}x{width} pixels is smaller than the {minimum}x{minimum} window of {metric}")]
    TooSmall {
        /// Metric name.
        metric: &'static str,
        /// Height, pixels.
        height: usize,
        /// Width, pixels.
        width: usize,
        /// Smallest side allowed.
        minimum: usize,
    },
}

/// RGB values of an image, row-major with the channels together. `[H, W, 3]`
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pixels<'a> {
    /// Values meant to lie in [0, 1]; they are clipped to it, NaN becomes 0.
    Unit(&'a [f32]),
    /// 8-bit values, read as `v / 255`.
    Bytes(&'a [u8]),
}

/// A borrowed RGB image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RgbView<'a> {
    height: usize,
    width: usize,
    pixels: Pixels<'a>,
}

impl<'a> RgbView<'a> {
    /// An image over a buffer of `height * width * 3` values.
    ///
    /// # Errors
    /// When the buffer has another length.
    pub fn new(height: usize, width: usize, pixels: Pixels<'a>) -> Result<Self, MetricError> {
        let found = match pixels {
            Pixels::Unit(values) => values.len(),
            Pixels::Bytes(values) => values.len(),
        };
        let expected = height.saturating_mul(width).saturating_mul(3);
        if found != expected {
            return Err(MetricError::BufferSize {
                height,
                width,
                expected,
                found,
            });
        }
        Ok(Self { height, width, pixels })
    }

    /// Height, pixels.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// Width, pixels.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// The values behind the view.
    #[must_use]
    pub fn pixels(&self) -> Pixels<'a> {
        self.pixels
    }

    /// Writes the clipped values `start..start + out.len()` as f64.
    #[inline(always)]
    pub(crate) fn load(&self, start: usize, out: &mut [f64]) {
        match self.pixels {
            Pixels::Unit(values) => {
                for (out, &value) in out.iter_mut().zip(&values[start..]) {
                    *out = f64::from(unit(value));
                }
            }
            Pixels::Bytes(values) => {
                for (out, &value) in out.iter_mut().zip(&values[start..]) {
                    *out = f64::from(value) / 255.0;
                }
            }
        }
    }
}

/// Clips to [0, 1]; NaN becomes 0.
#[inline(always)]
fn unit(value: f32) -> f32 {
    let positive = if value > 0.0 { value } else { 0.0 };
    if positive < 1.0 { positive } else { 1.0 }
}

/// Fails unless the two images have the same size.
pub(crate) fn same_size(prediction: &RgbView<'_>, reference: &RgbView<'_>) -> Result<(), MetricError> {
    let size = |view: &RgbView<'_>| [view.height, view.width];
    if size(prediction) == size(reference) {
        return Ok(());
    }
    Err(MetricError::SizeMismatch {
        prediction: size(prediction),
        reference: size(reference),
    })
}

/// Mean squared difference over all pixels and channels, both images clipped to [0, 1].
///
/// # Errors
/// When the sizes differ or the images are empty.
pub fn mse(prediction: &RgbView<'_>, reference: &RgbView<'_>) -> Result<f64, MetricError> {
    same_size(prediction, reference)?;
    let row = prediction.width * 3;
    if row == 0 || prediction.height == 0 {
        return Err(MetricError::TooSmall {
            metric: "MSE",
            height: prediction.height,
            width: prediction.width,
            minimum: 1,
        });
    }
    let total = pulp::Arch::new().dispatch(SquaredError {
        prediction,
        reference,
        row,
    });
    Ok(total / (prediction.height * row) as f64)
}

/// The sum of a comparison, in a form that is compiled once for each vector instruction set.
struct SquaredError<'a> {
    prediction: &'a RgbView<'a>,
    reference: &'a RgbView<'a>,
    row: usize,
}

impl pulp::NullaryFnOnce for SquaredError<'_> {
    type Output = f64;

    #[inline(always)]
    fn call(self) -> f64 {
        let (mut a, mut b) = (vec![0.0f64; self.row], vec![0.0f64; self.row]);
        let mut total = 0.0;
        for start in (0..self.prediction.height * self.row).step_by(self.row) {
            self.prediction.load(start, &mut a);
            self.reference.load(start, &mut b);
            total += squared_difference(&a, &b);
        }
        total
    }
}

/// Peak signal-to-noise ratio in dB over the full image (paper; data range 1). Equal images give [`PSNR_CEILING_DB`].
///
/// # Errors
/// When the sizes differ or the images are empty.
pub fn psnr(prediction: &RgbView<'_>, reference: &RgbView<'_>) -> Result<f64, MetricError> {
    let mse = mse(prediction, reference)?;
    Ok(if mse < EQUAL_MSE {
        PSNR_CEILING_DB
    } else {
        -10.0 * libm::log10(mse)
    })
}

/// Eight running sums, whatever the vector width of the machine, so that the result does not depend on it.
#[inline(always)]
fn squared_difference(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0f64; 8];
    let (mut blocks_a, mut blocks_b) = (a.chunks_exact(8), b.chunks_exact(8));
    for (a, b) in (&mut blocks_a).zip(&mut blocks_b) {
        for lane in 0..8 {
            let difference = a[lane] - b[lane];
            sums[lane] += difference * difference;
        }
    }
    for (lane, (a, b)) in blocks_a.remainder().iter().zip(blocks_b.remainder()).enumerate() {
        sums[lane] += (a - b) * (a - b);
    }
    fold_lanes(sums)
}

/// Adds eight running sums in a fixed order.
#[inline(always)]
pub(crate) fn fold_lanes(sums: [f64; 8]) -> f64 {
    ((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_images_reach_the_ceiling() {
        let data = [0.25f32; 12];
        let view = RgbView::new(2, 2, Pixels::Unit(&data)).unwrap();
        assert_eq!(psnr(&view, &view).unwrap(), PSNR_CEILING_DB);
    }

    #[test]
    fn values_are_clipped_and_nan_counts_as_black() {
        let wild = [f32::NAN, 7.0, -3.0, f32::INFINITY, f32::NEG_INFINITY, 0.5];
        let tame = [0.0, 1.0, 0.0, 1.0, 0.0, 0.5];
        let wild = RgbView::new(1, 2, Pixels::Unit(&wild)).unwrap();
        let tame = RgbView::new(1, 2, Pixels::Unit(&tame)).unwrap();
        assert_eq!(mse(&wild, &tame).unwrap(), 0.0);
    }

    #[test]
    fn a_known_difference() {
        let a = [1.0f32; 30];
        let b = [0.0f32; 30];
        let a = RgbView::new(2, 5, Pixels::Unit(&a)).unwrap();
        let b = RgbView::new(2, 5, Pixels::Unit(&b)).unwrap();
        assert_eq!(psnr(&a, &b).unwrap(), 0.0);
    }

    #[test]
    fn sizes_must_agree() {
        let data = [0.0f32; 12];
        let a = RgbView::new(2, 2, Pixels::Unit(&data)).unwrap();
        let b = RgbView::new(1, 4, Pixels::Unit(&data)).unwrap();
        assert!(matches!(mse(&a, &b), Err(MetricError::SizeMismatch { .. })));
        assert!(matches!(
            RgbView::new(3, 2, Pixels::Unit(&data)),
            Err(MetricError::BufferSize { .. })
        ));
    }
}
