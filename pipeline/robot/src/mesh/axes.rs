//! Which way is up in a mesh file: what robot viewers do, in one place for every format.
//!
//! COLLADA says its up axis, glTF is y up by its standard (glTF 2.0 specification, section 3.4). RViz and the programs that
//! read meshes with Assimp as it does, Gazebo, SAPIEN and the three.js URDF loader leave both aside: the numbers, after the
//! transforms of the file's nodes, are those of the link's frame. Robots are checked in these viewers, so their files are
//! right by that rule, whatever the tag says. Units are another matter: all of them honour the unit of COLLADA.

use glam::{DMat3, DVec3};
use rogs_schemas::records::robot::MeshAxes;

/// The axis that a file calls up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Up {
    /// It does not say; the standard means y.
    Unsaid,
    X,
    Y,
    Z,
}

/// The rotation from a file's axes to the link's, and what a person should hear of it.
pub(super) fn turn(axes: MeshAxes, up: Up) -> (DMat3, Option<String>) {
    match (axes, up) {
        (MeshAxes::Viewers, Up::X | Up::Y) => {
            let note = format!(
                "its up_axis {up:?}_UP is left aside, as robot viewers do (`mesh_axes = \"standard\"` turns the mesh)"
            );
            (DMat3::IDENTITY, Some(note))
        }
        (MeshAxes::Viewers, Up::Unsaid | Up::Z) | (MeshAxes::Standard, Up::Z) => (DMat3::IDENTITY, None),
        (MeshAxes::Standard, Up::Y | Up::Unsaid) => (DMat3::from_cols(DVec3::X, DVec3::Z, -DVec3::Y), None),
        (MeshAxes::Standard, Up::X) => (DMat3::from_cols(DVec3::Z, DVec3::Y, -DVec3::X), None),
    }
}
