//! Smoothness of motions and shapes of Gaussians.

use glam::DVec3;

use crate::bases::MotionBases;
use crate::error::{OptimiseError, Result, expect};
use crate::losses::Loss;

/// Mean length of the second differences over time. `values [series, frames, width]`
///
/// # Errors
/// For a length that does not match the shape, or fewer than three frames.
pub fn acceleration(values: &[f32], frames: usize, width: usize) -> Result<Loss> {
    if frames < 3 {
        return Err(OptimiseError::Empty {
            what: "second differences need at least three frames",
        });
    }
    let series = values.len() / (frames * width).max(1);
    expect("values over time", values.len(), series * frames * width)?;
    let count = (series * (frames - 2)).max(1) as f64;
    let mut loss = Loss {
        value: 0.0,
        gradient: vec![0.0; values.len()],
    };
    let mut second = vec![0.0; width];
    for one in 0..series {
        for frame in 1..frames - 1 {
            let at = (one * frames + frame) * width;
            let mut square = 0.0;
            for k in 0..width {
                let value = |index: usize| f64::from(values[index]);
                second[k] = 2.0 * value(at + k) - value(at + k - width) - value(at + k + width);
                square += second[k] * second[k];
            }
            let length = square.sqrt();
            loss.value += length / count;
            if length > 0.0 {
                for k in 0..width {
                    let unit = (second[k] / length / count) as f32;
                    loss.gradient[at + k] += 2.0 * unit;
                    loss.gradient[at + k - width] -= unit;
                    loss.gradient[at + k + width] -= unit;
                }
            }
        }
    }
    Ok(loss)
}

/// Smoothness of the bases: acceleration of the rotations plus twice that of the translations; the first loss has the
/// gradient of the rotations and the whole value, the second the gradient of the translations.
///
/// # Errors
/// As [`acceleration`].
pub fn bases_smoothness(bases: &MotionBases) -> Result<(Loss, Vec<f32>)> {
    let mut rotations = acceleration(&bases.rotations, bases.frames, 6)?;
    let translations = acceleration(&bases.translations, bases.frames, 3)?;
    rotations.value += 2.0 * translations.value;
    let gradient = translations.gradient.iter().map(|value| 2.0 * value).collect();
    Ok((rotations, gradient))
}

/// Half the mean length of the second differences of centres at three neighbouring frames. `means [G, 3 frames, B, 3]`
///
/// # Errors
/// For a length that does not match the shape.
pub fn track_smoothness(means: &[f32], batch: usize) -> Result<Loss> {
    let (gaussians, row) = neighbours(means, batch)?;
    let count = (gaussians * batch).max(1) as f64;
    let mut loss = Loss {
        value: 0.0,
        gradient: vec![0.0; means.len()],
    };
    for one in 0..gaussians * batch {
        let at = (one / batch) * 3 * row + (one % batch) * 3;
        let second = 2.0 * vector(&means[at + row..]) - vector(&means[at..]) - vector(&means[at + 2 * row..]);
        let length = second.length();
        loss.value += 0.5 * length / count;
        if length > 0.0 {
            let unit = second * (0.5 / length / count);
            add(&mut loss.gradient[at..], -unit);
            add(&mut loss.gradient[at + row..], 2.0 * unit);
            add(&mut loss.gradient[at + 2 * row..], -unit);
        }
    }
    Ok(loss)
}

/// Mean squared motion along the viewing ray: of the step to the middle frame, plus of the step from it. `means [G, 3
/// frames, B, 3]`, `centres [B]`: camera centres of the middle frames.
///
/// # Errors
/// For a length that does not match the shape.
pub fn ray_acceleration(means: &[f32], centres: &[DVec3]) -> Result<Loss> {
    let batch = centres.len();
    let (gaussians, row) = neighbours(means, batch)?;
    let count = (gaussians * batch).max(1) as f64;
    let mut loss = Loss {
        value: 0.0,
        gradient: vec![0.0; means.len()],
    };
    for one in 0..gaussians * batch {
        let at = (one / batch) * 3 * row + (one % batch) * 3;
        let (before, middle, after) = (
            vector(&means[at..]),
            vector(&means[at + row..]),
            vector(&means[at + 2 * row..]),
        );
        let to = middle - centres[one % batch];
        let length = to.length();
        if length <= 0.0 {
            continue;
        }
        let ray = to / length;
        let (first, second) = ((middle - before).dot(ray), (after - middle).dot(ray));
        loss.value += (first * first + second * second) / count;
        // The ray turns with the middle: d(v . ray) = (v - ray (v . ray)) / length.
        let turned = |step: DVec3, along: f64| (step - ray * along) / length;
        let scale = 2.0 / count;
        add(&mut loss.gradient[at..], -ray * (scale * first));
        add(&mut loss.gradient[at + 2 * row..], ray * (scale * second));
        let middle = (ray + turned(middle - before, first)) * (scale * first)
            + (turned(after - middle, second) - ray) * (scale * second);
        add(&mut loss.gradient[at + row..], middle);
    }
    Ok(loss)
}

/// Mean over the Gaussians of the unbiased variance of their three logarithmic scales. `log_scales [G, 3]`
///
/// # Errors
/// For a length that does not match the shape.
pub fn scale_variance(log_scales: &[f32]) -> Result<Loss> {
    let count = (log_scales.len() / 3).max(1) as f64;
    expect("logarithmic scales", log_scales.len() % 3, 0)?;
    let mut loss = Loss {
        value: 0.0,
        gradient: Vec::with_capacity(log_scales.len()),
    };
    for scales in log_scales.chunks_exact(3) {
        let mean = scales.iter().map(|&value| f64::from(value)).sum::<f64>() / 3.0;
        for &value in scales {
            let off = f64::from(value) - mean;
            loss.value += 0.5 * off * off / count;
            loss.gradient.push((off / count) as f32);
        }
    }
    Ok(loss)
}

/// Gaussians, and values from one frame to the next.
fn neighbours(means: &[f32], batch: usize) -> Result<(usize, usize)> {
    let row = 3 * batch;
    let gaussians = means.len() / (3 * row).max(1);
    expect("centres at three frames", means.len(), gaussians * 3 * row)?;
    Ok((gaussians, row))
}

fn vector(values: &[f32]) -> DVec3 {
    DVec3::new(values[0].into(), values[1].into(), values[2].into())
}

fn add(to: &mut [f32], value: DVec3) {
    for (to, value) in to.iter_mut().zip(value.to_array()) {
        *to += value as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::losses::differences::{check, numbers};

    #[test]
    fn gradients_are_those_of_central_differences() {
        check(&numbers(2 * 5 * 6, 1), 1e-3, 1e-3, |v| acceleration(v, 5, 6).unwrap());
        let means = numbers(4 * 3 * 2 * 3, 2);
        check(&means, 1e-3, 1e-3, |v| track_smoothness(v, 2).unwrap());
        let centres = [DVec3::new(0.1, 0.2, -3.0), DVec3::new(2.0, 0.5, -1.0)];
        check(&means, 1e-3, 1e-3, |v| ray_acceleration(v, &centres).unwrap());
        check(&numbers(12, 3), 1e-3, 1e-3, |v| scale_variance(v).unwrap());
        let bases = |values: &[f32]| MotionBases {
            frames: 4,
            rotations: values[..48].to_vec(),
            translations: values[48..].to_vec(),
        };
        check(&numbers(72, 4), 1e-3, 1e-3, |v| {
            let (mut loss, translations) = bases_smoothness(&bases(v)).unwrap();
            loss.gradient.extend(translations);
            loss
        });
    }

    #[test]
    fn uniform_motion_is_smooth() {
        let line: Vec<f32> = (0..12).map(|k| k as f32).collect();
        assert_eq!(acceleration(&line, 4, 3).unwrap().value, 0.0);
        assert!(acceleration(&line, 2, 3).is_err());
    }
}
