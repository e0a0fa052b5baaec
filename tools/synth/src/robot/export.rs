//! The robot model on disk: URDF, one binary glTF a link, and the spec for `robot-maps`.

use std::fmt::Write as _;
use std::path::Path;

use serde_json::json;

use super::{ARM_LIMITS, FINGER_CLOSED, Link, Motion, Robot};
use crate::error::{Error, Result};
use crate::mesh::TriMesh;
use crate::scene::default_robot_colours;

/// Name of the URDF inside the robot's folder.
pub const ROBOT_URDF_FILE: &str = "panda_synth.urdf";

/// Name of the [`rogs_schemas::records::robot::RobotSpec`] inside the robot's folder.
pub const ROBOT_SPEC_FILE: &str = "spec.json";

const VELOCITY: [f64; 7] = [2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61];

/// Writes `panda_synth.urdf`, `meshes/LINK.glb` and `spec.json` into `folder`.
///
/// # Errors
/// When a file cannot be written.
pub fn write_robot(robot: &Robot, folder: &Path) -> Result<()> {
    let meshes = folder.join("meshes");
    std::fs::create_dir_all(&meshes).map_err(|source| Error::io(&meshes, source))?;
    for link in &robot.links {
        rogs_files::write_bytes(&meshes.join(format!("{}.glb", link.name)), &glb(&link.mesh, link.name)?)?;
    }
    rogs_files::write_bytes(&folder.join(ROBOT_URDF_FILE), urdf(robot).as_bytes())?;
    let mut spec = serde_json::to_string_pretty(&robot.spec()).map_err(Error::json)?;
    spec.push('\n');
    rogs_files::write_bytes(&folder.join(ROBOT_SPEC_FILE), spec.as_bytes())?;
    Ok(())
}

fn urdf(robot: &Robot) -> String {
    let mut text = String::from("<?xml version=\"1.0\"?>\n<robot name=\"panda_synth\">\n");
    for (index, link) in robot.links.iter().enumerate() {
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "  <link name=\"{0}\">\n    <visual>\n      <geometry>\n        <mesh filename=\"meshes/{0}.glb\"/>\n      \
             </geometry>\n    </visual>\n  </link>\n",
            link.name
        );
        if index > 0 {
            joint(&mut text, robot, link);
        }
    }
    text.push_str("</robot>\n");
    text
}

fn joint(text: &mut String, robot: &Robot, link: &Link) {
    let kind = if link.motion == Motion::Fixed {
        "fixed"
    } else {
        "revolute"
    };
    let ([x, y, z], [roll, pitch, yaw]) = (link.xyz.to_array(), link.rpy);
    let _ = write!(
        text,
        "  <joint name=\"{}\" type=\"{kind}\">\n    <origin xyz=\"{x} {y} {z}\" rpy=\"{roll} {pitch} {yaw}\"/>\n    \
         <parent link=\"{}\"/>\n    <child link=\"{}\"/>\n",
        link.joint, robot.links[link.parent].name, link.name
    );
    let [ax, ay, az] = link.axis.to_array();
    let (lower, upper, velocity) = match link.motion {
        Motion::Fixed => {
            text.push_str("  </joint>\n");
            return;
        }
        Motion::Arm(index) => (ARM_LIMITS[index][0], ARM_LIMITS[index][1], VELOCITY[index]),
        Motion::Finger(multiplier) if multiplier > 0.0 => (0.0, FINGER_CLOSED, 2.0),
        Motion::Finger(_) => (-FINGER_CLOSED, 0.0, 2.0),
    };
    let _ = write!(
        text,
        "    <axis xyz=\"{ax} {ay} {az}\"/>\n    <limit lower=\"{lower}\" upper=\"{upper}\" effort=\"50\" \
         velocity=\"{velocity}\"/>\n"
    );
    match link.motion {
        Motion::Finger(multiplier) if link.joint != "finger_joint" => {
            let _ = writeln!(
                text,
                "    <mimic joint=\"finger_joint\" multiplier=\"{multiplier}\" offset=\"0\"/>"
            );
        }
        _ => {}
    }
    text.push_str("  </joint>\n");
}

/// One mesh as binary glTF 2.0, one primitive a material, in the link's own frame (no change of axes).
fn glb(mesh: &TriMesh, name: &str) -> Result<Vec<u8>> {
    let mut used: Vec<u8> = mesh.materials.clone();
    used.sort_unstable();
    used.dedup();
    let mut binary = Vec::new();
    for p in mesh.positions.iter().chain(&mesh.normals) {
        binary.extend(p.to_array().into_iter().flat_map(f32::to_le_bytes));
    }
    let vertex_bytes = 12 * mesh.positions.len();
    let low = mesh
        .positions
        .iter()
        .copied()
        .fold(glam::Vec3::INFINITY, glam::Vec3::min);
    let high = mesh
        .positions
        .iter()
        .copied()
        .fold(glam::Vec3::NEG_INFINITY, glam::Vec3::max);
    let count = mesh.positions.len();
    let mut views = vec![
        json!({"buffer": 0, "byteOffset": 0, "byteLength": vertex_bytes, "target": 34962}),
        json!({"buffer": 0, "byteOffset": vertex_bytes, "byteLength": vertex_bytes, "target": 34962}),
    ];
    let mut accessors = vec![
        json!({"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3",
            "min": low.to_array(), "max": high.to_array()}),
        json!({"bufferView": 1, "componentType": 5126, "count": count, "type": "VEC3"}),
    ];
    let mut primitives = Vec::new();
    let mut materials = Vec::new();
    let colours = default_robot_colours();
    for (slot, material) in used.into_iter().enumerate() {
        let offset = binary.len();
        let of_material = mesh
            .triangles
            .iter()
            .zip(&mesh.materials)
            .filter(|&(_, &m)| m == material);
        let mut corners = 0;
        for (triangle, _) in of_material {
            binary.extend(triangle.iter().flat_map(|v| v.to_le_bytes()));
            corners += 3;
        }
        views.push(json!({"buffer": 0, "byteOffset": offset, "byteLength": 4 * corners, "target": 34963}));
        accessors.push(json!({"bufferView": 2 + slot, "componentType": 5125, "count": corners, "type": "SCALAR"}));
        primitives.push(json!({"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2 + slot, "material": slot}));
        let [r, g, b] = colours[material as usize];
        materials.push(json!({"pbrMetallicRoughness":
            {"baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.6}}));
    }
    let document = json!({
        "asset": {"version": "2.0", "generator": "rogs-synth"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name}],
        "meshes": [{"name": name, "primitives": primitives}],
        "materials": materials,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": binary.len()}],
    });
    let mut text = serde_json::to_vec(&document).map_err(Error::json)?;
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + text.len() + 8 + binary.len();
    let mut bytes = Vec::with_capacity(total);
    bytes.extend(b"glTF");
    bytes.extend(2u32.to_le_bytes());
    bytes.extend((total as u32).to_le_bytes());
    bytes.extend((text.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(&text);
    bytes.extend((binary.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(&binary);
    Ok(bytes)
}
