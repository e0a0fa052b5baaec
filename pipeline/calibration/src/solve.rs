//! Robust least squares of few unknowns: Levenberg and Marquardt's damping, Tukey's weights, a prior, the covariance
//! (`docs/spec/calibration.md` section 2).

use std::collections::BTreeMap;

use rogs_agreement::{inverse, solve};

use crate::correction::{Correction, Prior, UNKNOWNS, Vector};

/// A square matrix of the unknowns.
pub(crate) type Square = [[f64; UNKNOWNS]; UNKNOWNS];

/// Residuals beyond this many standard deviations do not count (Tukey's constant).
const TUKEY: f64 = 4.685;
/// Neighbouring residuals come from the same pixels: so many count as one.
const TOGETHER: f64 = 4.0;
/// A share of residuals, and the standard deviation of normal ones over the size below which that share lies.
type Quantile = (f64, f64);
const MEDIAN: Quantile = (0.5, 1.4826);
/// For matches: on real clips more than half of them may be of things that move, or followed wrongly.
const LOWER: Quantile = (0.3, 2.5953);

/// Kinds of residuals; each has its own scale.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Distance of a drawn contour from the image's edge.
    Edge,
    /// Distance of a drawn silhouette from where its two sides' colours say it is.
    Outline,
    /// Distance of a tracked point from its epipolar line.
    Epipolar,
}

/// One residual with its derivatives.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row {
    pub kind: Kind,
    /// Pixels.
    pub residual: f64,
    /// Derivatives by a step of [`Correction::stepped`].
    pub gradient: Vector,
    /// Standard deviation of the measurement, pixels.
    pub sigma: f64,
    /// How much it counts, 0 to 1.
    pub weight: f64,
    /// Residuals of one group have errors in common, those of different ones have not.
    pub group: u32,
}

/// How it came out.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Solved {
    pub correction: Correction,
    /// Covariance of the unknowns, 0 for those that are not free.
    pub covariance: Square,
}

/// Robust scale of the residuals of each kind, pixels.
#[derive(Debug, Clone, Copy)]
struct Scales {
    edge: f64,
    outline: f64,
    epipolar: f64,
}

impl Scales {
    fn of(rows: &[Row], widest: f64) -> Self {
        let scale = |kind: Kind, least: f64, (share, factor): Quantile| {
            let mut sizes: Vec<(f64, f64)> = rows
                .iter()
                .filter(|row| row.kind == kind && row.weight > 0.0)
                .map(|row| (row.residual.abs(), row.weight))
                .collect();
            (factor * weighted_quantile(&mut sizes, share)).clamp(least, widest.max(least))
        };
        Self {
            edge: scale(Kind::Edge, 0.3, MEDIAN),
            outline: scale(Kind::Outline, 0.03, MEDIAN),
            epipolar: scale(Kind::Epipolar, 0.1, LOWER),
        }
    }

    /// Of a row on its own: its weight by Tukey's function, over its variance.
    fn weigh(&self, row: &Row) -> f64 {
        let scale = match row.kind {
            Kind::Edge => self.edge,
            Kind::Outline => self.outline,
            Kind::Epipolar => self.epipolar,
        };
        let variance = row.sigma * row.sigma + scale * scale;
        row.weight * tukey(row.residual / variance.sqrt()) / (variance * TOGETHER)
    }
}

/// Tukey's weight of a residual in standard deviations.
fn tukey(size: f64) -> f64 {
    let u = size / TUKEY;
    if u.abs() < 1.0 {
        (1.0 - u * u) * (1.0 - u * u)
    } else {
        0.0
    }
}

/// Weights of all rows, with scales of residuals up to `widest` pixels.
fn weights(rows: &[Row], widest: f64) -> Vec<f64> {
    let scales = Scales::of(rows, widest);
    rows.iter().map(|row| scales.weigh(row)).collect()
}

/// The median of values with weights `(value, weight)`; 0 of nothing.
pub(crate) fn weighted_median(values: &mut [(f64, f64)]) -> f64 {
    weighted_quantile(values, 0.5)
}

/// The value below which a share of all weight lies; 0 of nothing.
pub(crate) fn weighted_quantile(values: &mut [(f64, f64)], share: f64) -> f64 {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let enough = share * values.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut sum = 0.0;
    for &(value, weight) in values.iter() {
        sum += weight;
        if sum >= enough {
            return value;
        }
    }
    0.0
}

/// Solves for the correction nearest to `start` at which the rows fit, with scales of residuals up to `widest` pixels.
/// `rows` has the same rows in the same order for every correction; `None` where a point leaves the camera. `None` when
/// nothing can be solved for want of rows.
pub(crate) fn minimise(
    start: Correction,
    prior: &Prior,
    widest: f64,
    rounds: usize,
    rows: impl Fn(&Correction) -> Option<Vec<Row>>,
) -> Option<Solved> {
    let sigmas = prior.sigmas();
    let mut correction = start;
    let mut current = rows(&correction)?;
    let mut damping = 1e-4;
    for _ in 0..rounds {
        let weights = weights(&current, widest);
        let (matrix, right) = normal(&current, &weights, &correction, &sigmas);
        let cost = cost(&current, &weights, &correction, &sigmas);
        let mut stepped = None;
        for _ in 0..8 {
            let mut damped = matrix;
            for i in 0..UNKNOWNS {
                damped[i][i] *= 1.0 + damping;
            }
            let step = solve(damped, right)?;
            let candidate = correction.stepped(&step);
            let there = rows(&candidate);
            if let Some(there) = there
                && self::cost(&there, &weights, &candidate, &sigmas) <= cost
            {
                damping = (damping * 0.1).max(1e-9);
                stepped = Some((candidate, there, step));
                break;
            }
            damping *= 10.0;
        }
        let Some((candidate, there, step)) = stepped else { break };
        correction = candidate;
        current = there;
        if step.iter().all(|value| value.abs() < 1e-7) {
            break;
        }
    }
    let weights = weights(&current, widest);
    let (matrix, _) = normal(&current, &weights, &correction, &sigmas);
    let covariance = covariance(&current, &weights, &matrix, &sigmas)?;
    Some(Solved { correction, covariance })
}

/// The covariance of the unknowns: that of independent residuals, and what leaving out one group after the other changes
/// (jackknife; groups have errors in common). 0 for unknowns that are not free.
fn covariance(rows: &[Row], weights: &[f64], matrix: &Square, sigmas: &[Option<f64>; UNKNOWNS]) -> Option<Square> {
    let mut groups: BTreeMap<u32, (Square, Vector)> = BTreeMap::new();
    for (row, weight) in rows.iter().zip(weights).filter(|(_, weight)| **weight > 0.0) {
        let (without, pull) = groups.entry(row.group).or_insert((*matrix, [0.0; UNKNOWNS]));
        for i in (0..UNKNOWNS).filter(|&i| sigmas[i].is_some()) {
            let scaled = weight * row.gradient[i];
            for j in (0..=i).filter(|&j| sigmas[j].is_some()) {
                without[i][j] -= scaled * row.gradient[j];
            }
            pull[i] += scaled * row.residual;
        }
    }
    let mut covariance = inverse(matrix)?;
    for (without, pull) in groups.values() {
        let change = solve(*without, *pull)?;
        for i in 0..UNKNOWNS {
            for j in 0..UNKNOWNS {
                covariance[i][j] += change[i] * change[j];
            }
        }
    }
    for (i, row) in covariance.iter_mut().enumerate() {
        for (j, value) in row.iter_mut().enumerate() {
            if sigmas[i].is_none() || sigmas[j].is_none() {
                *value = 0.0;
            }
        }
    }
    Some(covariance)
}

/// Weighted squares of the residuals, and what the prior adds.
fn cost(rows: &[Row], weights: &[f64], correction: &Correction, sigmas: &[Option<f64>; UNKNOWNS]) -> f64 {
    let squares: f64 = rows
        .iter()
        .zip(weights)
        .map(|(row, weight)| weight * row.residual * row.residual)
        .sum();
    let vector = correction.vector();
    let away = vector.iter().zip(sigmas);
    squares
        + away
            .filter_map(|(value, sigma)| sigma.map(|sigma| (value / sigma) * (value / sigma)))
            .sum::<f64>()
}

/// The normal equations `matrix step = right` of the next step.
fn normal(
    rows: &[Row],
    weights: &[f64],
    correction: &Correction,
    sigmas: &[Option<f64>; UNKNOWNS],
) -> (Square, Vector) {
    let mut matrix = [[0.0; UNKNOWNS]; UNKNOWNS];
    let mut right = [0.0; UNKNOWNS];
    for (row, weight) in rows.iter().zip(weights).filter(|(_, weight)| **weight > 0.0) {
        for i in 0..UNKNOWNS {
            let scaled = weight * row.gradient[i];
            for j in 0..=i {
                matrix[i][j] += scaled * row.gradient[j];
            }
            right[i] -= scaled * row.residual;
        }
    }
    let vector = correction.vector();
    for i in 0..UNKNOWNS {
        match sigmas[i] {
            Some(sigma) => {
                matrix[i][i] += 1.0 / (sigma * sigma);
                right[i] -= vector[i] / (sigma * sigma);
            }
            None => {
                for j in 0..UNKNOWNS {
                    matrix[i.max(j)][i.min(j)] = 0.0;
                }
                matrix[i][i] = 1.0;
                right[i] = 0.0;
            }
        }
    }
    (matrix, right)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows that ask for a known turn, shift and focal length; every seventh is wrong by a lot.
    fn linear(correction: &Correction) -> Option<Vec<Row>> {
        let truth = [0.02, -0.01, 0.03, 0.05, 0.0, -0.04, 0.02, 0.0, 0.0, 0.0];
        let vector = correction.vector();
        let rows = (0..280).map(|number| {
            let gradient: Vector = std::array::from_fn(|i| {
                if i > FREE {
                    0.0
                } else {
                    100.0 * libm::sin(f64::from(number) * (1.3 + i as f64) + i as f64)
                }
            });
            let off: f64 = (0..UNKNOWNS).map(|i| gradient[i] * (vector[i] - truth[i])).sum();
            let noise = 0.2 * libm::sin(f64::from(number) * 17.0);
            Row {
                kind: Kind::Edge,
                residual: off + noise + if number % 7 == 0 { 30.0 } else { 0.0 },
                gradient,
                sigma: 0.3,
                weight: 1.0,
                group: number as u32,
            }
        });
        Some(rows.collect())
    }
    const FREE: usize = 6;

    #[test]
    fn outliers_do_not_move_the_solution_and_what_is_not_free_stays() {
        let prior = Prior {
            focal: Some(0.1),
            ..Prior::POSE
        };
        let solved = minimise(Correction::NONE, &prior, 20.0, 30, linear).unwrap();
        let vector = solved.correction.vector();
        let truth = [0.02, -0.01, 0.03, 0.05, 0.0, -0.04, 0.02, 0.0, 0.0, 0.0];
        for i in 0..UNKNOWNS {
            assert!((vector[i] - truth[i]).abs() < 1e-3, "{i}: {vector:?}");
            assert_eq!(solved.covariance[i][i] > 0.0, i <= FREE);
        }
        assert_eq!(vector[7..], [0.0; 3]);
        let sigma = solved.covariance[0][0].sqrt();
        assert!((1e-5..2e-3).contains(&sigma), "{sigma}");
    }

    #[test]
    fn without_rows_the_prior_stays() {
        let solved = minimise(Correction::NONE, &Prior::POSE, 10.0, 5, |_| Some(Vec::new())).unwrap();
        assert_eq!(solved.correction, Correction::NONE);
        assert!((solved.covariance[0][0] - 0.15 * 0.15).abs() < 1e-12);
        assert!(minimise(Correction::NONE, &Prior::POSE, 10.0, 5, |_| None).is_none());
    }

    #[test]
    fn the_median_of_weights_is_the_one_in_the_middle() {
        assert_eq!(weighted_median(&mut [(3.0, 1.0), (1.0, 1.0), (2.0, 5.0)]), 2.0);
        assert_eq!(weighted_median(&mut []), 0.0);
        let mut ten: Vec<(f64, f64)> = (1..=10).rev().map(|i| (f64::from(i), 1.0)).collect();
        assert_eq!([0.25, 0.5].map(|share| weighted_quantile(&mut ten, share)), [3.0, 5.0]);
    }
}
