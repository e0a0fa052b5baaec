//! The photometric loss: absolute differences and structural similarity.

use crate::error::{Result, expect};
use crate::losses::{Loss, ssim};

/// Share of the structural similarity.
const SIMILARITY: f64 = 0.2;

/// `0.8 mean |image - target| + 0.2 (1 - SSIM)`. `[height, width, 3]`
///
/// # Errors
/// When the lengths differ or the image is smaller than the window of the similarity.
pub fn photometric(image: &[f32], target: &[f32], height: usize, width: usize) -> Result<Loss> {
    expect("pixels of the target", target.len(), image.len())?;
    let mut loss = ssim::ssim(image, target, height, width)?;
    loss.value = SIMILARITY * (1.0 - loss.value);
    let each = (1.0 - SIMILARITY) / image.len() as f64;
    let mut sum = 0.0;
    for ((gradient, &a), &b) in loss.gradient.iter_mut().zip(image).zip(target) {
        let difference = f64::from(a) - f64::from(b);
        sum += difference.abs();
        let sign = if difference == 0.0 { 0.0 } else { difference.signum() };
        *gradient = (each * sign - SIMILARITY * f64::from(*gradient)) as f32;
    }
    loss.value += each * sum;
    Ok(loss)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::losses::differences::{check, numbers};

    #[test]
    fn gradients_are_those_of_central_differences() {
        let image = |seed: u32| -> Vec<f32> { numbers(11 * 12 * 3, seed).iter().map(|v| 0.5 + 0.4 * v).collect() };
        let target = image(2);
        check(&image(1), 1e-4, 2e-4, |v| photometric(v, &target, 11, 12).unwrap());
    }
}
