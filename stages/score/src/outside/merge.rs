//! Calibrated merging of camera-wise fields (paper, appendix on baselines).

use rogs_splat::sh::{coefficient_count, coefficient_from_colour};
use rogs_splat::{Colour, Gaussians};

use crate::metrics::median;

/// The scale factor of a camera's field: median over all valid pixels of all given images of reference over predicted
/// depth. `None` when no pixel is valid. Each entry is prediction, reference, support of one image. `[H, W]` each
#[must_use]
pub fn stereo_scale(images: &[(&[f32], &[f32], &[bool])]) -> Option<f64> {
    let ratio = |((&predicted, &truth), &supported): ((&f32, &f32), &bool)| {
        (supported && predicted.is_finite() && predicted > 0.0).then(|| f64::from(truth) / f64::from(predicted))
    };
    let of = |(own, truth, support): &(&[f32], &[f32], &[bool])| -> Vec<f64> {
        own.iter()
            .zip(truth.iter())
            .zip(support.iter())
            .filter_map(ratio)
            .collect()
    };
    median(images.iter().flat_map(of).collect())
}

/// The union of fields, in order. Plain colours stay so where all fields have them; else all become spherical harmonics
/// of the highest degree. `None` when the numbers of extra channels differ.
#[must_use]
pub fn merge(fields: &[Gaussians]) -> Option<Gaussians> {
    let mut out = Gaussians::empty();
    let degree = fields.iter().filter_map(|field| match &field.colour {
        Colour::Rgb(_) => None,
        Colour::Sh { degree, .. } => Some(*degree),
    });
    let degree = degree.max();
    let mut colours = Vec::new();
    for (index, field) in fields.iter().enumerate() {
        if index > 0 && field.extra_channels != out.extra_channels {
            return None;
        }
        match degree {
            None => colours.extend_from_slice(field.colour.values()),
            Some(degree) => widen(&field.colour, coefficient_count(degree), &mut colours),
        }
        out.means.extend_from_slice(&field.means);
        out.quats.extend_from_slice(&field.quats);
        out.scales.extend_from_slice(&field.scales);
        out.opacities.extend_from_slice(&field.opacities);
        out.extra.extend_from_slice(&field.extra);
        out.extra_channels = field.extra_channels;
    }
    out.colour = match degree {
        None => Colour::Rgb(colours),
        Some(degree) => Colour::Sh {
            degree,
            coefficients: colours,
        },
    };
    Some(out)
}

/// Appends colours as harmonics with `count` coefficients a channel.
fn widen(colour: &Colour, count: usize, out: &mut Vec<f32>) {
    let (own, values) = match colour {
        Colour::Rgb(rgb) => (1, rgb.iter().map(|&value| coefficient_from_colour(value)).collect()),
        Colour::Sh { degree, coefficients } => (coefficient_count(*degree), coefficients.clone()),
    };
    for row in values.chunks_exact(3 * own) {
        out.extend_from_slice(row);
        out.extend(std::iter::repeat_n(0.0, 3 * (count - own)));
    }
}
