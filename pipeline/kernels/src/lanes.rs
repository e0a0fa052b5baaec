//! Reductions of rows in a fixed order that vectors of any width can follow.

use crate::vectorised;

/// Partial results that are carried side by side.
const LANES: usize = 16;

/// The sum of a function of all values.
#[inline(always)]
pub fn sum(values: &[f32], of: impl Fn(f32) -> f32) -> f32 {
    reduce(values, 0.0, |lane, value| lane + of(value)).iter().sum()
}

/// Replaces all values by a function of them and sums these: those in whole rows of lanes side by side, then the lanes by
/// halves, then the rest one after the other. So a vector of sixteen numbers does it by itself, and narrower ones that take
/// their turns do the same.
#[inline(always)]
pub(crate) fn map_and_sum_by_halves(values: &mut [f32], of: impl Fn(f32) -> f32) -> f32 {
    let (whole, rest) = values.as_chunks_mut::<LANES>();
    let mut lanes = [0.0; LANES];
    for part in whole {
        for (lane, value) in lanes.iter_mut().zip(part) {
            *value = of(*value);
            *lane += *value;
        }
    }
    let mut half = LANES / 2;
    while half > 0 {
        for lane in 0..half {
            lanes[lane] += lanes[lane + half];
        }
        half /= 2;
    }
    rest.iter_mut().fold(lanes[0], |sum, value| {
        *value = of(*value);
        sum + *value
    })
}

/// The sum of all values in double precision.
#[must_use]
pub fn total(values: &[f32]) -> f64 {
    let mut lanes = [0.0f64; LANES];
    vectorised(
        #[inline(always)]
        || {
            let (whole, rest) = values.as_chunks::<LANES>();
            for part in whole {
                for (lane, &value) in lanes.iter_mut().zip(part) {
                    *lane += f64::from(value);
                }
            }
            for (lane, &value) in lanes.iter_mut().zip(rest) {
                *lane += f64::from(value);
            }
        },
    );
    lanes.iter().sum()
}

/// Adds rows to sums in double precision, the first row first. `[rows, columns], [columns]`
pub fn add_rows(rows: &[f32], sums: &mut [f64]) {
    vectorised(
        #[inline(always)]
        || {
            for row in rows.chunks_exact(sums.len().max(1)) {
                for (sum, &value) in sums.iter_mut().zip(row) {
                    *sum += f64::from(value);
                }
            }
        },
    );
}

/// The largest value.
#[inline(always)]
pub fn largest(values: &[f32]) -> f32 {
    let lanes = reduce(values, f32::NEG_INFINITY, f32::max);
    lanes.into_iter().fold(f32::NEG_INFINITY, f32::max)
}

/// The sum of the products of two rows.
#[inline(always)]
pub(crate) fn dot(a: &[f32], b: &[f32]) -> f32 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut lanes = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for ((lane, a), b) in lanes.iter_mut().zip(a).zip(b) {
            *lane += a * b;
        }
    }
    let rest: f32 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    lanes.iter().sum::<f32>() + rest
}

/// Every lane joins each sixteenth value.
#[inline(always)]
fn reduce(values: &[f32], start: f32, join: impl Fn(f32, f32) -> f32) -> [f32; LANES] {
    let mut lanes = [start; LANES];
    let whole = values.chunks_exact(LANES);
    let rest = whole.remainder();
    for part in whole {
        for (lane, &value) in lanes.iter_mut().zip(part) {
            *lane = join(*lane, value);
        }
    }
    for (lane, &value) in lanes.iter_mut().zip(rest) {
        *lane = join(*lane, value);
    }
    lanes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_and_broken_rows_are_reduced() {
        for count in [1usize, 15, 16, 17, 50] {
            let values: Vec<f32> = (0..count).map(|k| ((k * 7) % 11) as f32 - 20.0).collect();
            assert_eq!(sum(&values, |value| 2.0 * value), 2.0 * values.iter().sum::<f32>());
            assert_eq!(dot(&values, &values), values.iter().map(|value| value * value).sum());
            let exact: f64 = values.iter().map(|&value| f64::from(value)).sum();
            assert_eq!(total(&values), exact);
            let mut sums = vec![1.0; 3];
            add_rows(&values[..count / 3 * 3], &mut sums);
            for (column, sum) in sums.into_iter().enumerate() {
                let column = values[..count / 3 * 3].iter().skip(column).step_by(3);
                assert_eq!(sum, 1.0 + column.map(|&value| f64::from(value)).sum::<f64>());
            }
            assert_eq!(Some(largest(&values)), values.iter().copied().reduce(f32::max));
        }
    }
}
