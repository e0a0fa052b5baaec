//! The scene: Gaussians as a structure of arrays.

use crate::error::{Result, SplatError};
use crate::sh;

/// Largest number of Gaussians of one scene (indices are 32 bit).
pub const MAX_GAUSSIANS: usize = 1 << 30;

/// Gaussians in one world frame. Lengths are in any unit, the same as that of the camera (internal units inside the
/// networks); the row order is the identity of the Gaussians.
#[derive(Debug, Clone, PartialEq)]
pub struct Gaussians {
    /// Centres. `[N, 3]`
    pub means: Vec<f32>,
    /// Rotations, quaternions (w, x, y, z) of any non-zero norm. `[N, 4]`
    pub quats: Vec<f32>,
    /// Standard deviations along the local axes, linear. `[N, 3]`
    pub scales: Vec<f32>,
    /// Opacities in 0..1. `[N]`
    pub opacities: Vec<f32>,
    /// Colours.
    pub colour: Colour,
    /// Further channels that are composited with the same weights, for example a displacement. `[N, extra_channels]`
    pub extra: Vec<f32>,
    /// Number of further channels, 0 for none.
    pub extra_channels: usize,
}

/// Colours of Gaussians.
#[derive(Debug, Clone, PartialEq)]
pub enum Colour {
    /// Plain RGB, used as it is (not clamped). `[N, 3]`
    Rgb(Vec<f32>),
    /// Real spherical harmonics; the colour is `max(0, sum_k Y_k(direction) c_k + 0.5)`.
    Sh {
        /// Degree, 0 to 3.
        degree: usize,
        /// Coefficients, coefficient-major, colour last. `[N, (degree + 1)^2, 3]`
        coefficients: Vec<f32>,
    },
}

impl Gaussians {
    /// A scene without Gaussians.
    #[must_use]
    pub fn empty() -> Self {
        Self {
            means: Vec::new(),
            quats: Vec::new(),
            scales: Vec::new(),
            opacities: Vec::new(),
            colour: Colour::Rgb(Vec::new()),
            extra: Vec::new(),
            extra_channels: 0,
        }
    }

    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.opacities.len()
    }

    /// True when there is no Gaussian.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.opacities.is_empty()
    }

    /// Checks that all arrays belong to the same number of Gaussians. Values are not checked here: a Gaussian with a
    /// value that is not a number is dropped and counted by the renderer.
    ///
    /// # Errors
    /// Names the first array of a wrong length.
    pub fn validate(&self) -> Result<()> {
        let n = self.len();
        if n > MAX_GAUSSIANS {
            return Err(SplatError::Setting {
                what: "a scene holds at most 2^30 Gaussians",
                value: n.to_string(),
            });
        }
        SplatError::check("means", self.means.len(), 3 * n, "3 per Gaussian")?;
        SplatError::check("quats", self.quats.len(), 4 * n, "4 per Gaussian")?;
        SplatError::check("scales", self.scales.len(), 3 * n, "3 per Gaussian")?;
        match &self.colour {
            Colour::Rgb(rgb) => SplatError::check("rgb", rgb.len(), 3 * n, "3 per Gaussian")?,
            Colour::Sh { degree, coefficients } => {
                if *degree > sh::MAX_DEGREE {
                    return Err(SplatError::Setting {
                        what: "the degree of spherical harmonics is 0 to 3",
                        value: degree.to_string(),
                    });
                }
                let per = 3 * sh::coefficient_count(*degree);
                let meaning = format!("{per} per Gaussian at degree {degree}");
                SplatError::check("sh coefficients", coefficients.len(), per * n, &meaning)?;
            }
        }
        let meaning = format!("{} per Gaussian", self.extra_channels);
        SplatError::check(
            "extra",
            self.extra.len(),
            self.extra_channels.saturating_mul(n),
            &meaning,
        )
    }
}

impl Gaussians {
    /// The Gaussians whose flag is set, in their order. `keep [N]`; one that has no flag is left out.
    #[must_use]
    pub fn kept(&self, keep: &[bool]) -> Self {
        let pick = |values: &[f32], per: usize| -> Vec<f32> {
            let rows = values.chunks_exact(per.max(1)).zip(keep);
            rows.filter(|(_, keep)| **keep)
                .flat_map(|(row, _)| row)
                .copied()
                .collect()
        };
        let per = self.colour.values_per_gaussian();
        let colour = match &self.colour {
            Colour::Rgb(rgb) => Colour::Rgb(pick(rgb, per)),
            Colour::Sh { degree, coefficients } => Colour::Sh {
                degree: *degree,
                coefficients: pick(coefficients, per),
            },
        };
        Self {
            means: pick(&self.means, 3),
            quats: pick(&self.quats, 4),
            scales: pick(&self.scales, 3),
            opacities: pick(&self.opacities, 1),
            colour,
            extra: pick(&self.extra, self.extra_channels),
            extra_channels: self.extra_channels,
        }
    }
}

impl Colour {
    /// The values, whatever they mean.
    #[must_use]
    pub fn values(&self) -> &[f32] {
        match self {
            Self::Rgb(values)
            | Self::Sh {
                coefficients: values, ..
            } => values,
        }
    }

    /// Number of values of one Gaussian.
    #[must_use]
    pub fn values_per_gaussian(&self) -> usize {
        match self {
            Self::Rgb(_) => 3,
            Self::Sh { degree, .. } => 3 * sh::coefficient_count(*degree),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_keeps_its_order_and_all_its_values() {
        let count = |per: usize| (0..3 * per).map(|k| k as f32).collect::<Vec<f32>>();
        let scene = Gaussians {
            means: count(3),
            quats: count(4),
            scales: count(3),
            opacities: count(1),
            colour: Colour::Sh {
                degree: 1,
                coefficients: count(12),
            },
            extra: count(2),
            extra_channels: 2,
        };
        let kept = scene.kept(&[true, false, true]);
        kept.validate().unwrap();
        assert_eq!(kept.means, [0.0, 1.0, 2.0, 6.0, 7.0, 8.0]);
        assert_eq!(kept.extra, [0.0, 1.0, 4.0, 5.0]);
        assert_eq!(kept.colour.values()[12..], scene.colour.values()[24..]);
        assert_eq!(scene.kept(&[true; 3]), scene);
        assert!(scene.kept(&[]).is_empty());
    }
}
