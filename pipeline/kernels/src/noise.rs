//! Numbers for tests.

/// So many numbers in [-1, 1], others for each seed.
pub(crate) fn noise(count: usize, seed: usize) -> Vec<f32> {
    (0..count)
        .map(|k| (((k * 7919 + seed * 104_729) % 10_009) as f32 / 5004.5) - 1.0)
        .collect()
}
