//! Reductions of rows in a fixed order that vectors of any width can follow.

/// Partial results that are carried side by side.
const LANES: usize = 16;

/// The sum of a function of all values.
#[inline(always)]
pub fn sum(values: &[f32], of: impl Fn(f32) -> f32) -> f32 {
    reduce(values, 0.0, |lane, value| lane + of(value)).iter().sum()
}

/// The largest value.
#[inline(always)]
pub fn largest(values: &[f32]) -> f32 {
    let lanes = reduce(values, f32::NEG_INFINITY, f32::max);
    lanes.into_iter().fold(f32::NEG_INFINITY, f32::max)
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
            assert_eq!(Some(largest(&values)), values.iter().copied().reduce(f32::max));
        }
    }
}
