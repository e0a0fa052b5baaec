//! Mistakes that calibrations and states are known for, in words.

use std::fmt;

/// What is probably wrong.
#[derive(Debug, Clone, PartialEq)]
pub enum Mistake {
    /// The pose is base-to-camera where camera-to-base is meant.
    InvertedPose,
    /// The pose belongs to another camera of the clip.
    SwappedWith {
        /// Its name.
        camera: String,
    },
    /// The images are those of the other eye of a stereo pair.
    OtherEye {
        /// How far the images' eye stands to the right of the given one, metres.
        right_m: f64,
    },
    /// A camera that stands elsewhere by an amount that none of the others explains.
    WrongPose {
        /// Distance, metres.
        gone_m: f64,
        /// Angle, radians.
        turned: f64,
    },
    /// The same for a camera on the hand.
    WrongHandEye {
        /// Distance, metres.
        gone_m: f64,
        /// Angle, radians.
        turned: f64,
    },
    /// The camera on the hand moves against the hand during the clip.
    WristDrift,
    /// The camera stands still in the calibration and moves in the images.
    CameraMoved,
    /// Images and states are apart in time.
    TimeOffset {
        /// The states of frame f + `frames` belong to image f.
        frames: f64,
    },
    /// The intrinsics belong to images of another size.
    UnscaledIntrinsics {
        /// Width of those images, pixels.
        width: f64,
    },
    /// x and y of the intrinsics are swapped.
    TransposedIntrinsics,
    /// The focal length is off by this factor.
    FocalLength {
        /// True one over the given one.
        factor: f64,
    },
    /// The lens distorts and the calibration does not say so.
    Distortion {
        /// Radial coefficient: `1 + k1 r^2`.
        k1: f64,
    },
    /// The gripper state is 1 where open and 0 where closed.
    GripperSense,
    /// The gripper's range is another one.
    GripperRange {
        /// Gripper states in the images over the given ones.
        factor: f64,
    },
    /// Joints are in another order.
    JointOrder {
        /// In words: which ones.
        order: String,
    },
    /// Joint values have another unit.
    JointUnit {
        /// In words.
        unit: &'static str,
    },
    /// A joint turns the other way.
    JointSign {
        /// Its name.
        joint: String,
    },
    /// Images are mirrored, left for right.
    Mirrored,
    /// Images are upside down.
    UpsideDown,
}

impl Mistake {
    /// A short name for tables and scripts.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::InvertedPose => "inverted-pose",
            Self::SwappedWith { .. } => "swapped-cameras",
            Self::OtherEye { .. } => "other-eye",
            Self::WrongPose { .. } => "wrong-pose",
            Self::WrongHandEye { .. } => "wrong-hand-eye",
            Self::WristDrift => "wrist-drift",
            Self::CameraMoved => "camera-moved",
            Self::TimeOffset { .. } => "time-offset",
            Self::UnscaledIntrinsics { .. } => "unscaled-intrinsics",
            Self::TransposedIntrinsics => "transposed-intrinsics",
            Self::FocalLength { .. } => "focal-length",
            Self::Distortion { .. } => "distortion",
            Self::GripperSense => "gripper-sense",
            Self::GripperRange { .. } => "gripper-range",
            Self::JointOrder { .. } => "joint-order",
            Self::JointUnit { .. } => "joint-unit",
            Self::JointSign { .. } => "joint-sign",
            Self::Mirrored => "mirrored-image",
            Self::UpsideDown => "image-upside-down",
        }
    }

    /// Whether it concerns the robot's states and so every camera.
    #[must_use]
    pub fn is_of_states(&self) -> bool {
        matches!(
            self,
            Self::TimeOffset { .. }
                | Self::GripperSense
                | Self::GripperRange { .. }
                | Self::JointOrder { .. }
                | Self::JointUnit { .. }
                | Self::JointSign { .. }
        )
    }
}

impl Mistake {
    /// Whether it concerns how joint values are read.
    pub(super) fn is_of_joints(&self) -> bool {
        matches!(
            self,
            Self::JointOrder { .. } | Self::JointUnit { .. } | Self::JointSign { .. }
        )
    }
}

impl fmt::Display for Mistake {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::InvertedPose => f.write_str("its pose is inverted: give camera-to-base"),
            Self::SwappedWith { camera } => write!(f, "its pose is that of camera `{camera}`: swap them"),
            Self::OtherEye { right_m } => {
                let eye = if *right_m > 0.0 { "right" } else { "left" };
                write!(
                    f,
                    "its images are those of the {eye} eye, {:.0} mm away",
                    1000.0 * right_m.abs()
                )
            }
            Self::WrongPose { gone_m, turned } | Self::WrongHandEye { gone_m, turned } => {
                let what = if matches!(self, Self::WrongPose { .. }) {
                    "pose"
                } else {
                    "hand-eye pose"
                };
                let (cm, degrees) = (100.0 * gone_m, turned.to_degrees());
                write!(
                    f,
                    "its {what} is off by about {cm:.1} cm and {degrees:.1} degrees: calibrate it again"
                )
            }
            Self::WristDrift => f.write_str("it moves against the hand during the clip"),
            Self::CameraMoved => f.write_str("it was moved during the clip"),
            Self::TimeOffset { frames } => {
                let order = if *frames > 0.0 { "before" } else { "after" };
                write!(f, "states are recorded {:.1} frames {order} the images", frames.abs())
            }
            Self::UnscaledIntrinsics { width } => {
                write!(
                    f,
                    "its intrinsics are those of images {width:.0} pixels wide: scale them"
                )
            }
            Self::TransposedIntrinsics => f.write_str("x and y of its intrinsics are swapped"),
            Self::FocalLength { factor } => write!(f, "its focal length should be {factor:.2} times what is given"),
            Self::Distortion { k1 } => write!(f, "its lens distorts (k1 about {k1:.2}): undistort the images"),
            Self::GripperSense => f.write_str("the gripper state runs the other way: 0 is open, 1 closed"),
            Self::GripperRange { factor } => write!(f, "gripper states should be {factor:.2} times what is given"),
            Self::JointOrder { order } => write!(f, "joints are in another order: {order}"),
            Self::JointUnit { unit } => write!(f, "joint values have another unit: {unit}"),
            Self::JointSign { joint } => write!(f, "joint `{joint}` turns the other way"),
            Self::Mirrored => f.write_str("its images are mirrored, left for right"),
            Self::UpsideDown => f.write_str("its images are upside down"),
        }
    }
}
