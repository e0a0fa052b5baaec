//! Gaussians that move along polynomials of time and fade in and out: the fields of 4DGT
//! (`docs/spec/baseline-4dgt.md` section 8).

use rogs_geometry::quaternion_product;
use rogs_schemas::records::polynomial::{ANGULAR, Polynomials, VELOCITIES};
use rogs_splat::{Colour, Gaussians};

/// Temporal weight at or below which a Gaussian is not rendered.
const MIN_WEIGHT: f32 = 0.05;
/// Opacity at or below which a Gaussian is not rendered.
const MIN_OPACITY: f32 = 1e-4;

/// The Gaussians of a field that are rendered at a time.
#[derive(Debug, Clone, PartialEq)]
pub struct PolynomialState {
    /// Their indices in the field, ascending.
    pub kept: Vec<u32>,
    /// Their state, metres.
    pub gaussians: Gaussians,
}

/// Centres of all Gaussians at a time in seconds, metres. `[N, 3]`
#[must_use]
pub fn centres_m(field: &Polynomials, time_s: f32) -> Vec<f32> {
    (0..field.len())
        .flat_map(|index| centre(field, index, time_s))
        .collect()
}

/// Displacement of every Gaussian between two times, metres. `[N, 3]`
#[must_use]
pub fn displacement_m(field: &Polynomials, from_s: f32, to_s: f32) -> Vec<f32> {
    let between = |index: usize| {
        let (from, to) = (centre(field, index, from_s), centre(field, index, to_s));
        std::array::from_fn::<f32, 3, _>(|axis| to[axis] - from[axis])
    };
    (0..field.len()).flat_map(between).collect()
}

/// The rendered Gaussians at a time in seconds.
#[must_use]
pub fn state_at(field: &Polynomials, time_s: f32) -> PolynomialState {
    let mut state = PolynomialState {
        kept: Vec::new(),
        gaussians: Gaussians::empty(),
    };
    let mut rgb = Vec::new();
    for index in 0..field.len() {
        let dt = time_s - field.time_s[index];
        let weight = libm::expf(-0.5 * dt * dt / field.variance_s2[index]);
        let opacity = field.opacity[index] * weight;
        if !(weight > MIN_WEIGHT && opacity > MIN_OPACITY) {
            continue;
        }
        let angular: [f32; 3] = std::array::from_fn(|axis| {
            field.angular[index * ANGULAR + axis] * dt + field.angular[index * ANGULAR + 3 + axis] * (dt * dt)
        });
        let own: [f32; 4] = std::array::from_fn(|part| field.rotation[index * 4 + part]);
        state.kept.push(index as u32);
        state.gaussians.means.extend(centre(field, index, time_s));
        state
            .gaussians
            .quats
            .extend(quaternion_product(own, quaternion_of_angle(angular)));
        state
            .gaussians
            .scales
            .extend_from_slice(&field.scale_m[index * 3..index * 3 + 3]);
        state.gaussians.opacities.push(opacity);
        rgb.extend_from_slice(&field.rgb[index * 3..index * 3 + 3]);
    }
    state.gaussians.colour = Colour::Rgb(rgb);
    state
}

fn centre(field: &Polynomials, index: usize, time_s: f32) -> [f32; 3] {
    let dt = time_s - field.time_s[index];
    let powers = [dt, dt * dt, dt * dt * dt, dt * dt * dt * dt];
    std::array::from_fn(|axis| {
        let velocity = |degree: usize| field.velocity[index * VELOCITIES + degree * 3 + axis];
        let moved: f32 = powers
            .iter()
            .enumerate()
            .map(|(degree, power)| velocity(degree) * power)
            .sum();
        field.centre_m[index * 3 + axis] + moved
    })
}

/// The quaternion (w, x, y, z) of a rotation vector, by its series where the angle is tiny. Not renormalised.
fn quaternion_of_angle(vector: [f32; 3]) -> [f32; 4] {
    let angle = vector.iter().map(|value| value * value).sum::<f32>().sqrt();
    let half = 0.5 * angle;
    let (real, sine) = if angle < 1e-6 {
        (1.0 - 0.5 * half * half, half - 0.5 * half * half * half)
    } else {
        (libm::cosf(half), libm::sinf(half))
    };
    let [x, y, z] = vector.map(|value| sine * (value / (angle + 1e-8)));
    [real, x, y, z]
}
