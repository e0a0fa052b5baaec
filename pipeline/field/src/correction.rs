//! The accumulated, time-shared correction of a field and the attributes that the updater sees
//! (`docs/spec/stage2.md` sections B.2 and B.6).

use rayon::prelude::*;
use rogs_schemas::records::field::RAW_CHANNELS;
use rogs_schemas::records::refinement::{RESIDUAL_CHANNELS, ScaleResidual};
use rogs_schemas::units::{iu_from_m, m_from_iu};

use crate::attributes::{MIN_LINEAR_SCALE_IU, colour, opacity_logit, scale_iu};

/// Bound of the accumulated position correction, metres (Euclidean norm).
pub const POSITION_BOUND_M: f32 = 0.05;
/// The constant spherical harmonic in what the updater sees: one unit in the last place below `rogs_splat::sh::C0`. The
/// refiners were trained with it, and their outputs keep their bytes.
const UPDATER_C0: f32 = 0.282_094_79;

/// Residual channels that share a gate, in gate order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GateGroup {
    /// Position, 3 channels.
    Position,
    /// Scale, 3 channels.
    Scale,
    /// Rotation, 4 channels.
    Rotation,
    /// Opacity, 1 channel.
    Opacity,
    /// Spherical harmonics, 48 channels.
    Harmonics,
}

impl GateGroup {
    /// All groups in gate order.
    pub const ALL: [Self; 5] = [
        Self::Position,
        Self::Scale,
        Self::Rotation,
        Self::Opacity,
        Self::Harmonics,
    ];

    /// Channels of the group among the 59.
    #[must_use]
    pub fn channels(self) -> std::ops::Range<usize> {
        match self {
            Self::Position => 0..3,
            Self::Scale => 3..6,
            Self::Rotation => 6..10,
            Self::Opacity => 10..11,
            Self::Harmonics => 11..RESIDUAL_CHANNELS,
        }
    }
}

/// Accumulated corrections of a field, zero before the first update. They name no time: one value serves all query
/// times, so displacements between times cannot change.
#[derive(Debug, Clone, PartialEq)]
pub struct Correction {
    /// `[N, 59]`; positions in METRES (the form in which they are stored, so that a resumed run continues from the same
    /// bits), the others in the parameterisation of Stage 1.
    values: Vec<f32>,
}

impl Correction {
    /// No correction of `count` Gaussians.
    #[must_use]
    pub fn zero(count: usize) -> Self {
        Self {
            values: vec![0.0; count * RESIDUAL_CHANNELS],
        }
    }

    /// Rebuilds a stored correction: flags of all Gaussians and the values of the touched ones in index order.
    /// `None` when there are not as many values as flags ask for.
    #[must_use]
    pub fn from_touched(touched: &[u8], values: &[f32]) -> Option<Self> {
        let count = touched.iter().filter(|&&flag| flag != 0).count();
        if values.len() != count * RESIDUAL_CHANNELS {
            return None;
        }
        let mut all = Self::zero(touched.len());
        let rows = all.values.chunks_exact_mut(RESIDUAL_CHANNELS).zip(touched);
        let targets = rows.filter(|(_, flag)| **flag != 0).map(|(row, _)| row);
        for (target, source) in targets.zip(values.chunks_exact(RESIDUAL_CHANNELS)) {
            target.copy_from_slice(source);
        }
        Some(all)
    }

    /// The correction as it is stored: a flag per Gaussian, set where any value is not zero, and the values of the
    /// flagged ones in index order. A correction of zero changes nothing: the field renders as Stage 1, bit for bit.
    #[must_use]
    pub fn to_touched(&self) -> (Vec<u8>, Vec<f32>) {
        let rows = || self.values.par_chunks_exact(RESIDUAL_CHANNELS);
        let changed = |row: &[f32]| row.iter().any(|value| value.to_bits() != 0);
        let touched: Vec<u8> = rows().map(|row| u8::from(changed(row))).collect();
        let count = touched.iter().filter(|&&flag| flag != 0).count();
        let mut values = Vec::with_capacity(count * RESIDUAL_CHANNELS);
        for (row, _) in self
            .values
            .chunks_exact(RESIDUAL_CHANNELS)
            .zip(&touched)
            .filter(|(_, flag)| **flag != 0)
        {
            values.extend_from_slice(row);
        }
        (touched, values)
    }

    /// The correction of one Gaussian. `[59]`, position in metres
    #[must_use]
    pub fn row(&self, gaussian: usize) -> &[f32] {
        &self.values[gaussian * RESIDUAL_CHANNELS..(gaussian + 1) * RESIDUAL_CHANNELS]
    }

    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.values.len() / RESIDUAL_CHANNELS
    }

    /// True when there is no Gaussian.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Adds a gated residual to one Gaussian and bounds its accumulated position correction. `residual` is `[59]`,
    /// position in internal units; `gates` are in the order of [`GateGroup::ALL`]. Returns the factor by which the bound
    /// shortened the position correction, 1 where it did not act.
    pub fn add(&mut self, gaussian: usize, residual: &[f32], gates: [f32; 5]) -> f32 {
        let row = &mut self.values[gaussian * RESIDUAL_CHANNELS..(gaussian + 1) * RESIDUAL_CHANNELS];
        for (group, gate) in GateGroup::ALL.into_iter().zip(gates) {
            for channel in group.channels() {
                let before = row[channel];
                row[channel] = match group {
                    GateGroup::Position => iu_from_m(before) + gate * residual[channel],
                    _ => before + gate * residual[channel],
                };
            }
        }
        let shortening = bound_factor([row[0], row[1], row[2]], iu_from_m(POSITION_BOUND_M));
        for value in &mut row[..3] {
            *value = m_from_iu(*value * shortening);
        }
        shortening
    }

    /// The updater's 59 attribute channels of one Gaussian at one time: centre 3 (internal units), scale 3, rotation 4,
    /// opacity logit 1, SH 48 colour-major. `centre_iu` is the Stage-1 centre, `raw` the Stage-1 attributes at that
    /// time (`[RAW_CHANNELS]`: colour 3, scale 3, rotation 4, opacity 1).
    pub fn attributes(&self, gaussian: usize, centre_iu: [f32; 3], raw: &[f32], mode: ScaleResidual, out: &mut [f32]) {
        debug_assert_eq!((raw.len(), out.len()), (RAW_CHANNELS, RESIDUAL_CHANNELS));
        let correction = self.row(gaussian);
        for axis in 0..3 {
            out[axis] = centre_iu[axis] + iu_from_m(correction[axis]);
            out[3 + axis] = match mode {
                ScaleResidual::PreActivation => raw[3 + axis] + correction[3 + axis],
                ScaleResidual::Linear => (scale_iu(raw[3 + axis]) + correction[3 + axis]).max(MIN_LINEAR_SCALE_IU),
            };
        }
        for part in 0..4 {
            out[6 + part] = raw[6 + part] + correction[6 + part];
        }
        out[10] = opacity_logit(raw[10]) + correction[10];
        out[11..].copy_from_slice(&correction[11..]);
        for channel in 0..3 {
            out[11 + 16 * channel] += (colour(raw[channel]) - 0.5) / UPDATER_C0;
        }
    }
}

/// Factor that shortens `value` to Euclidean norm `limit`, 1 when it is not longer.
fn bound_factor(value: [f32; 3], limit: f32) -> f32 {
    let norm = (value[0] * value[0] + value[1] * value[1] + value[2] * value[2]).sqrt();
    if norm <= limit { 1.0 } else { limit / norm }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn position_correction_never_exceeds_five_centimetres() {
        let mut correction = Correction::zero(1);
        // Between -0.4 and 0.4, in no order.
        let residuals: Vec<f32> = (0..RESIDUAL_CHANNELS * 400)
            .map(|k| ((k * 7919 % 10_007) as f32 / 10_007.0 - 0.5) * 0.8)
            .collect();
        let mut longest = 0.0f64;
        for residual in residuals.chunks_exact(RESIDUAL_CHANNELS) {
            correction.add(0, residual, [0.9; 5]);
            let norm = correction.row(0)[..3]
                .iter()
                .map(|&v| f64::from(v) * f64::from(v))
                .sum::<f64>()
                .sqrt();
            assert!(norm <= 0.05 * (1.0 + 1e-6), "{norm}");
            longest = longest.max(norm);
        }
        assert!(longest > 0.05 * (1.0 - 1e-6), "the bound was reached");
        correction.add(0, &[f32::INFINITY; RESIDUAL_CHANNELS], [0.0; 5]);
    }

    #[test]
    fn gates_scale_their_groups_alone() {
        let mut correction = Correction::zero(3);
        correction.add(1, &[0.01; RESIDUAL_CHANNELS], [0.5, 0.25, 2.0, 0.0, 1.0]);
        let row = correction.row(1);
        assert!((row[0] * 3.5 - 0.005).abs() < 1e-8);
        assert_eq!(
            (row[3], row[6], row[10], row[11], row[58]),
            (0.0025, 0.02, 0.0, 0.01, 0.01)
        );
        let (touched, values) = correction.to_touched();
        assert_eq!(
            (touched.as_slice(), values.len()),
            ([0, 1, 0].as_slice(), RESIDUAL_CHANNELS)
        );
        assert_eq!(Correction::from_touched(&touched, &values).unwrap(), correction);
        assert!(Correction::from_touched(&touched, &values[1..]).is_none());
    }

    #[test]
    fn attributes_follow_the_stage_1_parameterisation() {
        let mut correction = Correction::zero(1);
        let mut residual = [0.0; RESIDUAL_CHANNELS];
        (
            residual[0],
            residual[3],
            residual[6],
            residual[10],
            residual[11],
            residual[12],
        ) = (0.035, 0.5, 0.25, -1.0, 0.125, 2.0);
        correction.add(0, &residual, [1.0; 5]);
        let raw = [0.3, -0.2, 0.0, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0, 0.75];
        let mut out = [0.0; RESIDUAL_CHANNELS];
        correction.attributes(0, [1.0, 2.0, 3.0], &raw, ScaleResidual::PreActivation, &mut out);
        assert!((out[0] - 1.035).abs() < 1e-6);
        assert_eq!((out[3], out[6], out[10], out[12]), (1.5, 1.25, -1.5, 2.0));
        let sh = 0.5 * 0.3f32.tanh() / 0.282_094_79 + 0.125;
        assert!((out[11] - sh).abs() < 1e-6);
        correction.attributes(0, [1.0, 2.0, 3.0], &raw, ScaleResidual::Linear, &mut out);
        assert!((out[3] - (0.001 * (1.0f32.exp() + 1.0).ln() + 0.5)).abs() < 1e-6);
    }
}
