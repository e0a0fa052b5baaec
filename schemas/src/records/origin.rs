//! Where references come from: what a score is measured against decides what it says.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// What made a reference. Tables name it beside every number, so that nobody takes one for another.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize, schemars::JsonSchema,
)]
#[serde(rename_all = "kebab-case")]
pub enum ReferenceOrigin {
    /// The episode does not say.
    #[default]
    NotStated,
    /// Known without error, from a renderer.
    Exact,
    /// A depth camera, or a stereo camera's own program.
    DepthCamera,
    /// The cache of FoundationStereo, a learned stereo network; the paper's depth references.
    FoundationStereo,
    /// Classical stereo matching of a pair of images (`docs/spec/references.md` section 1).
    ClassicalStereo,
    /// A learned point tracker, lifted by depth.
    PointTracker,
    /// Forward kinematics of points on the robot's mesh (`docs/spec/references.md` section 2).
    Kinematics,
}

impl ReferenceOrigin {
    /// Every origin.
    pub const ALL: [Self; 7] = [
        Self::NotStated,
        Self::Exact,
        Self::DepthCamera,
        Self::FoundationStereo,
        Self::ClassicalStereo,
        Self::PointTracker,
        Self::Kinematics,
    ];

    /// Its name in files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::NotStated => "not-stated",
            Self::Exact => "exact",
            Self::DepthCamera => "depth-camera",
            Self::FoundationStereo => "foundation-stereo",
            Self::ClassicalStereo => "classical-stereo",
            Self::PointTracker => "point-tracker",
            Self::Kinematics => "kinematics",
        }
    }

    /// What tables and reports call it.
    #[must_use]
    pub const fn label(self) -> &'static str {
        match self {
            Self::NotStated => "origin not stated",
            Self::Exact => "exact",
            Self::DepthCamera => "depth camera",
            Self::FoundationStereo => "FoundationStereo cache",
            Self::ClassicalStereo => "classical stereo",
            Self::PointTracker => "point tracker",
            Self::Kinematics => "kinematics",
        }
    }
}

impl fmt::Display for ReferenceOrigin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for ReferenceOrigin {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|origin| origin.name() == text);
        found.ok_or_else(|| {
            format!(
                "unknown origin `{text}` of a reference, expected one of {}",
                Self::ALL.map(Self::name).join(", ")
            )
        })
    }
}

/// What a reference is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum ReferenceKind {
    /// Depth of one camera.
    Depth,
    /// 3D tracks.
    Tracks,
}

/// A reference that a clip was scored against.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ReferenceUse {
    /// Depth or tracks.
    pub kind: ReferenceKind,
    /// Camera id; empty for tracks.
    pub camera: String,
    /// What made it.
    pub origin: ReferenceOrigin,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_back_and_are_those_of_json() {
        for origin in ReferenceOrigin::ALL {
            assert_eq!(origin.name().parse(), Ok(origin));
            assert_eq!(serde_json::json!(origin), origin.name());
        }
        let error = "lidar".parse::<ReferenceOrigin>().unwrap_err();
        assert!(
            error.contains("`lidar`") && error.contains("classical-stereo"),
            "{error}"
        );
    }
}
