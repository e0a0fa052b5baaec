//! Numbers as colours: errors and depths.

/// Error, of 255, from which on error maps have their brightest colour.
pub const FULL_ERROR: u8 = 64;

/// Black over red to yellow, for 0 to 1.
#[must_use]
pub fn heat(x: f32) -> [u8; 3] {
    let channel = |value: f32| (255.0 * value.clamp(0.0, 1.0)) as u8;
    [channel(2.0 * x), channel(2.0 * x - 1.0), 0]
}

/// The colour of the mean absolute difference of the channels of two colours; [`FULL_ERROR`] is the brightest.
#[must_use]
pub fn error(a: &[u8], b: &[u8]) -> [u8; 3] {
    let sum: u32 = a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
    heat((sum as f32 / 3.0 / f32::from(FULL_ERROR)).min(1.0))
}

/// A ramp of rising brightness from blue over red to yellow, for 0 to 1.
#[must_use]
pub fn ramp(x: f32) -> [u8; 3] {
    let channel = |value: f32| (255.0 * value.clamp(0.0, 1.0)) as u8;
    [
        channel(1.8 * x),
        channel(1.9 * x - 0.75),
        channel(0.35 + 0.9 * x - 2.6 * (x - 0.35).max(0.0) + 1.6 * (x - 0.75).max(0.0)),
    ]
}

/// The colour of a depth between two depths, black where there is none.
#[must_use]
pub fn depth(depth_m: f32, (near, far): (f32, f32)) -> [u8; 3] {
    if depth_m > 0.0 {
        ramp(((depth_m - near) / (far - near)).clamp(0.0, 1.0))
    } else {
        [0; 3]
    }
}

/// 2 % and 98 % quantiles of the positive depths, metres; none where there is no depth.
#[must_use]
pub fn depth_range(depths: impl Iterator<Item = f32>) -> Option<(f32, f32)> {
    let mut depths: Vec<f32> = depths.filter(|depth| depth.is_finite() && *depth > 0.0).collect();
    if depths.is_empty() {
        return None;
    }
    depths.sort_unstable_by(f32::total_cmp);
    let at = |quantile: f64| depths[((depths.len() - 1) as f64 * quantile) as usize];
    let (near, far) = (at(0.02), at(0.98));
    Some((near, far.max(near + 1e-3)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_grow_brighter() {
        let colour = |by: u8| error(&[100; 3], &[100 + by; 3]);
        assert_eq!(colour(0), [0, 0, 0]);
        assert_eq!(colour(FULL_ERROR / 2), [255, 0, 0]);
        assert_eq!(colour(FULL_ERROR), [255, 255, 0]);
        assert_eq!(colour(150), [255, 255, 0]);
    }

    #[test]
    fn depths_lie_between_their_quantiles() {
        let range = depth_range((0..=100).map(|k| k as f32 / 100.0).chain([f32::NAN, 0.0])).unwrap();
        assert!(range.0 < 0.05 && range.1 > 0.95, "{range:?}");
        assert_eq!(depth(0.0, range), [0; 3]);
        assert_eq!(depth(9.0, range), ramp(1.0));
        assert_eq!(depth_range([0.0].into_iter()), None);
    }
}
