//! The shift of the image that explains most edges (`docs/spec/agreement.md` section 4).

use glam::{DMat2, DVec2};

use crate::measure::EdgeSample;

/// Edges this far from a shift count half in the first, wide vote, pixels.
const VOTE_PX: f64 = 1.5;
/// Residuals beyond this many standard deviations do not count (Tukey's constant).
pub(crate) const TUKEY: f64 = 4.685;
/// Neighbouring contour points share most of the pixels that their edges come from: so many count as one.
pub(crate) const TOGETHER: f64 = 4.0;

/// A shift of the whole robot in the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImageShift {
    /// Where the image's robot lies as seen from the drawn one, pixels.
    pub px: DVec2,
    /// Covariance of the shift, pixels squared.
    pub covariance: DMat2,
    /// Robust standard deviation of the edges around it, along their normals, pixels.
    pub residual_px: f64,
    /// Share of the (weighted) edges that agree on it.
    pub agreeing: f64,
}

impl ImageShift {
    /// Standard deviation of the length of the shift, along its direction (the larger one when there is no shift), pixels.
    #[must_use]
    pub fn sigma_px(&self) -> f64 {
        let along = self.px.try_normalize().filter(|_| self.px.length() > 0.2);
        let variance = match along {
            Some(direction) => direction.dot(self.covariance * direction),
            None => {
                let (a, d, b) = (
                    self.covariance.x_axis.x,
                    self.covariance.y_axis.y,
                    self.covariance.x_axis.y,
                );
                0.5 * (a + d) + f64::sqrt(0.25 * (a - d) * (a - d) + b * b)
            }
        };
        variance.max(0.0).sqrt()
    }
}

/// The shift within `range_px` that most edges agree on: a vote on a grid, then iteratively reweighted least squares
/// with Tukey's weights. `None` when fewer than 12 edges have weight, or all run in one direction.
#[must_use]
pub fn common_shift(samples: &[EdgeSample], range_px: f64) -> Option<ImageShift> {
    let used: Vec<&EdgeSample> = samples.iter().filter(|sample| sample.weight > 0.05).collect();
    if used.len() < 12 {
        return None;
    }
    let mut px = vote(&used, range_px);
    let mut scale = 2.0 * VOTE_PX;
    let mut solved = None;
    for _ in 0..8 {
        let (mut normal_matrix, mut right, mut agreeing, mut total) = (DMat2::ZERO, DVec2::ZERO, 0.0, 0.0);
        for sample in &used {
            let residual = sample.offset_px - sample.normal.dot(px);
            let u = residual / (TUKEY * f64::hypot(scale, sample.sigma_px));
            let tukey = if u.abs() < 1.0 {
                (1.0 - u * u) * (1.0 - u * u)
            } else {
                0.0
            };
            let weight = sample.weight * tukey / (sample.sigma_px * sample.sigma_px + scale * scale);
            normal_matrix +=
                weight * DMat2::from_cols(sample.normal * sample.normal.x, sample.normal * sample.normal.y);
            right += weight * sample.offset_px * sample.normal;
            agreeing += sample.weight * tukey;
            total += sample.weight;
        }
        let trace = normal_matrix.x_axis.x + normal_matrix.y_axis.y;
        if !(trace > 0.0 && normal_matrix.determinant() > 1e-3 * trace * trace) {
            return None;
        }
        let inverse = normal_matrix.inverse();
        px = (inverse * right).clamp_length_max(1.5 * range_px);
        let mut residuals: Vec<f64> = used
            .iter()
            .map(|sample| (sample.offset_px - sample.normal.dot(px)).abs())
            .filter(|residual| *residual < TUKEY * (scale + 0.5))
            .collect();
        let middle = residuals.len() / 2;
        if residuals.is_empty() {
            return None;
        }
        let (_, &mut median, _) = residuals.select_nth_unstable_by(middle, f64::total_cmp);
        scale = (1.4826 * median).clamp(0.3, 2.0 * VOTE_PX);
        solved = Some(ImageShift {
            px,
            covariance: inverse * TOGETHER,
            residual_px: 1.4826 * median,
            agreeing: agreeing / total,
        });
    }
    solved
}

/// The place of a grid that most edges agree on; of equals the one nearest to no shift.
fn vote(samples: &[&EdgeSample], range_px: f64) -> DVec2 {
    let steps = (range_px / VOTE_PX).ceil() as i32;
    let mut best = (f64::NEG_INFINITY, DVec2::ZERO);
    for row in -steps..=steps {
        for column in -steps..=steps {
            let shift = DVec2::new(f64::from(column), f64::from(row)) * VOTE_PX;
            let votes: f64 = samples
                .iter()
                .map(|sample| {
                    let off = (sample.offset_px - sample.normal.dot(shift)) / VOTE_PX;
                    sample.weight / (1.0 + off * off * off * off)
                })
                .sum();
            let votes = votes * (1.0 - 0.02 * shift.length() / range_px);
            if votes > best.0 {
                best = (votes, shift);
            }
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::contour::ContourKind;

    fn sample(angle: f64, offset_px: f64) -> EdgeSample {
        EdgeSample {
            pixel: DVec2::ZERO,
            normal: DVec2::from_angle(angle),
            base_point: DVec3::ZERO,
            link_point: DVec3::ZERO,
            link: 0,
            depth_m: 1.0,
            kind: ContourKind::Silhouette,
            offset_px,
            sigma_px: 0.5,
            weight: 1.0,
            here: 0.0,
        }
    }

    #[test]
    fn the_shift_of_two_thirds_of_the_edges_is_found() {
        let truth = DVec2::new(5.0, -3.0);
        let samples: Vec<EdgeSample> = (0..90)
            .map(|i| {
                let angle = f64::from(i) * 0.7;
                let right = DVec2::from_angle(angle).dot(truth);
                sample(
                    angle,
                    if i % 3 == 0 {
                        f64::from(i * 7 % 23) - 11.0
                    } else {
                        right
                    },
                )
            })
            .collect();
        let shift = common_shift(&samples, 12.0).unwrap();
        assert!((shift.px - truth).length() < 0.2, "{shift:?}");
        assert!(shift.sigma_px() < 0.5 && shift.agreeing > 0.6, "{shift:?}");
    }

    #[test]
    fn parallel_edges_give_no_shift() {
        let samples: Vec<EdgeSample> = (0..40).map(|_| sample(0.3, 2.0)).collect();
        assert_eq!(common_shift(&samples, 12.0), None);
        assert_eq!(common_shift(&samples[..5], 12.0), None);
    }
}
