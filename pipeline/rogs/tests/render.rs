//! `rogs render` on a small wall of Gaussians: pictures, arrays for Python, PLY files in two frames.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use rogs_field::read_ply_file;
use rogs_r4c::write_record;
use rogs_schemas::key::{KeyMaterial, Provenance};
use rogs_schemas::records::clip::SourceView;
use rogs_schemas::records::field::{Field, TimeSlice, WeightsInfo};
use rogs_schemas::records::robot::NO_LINK;
use rogs_schemas::{CameraIndex, FrameIndex, RigidPose};
use rogs_splat::Colour;
use serde_json::Value;

const HEIGHT: usize = 24;
const WIDTH: usize = 32;

/// A folder with a field and a camera file.
struct Workspace(tempfile::TempDir);

impl Workspace {
    /// A wall one metre ahead of the camera that moves 0.1 m along x from time 0 to time 1.
    fn new() -> Self {
        let workspace = Self(tempfile::tempdir().unwrap());
        let provenance = Provenance {
            material: KeyMaterial {
                stage: "lift".into(),
                stage_version: 1,
                schema: "rogs.field 1.0".into(),
                params: "{}".into(),
                inputs: BTreeMap::new(),
            },
            input_content: BTreeMap::new(),
        };
        write_record(&workspace.path("field.r4c"), &wall(), &provenance).unwrap();
        workspace.write(
            "camera.json",
            r#"{"name": "front", "width": 32, "height": 24,
                "intrinsics": {"fx": 30, "fy": 30, "cx": 16, "cy": 12},
                "recon_from_camera": [[1,0,0,0], [0,1,0,0], [0,0,1,0], [0,0,0,1]]}"#,
        );
        workspace
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).unwrap();
    }

    fn run(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_rogs"))
            .arg("render")
            .args(arguments)
            .current_dir(self.0.path())
            .output()
            .unwrap()
    }

    fn good(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        let (out, err) = (
            String::from_utf8_lossy(&output.stdout),
            String::from_utf8_lossy(&output.stderr),
        );
        assert!(output.status.success(), "{arguments:?}: {err}");
        out.into_owned()
    }

    fn bad(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        assert!(!output.status.success(), "{arguments:?} must fail");
        String::from_utf8_lossy(&output.stderr).into_owned()
    }
}

/// The base frame of the wall: turned by 90 degrees, with z up where the camera looks along x, and half a metre away.
fn recon_from_base() -> RigidPose {
    RigidPose {
        rotation: [0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0],
        translation: [0.0, 0.25, -0.5],
    }
}

fn wall() -> Field {
    let n = HEIGHT * WIDTH;
    let mut position_m = Vec::new();
    for row in 0..HEIGHT {
        for column in 0..WIDTH {
            position_m.extend([
                (column as f32 + 0.5 - 16.0) / 30.0,
                (row as f32 + 0.5 - 12.0) / 30.0,
                1.0,
            ]);
        }
    }
    // Raw colour (a bluish grey), scale, rotation, opacity.
    let raw = [0.0, 0.25, 0.5, 170.0, 170.0, 1.0, 1.0, 0.25, 0.0, 0.0, 5.0];
    let slice = |time: f64| TimeSlice {
        time,
        displacement_m: (0..n).flat_map(|_| [0.1 * time as f32, 0.0, 0.0]).collect(),
        gate: vec![0; n],
        moving_raw: vec![],
    };
    Field {
        clip_id: "wall".parse().unwrap(),
        frame_count: 17,
        height: HEIGHT as u32,
        width: WIDTH as u32,
        views: vec![SourceView {
            camera: CameraIndex(0),
            frame: FrameIndex(0),
        }],
        recon_from_base: recon_from_base(),
        weights: WeightsInfo {
            trained: false,
            configuration: "ci".into(),
            description: "none".into(),
            hash: String::new(),
        },
        position_m,
        base_raw: raw.repeat(n),
        support: vec![0; n],
        link: vec![NO_LINK; n],
        scale_cap_iu: vec![f32::INFINITY; n],
        slices: [0.0, 0.5, 1.0].map(slice).to_vec(),
        query_state: vec![],
    }
}

/// An array of an archive: shape and values.
struct Array {
    shape: Vec<usize>,
    values: Vec<f64>,
}

/// Reads an archive of stored arrays through its directory, as numpy does.
fn read_npz(path: &Path) -> BTreeMap<String, Array> {
    let bytes = std::fs::read(path).unwrap();
    let u16_at = |at: usize| usize::from(u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap()));
    let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let end = bytes.len() - 22;
    assert_eq!(&bytes[end..end + 4], b"PK\x05\x06");
    let mut arrays = BTreeMap::new();
    let mut at = u32_at(end + 16);
    for _ in 0..u16_at(end + 10) {
        assert_eq!(&bytes[at..at + 4], b"PK\x01\x02");
        let (size, name_length, local) = (u32_at(at + 24), u16_at(at + 28), u32_at(at + 42));
        let name = std::str::from_utf8(&bytes[at + 46..at + 46 + name_length]).unwrap();
        at += 46 + name_length;
        assert_eq!(&bytes[local..local + 4], b"PK\x03\x04");
        assert_eq!(u32_at(local + 22), size, "sizes of {name}");
        let start = local + 30 + u16_at(local + 26) + u16_at(local + 28);
        let npy = &bytes[start..start + size];
        assert_eq!(&npy[..8], b"\x93NUMPY\x01\x00");
        let header_end = 10 + usize::from(u16::from_le_bytes([npy[8], npy[9]]));
        let header = std::str::from_utf8(&npy[10..header_end]).unwrap();
        let shape = header.split_once('(').unwrap().1.split_once(')').unwrap().0;
        let shape = shape.split(',').filter_map(|size| size.trim().parse().ok()).collect();
        let data = &npy[header_end..];
        let values = if header.contains("'<f4'") {
            let value = |b: &[u8]| f64::from(f32::from_le_bytes(b.try_into().unwrap()));
            data.chunks_exact(4).map(value).collect()
        } else {
            assert!(header.contains("'<f8'"), "{header}");
            data.chunks_exact(8)
                .map(|b| f64::from_le_bytes(b.try_into().unwrap()))
                .collect()
        };
        arrays.insert(name.trim_end_matches(".npy").to_owned(), Array { shape, values });
    }
    arrays
}

#[test]
fn an_npz_holds_images_displacement_and_the_camera() {
    let workspace = Workspace::new();
    let printed = workspace.good(&[
        "field.r4c",
        "--time",
        "1",
        "--camera",
        "camera.json",
        "--out",
        "out",
        "--npz",
        "--depth",
        "--alpha",
        "--json",
    ]);
    let printed: Value = serde_json::from_str(&printed).unwrap();
    let files: Vec<&str> = printed["items"][0]["files"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| f.as_str().unwrap())
        .collect();
    for name in ["front.png", "front.depth.exr", "front.alpha.exr", "front.npz"] {
        assert!(files.iter().any(|file| file.ends_with(name)), "{name} in {files:?}");
        assert!(workspace.path("out").join(name).is_file());
    }
    let arrays = read_npz(&workspace.path("out/front.npz"));
    let shapes: Vec<(&str, &[usize])> = arrays
        .iter()
        .map(|(name, a)| (name.as_str(), a.shape.as_slice()))
        .collect();
    assert_eq!(
        shapes,
        [
            ("alpha", [24, 32].as_slice()),
            ("depth", &[24, 32]),
            ("displacement", &[24, 32, 3]),
            ("intrinsics", &[3, 3]),
            ("recon_from_camera", &[4, 4]),
            ("rgb", &[24, 32, 3]),
            ("time", &[]),
        ]
    );
    // The wall is a metre away, opaque, and has moved 0.1 m along x; pixels at its rim are left out.
    for row in 4..20 {
        for column in 8..28 {
            let pixel = row * WIDTH + column;
            let at = |name: &str, index: usize| arrays[name].values[index];
            assert!((at("depth", pixel) - 1.0).abs() < 1e-3, "depth {}", at("depth", pixel));
            assert!(at("alpha", pixel) > 0.9 && at("alpha", pixel) <= 1.0);
            assert!((at("displacement", 3 * pixel) - 0.1).abs() < 1e-4);
            assert!(at("displacement", 3 * pixel + 1).abs() < 1e-6);
            assert!((at("rgb", 3 * pixel) / at("alpha", pixel) - 0.5).abs() < 1e-3);
        }
    }
    assert_eq!(arrays["intrinsics"].values[..3], [30.0, 0.0, 16.0]);
    assert_eq!(arrays["time"].values, [1.0]);
    // Counted from another time; what EXR and PNG show does not change with the arrays.
    let picture = std::fs::read(workspace.path("out/front.png")).unwrap();
    workspace.good(&[
        "field.r4c",
        "--time",
        "1",
        "--camera",
        "camera.json",
        "--out",
        "later",
        "--npz",
        "--since",
        "0.5",
    ]);
    let later = read_npz(&workspace.path("later/front.npz"));
    assert!((later["displacement"].values[3 * (12 * WIDTH + 16)] - 0.05).abs() < 1e-4);
    workspace.good(&["field.r4c", "--time", "1", "--camera", "camera.json", "--out", "plain"]);
    assert!(picture == std::fs::read(workspace.path("plain/front.png")).unwrap());
    assert!(!workspace.path("plain/front.npz").exists() && !workspace.path("plain/field.ply").exists());
}

#[test]
fn a_ply_is_written_in_either_frame_and_renders_as_the_field_does() {
    let workspace = Workspace::new();
    let field = |out: &str, extra: &[&str]| {
        let arguments = [
            "field.r4c",
            "--time",
            "0.5",
            "--camera",
            "camera.json",
            "--npz",
            "--out",
            out,
        ];
        workspace.good(&[&arguments, extra].concat())
    };
    assert!(field("recon", &["--ply"]).contains("field.ply"));
    field("base", &["--ply", "--axes", "base"]);
    let (recon, base) = (
        read_ply_file(&workspace.path("recon/field.ply")).unwrap(),
        read_ply_file(&workspace.path("base/field.ply")).unwrap(),
    );
    assert!(
        recon.comments.iter().any(|c| c == "frame recon_opencv unit m"),
        "{:?}",
        recon.comments
    );
    assert!(
        base.comments.iter().any(|c| c == "frame base unit m"),
        "{:?}",
        base.comments
    );
    let RigidPose {
        rotation: r,
        translation: t,
    } = recon_from_base();
    let pairs = recon
        .gaussians
        .means
        .chunks_exact(3)
        .zip(base.gaussians.means.chunks_exact(3));
    for (recon, base) in pairs {
        for k in 0..3 {
            let back: f64 = (0..3).map(|i| r[3 * k + i] * f64::from(base[i])).sum::<f64>() + t[k];
            assert!((back - f64::from(recon[k])).abs() < 1e-5, "{recon:?} {base:?}");
        }
    }
    assert!(matches!(base.gaussians.colour, Colour::Sh { degree: 0, .. }));

    // The same camera, given in the frame of each file, sees the same picture as it sees of the field.
    let identity = "[[1,0,0,0], [0,1,0,0], [0,0,1,0], [0,0,0,1]]";
    // base_from_recon: the transposed rotation, and - R^T t.
    let base_from_camera = "[[0,0,1,0.5], [-1,0,0,0], [0,-1,0,0.25], [0,0,0,1]]";
    let camera = std::fs::read_to_string(workspace.path("camera.json")).unwrap();
    workspace.write("in-base.json", &camera.replace(identity, base_from_camera));
    let rendered = |file: &str, camera: &str, out: &str| {
        workspace.good(&[file, "--camera", camera, "--out", out, "--npz"]);
        let arrays = read_npz(&workspace.path(out).join("front.npz"));
        assert!(!arrays.contains_key("displacement") && !arrays.contains_key("time"));
        arrays
    };
    let of_field = read_npz(&workspace.path("recon/front.npz"));
    for arrays in [
        rendered("recon/field.ply", "camera.json", "a"),
        rendered("base/field.ply", "in-base.json", "b"),
    ] {
        for name in ["rgb", "alpha", "depth"] {
            let worst = (arrays[name].values.iter().zip(&of_field[name].values))
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f64::max);
            // The low-pass filter is in pixels, so a scene in metres renders as one in internal units does.
            assert!(worst < 2e-3, "{name}: {worst}");
        }
    }
}

/// Built with the feature `gpu`; needs a graphics adapter (Mesa's software Vulkan is one).
#[cfg(feature = "gpu")]
#[test]
fn a_graphics_processor_draws_the_picture_of_the_processor() {
    let workspace = Workspace::new();
    let picture = |device: &str| {
        let common = ["field.r4c", "--time", "1", "--camera", "camera.json", "--npz"];
        workspace.good(&[common.as_slice(), &["--out", device, "--device", device]].concat());
        let png = image::open(workspace.path(device).join("front.png")).unwrap().to_rgb8();
        (read_npz(&workspace.path(device).join("front.npz")), png.into_raw())
    };
    let ((ours, ours_png), (reference, reference_png)) = (picture("gpu"), picture("cpu"));
    for name in ["rgb", "alpha", "depth", "displacement"] {
        let values = &reference[name].values;
        assert!(values.iter().any(|v| *v > 0.05), "{name} shows something");
        assert_eq!(ours[name].values.len(), values.len());
        let worst = (ours[name].values.iter().zip(values))
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max);
        assert!(worst < 1e-5, "{name}: {worst}");
    }
    assert_eq!(ours_png.len(), reference_png.len());
    assert!(ours_png.iter().zip(&reference_png).all(|(a, b)| a.abs_diff(*b) <= 1));
}

#[test]
fn requests_that_make_no_sense_are_refused_with_a_reason() {
    let workspace = Workspace::new();
    let common = ["--camera", "camera.json", "--out", "out"];
    let field = |extra: &[&str]| workspace.bad(&[&["field.r4c"], common.as_slice(), extra].concat());
    assert!(field(&["--axes", "base"]).contains("--ply"));
    assert!(field(&["--since", "0"]).contains("--npz"));
    assert!(
        field(&["--npz", "--since", "0.3"]).contains("stored times"),
        "{}",
        field(&["--npz", "--since", "0.3"])
    );
    assert!(field(&["--time", "0.3"]).contains("stored times"));
    assert!(field(&["--time", "1.5"]).contains("outside the clip"));
    assert!(
        workspace
            .bad(&["field.r4c", "--camera", "camera.json"])
            .contains("--out DIR")
    );
    assert!(field(&["--device", "tpu"]).contains("`cpu` or `gpu`"));
    workspace.good(&[["field.r4c", "--ply"].as_slice(), &common].concat());
    let ply = |extra: &[&str]| workspace.bad(&[&["out/field.ply"], common.as_slice(), extra].concat());
    assert!(ply(&["--ply"]).contains("PLY file already"));
    assert!(ply(&["--npz", "--since", "0"]).contains("--since"));
    assert!(ply(&["--time", "0"]).contains("--time"));
    workspace.write("camera.json", "{\"name\": \"../up\"}");
    assert!(field(&[]).contains("camera file"));
    // Nothing is written before all that was asked is known to make sense.
    workspace.bad(&["field.r4c", "--ply", "--camera", "camera.json", "--out", "never"]);
    assert!(!workspace.path("never").exists());
}

#[test]
fn nothing_is_written_before_every_camera_and_option_is_understood() {
    let workspace = Workspace::new();
    let good = std::fs::read_to_string(workspace.path("camera.json")).unwrap();
    let with_second = |from: &str, to: &str| {
        let second = good.replace("front", "second").replace(from, to);
        assert_ne!(second, good.replace("front", "second"));
        format!("[{good}, {second}]")
    };
    for (name, text, said) in [
        ("no", "{".to_owned(), "not a camera file"),
        ("empty", "[]".to_owned(), "holds no camera"),
        ("pose", with_second("[0,0,1,0]", "[0,0,2,0]"), ""),
        ("lens", with_second("\"fx\": 30", "\"fx\": 0"), "`second`"),
        ("size", with_second("\"width\": 32", "\"width\": 0"), "`second`"),
        (
            "frame",
            with_second("recon_from_camera", "world_from_camera"),
            "not a camera file",
        ),
    ] {
        workspace.write("cameras.json", &text);
        let all = [
            "field.r4c",
            "--camera",
            "cameras.json",
            "--out",
            "out",
            "--ply",
            "--npz",
        ];
        let error = workspace.bad(&all);
        assert!(error.starts_with("error: ") && error.contains(said), "{name}: {error}");
        assert!(!workspace.path("out").exists(), "{name}: something was written");
    }
    for extra in [
        ["--since", "0.3"],
        ["--refinement", "missing.r4c"],
        ["--camera", "missing.json"],
    ] {
        let camera: &[&str] = if extra[0] == "--camera" {
            &[]
        } else {
            &["--camera", "camera.json"]
        };
        workspace.bad(&[&["field.r4c", "--out", "out", "--ply", "--npz"], camera, &extra].concat());
        assert!(!workspace.path("out").exists(), "{extra:?}: something was written");
    }
}

/// A folder of PNG images, by their names.
fn images(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.sort();
    paths
}

#[test]
fn a_film_of_images_holds_the_pictures_of_its_times() {
    let workspace = Workspace::new();
    let common = ["field.r4c", "--camera", "camera.json", "--video"];
    let made = workspace.good(&[common.as_slice(), &["frames", "--json"]].concat());
    let made: Value = serde_json::from_str(&made).unwrap();
    assert_eq!((&made["frames"], &made["width"]), (&3.into(), &32.into()));
    assert_eq!(made["times"], serde_json::json!([0.0, 0.5, 1.0]));
    let frames = images(&workspace.path("frames"));
    assert_eq!(frames.len(), 3);
    for (frame, time) in frames.iter().zip(["0", "0.5", "1"]) {
        workspace.good(&["field.r4c", "--camera", "camera.json", "--time", time, "--out", "still"]);
        let still = std::fs::read(workspace.path("still/front.png")).unwrap();
        assert!(std::fs::read(frame).unwrap() == still, "the frame of time {time}");
    }
    // Depth stands beside; a time is held where there are more frames than times.
    let wide = [
        common.as_slice(),
        &["wide", "--beside", "depth", "--times", "0,1", "--frames", "4"],
    ]
    .concat();
    workspace.good(&wide);
    let wide: Vec<image::RgbImage> = (images(&workspace.path("wide")).iter())
        .map(|path| image::open(path).unwrap().to_rgb8())
        .collect();
    assert_eq!((wide.len(), wide[0].dimensions()), (4, (64, 24)));
    assert!(wide[0] == wide[1] && wide[1] != wide[2] && wide[2] == wide[3]);
}

#[test]
fn a_path_moves_the_camera_and_a_size_changes_the_picture() {
    let workspace = Workspace::new();
    let near = std::fs::read_to_string(workspace.path("camera.json")).unwrap();
    let far = near.replace("[1,0,0,0]", "[1,0,0,0.1]");
    workspace.write("path.json", &format!("[{near}, {far}]"));
    let path = ["field.r4c", "--camera", "path.json", "--time", "0", "--video"];
    workspace.good(&[path.as_slice(), &["moved", "--frames", "3"]].concat());
    let moved = images(&workspace.path("moved"));
    assert_eq!(moved.len(), 3);
    workspace.good(&["field.r4c", "--camera", "camera.json", "--time", "0", "--out", "still"]);
    let read = |path: &Path| std::fs::read(path).unwrap();
    assert!(read(&moved[0]) == read(&workspace.path("still/front.png")));
    assert!(read(&moved[1]) != read(&moved[0]) && read(&moved[2]) != read(&moved[1]));

    // From the side of the base frame: the wall stands half a metre before its origin, turned.
    let lookat = [
        "field.r4c",
        "--camera",
        "lookat:-0.5,0,0.25,0.5,0,0.25",
        "--out",
        "seen",
        "--size",
        "64x40",
    ];
    workspace.good(&lookat);
    let seen = image::open(workspace.path("seen/lookat.png")).unwrap().to_rgb8();
    assert_eq!(seen.dimensions(), (64, 40));
    assert!(
        seen.get_pixel(32, 20).0.iter().any(|&value| value > 60),
        "the wall is seen"
    );
}

#[test]
fn films_that_make_no_sense_are_refused_and_leave_nothing() {
    let workspace = Workspace::new();
    let one = std::fs::read_to_string(workspace.path("camera.json")).unwrap();
    workspace.write("one.json", &format!("[{one}]"));
    workspace.write(
        "viewer.json",
        r#"{"camera_type": "perspective", "render_height": 24, "render_width": 32,
        "camera_path": [{"camera_to_world": [1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1], "fov": 50}]}"#,
    );
    let before = images(workspace.0.path());
    for (arguments, said) in [
        (
            ["--camera", "camera.json", "--video", "a.mov"].as_slice(),
            ".mp4, .webm or .gif",
        ),
        (&["--camera", "one.json", "--video", "a"], "two poses or more"),
        (&["--camera", "viewer.json", "--video", "a"], "two poses or more"),
        (&["--camera", "viewer.json", "--out", "a"], "add `--video FILE`"),
        (&["--camera", "orbit", "--video", "a"], "clip.r4c"),
        (
            &["--camera", "camera.json", "--video", "a", "--times", "0,1.5"],
            "outside the clip",
        ),
        (
            &["--camera", "camera.json", "--video", "a", "--times", "half"],
            "invalid times",
        ),
        (
            &["--camera", "camera.json", "--video", "a", "--fps", "0"],
            "invalid rate",
        ),
        (
            &["--camera", "camera.json", "--video", "a", "--frames", "0"],
            "frames 0",
        ),
        (
            &["--camera", "camera.json", "--video", "a", "--beside", "error"],
            "a camera of the clip",
        ),
        (
            &["--camera", "camera.json", "--video", "a", "--out", "b"],
            "`--video` makes a film alone",
        ),
        (&["--camera", "camera.json", "--out", "b", "--times", "all"], "--video"),
        (&["--camera", "lookat:1,2", "--video", "a"], "six numbers"),
    ] {
        let error = workspace.bad(&[["field.r4c"].as_slice(), arguments].concat());
        assert!(error.contains(said), "{arguments:?}: {error}");
        assert_eq!(images(workspace.0.path()), before, "{arguments:?}");
    }
    let error = workspace.bad(&["camera.json", "--camera", "camera.json", "--video", "a"]);
    assert!(error.contains("camera.json"), "a file that is no field: {error}");
    assert_eq!(images(workspace.0.path()), before);
}

/// Without the program there are images, and what to do is said.
#[test]
fn without_ffmpeg_a_film_is_a_folder_of_images() {
    let workspace = Workspace::new();
    let output = Command::new(env!("CARGO_BIN_EXE_rogs"))
        .args(["render", "field.r4c", "--camera", "camera.json", "--video", "out.mp4"])
        .env("PATH", workspace.0.path())
        .current_dir(workspace.0.path())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(
        said.contains("install ffmpeg") && said.contains("ffmpeg -framerate 10"),
        "{said}"
    );
    assert_eq!(images(&workspace.path("out-frames")).len(), 3);
    assert!(!workspace.path("out.mp4").exists());
}
