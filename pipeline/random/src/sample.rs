//! Bounded integers, permutations and samples, with numpy's two ways of bounding (`docs/spec/scoring.md` section 2).

use crate::pcg64::Pcg64;

impl Pcg64 {
    /// A uniform integer in `0..=max` by masking and rejection, as `permutation` and `shuffle` draw it.
    pub fn masked(&mut self, max: u32) -> u32 {
        if max == 0 {
            return 0;
        }
        let mask = u32::MAX >> max.leading_zeros();
        loop {
            let value = self.next_u32() & mask;
            if value <= max {
                return value;
            }
        }
    }

    /// A uniform integer in `0..=max` by Lemire's multiplication, as `integers` and `choice` draw it.
    pub fn lemire(&mut self, max: u32) -> u32 {
        match max {
            0 => return 0,
            u32::MAX => return self.next_u32(),
            _ => {}
        }
        let count = max + 1;
        let mut product = u64::from(self.next_u32()) * u64::from(count);
        if (product as u32) < count {
            let threshold = count.wrapping_neg() % count;
            while (product as u32) < threshold {
                product = u64::from(self.next_u32()) * u64::from(count);
            }
        }
        (product >> 32) as u32
    }

    /// `Generator.permutation(n)`.
    pub fn permutation(&mut self, n: u32) -> Vec<u32> {
        let mut order: Vec<u32> = (0..n).collect();
        for last in (1..n).rev() {
            let other = self.masked(last);
            order.swap(last as usize, other as usize);
        }
        order
    }

    /// `sorted(Generator.permutation(n)[:take])`: a sample without replacement, in ascending order.
    pub fn sorted_sample(&mut self, n: u32, take: usize) -> Vec<u32> {
        let mut sample = self.permutation(n);
        sample.truncate(take);
        sample.sort_unstable();
        sample
    }

    /// `Generator.integers(0, n, count)`: `count` integers in `0..n`. All zeros for `n` of 0 or 1.
    pub fn integers(&mut self, n: u32, count: usize) -> Vec<u32> {
        (0..count).map(|_| self.lemire(n.saturating_sub(1))).collect()
    }

    /// `Generator.choice(n, k, replace=False)` for `n` up to 10,000: `k` distinct integers in `0..n` in random order.
    ///
    /// Above 10,000 numpy may switch to another method; this one stays uniform there but is no longer bit-equal.
    /// A `k` above `n` is taken as `n`.
    pub fn choice(&mut self, n: u32, k: u32) -> Vec<u32> {
        let k = k.min(n);
        let mut chosen: Vec<u32> = Vec::with_capacity(k as usize);
        for candidate in n - k..n {
            let value = self.lemire(candidate);
            chosen.push(if chosen.contains(&value) { candidate } else { value });
        }
        for last in (1..k).rev() {
            let other = self.lemire(last);
            chosen.swap(last as usize, other as usize);
        }
        chosen
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_maximum_of_zero_draws_nothing() {
        let mut rng = Pcg64::from_seed(1);
        let before = rng.clone();
        assert_eq!((rng.masked(0), rng.lemire(0)), (0, 0));
        assert_eq!(rng, before);
    }

    #[test]
    fn choice_draws_distinct_values_of_the_range() {
        let mut rng = Pcg64::from_seed(3);
        for _ in 0..200 {
            let mut values = rng.choice(17, 8);
            values.sort_unstable();
            values.dedup();
            assert_eq!(values.len(), 8);
            assert!(values[7] < 17);
        }
        assert_eq!(rng.choice(3, 9).len(), 3);
    }

    #[test]
    fn permutation_of_nothing_is_empty() {
        assert!(Pcg64::from_seed(0).permutation(0).is_empty());
        assert_eq!(Pcg64::from_seed(0).permutation(1), [0]);
    }
}
