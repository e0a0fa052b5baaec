//! Fields of baselines for the players: the same Gaussians at every time, in the reconstruction frame, metres.

use rogs_field::polynomial::{centres_m, state_at};
use rogs_geometry::{Base, Pose, Recon, Similarity};
use rogs_schemas::FrameIndex;
use rogs_schemas::records::motion_bases::MotionBasisField;
use rogs_schemas::records::polynomial::Polynomials;
use rogs_score::outside::{BasisField, OutsideError, merge};
use rogs_splat::{Colour, Gaussians};

/// Most Gaussians of a scene; of a field with more the most opaque ones.
const MOST_GAUSSIANS: usize = 1_000_000;

/// The field of Shape of Motion: those of its cameras together.
pub(crate) struct MotionBasisScene {
    cameras: Vec<BasisField>,
    recon_from_base: Similarity<Recon, Base>,
}

impl MotionBasisScene {
    /// A field in its frame.
    ///
    /// # Errors
    /// When the arrays of a camera contradict each other.
    pub(crate) fn new(field: MotionBasisField, recon_from_base: Pose<Recon, Base>) -> Result<Self, OutsideError> {
        let cameras = field.cameras.into_iter();
        let cameras = cameras.map(|(_, own)| BasisField::new(own).map_err(OutsideError::Contradiction));
        Ok(Self {
            cameras: cameras.collect::<Result<_, _>>()?,
            recon_from_base: recon_from_base.into(),
        })
    }

    /// All Gaussians at a clip frame.
    ///
    /// # Errors
    /// When the field has no such frame.
    pub(crate) fn at(&self, frame: FrameIndex) -> Result<Gaussians, OutsideError> {
        let cameras = self.cameras.iter().map(|own| own.at(frame.at()));
        let cameras: Vec<Gaussians> = cameras.collect::<Result<_, _>>()?;
        let all = merge(&cameras);
        let all = all.ok_or_else(|| OutsideError::Contradiction("the cameras' fields do not fit together".into()))?;
        Ok(all.moved(&self.recon_from_base))
    }
}

/// The field of 4DGT.
pub(crate) struct PolynomialScene {
    field: Polynomials,
    /// Clip frames per second.
    fps: f64,
    /// Gaussians that are shown, ascending.
    shown: Vec<u32>,
    recon_from_base: Similarity<Recon, Base>,
}

impl PolynomialScene {
    /// A field of a clip with so many frames a second, in its frame.
    pub(crate) fn new(field: Polynomials, fps: f64, recon_from_base: Pose<Recon, Base>) -> Self {
        let mut shown: Vec<u32> = (0..field.len() as u32).collect();
        if shown.len() > MOST_GAUSSIANS {
            let opacity = |index: &u32| field.opacity[*index as usize];
            shown.sort_by(|a, b| opacity(b).total_cmp(&opacity(a)));
            shown.truncate(MOST_GAUSSIANS);
            shown.sort_unstable();
        }
        Self {
            field,
            fps,
            shown,
            recon_from_base: recon_from_base.into(),
        }
    }

    /// The Gaussians that are shown at a clip frame; those that are not rendered there are transparent.
    pub(crate) fn at(&self, frame: FrameIndex) -> Gaussians {
        let seconds = (f64::from(frame.0) / self.fps) as f32;
        let state = state_at(&self.field, seconds);
        let centres = centres_m(&self.field, seconds);
        let rgb = state.gaussians.colour.values();
        let mut out = Gaussians::empty();
        let mut colours = Vec::with_capacity(3 * self.shown.len());
        for &index in &self.shown {
            let at = index as usize;
            out.means.extend_from_slice(&centres[3 * at..3 * at + 3]);
            out.scales.extend_from_slice(&self.field.scale_m[3 * at..3 * at + 3]);
            match state.kept.binary_search(&index) {
                Ok(row) => {
                    out.quats
                        .extend_from_slice(&state.gaussians.quats[4 * row..4 * row + 4]);
                    out.opacities.push(state.gaussians.opacities[row]);
                    colours.extend_from_slice(&rgb[3 * row..3 * row + 3]);
                }
                Err(_) => {
                    out.quats.extend_from_slice(&self.field.rotation[4 * at..4 * at + 4]);
                    out.opacities.push(0.0);
                    colours.extend_from_slice(&self.field.rgb[3 * at..3 * at + 3]);
                }
            }
        }
        out.colour = Colour::Rgb(colours);
        out.moved(&self.recon_from_base)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    /// Two Gaussians, one of which is there at the beginning alone; both move along x.
    fn field() -> Polynomials {
        let mut velocity = vec![0.0; 24];
        (velocity[0], velocity[12]) = (1.0, 2.0);
        Polynomials {
            centre_m: vec![0.0, 0.0, 1.0, 0.5, 0.0, 2.0],
            time_s: vec![0.0, 0.0],
            variance_s2: vec![1e-4, 1e4],
            velocity,
            angular: vec![0.0; 12],
            rotation: [[1.0, 0.0, 0.0, 0.0]; 2].concat(),
            scale_m: vec![0.01; 6],
            opacity: vec![0.9, 0.8],
            rgb: vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
        }
    }

    #[test]
    fn a_gaussian_keeps_its_row_where_it_is_not_rendered() {
        let aside = Pose::from_translation(DVec3::new(0.0, 0.25, 0.0));
        let scene = PolynomialScene::new(field(), 10.0, aside);
        let (first, last) = (scene.at(FrameIndex(0)), scene.at(FrameIndex(5)));
        assert_eq!(first.means, [0.0, 0.25, 1.0, 0.5, 0.25, 2.0]);
        assert_eq!(last.means, [0.5, 0.25, 1.0, 1.5, 0.25, 2.0]);
        assert_eq!(first.opacities, [0.9, 0.8]);
        assert_eq!(last.opacities[0], 0.0);
        assert!((last.opacities[1] - 0.8).abs() < 1e-4);
        assert_eq!(first.colour, last.colour);
    }
}
