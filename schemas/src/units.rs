//! The one place where metres and internal units are converted.
//!
//! Network and rasteriser computations use a fixed 3.5 internal units (`iu`) per metre across clips (paper, appendix
//! "Internal units"); files hold metres. Rotations, opacities and colours are never rescaled.

/// Internal length units per metre. Fixed for every clip; no per-scene scale exists.
pub const UNITS_PER_METRE: f64 = 3.5;

/// Converts a length in metres to internal units.
#[must_use]
pub fn iu_from_m(metres: f32) -> f32 {
    metres * UNITS_PER_METRE as f32
}

/// Converts a length in internal units to metres.
#[must_use]
pub fn m_from_iu(units: f32) -> f32 {
    units / UNITS_PER_METRE as f32
}

/// The unit of lengths in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LengthUnit {
    /// Metres: files, calibrations, scenes of other programs.
    Metre,
    /// Internal units: networks, and fields as they are rendered.
    Internal,
}

impl LengthUnit {
    /// How many of them are in a metre.
    #[must_use]
    pub const fn per_metre(self) -> f64 {
        match self {
            Self::Metre => 1.0,
            Self::Internal => UNITS_PER_METRE,
        }
    }

    /// Converts a length of this unit to metres.
    #[must_use]
    pub fn to_m(self, length: f32) -> f32 {
        length / self.per_metre() as f32
    }
}
