//! Sums, means and medians.

/// Sum in numpy's pairwise order, so that means agree with numpy's bit for bit.
///
/// Runs of up to 128 values are added in eight interleaved partial sums; longer ones are split in halves, the first a
/// multiple of eight.
#[must_use]
pub fn pairwise_sum(values: &[f64]) -> f64 {
    let n = values.len();
    if n < 8 {
        // numpy starts from -0.0 so that a sum of negative zeros keeps its sign.
        return values.iter().fold(-0.0, |sum, value| sum + value);
    }
    if n <= 128 {
        let mut lanes: [f64; 8] = std::array::from_fn(|lane| values[lane]);
        let blocks = values[8..].chunks_exact(8);
        let rest = blocks.remainder();
        for block in blocks {
            for (lane, value) in lanes.iter_mut().zip(block) {
                *lane += value;
            }
        }
        let sum = ((lanes[0] + lanes[1]) + (lanes[2] + lanes[3])) + ((lanes[4] + lanes[5]) + (lanes[6] + lanes[7]));
        return rest.iter().fold(sum, |sum, value| sum + value);
    }
    let half = n / 2 - (n / 2) % 8;
    pairwise_sum(&values[..half]) + pairwise_sum(&values[half..])
}

/// Mean, or `None` of nothing.
#[must_use]
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| pairwise_sum(values) / values.len() as f64)
}

/// Median, the mean of the middle two for even counts; `None` of nothing. NaN sorts last.
#[must_use]
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    let n = values.len();
    if n == 0 {
        return None;
    }
    let (below, &mut upper, _) = values.select_nth_unstable_by(n / 2, f64::total_cmp);
    if n % 2 == 1 {
        return Some(upper);
    }
    let lower = below.iter().copied().max_by(f64::total_cmp)?;
    Some((lower + upper) / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians() {
        assert_eq!(median(vec![]), None);
        assert_eq!(median(vec![3.0]), Some(3.0));
        assert_eq!(median(vec![4.0, 1.0, 3.0]), Some(3.0));
        assert_eq!(median(vec![4.0, 1.0, 3.0, 2.0]), Some(2.5));
    }

    #[test]
    fn sums_of_every_length_are_close_to_the_plain_sum() {
        for n in 0..400 {
            let values: Vec<f64> = (0..n).map(|index| f64::from(index) * 0.1).collect();
            let plain: f64 = values.iter().sum();
            assert!((pairwise_sum(&values) - plain).abs() <= 1e-12 * plain.abs().max(1.0));
        }
    }
}
