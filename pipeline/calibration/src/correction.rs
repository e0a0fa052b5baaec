//! What is solved for: the unknowns of one camera (`docs/spec/calibration.md` section 1).

use glam::{DMat3, DVec2, DVec3};
use rogs_geometry::{Camera, Pinhole, Pose, rotation_about_axis};
use rogs_schemas::Intrinsics;

/// Number of unknowns.
pub const UNKNOWNS: usize = 10;
/// One number an unknown: turn (3, radians), shift (3, metres), focal length (natural logarithm of a factor), principal
/// point (2, shares of image width and height), time lag (frames).
pub type Vector = [f64; UNKNOWNS];

/// Place of the focal length in a [`Vector`].
pub(crate) const FOCAL: usize = 6;
/// Place of the principal point in a [`Vector`].
pub(crate) const PRINCIPAL: usize = 7;
/// Place of the time lag in a [`Vector`].
pub(crate) const LAG: usize = 9;

/// How a camera differs from the given one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    /// The camera as the given one sees it.
    pub moved: Pose<Camera, Camera>,
    /// Natural logarithm of the factor on both focal lengths.
    pub focal: f64,
    /// Shift of the principal point, shares of image width and height.
    pub principal: DVec2,
    /// States of time `f + lag` belong to image `f`, frames.
    pub lag_frames: f64,
}

impl Correction {
    /// The given camera itself.
    pub const NONE: Self = Self {
        moved: Pose::IDENTITY,
        focal: 0.0,
        principal: DVec2::ZERO,
        lag_frames: 0.0,
    };

    /// The numbers: the turn as a rotation vector.
    #[must_use]
    pub fn vector(&self) -> Vector {
        let turn = self.moved.quaternion().to_scaled_axis();
        let shift = self.moved.translation;
        let DVec2 { x, y } = self.principal;
        [
            turn.x,
            turn.y,
            turn.z,
            shift.x,
            shift.y,
            shift.z,
            self.focal,
            x,
            y,
            self.lag_frames,
        ]
    }

    /// After a step: the camera turns and goes in its own frame as it stands now.
    #[must_use]
    pub fn stepped(&self, step: &Vector) -> Self {
        let [a, b, c, d, e, f, focal, x, y, lag] = *step;
        let turn = DVec3::new(a, b, c);
        Self {
            moved: self.moved * Pose::new(turned(turn), DVec3::new(d, e, f)),
            focal: self.focal + focal,
            principal: self.principal + DVec2::new(x, y),
            lag_frames: self.lag_frames + lag,
        }
    }

    /// The lens with this correction.
    #[must_use]
    pub fn lens(&self, given: &Pinhole) -> Pinhole {
        let Intrinsics { fx, fy, cx, cy } = given.intrinsics;
        let factor = libm::exp(self.focal);
        Pinhole {
            intrinsics: Intrinsics {
                fx: fx * factor,
                fy: fy * factor,
                cx: cx + self.principal.x * f64::from(given.width),
                cy: cy + self.principal.y * f64::from(given.height),
            },
            ..*given
        }
    }

    /// How far it has gone, metres, and turned, radians.
    #[must_use]
    pub fn gone_and_turned(&self) -> [f64; 2] {
        let turn = self.moved.quaternion().to_scaled_axis();
        [self.moved.translation.length(), turn.length()]
    }
}

/// The rotation of a rotation vector, radians.
fn turned(vector: DVec3) -> DMat3 {
    let angle = vector.length();
    if angle < 1e-12 {
        DMat3::IDENTITY
    } else {
        rotation_about_axis(vector / angle, angle)
    }
}

/// Which unknowns are free, and how far each is likely to be off: standard deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Turn about any axis, radians.
    pub turn: f64,
    /// Shift along any axis, metres.
    pub shift_m: f64,
    /// Focal length, a share of it; `None`: as given.
    pub focal: Option<f64>,
    /// Principal point, a share of the image's sides; `None`: as given.
    pub principal: Option<f64>,
    /// Time lag, frames; `None`: none.
    pub lag_frames: Option<f64>,
}

impl Prior {
    /// A pose that may be off by some 10 degrees and 10 cm; lens and clock as given.
    pub const POSE: Self = Self {
        turn: 0.15,
        shift_m: 0.1,
        focal: None,
        principal: None,
        lag_frames: None,
    };

    /// A pose of which nothing is known.
    pub const NOTHING: Self = Self {
        turn: 10.0,
        shift_m: 10.0,
        ..Self::POSE
    };

    /// A hand-eye pose of another rig of the same build: some 3 degrees and 1 cm off. Along a path, a delay of a tenth of a
    /// frame between images and states is as good as a turn of the camera, so that it is solved for.
    pub const HAND_EYE: Self = Self {
        turn: 0.06,
        shift_m: 0.01,
        lag_frames: Some(0.2),
        ..Self::POSE
    };

    /// Standard deviation by unknown; `None`: not free.
    pub(crate) fn sigmas(&self) -> [Option<f64>; UNKNOWNS] {
        let (turn, shift) = (Some(self.turn), Some(self.shift_m));
        let principal = self.principal;
        [
            turn,
            turn,
            turn,
            shift,
            shift,
            shift,
            self.focal,
            principal,
            principal,
            self.lag_frames,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_add_up_and_the_vector_gives_them_back() {
        let step = [0.02, -0.03, 0.01, 0.1, 0.2, -0.3, 0.05, 0.01, -0.02, 0.7];
        let once = Correction::NONE.stepped(&step);
        for (found, expected) in once.vector().iter().zip(step) {
            assert!((found - expected).abs() < 1e-12, "{:?}", once.vector());
        }
        let back = once.stepped(&step.map(|value| -value));
        // The shift is made in the turned frame, so that only the turn and the plain numbers come back.
        let vector = back.vector();
        assert!([0, 1, 2, 6, 7, 8, 9].iter().all(|&i| vector[i].abs() < 1e-12));
        let lens = Pinhole::centred(100.0, 200, 100);
        let found = once.lens(&lens).intrinsics;
        assert!((found.fx - 100.0 * f64::exp(0.05)).abs() < 1e-9);
        assert!((found.cx - 102.0).abs() < 1e-9 && (found.cy - 48.0).abs() < 1e-9);
    }
}
