//! Gaussians, one by one, in the terms that files of other programs share: metres, unit quaternions (x, y, z, w), harmonics.

use glam::{DMat3, DVec3};
use rogs_field::Axes;
use rogs_geometry::{Frame, Pose};
use rogs_schemas::units::LengthUnit;
use rogs_splat::{Colour, Gaussians, sh};

use crate::error::{Error, Result};

/// The frame that a field is written in: base or reconstruction frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum World {}

impl Frame for World {
    const NAME: &'static str = "world";
}

/// The same frame turned so that x points right, y up and z to the viewer, as viewers and glTF have it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum YUp {}

impl Frame for YUp {
    const NAME: &'static str = "y_up";
}

/// How a frame is turned for programs whose y points up: the reconstruction frame by half a turn about x, the base, whose z
/// points up, by a quarter turn about x.
#[must_use]
pub fn y_up_from_world(axes: Axes) -> Pose<YUp, World> {
    let rows = match axes {
        Axes::Recon => [DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z],
        Axes::Base => [DVec3::X, DVec3::Z, DVec3::NEG_Y],
    };
    Pose::new(
        DMat3::from_cols_array_2d(&rows.map(|row| row.to_array())).transpose(),
        DVec3::ZERO,
    )
}

/// Which Gaussians have only finite numbers, sizes above 0 and a rotation: files of integers can hold no others.
#[must_use]
pub fn whole(gaussians: &Gaussians) -> Vec<bool> {
    let per = gaussians.colour.values_per_gaussian();
    let one = |n: usize| {
        let quat = &gaussians.quats[4 * n..4 * n + 4];
        let parts = [
            &gaussians.means[3 * n..3 * n + 3],
            &gaussians.scales[3 * n..3 * n + 3],
            quat,
            &gaussians.colour.values()[per * n..per * (n + 1)],
        ];
        parts.into_iter().flatten().all(|value| value.is_finite())
            && gaussians.scales[3 * n..3 * n + 3].iter().all(|scale| *scale > 0.0)
            && quat.iter().any(|value| *value != 0.0)
            && (0.0..=1.0).contains(&gaussians.opacities[n])
    };
    (0..gaussians.len()).map(one).collect()
}

/// Gaussians whose arrays were found to agree.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Splats<'a> {
    gaussians: &'a Gaussians,
    unit: LengthUnit,
    degree: usize,
}

impl<'a> Splats<'a> {
    /// Checks that all numbers can be written.
    pub(crate) fn new(gaussians: &'a Gaussians, unit: LengthUnit) -> Result<Self> {
        let unfit = |what: String| Error::Unfit { what };
        gaussians.validate().map_err(|error| unfit(error.to_string()))?;
        if let Some(row) = whole(gaussians).iter().position(|whole| !whole) {
            return Err(unfit(format!(
                "Gaussian {row} has a number that is not finite, or no size; leave it out first"
            )));
        }
        let degree = match gaussians.colour {
            Colour::Rgb(_) => 0,
            Colour::Sh { degree, .. } => degree,
        };
        Ok(Self {
            gaussians,
            unit,
            degree,
        })
    }

    pub(crate) fn len(&self) -> usize {
        self.gaussians.len()
    }

    /// Degree of the harmonics, 0 to 3.
    pub(crate) fn degree(&self) -> usize {
        self.degree
    }

    /// Metres.
    pub(crate) fn centre_m(&self, n: usize) -> [f32; 3] {
        std::array::from_fn(|k| self.unit.to_m(self.gaussians.means[3 * n + k]))
    }

    /// Standard deviations, metres.
    pub(crate) fn scale_m(&self, n: usize) -> [f32; 3] {
        std::array::from_fn(|k| self.unit.to_m(self.gaussians.scales[3 * n + k]))
    }

    /// Unit quaternion (x, y, z, w).
    pub(crate) fn rotation(&self, n: usize) -> [f64; 4] {
        let [w, x, y, z] = std::array::from_fn(|k| f64::from(self.gaussians.quats[4 * n + k]));
        let length = (w * w + x * x + y * y + z * z).sqrt();
        [x, y, z, w].map(|value| value / length)
    }

    pub(crate) fn opacity(&self, n: usize) -> f32 {
        self.gaussians.opacities[n]
    }

    /// Harmonic of degree 0, red, green, blue.
    pub(crate) fn constant(&self, n: usize) -> [f32; 3] {
        match &self.gaussians.colour {
            Colour::Rgb(rgb) => std::array::from_fn(|k| sh::coefficient_from_colour(rgb[3 * n + k])),
            Colour::Sh { coefficients, .. } => {
                let per = 3 * sh::coefficient_count(self.degree);
                std::array::from_fn(|k| coefficients[per * n + k])
            }
        }
    }

    /// The colour that the harmonic of degree 0 is.
    pub(crate) fn colour(&self, n: usize) -> [f32; 3] {
        match &self.gaussians.colour {
            Colour::Rgb(rgb) => std::array::from_fn(|k| rgb[3 * n + k]),
            Colour::Sh { .. } => self.constant(n).map(|value| sh::C0 * value + 0.5),
        }
    }

    /// The other harmonics. `[(degree + 1)^2 - 1, 3]`
    pub(crate) fn rest(&self, n: usize) -> &'a [f32] {
        match &self.gaussians.colour {
            Colour::Rgb(_) => &[],
            Colour::Sh { coefficients, .. } => {
                let per = 3 * sh::coefficient_count(self.degree);
                &coefficients[per * n + 3..per * (n + 1)]
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Some Gaussians with harmonics of a degree, metres.
    pub(crate) fn scene(count: usize, degree: usize) -> Gaussians {
        let value = |k: usize| ((k * 7919 % 1009) as f32 / 1009.0 - 0.5) * 2.0;
        let per = 3 * sh::coefficient_count(degree);
        Gaussians {
            means: (0..3 * count).map(|k| 1.5 * value(k)).collect(),
            quats: (0..4 * count).map(|k| value(k + 3)).collect(),
            scales: (0..3 * count).map(|k| 0.01 + 0.008 * value(k + 5)).collect(),
            opacities: (0..count).map(|k| 0.5 + 0.5 * value(k + 7)).collect(),
            colour: Colour::Sh {
                degree,
                coefficients: (0..per * count).map(|k| 0.9 * value(k + 11)).collect(),
            },
            extra: Vec::new(),
            extra_channels: 0,
        }
    }

    #[test]
    fn up_is_up_in_both_frames() {
        let base = y_up_from_world(Axes::Base);
        assert_eq!(base.point(DVec3::Z), DVec3::Y);
        assert_eq!(base.point(DVec3::Y), DVec3::NEG_Z);
        let recon = y_up_from_world(Axes::Recon);
        assert_eq!(recon.point(DVec3::NEG_Y), DVec3::Y);
        assert_eq!(recon.point(DVec3::Z), DVec3::NEG_Z);
        for pose in [base, recon] {
            assert!((pose.rotation.determinant() - 1.0).abs() < 1e-15);
        }
    }

    #[test]
    fn what_cannot_be_written_is_found() {
        let mut gaussians = scene(4, 1);
        assert_eq!(whole(&gaussians), [true; 4]);
        gaussians.means[4] = f32::NAN;
        gaussians.scales[6] = 0.0;
        assert_eq!(whole(&gaussians), [true, false, false, true]);
        let error = Splats::new(&gaussians, LengthUnit::Metre).unwrap_err();
        assert!(error.to_string().contains("Gaussian 1"), "{error}");
    }
}
