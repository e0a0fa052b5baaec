//! Meshes as robot viewers take them: axes and units of every format, and sizes that do not fit the robot.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::path::Path;

use rogs_robot::{Mesh, MeshFile, MeshScene, RobotModel};
use rogs_schemas::records::robot::{MeshAxes, RobotSpec};

/// The corners of a slanted triangle, metres.
const CORNERS: [[f32; 3]; 3] = [[0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.5]];

fn stl() -> String {
    let corners = CORNERS.map(|[x, y, z]| format!("vertex {x} {y} {z}\n")).concat();
    format!("solid a\nfacet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\nendsolid a\n")
}

fn dae(asset: &str, scale: f32) -> String {
    let numbers: Vec<String> = CORNERS
        .iter()
        .flatten()
        .map(|value| (value * scale).to_string())
        .collect();
    format!(
        r##"<COLLADA><asset>{asset}</asset><library_geometries><geometry id="g"><mesh>
        <source id="s"><float_array id="a" count="9">{}</float_array></source>
        <vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
        <triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh></geometry>
        </library_geometries><library_visual_scenes><visual_scene id="w"><node><instance_geometry url="#g"/></node>
        </visual_scene></library_visual_scenes><scene><instance_visual_scene url="#w"/></scene></COLLADA>"##,
        numbers.join(" ")
    )
}

fn read(ending: &str, text: &str, axes: MeshAxes) -> MeshFile {
    Mesh::parse(ending, text.as_bytes(), axes, &|_| Err("no other files".into())).unwrap()
}

fn near(mesh: &Mesh, expected: [[f32; 3]; 3]) -> bool {
    let places = mesh.positions.iter().flatten().zip(expected.iter().flatten());
    mesh.positions.len() == 3 && places.into_iter().all(|(a, b)| (a - b).abs() < 1e-6)
}

#[test]
fn the_same_numbers_are_the_same_mesh_whatever_axis_is_called_up() {
    let from_stl = read("stl", &stl(), MeshAxes::Viewers);
    let turned_y = CORNERS.map(|[x, y, z]| [x, -z, y]);
    let turned_x = CORNERS.map(|[x, y, z]| [-z, y, x]);
    let obj = "v 0.1 0 0\nv 0 0.2 0\nv 0 0 0.5\nf 1 2 3\n";
    assert_eq!(read("obj", obj, MeshAxes::Standard).mesh, from_stl.mesh);
    // Asset of the file, the numbers' unit, what the standard makes of it, and whether the viewers' rule is noted.
    for (asset, scale, standard, noted) in [
        ("<up_axis>Z_UP</up_axis>", 1.0, CORNERS, false),
        ("<up_axis>Y_UP</up_axis>", 1.0, turned_y, true),
        ("<up_axis>X_UP</up_axis>", 1.0, turned_x, true),
        ("", 1.0, turned_y, false),
        ("<unit meter=\"0.001\"/><up_axis>Z_UP</up_axis>", 1000.0, CORNERS, false),
        (
            "<unit meter=\"0.0254\"/><up_axis>Y_UP</up_axis>",
            1.0 / 0.0254,
            turned_y,
            true,
        ),
    ] {
        let text = dae(asset, scale);
        let viewers = read("dae", &text, MeshAxes::Viewers);
        assert!(near(&viewers.mesh, CORNERS), "{asset}: {:?}", viewers.mesh.positions);
        assert_eq!(
            viewers.notes.iter().any(|note| note.contains("mesh_axes")),
            noted,
            "{asset}: {:?}",
            viewers.notes
        );
        let letter = read("dae", &text, MeshAxes::Standard);
        assert!(near(&letter.mesh, standard), "{asset}: {:?}", letter.mesh.positions);
        assert!(letter.notes.is_empty());
    }
}

/// A robot of two links 0.5 m apart, with a mesh at the second.
fn robot(folder: &Path, scale: &str) -> RobotModel {
    let text = format!(
        r#"<robot name="r"><link name="base"/><link name="arm"><visual><geometry><mesh filename="m.stl" {scale}/></geometry></visual></link>
        <joint name="j" type="fixed"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.5"/></joint></robot>"#
    );
    std::fs::write(folder.join("robot.urdf"), text).unwrap();
    RobotModel::load(&folder.join("robot.urdf")).unwrap()
}

#[test]
fn meshes_out_of_proportion_are_told_with_the_likely_unit() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("m.stl"), stl()).unwrap();
    for (scale, words) in [
        ("", None),
        (r#"scale="0.5 0.5 0.5""#, None),
        (r#"scale="1000 1000 1000""#, Some("look like millimetres")),
        (r#"scale="0.001 0.001 0.001""#, Some("100 to 1000 times too small")),
    ] {
        let scene = MeshScene::of_robot(&robot(folder.path(), scale), &RobotSpec::default()).unwrap();
        match words {
            None => assert!(scene.notes.is_empty(), "{scale}: {:?}", scene.notes),
            Some(words) => assert!(
                scene.notes.len() == 1 && scene.notes[0].contains(words) && scene.notes[0].contains("`m.stl`"),
                "{scale}: {:?}",
                scene.notes
            ),
        }
    }
}

#[test]
fn what_a_mesh_file_says_of_its_axes_reaches_the_scene_once() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("m.stl"), stl()).unwrap();
    std::fs::write(folder.path().join("m.dae"), dae("<up_axis>Y_UP</up_axis>", 1.0)).unwrap();
    let text = std::fs::read_to_string({
        robot(folder.path(), "");
        folder.path().join("robot.urdf")
    })
    .unwrap();
    let visual = r#"<visual><geometry><mesh filename="m.dae"/></geometry></visual>"#;
    let text = text.replace("</link>\n", &format!("{visual}{visual}</link>\n"));
    std::fs::write(folder.path().join("robot.urdf"), text).unwrap();
    let model = RobotModel::load(&folder.path().join("robot.urdf")).unwrap();
    let scene = MeshScene::of_robot(&model, &RobotSpec::default()).unwrap();
    assert_eq!(scene.notes.len(), 1, "{:?}", scene.notes);
    assert!(scene.notes[0].contains("`m.dae`") && scene.notes[0].contains("Y_UP"));
}

#[test]
fn shapes_without_a_file_have_sizes_too() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("m.stl"), stl()).unwrap();
    robot(folder.path(), "");
    let path = folder.path().join("robot.urdf");
    let text = std::fs::read_to_string(&path).unwrap();
    for (shape, told) in [
        (r#"<box size="0.1 0.1 0.5"/>"#, None),
        (r#"<box size="100 100 500"/>"#, Some("millimetres")),
        (r#"<cylinder radius="40" length="300"/>"#, Some("millimetres")),
        (r#"<sphere radius="0.0001"/>"#, Some("too small")),
    ] {
        std::fs::write(&path, text.replace(r#"<mesh filename="m.stl" />"#, shape)).unwrap();
        let model = RobotModel::load(&path).unwrap();
        let scene = MeshScene::of_robot(&model, &RobotSpec::default()).unwrap();
        assert_eq!(
            scene.notes.len(),
            usize::from(told.is_some()),
            "{shape}: {:?}",
            scene.notes
        );
        let fits = |note: &String| note.contains("a shape of link `arm`") && note.contains(told.unwrap_or_default());
        assert!(scene.notes.iter().all(fits), "{shape}: {:?}", scene.notes);
    }
}

#[test]
fn capitals_do_not_matter() {
    let expected = read("stl", &stl(), MeshAxes::Viewers).mesh;
    assert_eq!(read("stl", &stl().to_uppercase(), MeshAxes::Viewers).mesh, expected);
    let lower = dae("<up_axis> y_up </up_axis>", 1.0);
    let file = read("dae", &lower, MeshAxes::Viewers);
    assert!(
        near(&file.mesh, CORNERS) && file.notes[0].contains("Y_UP"),
        "{:?}",
        file.notes
    );
}

/// The triangle as glTF, its numbers `corners`, below a node with this transform.
fn gltf(corners: [[f32; 3]; 3], node: &str, scenes: &str) -> String {
    use base64::Engine as _;
    let bytes: Vec<u8> = corners
        .as_flattened()
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    let data = base64::engine::general_purpose::STANDARD.encode(&bytes);
    format!(
        r#"{{"asset":{{"version":"2.0"}},{scenes}"nodes":[{{"children":[1]}},{{"mesh":0{node}}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,1]}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}}],
        "buffers":[{{"byteLength":36,"uri":"data:application/octet-stream;base64,{data}"}}]}}"#
    )
}

#[test]
fn gltf_is_taken_as_it_lies_after_its_nodes() {
    let y_up = CORNERS.map(|[x, y, z]| [x, z, -y]);
    let scene = r#""scene":0,"scenes":[{"nodes":[0]}],"#;
    for (corners, node, scenes) in [
        (CORNERS, "", scene),
        // As exporters turn a mesh that is y up: by a rotation or a matrix of its node.
        (y_up, r#","rotation":[0.70710678,0,0,0.70710678]"#, scene),
        (y_up, r#","matrix":[1,0,0,0, 0,0,1,0, 0,-1,0,0, 0,0,0,1]"#, scene),
        (
            CORNERS.map(|corner| corner.map(|value| value * 1000.0)),
            r#","scale":[0.001,0.001,0.001]"#,
            scene,
        ),
        // Scenes without a default, and a library of parts without any.
        (CORNERS, "", r#""scenes":[{"nodes":[0]}],"#),
        (CORNERS, "", ""),
    ] {
        let text = gltf(corners, node, scenes);
        let file = read("gltf", &text, MeshAxes::Viewers);
        assert!(near(&file.mesh, CORNERS), "{node} {scenes}: {:?}", file.mesh.positions);
        let turned = read("gltf", &text, MeshAxes::Standard);
        assert!(
            near(&turned.mesh, CORNERS.map(|[x, y, z]| [x, -z, y])),
            "{node} {scenes}"
        );
    }
}
