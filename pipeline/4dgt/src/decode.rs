//! Raw numbers of the heads to activated Gaussians (`docs/spec/baseline-4dgt.md` section 6).

use rogs_schemas::records::polynomial::{ANGULAR, Polynomials, VELOCITIES};

use crate::config::{HEADS, PATCH};
use crate::rays::Rays;

/// Largest depth, metres.
const FAR_M: f32 = 50.0;
/// Smallest and largest standard deviation, metres.
const SCALES_M: [f32; 2] = [1e-4, 0.5];
/// `sqrt(-2 ln 0.05)`: at so many standard deviations a Gaussian has dropped to 0.05.
const EDGE: f32 = 2.447_746_8;
/// Shortest half life and what a sigmoid adds to it, seconds.
const LIFE_S: [f32; 2] = [0.1, 9999.9];
/// By how much a velocity of each degree is smaller than that of the degree before.
const DEGREE: f32 = 8.0;

/// What the heads say of all pixels, by [`HEADS`]. `[T * N, channels * PATCH^2]` each
pub type RawHeads = [Vec<f32>; HEADS.len()];

/// The raw numbers of one frame.
pub struct RawFrame<'a> {
    /// By head, of the frame's patches. `[N, channels * PATCH^2]`
    heads: [&'a [f32]; HEADS.len()],
    size: [usize; 2],
}

impl<'a> RawFrame<'a> {
    /// Frame `index` of what the heads say of all patches.
    #[must_use]
    pub fn new(heads: &'a RawHeads, index: usize, size: [usize; 2]) -> Self {
        let area = size[0] * size[1];
        let own = |head: usize| {
            let length = HEADS[head].1 * area;
            &heads[head][index * length..][..length]
        };
        Self {
            heads: std::array::from_fn(own),
            size,
        }
    }

    /// The channels of a head at a pixel.
    #[must_use]
    pub fn pixel<const C: usize>(&self, head: usize, row: usize, column: usize) -> [f32; C] {
        let patch = row / PATCH * (self.size[1] / PATCH) + column / PATCH;
        let within = row % PATCH * PATCH + column % PATCH;
        let first = patch * C * PATCH * PATCH + within;
        std::array::from_fn(|channel| self.heads[head][first + channel * PATCH * PATCH])
    }
}

/// Activates the raw numbers of a frame whose rays and time are these; row `row * W + column`.
#[must_use]
pub fn decode(raw: &RawFrame<'_>, rays: &Rays, time_s: f32) -> Polynomials {
    let [height, width] = raw.size;
    let mut field = Polynomials::default();
    for row in 0..height {
        for column in 0..width {
            let direction = &rays.direction[(row * width + column) * 3..][..3];
            let [depth] = raw.pixel::<1>(0, row, column).map(depth_m);
            let offset = raw.pixel::<4>(4, row, column).map(|value| sigmoid(value) - 0.5);
            let centre = |axis: usize| rays.origin[axis] + depth * direction[axis] + offset[axis];
            field.centre_m.extend([0, 1, 2].map(centre));
            field.time_s.push(time_s + offset[3]);
            field.opacity.extend(raw.pixel::<1>(1, row, column).map(sigmoid));
            field.scale_m.extend(raw.pixel::<3>(2, row, column).map(scale_m));
            field.rotation.extend(normalised(raw.pixel::<4>(3, row, column)));
            let velocity = raw.pixel::<16>(5, row, column);
            field.velocity.extend(velocities::<VELOCITIES>(&velocity));
            field
                .variance_s2
                .extend(raw.pixel::<1>(6, row, column).map(variance_s2));
            let angular = raw.pixel::<8>(7, row, column);
            field.angular.extend(velocities::<ANGULAR>(&angular));
            let colour = raw.pixel::<4>(8, row, column).map(sigmoid);
            field.rgb.extend_from_slice(&colour[..3]);
        }
    }
    field
}

/// Depth along the camera's axis, metres.
fn depth_m(raw: f32) -> f32 {
    FAR_M * sigmoid(raw - 4.0)
}

/// Standard deviation, metres.
fn scale_m(raw: f32) -> f32 {
    let [least, most] = SCALES_M.map(|scale| scale * EDGE);
    (sigmoid(raw - 2.3) * (most - least) + least) / EDGE
}

/// Temporal variance of a half life, square seconds.
fn variance_s2(raw: f32) -> f32 {
    let life = LIFE_S[0] + LIFE_S[1] * sigmoid(raw - 2.0);
    life * life / (EDGE * EDGE)
}

/// Velocities by degree: axis and speed of each degree, four numbers. `4 N / 3 -> N`
fn velocities<const N: usize>(raw: &[f32]) -> [f32; N] {
    let mut out = [0.0; N];
    let mut divisor = 1.0;
    for (raw, out) in raw.chunks_exact(4).zip(out.chunks_exact_mut(3)) {
        let speed = (2.0 * sigmoid(raw[3] - 6.9068) - 1e-4).max(0.0) / divisor;
        let axis = normalised([raw[0], raw[1], raw[2]]);
        out.iter_mut().zip(axis).for_each(|(out, axis)| *out = speed * axis);
        divisor *= DEGREE;
    }
    out
}

/// `v / (|v| + 1e-8)`.
fn normalised<const C: usize>(values: [f32; C]) -> [f32; C] {
    let norm = values.iter().map(|value| value * value).sum::<f32>().sqrt();
    values.map(|value| value / (norm + 1e-8))
}

fn sigmoid(x: f32) -> f32 {
    let e = libm::expf(-x.abs());
    if x >= 0.0 { 1.0 / (1.0 + e) } else { e / (1.0 + e) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_at_zero_are_those_of_the_page() {
        assert!((depth_m(0.0) - 0.899).abs() < 1e-3);
        // A half life of 1192 seconds.
        assert!((libm::sqrtf(variance_s2(0.0)) * EDGE - 1192.1).abs() < 0.2);
        assert!((scale_m(-1e3) - 1e-4).abs() < 1e-8 && (scale_m(1e3) - 0.5).abs() < 1e-6);
        assert_eq!(velocities::<6>(&[1.0, 0.0, 0.0, -40.0, 0.0, 3.0, 4.0, 60.0]), {
            let second = (2.0f32 - 1e-4) / 8.0;
            [0.0, 0.0, 0.0, 0.0, second * 0.6, second * 0.8]
        });
    }
}
