//! Readers of robots and meshes on random and damaged files: no panic, bounded memory, always a message.
//! More cases with `PROPTEST_CASES=100000`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use proptest::prelude::*;
use rogs_needs::{needs, shared};
use rogs_robot::{Mesh, RobotModel};
use rogs_schemas::records::robot::MeshAxes;

/// Counts live bytes, to see that no file makes a reader allocate much more than its size.
struct Counting;

static LIVE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

#[allow(unsafe_code, reason = "a counting allocator that hands everything on to the system's")]
// SAFETY: every call is handed on unchanged to the system allocator; the counters touch no memory of the caller.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let live = LIVE.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        PEAK.fetch_max(live, Ordering::Relaxed);
        // SAFETY: the caller's contract is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller's contract is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Most bytes that any reader may hold for the files of these tests (at most 128 KiB; one of 4 MiB is refused), over everything else alive.
const LIMIT: usize = 64 << 20;

/// Tests run side by side, but memory is counted for the whole process.
static ALONE: Mutex<()> = Mutex::new(());

fn bounded<T>(work: impl FnOnce() -> T) -> T {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let before = LIVE.load(Ordering::Relaxed);
    PEAK.store(before, Ordering::Relaxed);
    let result = work();
    let peak = PEAK.load(Ordering::Relaxed).saturating_sub(before);
    assert!(peak < LIMIT, "{peak} bytes");
    result
}

fn parse(ending: &str, bytes: &[u8]) -> Result<Mesh, String> {
    let others = |_: &str| Err("no other files".into());
    bounded(|| Mesh::parse(ending, bytes, MeshAxes::Viewers, &others)).map(|file| file.mesh)
}

/// A mesh that came through is usable as it is.
fn check(result: Result<Mesh, String>) {
    match result {
        Err(message) => assert!(!message.is_empty()),
        Ok(mesh) => {
            assert!(!mesh.triangles.is_empty());
            assert!(
                mesh.triangles
                    .iter()
                    .flatten()
                    .all(|&corner| (corner as usize) < mesh.positions.len())
            );
            assert!(mesh.positions.iter().flatten().all(|value| value.is_finite()));
        }
    }
}

fn load_robot(bytes: &[u8]) -> Result<RobotModel, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("robot.urdf");
    std::fs::write(&path, bytes).unwrap();
    bounded(|| RobotModel::load(&path).map_err(|error| error.chain()))
}

fn binary_stl() -> Vec<u8> {
    let mut bytes = vec![0u8; 80];
    bytes.extend(12u32.to_le_bytes());
    for value in 0..12 * 50 {
        bytes.push((value * 37 % 61) as u8);
    }
    bytes
}

const TEXT_STL: &str = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 1 2\nvertex 3 4 5\nvertex 6 7 8e-3\nendloop\nendfacet\nendsolid a\n";
const OBJ: &str = "o a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1e-3\nvn 0 0 1\nf 1/1/1 2//1 3 4\nf -1 -2 -3\n";
const DAE: &str = r##"<?xml version="1.0"?><COLLADA><asset><unit meter="0.01"/><up_axis>Z_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="12">0 0 0 1 0 0 1 1 0 0 1 0</float_array><technique_common><accessor source="#a" count="4" stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices><polylist count="1"><input semantic="VERTEX" source="#v" offset="0"/><vcount>4</vcount><p>0 1 2 3</p></polylist>
</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="w"><node><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</matrix><instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#w"/></scene></COLLADA>"##;
const GLTF: &str = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0,"translation":[0,0,1]}],
"meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]},{"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}],
"bufferViews":[{"buffer":0,"byteOffset":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":6}],
"buffers":[{"byteLength":42,"uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAAABAAIA"}]}"#;
const URDF: &str = r#"<?xml version="1.0"?><robot name="r"><link name="a"><visual><origin rpy="0 0 1" xyz="0 0 0"/><geometry><box size="1 1 1"/></geometry></visual></link>
<link name="b"><collision><geometry><mesh filename="m.stl" scale="1 1 1"/></geometry></collision></link><link name="c"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="k" type="prismatic"><parent link="b"/><child link="c"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/><mimic joint="j" multiplier="-1" offset="0.1"/></joint></robot>"#;

/// The same file in one piece, its triangle in a chunk of its own.
fn glb() -> Vec<u8> {
    let positions = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let corners = [0u16, 1, 2, 0];
    let data: Vec<u8> = (positions.iter().flat_map(|value| value.to_le_bytes()))
        .chain(corners.iter().flat_map(|corner| corner.to_le_bytes()))
        .collect();
    let (head, _) = GLTF.split_once("\"buffers\"").unwrap();
    let mut json = format!("{head}\"buffers\":[{{\"byteLength\":{}}}]}}", data.len()).into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut file = b"glTF\x02\x00\x00\x00".to_vec();
    let length = 12 + 8 + json.len() + 8 + data.len();
    file.extend((length as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", data)] {
        file.extend((chunk.len() as u32).to_le_bytes());
        file.extend(kind);
        file.extend(chunk);
    }
    file
}

/// Cuts, overwrites, repeats and swaps pieces of a file.
fn damage(mut bytes: Vec<u8>, edits: &[(u8, u16, u16, u8)]) -> Vec<u8> {
    for &(kind, at, length, value) in edits {
        let at = usize::from(at) % bytes.len().max(1);
        let end = (at + usize::from(length) % 64 + 1).min(bytes.len());
        match kind % 5 {
            0 if at < bytes.len() => bytes[at] = value,
            1 => bytes.truncate(at),
            2 => drop(bytes.drain(at..end)),
            3 => {
                let piece = bytes[at..end].to_vec();
                bytes.splice(
                    at..at,
                    piece
                        .into_iter()
                        .cycle()
                        .take((end - at) * (1 + usize::from(value) % 8)),
                );
            }
            _ => {
                let numbers: [&[u8]; 8] = [
                    b"-1",
                    b"4294967295",
                    b"1e999",
                    b"nan",
                    b"0",
                    b"18446744073709551616",
                    b"../../etc/passwd",
                    b"#g",
                ];
                bytes.splice(at..at, numbers[usize::from(value) % 8].iter().copied());
            }
        }
    }
    bytes
}

fn edits() -> impl Strategy<Value = Vec<(u8, u16, u16, u8)>> {
    prop::collection::vec(any::<(u8, u16, u16, u8)>(), 1..6)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes_are_no_mesh_and_no_harm(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
        for ending in ["stl", "obj", "dae", "gltf", "glb"] {
            check(parse(ending, &bytes));
        }
        let mut binary = b"glTF\x02\x00\x00\x00".to_vec();
        binary.extend(&bytes);
        check(parse("glb", &binary));
    }

    #[test]
    fn damaged_meshes_do_no_harm(edits in edits()) {
        check(parse("stl", &damage(binary_stl(), &edits)));
        check(parse("stl", &damage(TEXT_STL.into(), &edits)));
        check(parse("obj", &damage(OBJ.into(), &edits)));
        check(parse("dae", &damage(DAE.into(), &edits)));
        check(parse("gltf", &damage(GLTF.into(), &edits)));
        check(parse("glb", &damage(glb(), &edits)));
    }

    #[test]
    fn damaged_robots_do_no_harm(edits in edits()) {
        match load_robot(&damage(URDF.into(), &edits)) {
            Err(message) => prop_assert!(message.contains("robot.urdf"), "{}", message),
            Ok(model) => {
                // Whatever loads must have finite kinematics.
                let state = model.joint_state([]).unwrap();
                prop_assert!(model.fk(&state).iter().all(|pose| pose.translation.is_finite() && pose.rotation.is_finite()));
            }
        }
    }

    #[test]
    fn random_text_is_no_robot(text in "[<>/a-z =\"'!\\[\\]&;#-]{0,300}") {
        prop_assert!(load_robot(text.as_bytes()).is_err());
    }
}

#[test]
fn a_binary_gltf_shorter_than_its_own_head_is_refused() {
    for length in [0, 11] {
        let mut file = glb();
        file[8] = length;
        file[9..12].fill(0);
        let message = parse("glb", &file).unwrap_err();
        assert!(message.contains(&format!("it has {length} bytes")), "{message}");
    }
}

#[test]
fn the_examples_themselves_are_read() {
    for (ending, bytes) in [
        ("stl", binary_stl()),
        ("stl", TEXT_STL.into()),
        ("obj", OBJ.into()),
        ("dae", DAE.into()),
        ("gltf", GLTF.into()),
        ("glb", glb()),
    ] {
        assert!(parse(ending, &bytes).is_ok(), "{ending}: {:?}", parse(ending, &bytes));
    }
    assert_eq!(
        load_robot(URDF.as_bytes()).unwrap().joints[1].mimic.unwrap().multiplier,
        -1.0
    );
}

#[test]
fn positions_without_an_accessor_are_refused() {
    let text = GLTF.replace(r#""POSITION":0"#, r#""POSITION":9"#);
    assert!(parse("gltf", text.as_bytes()).unwrap_err().contains("accessor 9 of 2"));
}

#[test]
fn robots_with_wrong_structure_are_refused_with_the_reason() {
    let wrong = |from: &str, to: &str| load_robot(URDF.replace(from, to).as_bytes()).unwrap_err();
    for (from, to, reason) in [
        (
            r#"<link name="c"/>"#,
            r#"<link name="c"/><link name="c"/>"#,
            "two links are called `c`",
        ),
        (
            r#"<link name="c"/>"#,
            r#"<link name="c"/><link name="d"/>"#,
            "2 root links (a, d)",
        ),
        (r#"<child link="c"/>"#, r#"<child link="a"/>"#, "cycle"),
        (r#"<child link="c"/>"#, r#"<child link="b"/>"#, "child of two joints"),
        (
            r#"<child link="c"/>"#,
            r#"<child link="z"/>"#,
            "child link `z` does not exist",
        ),
        (r#"name="k""#, r#"name="j""#, "two joints are called `j`"),
        (r#"<mimic joint="j""#, r#"<mimic joint="k""#, "mimics itself"),
        (r#"type="prismatic""#, r#"type="ball""#, "the type `ball` is not known"),
        (r#"type="prismatic""#, "", "it has no `type`"),
        (r#"<parent link="b"/>"#, "", "names no parent link"),
        (r#"<mimic joint="j""#, r#"<mimic"#, "mimic names no joint"),
        (r#"<axis xyz="0 1 0"/>"#, r#"<axis xyz="0 0 0"/>"#, "no direction"),
        (r#"lower="-1""#, r#"lower="nan""#, "not finite"),
        (r#"lower="-1""#, r#"lower="2""#, "reversed"),
        (r#"xyz="0 0 0""#, r#"xyz="0 inf 0""#, "not finite"),
        (r#"<box size="1 1 1"/>"#, r#"<box size="1 -1 1"/>"#, "must be positive"),
        (
            "<robot name",
            "<!DOCTYPE a [<!ENTITY b 'c'>]><robot name",
            "document type",
        ),
    ] {
        let message = wrong(from, to);
        assert!(message.contains(reason), "{message}");
    }
    assert!(load_robot(&vec![b' '; (4 << 20) + 1]).unwrap_err().contains("larger"));
    assert!(
        load_robot(format!("<robot {}/>", "a='' ".repeat(50)).as_bytes())
            .unwrap_err()
            .contains("attributes")
    );
    assert!(
        load_robot("<a>".repeat(5000).as_bytes())
            .unwrap_err()
            .contains("nested")
    );
}

#[test]
fn a_cycle_beside_the_tree_is_found() {
    let joint = |name: &str, parent: &str, child: &str| {
        format!(r#"<joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/></joint>"#)
    };
    let text = format!(
        r#"<robot name="r"><link name="a"/><link name="b"/><link name="c"/>{}{}</robot>"#,
        joint("j", "b", "c"),
        joint("k", "c", "b")
    );
    assert!(load_robot(text.as_bytes()).unwrap_err().contains("cycle"));
}

#[needs(shared)]
#[test]
fn real_meshes_with_flipped_bytes_do_no_harm() {
    let folder = shared!("data/robots/panda_robotiq_2f85/meshes");
    for name in ["collision/link5.stl", "visual/link7.dae"] {
        let path = folder.join(name);
        let original = std::fs::read(&path).unwrap();
        // The head of the file is where structure lies; the tail is numbers.
        let mut bytes = original[..original.len().min(100_000)].to_vec();
        let ending = Path::new(name).extension().unwrap().to_str().unwrap();
        let mut state = 5usize;
        for _ in 0..25 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let at = (state >> 33) % bytes.len();
            bytes[at] ^= 1 << ((state >> 20) % 8);
            check(parse(ending, &bytes));
        }
    }
}
