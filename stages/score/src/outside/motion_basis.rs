//! Gaussians moved by shared rigid motions: the fields of Shape of Motion (`docs/spec/baseline-som.md` section 5).

use glam::{DMat3, DVec3, Vec3};
use rogs_arrays::{ANY, Array, ArrayFile};
use rogs_geometry::{quaternion, quaternion_product, wxyz_f32};
use rogs_splat::{Colour, Gaussians};

use crate::outside::{OutsideError, expect};

/// Raw parameters as the checkpoint has them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MotionBasisParts {
    /// Bases.
    pub bases: usize,
    /// Frames.
    pub frames: usize,
    /// Rotations of the bases, two columns each. `[K, T, 6]`
    pub rotations: Vec<f32>,
    /// Translations of the bases, metres. `[K, T, 3]`
    pub translations: Vec<f32>,
    /// Logits of the foreground's mixture. `[G, K]`
    pub coefficients: Vec<f32>,
    /// Foreground, then background: canonical centres, metres. `[G + B, 3]`
    pub means: Vec<f32>,
    /// Canonical rotations (w, x, y, z), any length. `[G + B, 4]`
    pub quats: Vec<f32>,
    /// Logarithms of the standard deviations. `[G + B, 3]`
    pub scales: Vec<f32>,
    /// Logits of the opacities. `[G + B]`
    pub opacities: Vec<f32>,
    /// Logits of the colours. `[G + B, 3]`
    pub colours: Vec<f32>,
}

impl MotionBasisParts {
    /// Reads a checkpoint's tensors by their names in Shape of Motion (`fg.params.means`, `motion_bases.params.rots`, ...),
    /// with or without `model.` before them. The background may be missing.
    ///
    /// # Errors
    /// When a tensor is missing or has the wrong shape.
    pub fn read(file: &ArrayFile) -> Result<Self, OutsideError> {
        let find = |name: &str| file.find(&[name, &format!("model.{name}")]);
        let need = |name: &str| file.need(&[name, &format!("model.{name}")]);
        let both = |part: &str| -> Result<Vec<f32>, OutsideError> {
            let mut values = need(&format!("fg.params.{part}"))?.into_floats();
            let background = find(&format!("bg.params.{part}"))?;
            values.extend(background.map(Array::into_floats).unwrap_or_default());
            Ok(values)
        };
        let rotations = need("motion_bases.params.rots")?;
        rotations.expect_shape(file.path(), &[&[ANY, ANY, 6]])?;
        Ok(Self {
            bases: rotations.shape[0],
            frames: rotations.shape[1],
            rotations: rotations.into_floats(),
            translations: need("motion_bases.params.transls")?.into_floats(),
            coefficients: need("fg.params.motion_coefs")?.into_floats(),
            means: both("means")?,
            quats: both("quats")?,
            scales: both("scales")?,
            opacities: both("opacities")?,
            colours: both("colors")?,
        })
    }
}

/// A field with its mixture weights.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionBasisField {
    parts: MotionBasisParts,
    /// `[G, K]`
    weights: Vec<f32>,
}

impl MotionBasisField {
    /// Checks the arrays and computes the mixture weights.
    ///
    /// # Errors
    /// When the arrays contradict each other.
    pub fn new(parts: MotionBasisParts) -> Result<Self, OutsideError> {
        let n = parts.opacities.len();
        expect(
            "rotations",
            parts.rotations.len(),
            parts.bases.saturating_mul(parts.frames).saturating_mul(6),
        )?;
        expect(
            "translations",
            parts.translations.len(),
            parts.bases.saturating_mul(parts.frames).saturating_mul(3),
        )?;
        let foreground = parts.coefficients.len() / parts.bases.max(1);
        expect(
            "coefficients",
            parts.coefficients.len(),
            foreground.min(n) * parts.bases,
        )?;
        expect("means", parts.means.len(), 3 * n)?;
        expect("quats", parts.quats.len(), 4 * n)?;
        expect("scales", parts.scales.len(), 3 * n)?;
        expect("colours", parts.colours.len(), 3 * n)?;
        let mut weights = parts.coefficients.clone();
        for row in weights.chunks_exact_mut(parts.bases.max(1)) {
            let largest = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            row.iter_mut().for_each(|value| *value = libm::expf(*value - largest));
            let total: f32 = row.iter().sum();
            row.iter_mut().for_each(|value| *value /= total);
        }
        Ok(Self { parts, weights })
    }

    /// Number of Gaussians, foreground and background.
    #[must_use]
    pub fn len(&self) -> usize {
        self.parts.opacities.len()
    }

    /// True when there is no Gaussian.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of foreground Gaussians; the others do not move.
    #[must_use]
    pub fn foreground(&self) -> usize {
        self.weights.len().checked_div(self.parts.bases).unwrap_or(0)
    }

    /// All Gaussians at a frame, metres; foreground first.
    ///
    /// # Errors
    /// When the field has no such frame.
    pub fn at(&self, frame: usize) -> Result<Gaussians, OutsideError> {
        let parts = &self.parts;
        if frame >= parts.frames {
            return Err(OutsideError::NoFrame {
                frame,
                frames: parts.frames,
            });
        }
        let mut out = Gaussians::empty();
        for index in 0..self.len() {
            let mean: [f32; 3] = std::array::from_fn(|axis| parts.means[index * 3 + axis]);
            let quat = normalised([0, 1, 2, 3].map(|part| parts.quats[index * 4 + part]));
            if index < self.foreground() {
                let (rotation, translation) = self.motion(index, frame);
                let moved = rotation * Vec3::from(mean).as_dvec3() + translation;
                out.means.extend(moved.as_vec3().to_array());
                let turn = wxyz_f32(quaternion(&rotation));
                out.quats.extend(normalised(quaternion_product(turn, quat)));
            } else {
                out.means.extend(mean);
                out.quats.extend(quat);
            }
        }
        out.scales = parts.scales.iter().map(|&value| libm::expf(value)).collect();
        out.opacities = parts.opacities.iter().map(|&value| sigmoid(value)).collect();
        out.colour = Colour::Rgb(parts.colours.iter().map(|&value| sigmoid(value)).collect());
        Ok(out)
    }

    /// Displacement of every Gaussian between two frames, metres. `[N, 3]`
    ///
    /// # Errors
    /// When the field has no such frame.
    pub fn displacement_m(&self, from: usize, to: usize) -> Result<Vec<f32>, OutsideError> {
        let (from, to) = (self.at(from)?, self.at(to)?);
        Ok(to.means.iter().zip(&from.means).map(|(to, from)| to - from).collect())
    }

    /// The rigid motion of a foreground Gaussian: rotation and translation. The six numbers are mixed before they
    /// are made orthonormal.
    fn motion(&self, index: usize, frame: usize) -> (DMat3, DVec3) {
        let parts = &self.parts;
        let weights = &self.weights[index * parts.bases..(index + 1) * parts.bases];
        let mixed = |values: &[f32], width: usize, at: usize| -> f64 {
            let of = |basis: usize| f64::from(values[(basis * parts.frames + frame) * width + at]);
            weights
                .iter()
                .enumerate()
                .map(|(basis, &weight)| f64::from(weight) * of(basis))
                .sum()
        };
        let six: [f64; 6] = std::array::from_fn(|at| mixed(&parts.rotations, 6, at));
        let x = DVec3::new(six[0], six[1], six[2]).normalize_or_zero();
        let second = DVec3::new(six[3], six[4], six[5]);
        let y = (second - x * second.dot(x)).normalize_or_zero();
        let translation = std::array::from_fn(|at| mixed(&parts.translations, 3, at));
        (DMat3::from_cols(x, y, x.cross(y)), DVec3::from_array(translation))
    }
}

fn normalised(quat: [f32; 4]) -> [f32; 4] {
    let length = quat.iter().map(|value| value * value).sum::<f32>().sqrt().max(1e-12);
    quat.map(|value| value / length)
}

fn sigmoid(value: f32) -> f32 {
    1.0 / (1.0 + libm::expf(-value))
}
