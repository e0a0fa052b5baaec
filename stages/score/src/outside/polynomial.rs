//! Gaussians that move along polynomials of time and fade in and out: the fields of 4DGT (`docs/spec/baseline-4dgt.md` section 8).

use rogs_arrays::ArrayFile;
use rogs_geometry::quaternion_product;
use rogs_splat::{Colour, Gaussians};

use crate::outside::{OutsideError, expect};

/// Temporal weight at or below which a Gaussian is not rendered.
const MIN_WEIGHT: f32 = 0.05;
/// Opacity at or below which a Gaussian is not rendered.
const MIN_OPACITY: f32 = 1e-4;

/// Activated parameters of a field, one row a Gaussian.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PolynomialField {
    /// Centres at their own times, metres. `[N, 3]`
    pub centre_m: Vec<f32>,
    /// Own times, seconds. `[N]`
    pub time_s: Vec<f32>,
    /// Temporal variances, square seconds. `[N]`
    pub variance_s2: Vec<f32>,
    /// Velocities of degree 1 to 4. `[N, 4, 3]`
    pub velocity: Vec<f32>,
    /// Angular velocities of degree 1 and 2, increments in the Gaussian's own frame. `[N, 2, 3]`
    pub angular: Vec<f32>,
    /// Rotations at their own times (w, x, y, z). `[N, 4]`
    pub rotation: Vec<f32>,
    /// Standard deviations, metres. `[N, 3]`
    pub scale_m: Vec<f32>,
    /// Opacities at their own times. `[N]`
    pub opacity: Vec<f32>,
    /// Colours. `[N, 3]`
    pub rgb: Vec<f32>,
}

/// The Gaussians of a field that are rendered at a time.
#[derive(Debug, Clone, PartialEq)]
pub struct PolynomialState {
    /// Their indices in the field, ascending.
    pub kept: Vec<u32>,
    /// Their state, metres.
    pub gaussians: Gaussians,
}

impl PolynomialField {
    /// Reads the activated parameters, by the names of the fields here or by those of 4DGT's own code (`xyz`, `t`, `cov_t`,
    /// `ms3`, `omega`, `rotation`, `scaling`, `opacity`, `feature`; of `feature` the first three channels).
    ///
    /// # Errors
    /// When an array is missing or has the wrong length.
    pub fn read(file: &ArrayFile) -> Result<Self, OutsideError> {
        let floats = |names: &[&str]| Ok::<_, OutsideError>(file.need(names)?.into_floats());
        let colours = file.need(&["rgb", "feature"])?;
        let rgb = match colours.shape.last() {
            Some(&width) if width > 3 => {
                let values = colours.into_colours();
                values
                    .chunks_exact(width)
                    .flat_map(|one| [one[0], one[1], one[2]])
                    .collect()
            }
            _ => colours.into_colours(),
        };
        let field = Self {
            centre_m: floats(&["centre_m", "xyz"])?,
            time_s: floats(&["time_s", "t"])?,
            variance_s2: floats(&["variance_s2", "cov_t"])?,
            velocity: floats(&["velocity", "ms3"])?,
            angular: floats(&["angular", "omega"])?,
            rotation: floats(&["rotation"])?,
            scale_m: floats(&["scale_m", "scaling"])?,
            opacity: floats(&["opacity"])?,
            rgb,
        };
        field.validate()?;
        Ok(field)
    }

    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True when there is no Gaussian.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Checks the lengths of all arrays.
    ///
    /// # Errors
    /// Names the first that is wrong.
    pub fn validate(&self) -> Result<(), OutsideError> {
        let n = self.len();
        expect("centre_m", self.centre_m.len(), 3 * n)?;
        expect("variance_s2", self.variance_s2.len(), n)?;
        expect("velocity", self.velocity.len(), 12 * n)?;
        expect("angular", self.angular.len(), 6 * n)?;
        expect("rotation", self.rotation.len(), 4 * n)?;
        expect("scale_m", self.scale_m.len(), 3 * n)?;
        expect("opacity", self.opacity.len(), n)?;
        expect("rgb", self.rgb.len(), 3 * n)
    }

    /// Centres of all Gaussians at a time in seconds, metres. `[N, 3]`
    ///
    /// # Errors
    /// When the arrays contradict each other.
    pub fn centres_m(&self, time_s: f32) -> Result<Vec<f32>, OutsideError> {
        self.validate()?;
        Ok((0..self.len()).flat_map(|index| self.centre(index, time_s)).collect())
    }

    /// Displacement of every Gaussian between two times, metres. `[N, 3]`
    ///
    /// # Errors
    /// When the arrays contradict each other.
    pub fn displacement_m(&self, from_s: f32, to_s: f32) -> Result<Vec<f32>, OutsideError> {
        let (from, to) = (self.centres_m(from_s)?, self.centres_m(to_s)?);
        Ok(to.iter().zip(&from).map(|(to, from)| to - from).collect())
    }

    /// The rendered Gaussians at a time in seconds.
    ///
    /// # Errors
    /// When the arrays contradict each other.
    pub fn at(&self, time_s: f32) -> Result<PolynomialState, OutsideError> {
        self.validate()?;
        let mut state = PolynomialState {
            kept: Vec::new(),
            gaussians: Gaussians::empty(),
        };
        let mut rgb = Vec::new();
        for index in 0..self.len() {
            let dt = time_s - self.time_s[index];
            let weight = libm::expf(-0.5 * dt * dt / self.variance_s2[index]);
            let opacity = self.opacity[index] * weight;
            if !(weight > MIN_WEIGHT && opacity > MIN_OPACITY) {
                continue;
            }
            let angular: [f32; 3] = std::array::from_fn(|axis| {
                self.angular[index * 6 + axis] * dt + self.angular[index * 6 + 3 + axis] * (dt * dt)
            });
            let own: [f32; 4] = std::array::from_fn(|part| self.rotation[index * 4 + part]);
            state.kept.push(index as u32);
            state.gaussians.means.extend(self.centre(index, time_s));
            state
                .gaussians
                .quats
                .extend(quaternion_product(own, quaternion_of_angle(angular)));
            state
                .gaussians
                .scales
                .extend_from_slice(&self.scale_m[index * 3..index * 3 + 3]);
            state.gaussians.opacities.push(opacity);
            rgb.extend_from_slice(&self.rgb[index * 3..index * 3 + 3]);
        }
        state.gaussians.colour = Colour::Rgb(rgb);
        Ok(state)
    }

    fn centre(&self, index: usize, time_s: f32) -> [f32; 3] {
        let dt = time_s - self.time_s[index];
        let powers = [dt, dt * dt, dt * dt * dt, dt * dt * dt * dt];
        std::array::from_fn(|axis| {
            let velocity = |degree: usize| self.velocity[index * 12 + degree * 3 + axis];
            let moved: f32 = powers
                .iter()
                .enumerate()
                .map(|(degree, power)| velocity(degree) * power)
                .sum();
            self.centre_m[index * 3 + axis] + moved
        })
    }
}

/// The quaternion (w, x, y, z) of a rotation vector, by its series where the angle is tiny. Not renormalised.
fn quaternion_of_angle(vector: [f32; 3]) -> [f32; 4] {
    let angle = vector.iter().map(|value| value * value).sum::<f32>().sqrt();
    let half = 0.5 * angle;
    let (real, sine) = if angle < 1e-6 {
        (1.0 - 0.5 * half * half, half - 0.5 * half * half * half)
    } else {
        (libm::cosf(half), libm::sinf(half))
    };
    let [x, y, z] = vector.map(|value| sine * (value / (angle + 1e-8)));
    [real, x, y, z]
}
