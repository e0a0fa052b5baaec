//! Transforms that also change lengths.

use glam::{DMat3, DVec3};

use crate::pose::{Frame, Pose};

/// A similarity `a_from_b`: `p_a = scale R p_b + t`, scaled about the origin of frame `B`, then carried to frame `A`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity<A: Frame, B: Frame> {
    /// `R` and `t`, the translation in the unit of frame `A`.
    pub rigid: Pose<A, B>,
    /// Units of frame `A` per unit of frame `B`.
    pub scale: f64,
}

impl<A: Frame, B: Frame> Similarity<A, B> {
    /// A point of frame `B` in frame `A`.
    #[must_use]
    pub fn point(&self, point: DVec3) -> DVec3 {
        self.vector(point) + self.rigid.translation
    }

    /// `scale R`: differences of points of frame `B` in frame `A`, as one matrix.
    #[must_use]
    pub fn linear(&self) -> DMat3 {
        self.rigid.rotation * self.scale
    }

    /// A difference of points of frame `B` in frame `A`.
    #[must_use]
    pub fn vector(&self, vector: DVec3) -> DVec3 {
        self.rigid.rotation * vector * self.scale
    }
}

/// Lengths stay as they are.
impl<A: Frame, B: Frame> From<Pose<A, B>> for Similarity<A, B> {
    fn from(rigid: Pose<A, B>) -> Self {
        Self { rigid, scale: 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::{Base, Camera};

    #[test]
    fn points_are_scaled_turned_and_moved_and_differences_are_not_moved() {
        let rigid: Pose<Base, Camera> = Pose::from_xyz_euler([1.0, 2.0, 3.0], [0.0, 0.0, std::f64::consts::FRAC_PI_2]);
        let similarity = Similarity { rigid, scale: 2.0 };
        assert!((similarity.vector(DVec3::X) - DVec3::Y * 2.0).length() < 1e-15);
        assert!((similarity.linear() * DVec3::X - DVec3::Y * 2.0).length() < 1e-15);
        assert!((similarity.point(DVec3::X) - DVec3::new(1.0, 4.0, 3.0)).length() < 1e-15);
    }
}
