//! A robot as a tree of links and joints.

mod fk;
mod folder;
pub(crate) mod guard;
mod known;
mod load;
mod urdf;
pub(crate) mod xml;

use std::path::{Path, PathBuf};

use glam::DVec3;
use rogs_geometry::{Link, Pose};
use rogs_schemas::ids::suggestion;

pub use fk::{JointState, LimitExcess};
pub(crate) use folder::read_capped;
pub use rogs_robot_files::RobotFolder;

use crate::error::{Error, Result};

/// A robot description that was read and checked: one root, no cycles, unique names, finite numbers, mimic joints resolved
/// to the joint that drives them. Floating and planar joints are held at their origins.
#[derive(Debug, Clone)]
pub struct RobotModel {
    /// Name in the file.
    pub name: String,
    /// Path of the URDF file.
    pub path: PathBuf,
    /// Where its meshes lie.
    pub folder: RobotFolder,
    /// What the file says and nothing here uses, or what it leaves open, one line each: warnings for people.
    pub notes: Vec<String>,
    /// Links in the order of the file; a link id is an index into this list. At most 255.
    pub links: Vec<RobotLink>,
    /// Joints, every parent before its children.
    pub joints: Vec<Joint>,
    root_link: usize,
    base_link: usize,
}

/// A link with its geometry.
#[derive(Debug, Clone)]
pub struct RobotLink {
    /// Name, unique.
    pub name: String,
    /// What it looks like.
    pub visual: Vec<Shape>,
    /// What it collides with.
    pub collision: Vec<Shape>,
}

/// A piece of geometry of a link.
#[derive(Debug, Clone)]
pub struct Shape {
    /// The shape's frame in the link's frame.
    pub link_from_shape: Pose<Link, Link>,
    /// What it is.
    pub geometry: Geometry,
}

/// The geometries of URDF.
#[derive(Debug, Clone, PartialEq)]
pub enum Geometry {
    /// A box centred at the origin; full side lengths, metres.
    Box {
        /// Lengths along x, y, z.
        size: [f64; 3],
    },
    /// A cylinder around z, centred at the origin, metres.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Length along z.
        length: f64,
    },
    /// A cylinder around z with half a sphere at each end, centred at the origin, metres.
    Capsule {
        /// Radius of the cylinder and of the half spheres.
        radius: f64,
        /// Length of the cylinder along z, without the half spheres.
        length: f64,
    },
    /// A sphere centred at the origin, metres.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// A mesh file.
    Mesh {
        /// The reference as written.
        reference: String,
        /// Factors along x, y, z.
        scale: [f64; 3],
    },
}

/// A joint: the frame of its child link is `parent_from_origin * motion(value)`.
#[derive(Debug, Clone)]
pub struct Joint {
    /// Name, unique.
    pub name: String,
    /// How it moves.
    pub kind: JointKind,
    /// Link id of the parent.
    pub parent: usize,
    /// Link id of the child.
    pub child: usize,
    /// Pose of the joint at value 0 in the parent link.
    pub parent_from_origin: Pose<Link, Link>,
    /// Unit axis in the joint's frame.
    pub axis: DVec3,
    /// Lower and upper limit, radians or metres; one of them may be infinite. `None` where the file gives none, and for
    /// fixed and continuous joints.
    pub limits: Option<[f64; 2]>,
    /// The joint that drives this one.
    pub mimic: Option<Mimic>,
}

/// How a joint moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Not at all.
    Fixed,
    /// About its axis, radians.
    Rotational,
    /// Along its axis, metres.
    Linear,
}

/// `value = multiplier * value of driver + offset`; chains of mimic joints are already multiplied out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mimic {
    /// Index of the driving joint, which mimics nothing.
    pub driver: usize,
    /// Factor.
    pub multiplier: f64,
    /// Summand.
    pub offset: f64,
}

impl RobotModel {
    /// Reads a URDF file. Nothing is executed, nothing but the file is read; meshes follow when they are asked for.
    ///
    /// # Errors
    /// When the file cannot be read, exceeds the limits (4 MiB, depth, attributes), is not a URDF, or describes no tree of
    /// links: cycles, several roots, duplicate or unknown names, reversed limits, numbers that are not finite.
    pub fn load(path: &Path) -> Result<Self> {
        load::load(path)
    }

    /// The same model with all poses relative to `base_link` instead of the root link.
    ///
    /// # Errors
    /// When there is no such link.
    pub fn with_base_link(self, base_link: &str) -> Result<Self> {
        let base_link = self.link_id(base_link)?;
        Ok(Self { base_link, ..self })
    }

    /// Link id of the root of the tree.
    #[must_use]
    pub fn root_link(&self) -> usize {
        self.root_link
    }

    /// Link id of the link all poses refer to.
    #[must_use]
    pub fn base_link(&self) -> usize {
        self.base_link
    }

    /// Names of all links by link id.
    #[must_use]
    pub fn link_names(&self) -> Vec<String> {
        self.links.iter().map(|link| link.name.clone()).collect()
    }

    /// The id of a link.
    ///
    /// # Errors
    /// When there is no such link; the message suggests one.
    pub fn link_id(&self, name: &str) -> Result<usize> {
        let known = || self.links.iter().map(|link| link.name.as_str());
        known()
            .position(|candidate| candidate == name)
            .ok_or_else(|| Error::Unknown {
                kind: "link",
                name: name.to_owned(),
                suggestion: suggestion(name, known()),
            })
    }

    /// The index of a joint.
    ///
    /// # Errors
    /// When there is no such joint; the message suggests one.
    pub fn joint_index(&self, name: &str) -> Result<usize> {
        let known = |joint: &Joint| joint.name == name;
        self.joints.iter().position(known).ok_or_else(|| {
            let movable = self.joints.iter().filter(|joint| joint.kind != JointKind::Fixed);
            let suggestion = suggestion(name, movable.map(|joint| joint.name.as_str()));
            Error::Unknown {
                kind: "joint",
                name: name.to_owned(),
                suggestion,
            }
        })
    }

    /// Indices of the joints that can be set: movable and driven by nothing else.
    pub fn driven_joints(&self) -> impl Iterator<Item = usize> + '_ {
        let driven = |joint: &Joint| joint.kind != JointKind::Fixed && joint.mimic.is_none();
        self.joints
            .iter()
            .enumerate()
            .filter(move |(_, joint)| driven(joint))
            .map(|(index, _)| index)
    }
}
