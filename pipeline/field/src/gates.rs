//! Motion gates: where a Gaussian takes its query-time attributes (`docs/spec/stage1.md` section 7).

use rogs_schemas::records::field::{Field, GATE_ATTRIBUTES, GATE_OPACITY, RAW_CHANNELS, TimeSlice};

use crate::attributes::OPACITY;

/// Displacements of at least this many internal units take query-time attributes, by default.
pub const MOTION_GATE_IU: f32 = 0.005;

/// Thresholds of the motion gates, internal units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionGates {
    /// For colour, scale and rotation.
    pub attributes_iu: f32,
    /// For opacity.
    pub opacity_iu: f32,
}

impl Default for MotionGates {
    fn default() -> Self {
        Self {
            attributes_iu: MOTION_GATE_IU,
            opacity_iu: MOTION_GATE_IU,
        }
    }
}

impl MotionGates {
    /// Gate bits of a displacement ([`GATE_ATTRIBUTES`] and [`GATE_OPACITY`]).
    #[must_use]
    pub fn bits(&self, displacement_iu: [f32; 3]) -> u8 {
        let [x, y, z] = displacement_iu;
        let norm = (x * x + y * y + z * z).sqrt();
        let bit = |open: bool, value: u8| if open { value } else { 0 };
        bit(norm >= self.attributes_iu, GATE_ATTRIBUTES) | bit(norm >= self.opacity_iu, GATE_OPACITY)
    }
}

/// Puts the next query-time values into the raw attributes of a Gaussian where its gate is open. A closed gate has none.
pub fn choose_next<'v>(gate: u8, moving: &mut impl Iterator<Item = &'v [f32]>, raw: &mut [f32]) {
    if gate == 0 {
        return;
    }
    let Some(values) = moving.next() else { return };
    if gate & GATE_ATTRIBUTES != 0 {
        raw[..OPACITY].copy_from_slice(&values[..OPACITY]);
    }
    if gate & GATE_OPACITY != 0 {
        raw[OPACITY] = values[OPACITY];
    }
}

/// Raw attributes of every Gaussian at the time of a slice: query-time values where the gate is open, base values
/// elsewhere. `[N, RAW_CHANNELS]`
#[must_use]
pub fn raw_at(field: &Field, slice: &TimeSlice) -> Vec<f32> {
    let mut raw = field.base_raw.clone();
    let mut moving = slice.moving_raw.chunks_exact(RAW_CHANNELS);
    for (attributes, &gate) in raw.chunks_exact_mut(RAW_CHANNELS).zip(&slice.gate) {
        choose_next(gate, &mut moving, attributes);
    }
    raw
}
