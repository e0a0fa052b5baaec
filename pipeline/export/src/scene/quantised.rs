//! Gaussians in the steps of a scene file (`docs/spec/scene.md` section 3).

use rogs_schemas::units::LengthUnit;
use rogs_splat::{Colour, Gaussians, sh};

/// Step of centres and displacements, metres.
pub const POSITION_STEP_M: f32 = 0.000_25;
/// Step of the natural logarithm of a scale.
pub const SCALE_STEP: f32 = 0.12;
/// Scale of step 0, metres; smaller ones become it.
pub const SMALLEST_SCALE_M: f32 = 1e-5;
/// Step of each number of a unit quaternion.
pub const ROTATION_STEP: f32 = 1.0 / 63.0;
/// Step of colours, opacities and harmonics.
pub const COLOUR_STEP: f32 = 1.0 / 255.0;

/// Numbers of a Gaussian besides its centre: scale 3, rotation (w, x, y, z) 4, colour 3, opacity 1.
pub(super) const ATTRIBUTES: usize = 11;

/// The attributes of one Gaussian, in steps.
pub(super) type Attributes = [i16; ATTRIBUTES];

/// A Gaussian that cannot be seen, for values that are not finite.
const NOTHING: Attributes = [0, 0, 0, 63, 0, 0, 0, 0, 0, 0, 0];

fn steps(value: f32, step: f32) -> i16 {
    let steps = nearest(value / step);
    steps.clamp(i16::MIN.into(), i16::MAX.into()) as i16
}

/// The nearest integer, halves away from zero, within the range; 0 of what is not a number. What `libm::roundf` gives, in
/// few instructions on any processor: packing a field rounds a million numbers a time.
fn nearest(value: f32) -> i32 {
    // `as` cuts off, and keeps to the range.
    let whole = value as i32;
    let rest = value - whole as f32;
    whole.saturating_add(i32::from(rest >= 0.5) - i32::from(rest <= -0.5))
}

/// The centre of a Gaussian in steps; 0 where it is not finite.
pub(super) fn centre(gaussians: &Gaussians, unit: LengthUnit, index: usize) -> [i32; 3] {
    std::array::from_fn(|k| nearest(unit.to_m(gaussians.means[3 * index + k]) / POSITION_STEP_M))
}

/// The other attributes in steps. A colour with harmonics is its plain part.
pub(super) fn attributes(gaussians: &Gaussians, unit: LengthUnit, index: usize) -> Attributes {
    let quat: [f32; 4] = std::array::from_fn(|k| gaussians.quats[4 * index + k]);
    let norm = libm::sqrtf(quat.iter().map(|part| part * part).sum());
    let per = gaussians.colour.values_per_gaussian();
    let colour = &gaussians.colour.values()[per * index..][..3];
    let scales = &gaussians.scales[3 * index..][..3];
    let opacity = gaussians.opacities[index];
    let finite = scales
        .iter()
        .chain(colour)
        .chain([&opacity, &norm])
        .all(|x| x.is_finite());
    let placed = (0..3).all(|k| gaussians.means[3 * index + k].is_finite());
    if !finite || !placed || norm < 1e-10 {
        return NOTHING;
    }
    // One of the two quaternions of a rotation.
    let norm = if quat.iter().find(|part| **part != 0.0).is_some_and(|part| *part < 0.0) {
        -norm
    } else {
        norm
    };
    let mut out = [0; ATTRIBUTES];
    for k in 0..3 {
        let metres = unit.to_m(scales[k]).max(SMALLEST_SCALE_M);
        out[k] = steps(libm::logf(metres / SMALLEST_SCALE_M), SCALE_STEP);
        let plain = match gaussians.colour {
            Colour::Rgb(_) => colour[k],
            Colour::Sh { .. } => 0.5 + sh::C0 * colour[k],
        };
        out[7 + k] = steps(plain, COLOUR_STEP);
    }
    for k in 0..4 {
        out[3 + k] = steps(quat[k] / norm, ROTATION_STEP);
    }
    out[10] = steps(opacity, COLOUR_STEP);
    out
}

/// Harmonics above degree 0 of all Gaussians up to a degree, in steps: `[N, (degree + 1)^2 - 1, 3]`.
pub(super) fn harmonics(gaussians: &Gaussians, degree: usize) -> Vec<i32> {
    let Colour::Sh { coefficients, .. } = &gaussians.colour else {
        return Vec::new();
    };
    let (per, kept) = (
        gaussians.colour.values_per_gaussian(),
        3 * sh::coefficient_count(degree),
    );
    let rows = coefficients.chunks_exact(per);
    rows.flat_map(|row| row[3..kept].iter().map(|value| i32::from(steps(*value, COLOUR_STEP))))
        .collect()
}

/// The Gaussians of these steps, metres. `harmonics` as [`harmonics`] has them.
pub(super) fn gaussians(centres: &[i32], attributes: &[Attributes], degree: usize, harmonics: &[i32]) -> Gaussians {
    let mut out = Gaussians::empty();
    out.means = centres.iter().map(|&steps| steps as f32 * POSITION_STEP_M).collect();
    let more = 3 * (sh::coefficient_count(degree) - 1);
    let mut coefficients = Vec::with_capacity((3 + more) * attributes.len());
    for (index, own) in attributes.iter().enumerate() {
        let value = |k: usize| f32::from(own[k]);
        (out.scales).extend((0..3).map(|k| SMALLEST_SCALE_M * libm::expf(value(k) * SCALE_STEP)));
        out.quats.extend((0..4).map(|k| value(3 + k) * ROTATION_STEP));
        coefficients.extend((0..3).map(|k| sh::coefficient_from_colour(value(7 + k) * COLOUR_STEP)));
        let rest = &harmonics[more * index..][..more];
        coefficients.extend(rest.iter().map(|&steps| steps as f32 * COLOUR_STEP));
        out.opacities.push(value(10) * COLOUR_STEP);
    }
    out.colour = Colour::Sh { degree, coefficients };
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_integer_is_that_of_libm() {
        let edges = [
            0.0,
            0.5,
            1.5,
            2.5,
            8_388_607.5,
            8_388_609.0,
            2.147_483_6e9,
            4e9,
            f32::INFINITY,
            f32::NAN,
        ];
        let many = (0..2_000_000).map(|bits| f32::from_bits(bits * 2_147));
        for value in edges.into_iter().chain(many) {
            for value in [value, -value, value.next_up(), value.next_down()] {
                assert_eq!(nearest(value), libm::roundf(value) as i32, "{value:e}");
            }
        }
    }
}
