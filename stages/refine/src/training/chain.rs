//! From gradients in the Gaussians of a scene to gradients in the corrections.

use rogs_field::attributes::{MAX_SCALE_IU, MIN_LINEAR_SCALE_IU, SCALE_STEP_IU, sigmoid};
use rogs_field::{Correction, TimedField, raw_at};
use rogs_schemas::records::field::{Field, RAW_CHANNELS, TimeSlice};
use rogs_schemas::records::refinement::{RESIDUAL_CHANNELS, ScaleResidual};
use rogs_splat::backward::Gradients;
use rogs_splat::{Colour, Gaussians};
use rogs_worker::StageResult;

use crate::refinement::{bad_field, step};

/// The corrected field at a stored time with harmonics of full degree, whatever the correction.
pub(super) fn scene_at(
    field: &Field,
    correction: &Correction,
    mode: ScaleResidual,
    time: f64,
) -> StageResult<Gaussians> {
    let stored = step(0, correction);
    let timed = TimedField::new(field)
        .and_then(|field| field.with_correction(&stored, mode))
        .map_err(bad_field)?;
    let mut scene = timed.gaussians(time).map_err(bad_field)?;
    let values = scene.colour.values();
    let known = scene.colour.values_per_gaussian();
    let mut coefficients = vec![0.0; 48 * scene.len()];
    for (full, values) in coefficients.chunks_exact_mut(48).zip(values.chunks_exact(known)) {
        full[..known].copy_from_slice(values);
        if matches!(scene.colour, Colour::Rgb(_)) {
            full[..3]
                .iter_mut()
                .for_each(|value| *value = rogs_splat::sh::coefficient_from_colour(*value));
        }
    }
    scene.colour = Colour::Sh {
        degree: 3,
        coefficients,
    };
    Ok(scene)
}

/// Gradient through the bound: the radial part vanishes, the rest shrinks with the vector.
pub(super) fn bound_gradient(gradient: &mut [f32], bounded: &[f32], factor: f32) {
    let square: f32 = bounded.iter().map(|value| value * value).sum();
    let along: f32 = gradient.iter().zip(bounded).map(|(g, b)| g * b).sum::<f32>() / square;
    for (gradient, bounded) in gradient.iter_mut().zip(bounded) {
        *gradient = factor * (*gradient - along * bounded);
    }
}

/// Adds the gradient in the corrections that follows from one in the Gaussians at one time.
pub(super) fn add_chained(
    field: &Field,
    slice: &TimeSlice,
    scene: &Gaussians,
    correction: &Correction,
    mode: ScaleResidual,
    gradients: &Gradients,
    total: &mut [f32],
) {
    let raw = raw_at(field, slice);
    for (n, row) in total.chunks_exact_mut(RESIDUAL_CHANNELS).enumerate() {
        let (raw, shift) = (&raw[n * RAW_CHANNELS..(n + 1) * RAW_CHANNELS], correction.row(n));
        for axis in 0..3 {
            row[axis] += gradients.means[3 * n + axis];
            let scale = scene.scales[3 * n + axis];
            let slope = match mode {
                _ if scale >= field.scale_cap_iu[n] => 0.0,
                ScaleResidual::PreActivation if field.scale_cap_iu[n].is_infinite() && scale >= MAX_SCALE_IU => 0.0,
                ScaleResidual::PreActivation => SCALE_STEP_IU * sigmoid(raw[3 + axis] + shift[3 + axis]),
                ScaleResidual::Linear if scale <= MIN_LINEAR_SCALE_IU => 0.0,
                ScaleResidual::Linear => 1.0,
            };
            row[3 + axis] += slope * gradients.scales[3 * n + axis];
        }
        for part in 0..4 {
            row[6 + part] += gradients.quats[4 * n + part];
        }
        let opacity = scene.opacities[n];
        row[10] += opacity * (1.0 - opacity) * gradients.opacities[n];
        for coefficient in 0..16 {
            for colour in 0..3 {
                row[11 + 16 * colour + coefficient] += gradients.colour[48 * n + 3 * coefficient + colour];
            }
        }
    }
}
