//! What a raw attribute of a Gaussian means (`docs/spec/stage1.md` section 7).
//!
//! Raw channels are colour 3, scale 3, rotation (w, x, y, z) 4, opacity 1 ([`COLOUR`], [`SCALE`], [`ROTATION`],
//! [`OPACITY`]); the confidence of the heads is not kept. Scales come out in internal units, 3.5 per metre.

use std::ops::Range;

use rogs_schemas::records::field::RAW_CHANNELS;

/// Raw channels of the colour.
pub const COLOUR: Range<usize> = 0..3;
/// Raw channels of the scale.
pub const SCALE: Range<usize> = 3..6;
/// Raw channels of the rotation, a quaternion (w, x, y, z) of any length.
pub const ROTATION: Range<usize> = 6..10;
/// Raw channel of the opacity.
pub const OPACITY: usize = RAW_CHANNELS - 1;

/// Largest activated scale of an axis where a Gaussian has no cap of its own, internal units.
pub const MAX_SCALE_IU: f32 = MAX_SCALE as f32;
/// Activated scale per unit of softplus, internal units.
pub const SCALE_STEP_IU: f32 = SCALE_STEP as f32;
/// Smallest scale under linear residuals of Stage 2, internal units.
pub const MIN_LINEAR_SCALE_IU: f32 = 1e-6;
/// [`MAX_SCALE_IU`] before rounding to f32.
const MAX_SCALE: f64 = 0.3;
/// [`SCALE_STEP_IU`] before rounding to f32.
const SCALE_STEP: f64 = 0.001;

/// Plain RGB in 0..1 of a raw value: sigmoid(2 raw).
#[must_use]
pub fn colour(raw: f32) -> f32 {
    0.5 + 0.5 * libm::tanhf(raw)
}

/// Scale of an axis of a raw value: `min(0.3, 0.001 softplus(raw))`, internal units.
#[must_use]
pub fn scale_iu(raw: f32) -> f32 {
    scale_below_iu(raw, f32::INFINITY)
}

/// Largest scale of an axis of a Gaussian with this cap, internal units: the cap stands in the place of
/// [`MAX_SCALE_IU`] where it is finite, smaller for the footprint of the robot, larger where a field was made in a larger
/// unit.
#[must_use]
pub fn scale_limit_iu(cap_iu: f32) -> f32 {
    if cap_iu.is_finite() { cap_iu } else { MAX_SCALE_IU }
}

/// The same as [`scale_iu`] for a Gaussian with a cap of its own, [`scale_limit_iu`]. Internal units.
#[must_use]
pub fn scale_below_iu(raw: f32, cap_iu: f32) -> f32 {
    // softplus(x) = max(x, 0) + ln(1 + e^-|x|) neither overflows nor loses small values.
    let softplus = raw.max(0.0) + libm::log1pf(libm::expf(-raw.abs()));
    (SCALE_STEP_IU * softplus).min(scale_limit_iu(cap_iu))
}

/// The raw scale whose activation below a cap of `factor` times [`MAX_SCALE_IU`] is `factor` times that of `raw`.
#[must_use]
pub fn rescaled(raw: f32, factor: f64) -> f32 {
    let raw = f64::from(raw);
    let softplus = raw.max(0.0) + libm::log1p(libm::exp(-raw.abs()));
    let scale = factor * (SCALE_STEP * softplus).min(MAX_SCALE);
    let target = scale / SCALE_STEP;
    // The inverse of softplus: y + ln(1 - e^-y).
    (target + libm::log(-libm::expm1(-target))) as f32
}

/// Unit quaternion (w, x, y, z) of raw values; the identity when they are all 0.
#[must_use]
pub fn rotation(raw: [f32; 4]) -> [f32; 4] {
    let norm = raw.iter().map(|value| value * value).sum::<f32>().sqrt();
    if norm > 0.0 {
        raw.map(|value| value / norm)
    } else {
        [1.0, 0.0, 0.0, 0.0]
    }
}

/// Opacity in 0..1 of a raw value: sigmoid(2 raw - 2).
#[must_use]
pub fn opacity(raw: f32) -> f32 {
    sigmoid(opacity_logit(raw))
}

/// The logit of [`opacity`], to which residuals of Stage 2 are added.
#[must_use]
pub fn opacity_logit(raw: f32) -> f32 {
    2.0 * (raw - 1.0)
}

/// `1 / (1 + exp(-x))` without overflow.
#[must_use]
pub fn sigmoid(x: f32) -> f32 {
    let e = libm::expf(-x.abs());
    if x >= 0.0 { 1.0 / (1.0 + e) } else { e / (1.0 + e) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_are_capped_and_never_vanish() {
        assert!((scale_iu(1e5) - 0.3).abs() < 1e-9 && scale_iu(-80.0) > 0.0);
        assert!((scale_iu(1.0) - 0.001 * (1.0f32.exp() + 1.0).ln()).abs() < 1e-9);
    }

    #[test]
    fn rescaled_raw_values_activate_to_rescaled_scales() {
        // Exact for all that is not cut, in the raw values of both.
        let softplus = |raw: f64| if raw > 30.0 { raw } else { (1.0 + raw.exp()).ln() };
        let activated = |raw: f32| (SCALE_STEP * softplus(f64::from(raw))).min(MAX_SCALE);
        for raw in [-8.0f32, -1.0, 0.0, 0.5, 3.0, 40.0, 290.0, 310.0, 1e4] {
            for factor in [0.25, 1.0, 3.5] {
                let cap = (factor * MAX_SCALE) as f32;
                let found = f64::from(scale_below_iu(rescaled(raw, factor), cap));
                let expected = factor * activated(raw);
                assert!(
                    (found / expected - 1.0).abs() < 1e-5,
                    "{raw} {factor}: {found} {expected}"
                );
            }
        }
        assert!(rescaled(-200.0, 2.0) < -80.0, "tiny scales stay tiny");
    }
}
