//! Robot metrics: displacement error on tracks and depth error on the robot's core (`docs/spec/scoring.md` sections 6 and 7).

use rogs_schemas::records::robot::NO_LINK;

use crate::metrics::image::MetricError;

/// Smallest blending weight a displacement sum is divided by.
pub const MIN_BLEND_WEIGHT: f32 = 1e-6;

/// A rendered displacement: the blended sum over Gaussians and its weight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DisplacementMap<'a> {
    height: usize,
    width: usize,
    /// `sum(w_i d_i)`, metres. `[H, W, 3]`
    sum_m: &'a [f32],
    /// `sum(w_i)`. `[H, W]`
    weight: &'a [f32],
}

impl<'a> DisplacementMap<'a> {
    /// A map over `height * width * 3` sums and `height * width` weights.
    ///
    /// # Errors
    /// When a buffer has another length or the map is empty.
    pub fn new(height: usize, width: usize, sum_m: &'a [f32], weight: &'a [f32]) -> Result<Self, MetricError> {
        let area = height.saturating_mul(width);
        if area == 0 || sum_m.len() != area.saturating_mul(3) || weight.len() != area {
            return Err(MetricError::BufferSize {
                height,
                width,
                expected: area.saturating_mul(3),
                found: sum_m.len(),
            });
        }
        Ok(Self {
            height,
            width,
            sum_m,
            weight,
        })
    }

    /// The displacement at the pixel nearest to `(x, y)`, metres. Coordinates have INTEGER pixel centres and are clamped.
    #[must_use]
    pub fn nearest(&self, pixel: [f32; 2]) -> [f64; 3] {
        let clamp = |coordinate: f32, length: usize| {
            (f64::from(coordinate) + 0.5).floor().clamp(0.0, (length - 1) as f64) as usize
        };
        let at = clamp(pixel[1], self.height) * self.width + clamp(pixel[0], self.width);
        let weight = f64::from(self.weight[at].max(MIN_BLEND_WEIGHT));
        std::array::from_fn(|axis| f64::from(self.sum_m[at * 3 + axis]) / weight)
    }
}

/// One track at one pair of times.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackSample {
    /// Anchor pixel `(x, y)`, integer pixel centres.
    pub pixel: [f32; 2],
    /// Position at the anchor time, base frame, metres.
    pub anchor_m: [f32; 3],
    /// Position at the query time, base frame, metres.
    pub query_m: [f32; 3],
}

/// Length of the difference between rendered and tracked displacement, metres.
#[must_use]
pub fn track_error_m(map: &DisplacementMap<'_>, sample: &TrackSample) -> f64 {
    let rendered = map.nearest(sample.pixel);
    let squared: f64 = (0..3)
        .map(|axis| {
            let tracked = f64::from(sample.query_m[axis]) - f64::from(sample.anchor_m[axis]);
            (rendered[axis] - tracked).powi(2)
        })
        .sum();
    squared.sqrt()
}

/// The robot's core: one link in the whole 3x3 neighbourhood (image border excluded), supported reference depth, and
/// reference and mesh depth within `tau_m` of each other. All slices are `[H, W]`.
#[must_use]
pub fn robot_core(
    height: usize,
    width: usize,
    link: &[u8],
    mesh_m: &[f32],
    reference_m: &[f32],
    support: &[bool],
    tau_m: f64,
) -> Vec<bool> {
    let mut core = vec![false; height * width];
    for row in 1..height.saturating_sub(1) {
        for column in 1..width.saturating_sub(1) {
            let at = row * width + column;
            let same = |neighbour: usize| link[neighbour - 1..=neighbour + 1].iter().all(|&id| id == link[at]);
            core[at] = link[at] != NO_LINK
                && support[at]
                && (f64::from(reference_m[at]) - f64::from(mesh_m[at])).abs() <= tau_m
                && same(at - width)
                && same(at)
                && same(at + width);
        }
    }
    core
}

/// Sum of `|z_hat - z|` in metres and number of pixels over a core; undefined predictions count as 0.
#[must_use]
pub fn robot_depth_error(prediction: &[f32], reference_m: &[f32], core: &[bool]) -> (f64, u64) {
    let mut sum = 0.0;
    let mut count = 0;
    for ((&predicted, &truth), _) in prediction
        .iter()
        .zip(reference_m)
        .zip(core)
        .filter(|(_, inside)| **inside)
    {
        let predicted = if predicted.is_finite() {
            f64::from(predicted)
        } else {
            0.0
        };
        sum += (predicted - f64::from(truth)).abs();
        count += 1;
    }
    (sum, count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sampling_rounds_half_up_and_clamps() {
        let sum: Vec<f32> = (0..2 * 3 * 3).map(|index| index as f32).collect();
        let map = DisplacementMap::new(2, 3, &sum, &[1.0; 6]).unwrap();
        assert_eq!(map.nearest([0.49, 0.0])[0], 0.0);
        assert_eq!(map.nearest([0.5, 0.0])[0], 3.0);
        assert_eq!(map.nearest([-9.0, 99.0])[0], 9.0);
        assert_eq!(map.nearest([f32::NAN, 0.0])[0], 0.0);
    }

    #[test]
    fn an_empty_pixel_has_no_displacement() {
        let map = DisplacementMap::new(1, 1, &[0.0; 3], &[0.0]).unwrap();
        assert_eq!(map.nearest([0.0, 0.0]), [0.0; 3]);
        let sample = TrackSample {
            pixel: [0.0, 0.0],
            anchor_m: [1.0; 3],
            query_m: [1.0, 1.0, 1.5],
        };
        assert_eq!(track_error_m(&map, &sample), 0.5);
    }

    #[test]
    fn the_core_needs_one_link_all_around() {
        let mut link = vec![4u8; 25];
        link[0] = 5;
        let depth = vec![1.0f32; 25];
        let core = robot_core(5, 5, &link, &depth, &depth, &[true; 25], 0.03);
        // 3x3 interior without the pixel that touches the corner.
        assert_eq!(core.iter().filter(|&&inside| inside).count(), 8);
        assert!(!core[6]);
        let none = robot_core(5, 5, &[NO_LINK; 25], &depth, &depth, &[true; 25], 0.03);
        assert!(none.iter().all(|&inside| !inside));
    }
}
