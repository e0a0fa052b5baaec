//! Robots (URDF) and the meshes of their links.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use crate::cases::{Cases, altered};

#[test]
fn robots_and_their_meshes() {
    let cases = Cases::new();
    let workspace = &cases.workspace;
    workspace.write("joints.csv", "j\n0.1\n");
    let link = |name: &str, shape: &str| {
        format!("<link name=\"{name}\"><collision><geometry>{shape}</geometry></collision></link>")
    };
    let joint = |name: &str, parent: &str, child: &str, more: &str| {
        format!(
            "<joint name=\"{name}\" type=\"revolute\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
             <axis xyz=\"0 0 1\"/><limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/>{more}</joint>"
        )
    };
    let robot = |inside: &str| format!("<robot name=\"r\">{inside}</robot>");
    let ab = link("a", "<box size=\"1 1 1\"/>") + &link("b", "<box size=\"1 1 1\"/>");
    let good = robot(&(ab.clone() + &joint("j", "a", "b", "")));
    let said = |text: &str| {
        workspace.write("bad.urdf", text);
        let output = workspace.rogs(&["fk", "bad.urdf", "--joints", "joints.csv"]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!said.contains("panicked"), "{said}");
        (output.status.code(), said)
    };
    assert_eq!(said(&good).0, Some(0));
    let laughs: String = (0..9)
        .map(|n| format!("<!ENTITY l{n} \"&l{0};&l{0};\">", n + 1))
        .collect();
    for (text, words) in [
        (format!("<!DOCTYPE r [{laughs}]>{good}"), "document type"),
        ("<a>".repeat(5000), "nested"),
        (
            good.replacen("<robot ", &format!("<robot {}", "a='1' ".repeat(60)), 1),
            "attributes",
        ),
        (" ".repeat((4 << 20) + 1), "larger"),
        (
            robot(&(ab.clone() + &joint("j", "a", "b", "") + &joint("k", "b", "a", ""))),
            "cycle",
        ),
        (
            robot(&(ab.clone() + &ab + &joint("j", "a", "b", ""))),
            "two links are called `a`",
        ),
        (
            robot(&(ab.clone() + &joint("j", "a", "b", "<mimic joint=\"j\"/>"))),
            "mimics itself",
        ),
        (good.replace("lower=\"-1\"", "lower=\"2\""), "reversed"),
        (
            robot(
                &(ab.clone()
                    + &link("c", "<box size=\"1 1 1\"/>")
                    + &joint("j", "a", "b", "<mimic joint=\"k\"/>")
                    + &joint("k", "b", "c", "<mimic joint=\"j\"/>")),
            ),
            "mimics itself through other joints",
        ),
        (
            good.replace("<link name=\"a\">", "<link name=\"a\" name=\"b\">"),
            "bad.urdf",
        ),
        ("robot".to_owned(), "bad.urdf"),
    ] {
        let (code, said) = said(&text);
        assert_eq!(code, Some(2), "{words}: {said}");
        assert!(said.contains(words), "{words}: {said}");
    }

    // Masses are not what this program computes with: one below zero changes nothing.
    let heavy = good.replace(
        "<collision>",
        "<inertial><mass value=\"-1\"/><inertia ixx=\"0\" ixy=\"0\" ixz=\"0\" iyy=\"0\" iyz=\"0\" izz=\"0\"/></inertial><collision>",
    );
    assert_eq!(said(&heavy).0, Some(0));

    // Meshes, through a run: the robot's own file with one mesh replaced.
    let urdf = std::fs::read_to_string(workspace.path("data/robot/panda_synth.urdf")).unwrap();
    let mesh = urdf
        .split("filename=\"")
        .nth(1)
        .and_then(|rest| rest.split('"').next())
        .unwrap()
        .to_owned();
    let with_mesh = |reference: &str| {
        workspace.write(
            "data/robot/bad.urdf",
            &urdf.replacen(&format!("\"{mesh}\""), &format!("\"{reference}\""), 1),
        );
        let (code, text) = altered(workspace, "panda_synth.urdf", "bad.urdf");
        assert_eq!(code, Some(1), "{reference}: {text}");
        text
    };
    workspace.write("secret.stl", "solid");
    for reference in [
        "package://../../etc/passwd",
        "../../secret.stl",
        "/etc/passwd",
        "https://example.org/a.stl",
        "missing.stl",
    ] {
        let text = with_mesh(reference);
        assert!(
            text.contains(reference.rsplit('/').next().unwrap()) && text.contains("failed: "),
            "{text}"
        );
    }
    let put = |name: &str, bytes: &[u8]| std::fs::write(workspace.path("data/robot/meshes").join(name), bytes).unwrap();
    let mut stl = vec![0_u8; 84 + 50];
    stl[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    put("count.stl", &stl);
    assert!(with_mesh("meshes/count.stl").contains("count.stl"));
    put("index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n");
    assert!(with_mesh("meshes/index.obj").contains("index.obj"));
    put("nan.obj", b"v 0 nan 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    assert!(with_mesh("meshes/nan.obj").contains("nan.obj"));
    let gltf = r#"{"asset":{"version":"2.0"},"buffers":[{"uri":"../../../secret.stl","byteLength":36}],
        "bufferViews":[{"buffer":0,"byteLength":36}],"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3",
        "min":[0,0,0],"max":[1,1,1]}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"nodes":[{"mesh":0}],
        "scenes":[{"nodes":[0]}],"scene":0}"#;
    put("out.gltf", gltf.as_bytes());
    assert!(with_mesh("meshes/out.gltf").contains("out.gltf"));
    let bomb = gltf
        .replace("../../../secret.stl", "data:application/octet-stream;base64,AAAA")
        .replace("36", "4000000000");
    put("bomb.gltf", bomb.as_bytes());
    assert!(with_mesh("meshes/bomb.gltf").contains("bomb.gltf"));
    let laughing = format!("<!DOCTYPE r [{laughs}]><COLLADA>&l0;</COLLADA>");
    put("laughing.dae", laughing.as_bytes());
    assert!(with_mesh("meshes/laughing.dae").contains("laughing.dae"));
    // An archive is not unpacked.
    put("archive.3mf", b"PK\x03\x04");
    assert!(with_mesh("meshes/archive.3mf").contains("archive.3mf"));
    put("cut.glb", b"glTF\x02\0\0\0\xff\xff\xff\xff");
    assert!(with_mesh("meshes/cut.glb").contains("cut.glb"));
}
