//! PCG64 (XSL-RR 128/64), the bit generator behind numpy's `default_rng`.

use crate::seed_sequence::SeedSequence;

const MULTIPLIER: u128 = 0x2360_ed05_1fc6_5da4_4385_df64_9fcc_f645;

/// A PCG64 generator with numpy's seeding and numpy's half-word buffer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pcg64 {
    state: u128,
    increment: u128,
    /// High half of the last 64-bit draw, waiting for the next 32-bit draw.
    half: Option<u32>,
}

impl Pcg64 {
    /// `numpy.random.default_rng(seed)`.
    #[must_use]
    pub fn from_seed(seed: u64) -> Self {
        Self::from_sequence(&SeedSequence::from_integers(&[seed]))
    }

    /// `numpy.random.default_rng([a, b, ...])`.
    #[must_use]
    pub fn from_seeds(seeds: &[u64]) -> Self {
        Self::from_sequence(&SeedSequence::from_integers(seeds))
    }

    /// The generator seeded by a sequence.
    #[must_use]
    pub fn from_sequence(sequence: &SeedSequence) -> Self {
        let [state_high, state_low, stream_high, stream_low] = sequence.generate_u64::<4>();
        let wide = |high: u64, low: u64| (u128::from(high) << 64) | u128::from(low);
        let increment = (wide(stream_high, stream_low) << 1) | 1;
        let mut rng = Self {
            state: 0,
            increment,
            half: None,
        };
        rng.step();
        rng.state = rng.state.wrapping_add(wide(state_high, state_low));
        rng.step();
        rng
    }

    /// The 128-bit state.
    #[must_use]
    pub fn state(&self) -> u128 {
        self.state
    }

    /// The 128-bit stream increment (odd).
    #[must_use]
    pub fn increment(&self) -> u128 {
        self.increment
    }

    /// The next 64 random bits. Leaves a buffered half word alone.
    pub fn next_u64(&mut self) -> u64 {
        self.step();
        let folded = (self.state >> 64) as u64 ^ self.state as u64;
        folded.rotate_right((self.state >> 122) as u32)
    }

    /// The next 32 random bits: the low half of a 64-bit draw, and its high half the time after.
    pub fn next_u32(&mut self) -> u32 {
        if let Some(high) = self.half.take() {
            return high;
        }
        let value = self.next_u64();
        self.half = Some((value >> 32) as u32);
        value as u32
    }

    /// The next double in [0, 1), a multiple of 2^-53.
    pub fn next_double(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
    }

    fn step(&mut self) {
        self.state = self.state.wrapping_mul(MULTIPLIER).wrapping_add(self.increment);
    }
}
