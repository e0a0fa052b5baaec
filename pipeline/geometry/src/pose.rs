//! Typed rigid transforms.

use std::fmt;
use std::marker::PhantomData;
use std::ops::Mul;

use glam::{DMat3, DQuat, DVec3};
use rogs_schemas::units::LengthUnit;
use rogs_schemas::{RigidPose, WrittenPose};

use crate::error::{Error, Result};
use crate::rotation::{quaternion, rotation_from_euler_xyz};

/// A coordinate frame, as a type.
pub trait Frame: Copy + PartialEq + fmt::Debug {
    /// Name for messages.
    const NAME: &'static str;
}

macro_rules! frames {
    ($($(#[$doc:meta])* $name:ident = $text:literal;)*) => {
        $($(#[$doc])* #[derive(Debug, Clone, Copy, PartialEq, Eq)] pub enum $name {}
        impl Frame for $name { const NAME: &'static str = $text; })*
    };
}

frames! {
    /// The robot base.
    Base = "base";
    /// A camera, OpenCV axes: x right, y down, z forward.
    Camera = "camera";
    /// The reconstruction frame: the wrist camera at the first source time, fixed for the clip.
    Recon = "recon";
    /// A link of the robot.
    Link = "link";
}

/// A rigid transform `a_from_b`: maps points given in frame `B` to frame `A`, `p_a = R p_b + t`. The translation is in
/// metres, or in the unit that the name of the value gives (`recon_from_base_iu`: internal units).
pub struct Pose<A, B> {
    /// R.
    pub rotation: DMat3,
    /// t, metres unless the value's name gives another unit.
    pub translation: DVec3,
    frames: PhantomData<fn() -> (A, B)>,
}

/// Largest entry of `R^T R - I` that still counts as a rotation: matrices printed with four digits pass, scaled or
/// sheared ones do not.
pub const RIGIDITY_TOLERANCE: f64 = 1e-3;

impl<A: Frame, B: Frame> Pose<A, B> {
    /// The transform that changes nothing.
    pub const IDENTITY: Self = Self {
        rotation: DMat3::IDENTITY,
        translation: DVec3::ZERO,
        frames: PhantomData,
    };

    /// From a rotation matrix and a translation in metres, as they are.
    #[must_use]
    pub const fn new(rotation: DMat3, translation: DVec3) -> Self {
        Self {
            rotation,
            translation,
            frames: PhantomData,
        }
    }

    /// A translation without a rotation, metres.
    #[must_use]
    pub const fn from_translation(translation: DVec3) -> Self {
        Self::new(DMat3::IDENTITY, translation)
    }

    /// From `[x, y, z]` metres and the Euler angles `[a, b, c]` of the DROID logs: rotations about the FIXED axes x, y,
    /// z in this order, `R = Rz(c) Ry(b) Rx(a)` (`docs/spec/data.md` section 0). URDF `rpy` is the same convention.
    #[must_use]
    pub fn from_xyz_euler(xyz: [f64; 3], euler_xyz: [f64; 3]) -> Self {
        Self::new(rotation_from_euler_xyz(euler_xyz), DVec3::from_array(xyz))
    }

    /// From numbers on disk.
    ///
    /// # Errors
    /// When an entry is not finite or the matrix is not a rotation (within [`RIGIDITY_TOLERANCE`]).
    pub fn from_rigid(pose: &RigidPose) -> Result<Self> {
        let [a, b, c, d, e, f, g, h, i] = pose.rotation;
        let result = Self::new(
            DMat3::from_cols(DVec3::new(a, d, g), DVec3::new(b, e, h), DVec3::new(c, f, i)),
            DVec3::from_array(pose.translation),
        );
        result.check_rigid()?;
        Ok(result)
    }

    /// From a row-major 4x4 matrix. A last row that rounding has left within 1e-6 of `0 0 0 1` is taken as that.
    ///
    /// # Errors
    /// As [`Pose::from_rigid`]; also when the last row is another.
    pub fn from_matrix4(matrix: &[f64; 16]) -> Result<Self> {
        let last = [matrix[12], matrix[13], matrix[14], matrix[15] - 1.0];
        if !last.iter().all(|entry| entry.abs() <= 1e-6) {
            return Err(Error::NotRigid {
                what: format!("the last row is {:?}, not 0 0 0 1", &matrix[12..]),
            });
        }
        let m = matrix;
        Self::from_rigid(&RigidPose {
            rotation: [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]],
            translation: [m[3], m[7], m[11]],
        })
    }

    /// From any form in which poses are written. Rotations with few digits are made orthonormal.
    ///
    /// # Errors
    /// As [`Pose::from_matrix4`]; also when a quaternion has not the length 1 (within [`RIGIDITY_TOLERANCE`]).
    pub fn from_written(written: &WrittenPose) -> Result<Self> {
        let pose = match written {
            WrittenPose::Matrix(rows) => Self::from_matrix4(&std::array::from_fn(|index| rows[index / 4][index % 4]))?,
            WrittenPose::Euler([x, y, z, a, b, c]) => Self::from_xyz_euler([*x, *y, *z], [*a, *b, *c]),
            WrittenPose::Quaternion(translation, xyzw) => {
                let quaternion = DQuat::from_array(*xyzw);
                let length = quaternion.length();
                if !length.is_finite() || (length - 1.0).abs() > RIGIDITY_TOLERANCE {
                    return Err(Error::NotRigid {
                        what: format!("the quaternion has the length {length}, not 1"),
                    });
                }
                Self::new(
                    DMat3::from_quat(quaternion.normalize()),
                    DVec3::from_array(*translation),
                )
            }
        };
        pose.check_rigid()?;
        let exact = pose.rigidity_residual() < 1e-9;
        Ok(if exact { pose } else { pose.orthonormalized() })
    }

    /// The numbers for disk.
    #[must_use]
    pub fn to_rigid(&self) -> RigidPose {
        let [x, y, z] = [self.rotation.x_axis, self.rotation.y_axis, self.rotation.z_axis];
        RigidPose {
            rotation: [x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z],
            translation: self.translation.to_array(),
        }
    }

    /// The row-major 4x4 matrix.
    #[must_use]
    pub fn to_matrix4(&self) -> [f64; 16] {
        let RigidPose {
            rotation: r,
            translation: t,
        } = self.to_rigid();
        [
            r[0], r[1], r[2], t[0], r[3], r[4], r[5], t[1], r[6], r[7], r[8], t[2], 0.0, 0.0, 0.0, 1.0,
        ]
    }

    /// The pose at `share` of the way to another one: 0 here, 1 there. The translation goes straight, the rotation about one
    /// axis.
    #[must_use]
    pub fn towards(&self, other: &Self, share: f64) -> Self {
        let rotation = DMat3::from_quat(self.quaternion().slerp(other.quaternion(), share));
        Self::new(rotation, self.translation.lerp(other.translation, share))
    }

    /// `b_from_a`. Exact for an exact rotation: the transpose is used.
    #[must_use]
    pub fn inverse(&self) -> Pose<B, A> {
        let transposed = self.rotation.transpose();
        Pose::new(transposed, -(transposed * self.translation))
    }

    /// `c_from_b`, given where frame `C` stands in `A`. As `frame.inverse() * self`, but from the difference of the two
    /// positions, so that nothing is lost when both are far from the origin of `A`.
    #[must_use]
    pub fn seen_from<C: Frame>(&self, frame: &Pose<A, C>) -> Pose<C, B> {
        let turned = frame.rotation.transpose();
        Pose::new(turned * self.rotation, turned * (self.translation - frame.translation))
    }

    /// The same transform of lengths in another unit than metres.
    #[must_use]
    pub fn in_unit(&self, unit: LengthUnit) -> Self {
        Self::new(self.rotation, self.translation * unit.per_metre())
    }

    /// A point of frame `B` in frame `A`.
    #[must_use]
    pub fn point(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// A direction of frame `B` in frame `A`.
    #[must_use]
    pub fn direction(&self, direction: DVec3) -> DVec3 {
        self.rotation * direction
    }

    /// The rotation as a unit quaternion with non-negative real part.
    #[must_use]
    pub fn quaternion(&self) -> DQuat {
        quaternion(&self.rotation)
    }

    /// The nearest transform whose rotation is orthonormal to machine precision. For calibrations printed with few
    /// digits.
    #[must_use]
    pub fn orthonormalized(&self) -> Self {
        // Newton's iteration for the polar factor, R <- (R + R^-T) / 2; quadratic near a rotation.
        let mut rotation = self.rotation;
        for _ in 0..6 {
            rotation = (rotation + rotation.inverse().transpose()) * 0.5;
        }
        Self::new(rotation, self.translation)
    }

    /// Says what the frames are when the types cannot know, for example two poses of different links.
    #[must_use]
    pub fn relabelled<C, D>(&self) -> Pose<C, D> {
        Pose {
            rotation: self.rotation,
            translation: self.translation,
            frames: PhantomData,
        }
    }

    /// Largest entry of `R^T R - I`.
    #[must_use]
    pub fn rigidity_residual(&self) -> f64 {
        let residual = self.rotation.transpose() * self.rotation - DMat3::IDENTITY;
        residual
            .to_cols_array()
            .into_iter()
            .fold(0.0, |worst: f64, entry| worst.max(entry.abs()))
    }

    /// Checks that this is a rigid transform.
    ///
    /// # Errors
    /// When an entry is not finite, the rotation is not orthonormal, or it is a reflection.
    pub fn check_rigid(&self) -> Result<()> {
        let name = format!("{}_from_{}", A::NAME, B::NAME);
        if !self.rotation.is_finite() || !self.translation.is_finite() {
            return Err(Error::NotRigid {
                what: format!("{name} has an entry that is not finite"),
            });
        }
        let residual = self.rigidity_residual();
        if residual > RIGIDITY_TOLERANCE {
            let what = format!(
                "{name}: R^T R differs from the identity by {residual:.2e} (scale, shear or wrong order of numbers)"
            );
            return Err(Error::NotRigid { what });
        }
        if self.rotation.determinant() < 0.0 {
            return Err(Error::NotRigid {
                what: format!("{name} is a reflection (determinant -1)"),
            });
        }
        Ok(())
    }
}

impl<A, B, C> Mul<Pose<B, C>> for Pose<A, B> {
    type Output = Pose<A, C>;

    fn mul(self, other: Pose<B, C>) -> Pose<A, C> {
        Pose {
            rotation: self.rotation * other.rotation,
            translation: self.rotation * other.translation + self.translation,
            frames: PhantomData,
        }
    }
}

impl<A, B> Clone for Pose<A, B> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<A, B> Copy for Pose<A, B> {}

impl<A, B> PartialEq for Pose<A, B> {
    fn eq(&self, other: &Self) -> bool {
        self.rotation == other.rotation && self.translation == other.translation
    }
}

impl<A: Frame, B: Frame> fmt::Debug for Pose<A, B> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = format!("{}_from_{}", A::NAME, B::NAME);
        f.debug_struct(&name)
            .field("rotation", &self.rotation)
            .field("translation", &self.translation)
            .finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Pose<Base, Link> {
        Pose::from_xyz_euler([0.1, -0.2, 0.3], [0.4, -0.5, 2.6])
    }

    #[test]
    fn inverse_and_disk_round_trip() {
        let pose = example();
        let identity: Pose<Base, Base> = pose * pose.inverse();
        assert!(
            (identity.rotation - DMat3::IDENTITY)
                .to_cols_array()
                .iter()
                .all(|e| e.abs() < 1e-15)
        );
        assert!(identity.translation.length() < 1e-15);
        assert_eq!(Pose::<Base, Link>::from_rigid(&pose.to_rigid()).unwrap(), pose);
        assert_eq!(Pose::<Base, Link>::from_matrix4(&pose.to_matrix4()).unwrap(), pose);
    }

    #[test]
    fn every_written_form_gives_the_same_pose() {
        let expected = Pose::<Base, Camera>::from_xyz_euler([0.1, 0.2, 0.3], [0.4, -0.5, 0.6]);
        let matrix = expected.to_matrix4();
        let rows = |matrix: &[f64; 16]| {
            WrittenPose::Matrix(std::array::from_fn(|row| {
                std::array::from_fn(|column| matrix[4 * row + column])
            }))
        };
        let quaternion = expected.quaternion().to_array();
        let rounded = matrix.map(|entry| (entry * 1e6).round() / 1e6);
        let mut uncleaned = matrix;
        uncleaned[12] = 1e-8;
        uncleaned[15] = 1.0 + 1e-8;
        for (written, tolerance) in [
            (rows(&matrix), 1e-12),
            (rows(&rounded), 2e-6),
            (rows(&uncleaned), 1e-12),
            (WrittenPose::Euler([0.1, 0.2, 0.3, 0.4, -0.5, 0.6]), 1e-12),
            (WrittenPose::Quaternion([0.1, 0.2, 0.3], quaternion), 1e-12),
            (
                WrittenPose::Quaternion([0.1, 0.2, 0.3], quaternion.map(|part| (part * 1e6).round() / 1e6)),
                2e-6,
            ),
        ] {
            let found = Pose::<Base, Camera>::from_written(&written).unwrap();
            let far = found
                .to_matrix4()
                .iter()
                .zip(&matrix)
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f64::max);
            assert!(
                far <= tolerance && found.rigidity_residual() < 1e-9,
                "{written:?}: {far}"
            );
        }
        for written in [
            WrittenPose::Quaternion([0.0; 3], [0.0; 4]),
            WrittenPose::Quaternion([0.0; 3], [0.0, 0.0, 0.0, 2.0]),
            WrittenPose::Quaternion([0.0; 3], [f64::NAN, 0.0, 0.0, 1.0]),
            WrittenPose::Euler([f64::INFINITY, 0.0, 0.0, 0.0, 0.0, 0.0]),
        ] {
            assert!(Pose::<Base, Camera>::from_written(&written).is_err(), "{written:?}");
        }
    }

    #[test]
    fn what_is_not_rigid_is_refused() {
        let good = example().to_rigid();
        let scaled = RigidPose {
            rotation: good.rotation.map(|entry| entry * 1.01),
            ..good
        };
        assert!(
            Pose::<Base, Link>::from_rigid(&scaled)
                .unwrap_err()
                .to_string()
                .contains("base_from_link")
        );
        let mut mirrored = good;
        for entry in &mut mirrored.rotation[..3] {
            *entry = -*entry;
        }
        assert!(
            Pose::<Base, Link>::from_rigid(&mirrored)
                .unwrap_err()
                .to_string()
                .contains("reflection")
        );
        let broken = RigidPose {
            translation: [f64::NAN, 0.0, 0.0],
            ..good
        };
        assert!(
            Pose::<Base, Link>::from_rigid(&broken)
                .unwrap_err()
                .to_string()
                .contains("finite")
        );
        let mut matrix = example().to_matrix4();
        matrix[12] = 1e-8;
        matrix[15] = 1.0 - 1e-7;
        assert!(Pose::<Base, Link>::from_matrix4(&matrix).is_ok());
        matrix[12] = 1.0;
        assert!(
            Pose::<Base, Link>::from_matrix4(&matrix)
                .unwrap_err()
                .to_string()
                .contains("last row")
        );
    }

    #[test]
    fn a_matrix_with_few_digits_becomes_orthonormal() {
        let mut rigid = example().to_rigid();
        rigid.rotation = rigid.rotation.map(|entry| (entry * 1e4).round() / 1e4);
        let pose = Pose::<Base, Link>::from_rigid(&rigid).unwrap();
        assert!(pose.rigidity_residual() > 1e-6);
        assert!(pose.orthonormalized().rigidity_residual() < 1e-15);
        assert!(
            (pose.orthonormalized().rotation - example().rotation)
                .to_cols_array()
                .iter()
                .all(|e| e.abs() < 1e-4)
        );
    }

    #[test]
    fn a_frame_seen_from_another_is_what_inversion_and_composition_give() {
        let recon_from_base: Pose<Recon, Base> = Pose::from_xyz_euler([10.0, -20.0, 5.0], [1.1, 0.3, -2.0]);
        let recon_from_link: Pose<Recon, Link> = recon_from_base * example();
        let seen = recon_from_link.seen_from(&recon_from_base);
        assert!((seen.rotation - example().rotation).abs_diff_eq(DMat3::ZERO, 1e-15));
        assert!((seen.translation - example().translation).length() < 1e-14);
        assert_eq!(recon_from_base.seen_from(&recon_from_base).translation, DVec3::ZERO);
    }

    #[test]
    fn units_scale_the_translation_alone() {
        let (metres, internal) = (example(), example().in_unit(LengthUnit::Internal));
        assert_eq!(metres.in_unit(LengthUnit::Metre), metres);
        assert_eq!(internal.rotation, metres.rotation);
        assert_eq!(
            internal.translation,
            metres.translation * LengthUnit::Internal.per_metre()
        );
    }
}
