//! What lies in the data of people: every row of the table of bad inputs in `docs/faults.md`, through the program, with the
//! message that a person sees. One bad episode or file never stops, changes or hides another.

mod support;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value, json};
use support::{ROGS, Workspace};

/// The one episode that `synth` makes with this seed.
const GOOD: &str = "synth-00000011";

/// What a damaged episode leads to.
enum Said {
    /// The clip fails; message and hint contain these words.
    Failure(&'static str, &'static str),
    /// The clip is made, with a warning that contains these words.
    Warning(&'static str),
    /// The clip is made, and nothing is said.
    Nothing,
}

use Said::{Failure, Nothing, Warning};

/// Copies of the good episode, each with its damage and what must be said about it; all go through one run.
struct Cases {
    workspace: Workspace,
    expected: BTreeMap<String, Said>,
}

impl Cases {
    /// The run stops behind the robot's maps.
    fn new() -> Self {
        let workspace = Workspace::small(1);
        let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
        let manifest = manifest.replacen("[run]\n", "[run]\nstages = [\"robot-maps\"]\n", 1);
        workspace.write("manifest.toml", &manifest);
        Self {
            workspace,
            expected: BTreeMap::from([(GOOD.to_owned(), Nothing)]),
        }
    }

    /// A copy of the good episode under another name, to be damaged.
    fn add(&mut self, name: &str, said: Said) -> PathBuf {
        let episodes = self.workspace.path("data/episodes");
        let (from, to) = (episodes.join(GOOD), episodes.join(name));
        // Neither of these is read by the stages of these tests.
        copy(&from, &to, &["ids", "tracks", "synth.json"]);
        edit(&to, |episode| {
            episode["episode_id"] = name.into();
            episode.as_object_mut().unwrap().remove("tracks");
        });
        assert!(self.expected.insert(name.to_owned(), said).is_none());
        to
    }

    fn edited(&mut self, name: &str, said: Said, change: impl FnOnce(&mut Value)) {
        edit(&self.add(name, said), change);
    }

    /// Changes the table of states; the first line is the header.
    fn states(&mut self, name: &str, said: Said, change: impl FnOnce(&mut Vec<Vec<String>>)) {
        let path = self.add(name, said).join("joints.csv");
        let text = std::fs::read_to_string(&path).unwrap();
        let mut rows: Vec<Vec<String>> = text
            .lines()
            .map(|line| line.split(',').map(String::from).collect())
            .collect();
        change(&mut rows);
        let lines: Vec<String> = rows.iter().map(|row| row.join(",")).collect();
        std::fs::write(path, lines.join("\n") + "\n").unwrap();
    }

    /// Runs everything and compares.
    fn check(&self) {
        let (code, summary) = self
            .workspace
            .rogs_json(&["run", "manifest.toml", "--no-report", "--json"]);
        let failures = summary["failures"].as_array().unwrap();
        let warnings: Vec<&str> = summary["warnings"]
            .as_array()
            .unwrap()
            .iter()
            .map(|text| text.as_str().unwrap())
            .collect();
        let expected = self
            .expected
            .values()
            .filter(|said| matches!(said, Failure(..)))
            .count();
        assert_eq!(code, Some(if expected > 0 { 3 } else { 0 }), "{summary:#}");
        for (clip, said) in &self.expected {
            let failure = failures.iter().find(|failure| failure["clip"] == clip.as_str());
            let of_clip: Vec<&&str> = warnings
                .iter()
                .filter(|text| text.starts_with(&format!("{clip} ")))
                .collect();
            match said {
                Failure(message, hint) => {
                    let failure = failure.unwrap_or_else(|| panic!("`{clip}` did not fail: {of_clip:?}"));
                    let text = |key: &str| failure[key].as_str().unwrap_or_default().to_owned();
                    assert!(text("message").contains(message), "{clip}: {failure:#}");
                    assert!(text("hint").contains(hint), "{clip}: {failure:#}");
                    assert_eq!(failure["code"], "bad_input", "{clip}");
                }
                Warning(words) => {
                    assert!(failure.is_none(), "{clip}: {failure:?}");
                    assert!(of_clip.iter().any(|text| text.contains(words)), "{clip}: {of_clip:?}");
                }
                Nothing => assert!(
                    failure.is_none() && of_clip.is_empty(),
                    "{clip}: {failure:?} {of_clip:?}"
                ),
            }
        }
        assert_eq!(failures.len(), expected, "{summary:#}");
    }
}

fn copy(from: &Path, to: &Path, without: &[&str]) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap();
        if without.iter().any(|left_out| name == *left_out) {
            continue;
        }
        if path.is_dir() {
            copy(&path, &to.join(name), without);
        } else {
            std::fs::copy(&path, to.join(name)).unwrap();
        }
    }
}

/// Changes the description of an episode.
fn edit(folder: &Path, change: impl FnOnce(&mut Value)) {
    let path = folder.join("episode.json");
    let mut value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    change(&mut value);
    std::fs::write(path, value.to_string()).unwrap();
}

/// The camera-to-base matrix of the first fixed camera.
fn fixed(episode: &mut Value) -> &mut Value {
    let cameras = episode["cameras"].as_array_mut().unwrap();
    let camera = cameras.iter_mut().find(|camera| camera["id"] == "ext1").unwrap();
    &mut camera["mount"]["fixed"]["base_from_camera"]
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

#[test]
fn joints_grippers_and_times() {
    let mut cases = Cases::new();
    let set = |row: usize, column: usize, value: &str| {
        let value = value.to_owned();
        move |rows: &mut Vec<Vec<String>>| rows[row][column] = value
    };
    cases.states(
        "nan",
        Failure("joint `panda_joint2` is NaN at row 3", ""),
        set(4, 2, "nan"),
    );
    cases.states(
        "inf",
        Failure("joint `panda_joint1` is -inf at row 0", ""),
        set(1, 1, "-inf"),
    );
    cases.states("cells", Failure("row 1 has 8 cells, the header 9", ""), |rows| {
        drop(rows[2].pop())
    });
    cases.states("dof", Failure("there is no column `panda_joint7`", ""), |rows| {
        rows.iter_mut().for_each(|row| drop(row.remove(7)));
    });
    cases.states(
        "degrees",
        Failure("joint `panda_joint4` is -105", "were these degrees?"),
        |rows| {
            rows.iter_mut().skip(1).for_each(|row| row[4] = "-105.2".into());
        },
    );
    cases.states("limits", Warning("joint `panda_joint4` leaves its limits"), |rows| {
        rows.iter_mut().skip(1).for_each(|row| row[4] = "0.4".into());
    });
    cases.states(
        "open",
        Failure("the gripper is 1.5 at row 2, it must be in 0 (open) to 1 (closed)", ""),
        set(3, 8, "1.5"),
    );
    cases.states("width", Failure("the gripper is -0.2 at row 0", ""), set(1, 8, "-0.2"));
    cases.states(
        "nan-gripper",
        Failure("the gripper is NaN at row 0", ""),
        set(1, 8, "nan"),
    );
    cases.states(
        "short",
        Failure("there are 16 rows, the episode has 17 frames", ""),
        |rows| drop(rows.pop()),
    );
    cases.states(
        "back",
        Failure("the time 0.01 at row 2 does not ascend", ""),
        set(3, 0, "0.01"),
    );
    cases.states("twice", Failure("at row 3 does not ascend", ""), |rows| {
        rows[4][0] = rows[3][0].clone()
    });
    cases.states(
        "milliseconds",
        Failure("the times step by 66.", "were these milliseconds?"),
        |rows| {
            for row in rows.iter_mut().skip(1) {
                row[0] = (1000.0 * row[0].parse::<f64>().unwrap()).to_string();
            }
        },
    );
    cases.edited(
        "rate",
        Failure("but 30 frames a second step by 0.0333 s", "correct `fps`"),
        |episode| episode["fps"] = 30.into(),
    );
    cases.states(
        "gap",
        Warning("frames are missing at 1 place, the longest gap is 0.267 s before row 9"),
        |rows| {
            for row in rows.iter_mut().skip(10) {
                row[0] = (0.2 + row[0].parse::<f64>().unwrap()).to_string();
            }
        },
    );
    cases.check();
    // Times that the clip does not have.
    let workspace = &cases.workspace;
    let (code, said) = altered(workspace, "[ingest]\n", "[ingest]\nquery = [17]\n");
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("`query` frame 17 is not below `frames` 17"), "{said}");
}

#[test]
fn poses_and_intrinsics() {
    let mut cases = Cases::new();
    cases.edited(
        "scale",
        Failure("`base_from_camera` of camera `ext1` is not rigid", ""),
        |episode| {
            let matrix = fixed(episode);
            for (row, column) in (0..3).flat_map(|row| (0..3).map(move |column| (row, column))) {
                matrix[row][column] = (2.0 * number(&matrix[row][column])).into();
            }
        },
    );
    cases.edited("mirror", Failure("reflection", ""), |episode| {
        let matrix = fixed(episode);
        for row in 0..3 {
            matrix[row][0] = (-number(&matrix[row][0])).into();
        }
    });
    cases.edited(
        "transposed",
        Failure("`base_from_camera` of camera `ext1` is not rigid", ""),
        |episode| {
            let matrix = fixed(episode).clone();
            for (row, column) in (0..4).flat_map(|row| (0..4).map(move |column| (row, column))) {
                fixed(episode)[row][column] = matrix[column][row].clone();
            }
        },
    );
    cases.edited("millimetres", Failure(" m", "were these millimetres?"), |episode| {
        let matrix = fixed(episode);
        for row in 0..3 {
            matrix[row][3] = (1000.0 * number(&matrix[row][3])).into();
        }
    });
    cases.edited(
        "zeros",
        Failure("all zeros: it was never filled in", "calibration"),
        |episode| {
            *fixed(episode) = json!([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]);
        },
    );
    // World-to-camera instead of camera-to-world is rigid too; that the camera sees no robot gives it away.
    cases.edited(
        "inverse",
        Warning("camera `ext1` never sees the robot: is its pose camera-to-base"),
        |episode| {
            let matrix = fixed(episode).clone();
            let inverse = fixed(episode);
            for row in 0..3 {
                for column in 0..3 {
                    inverse[row][column] = matrix[column][row].clone();
                }
                let translation: f64 = (0..3).map(|k| number(&matrix[k][row]) * number(&matrix[k][3])).sum();
                inverse[row][3] = (-translation).into();
            }
        },
    );
    cases.edited(
        "focal",
        Failure("the focal lengths of camera `wrist` are 0", ""),
        |episode| {
            episode["cameras"][0]["intrinsics"]["fx"] = 0.into();
        },
    );
    cases.edited(
        "centre",
        Failure("the principal point (640, ", "recorded image size"),
        |episode| {
            episode["cameras"][0]["intrinsics"]["cx"] = 640.into();
        },
    );
    cases.edited(
        "resized",
        Failure("images are 56x42, the episode says 112x84", "correct both"),
        |episode| {
            let camera = &mut episode["cameras"][0];
            (camera["width"], camera["height"]) = (112.into(), 84.into());
        },
    );
    cases.check();
}

#[test]
fn images_and_depth() {
    let mut cases = Cases::new();
    let place = |cases: &mut Cases, name: &str, said: Said| cases.add(name, said).join("wrist/000009.png");
    let path = place(&mut cases, "huge", Failure("wrist/000009.png", ""));
    let mut bytes = std::fs::read(&path).unwrap();
    // The header declares 60,000 x 60,000 pixels.
    bytes[16..24].copy_from_slice(&[0, 0, 0xea, 0x60, 0, 0, 0xea, 0x60]);
    std::fs::write(path, bytes).unwrap();
    let path = place(&mut cases, "deep", Failure("expected 8-bit RGB or grey", ""));
    image::ImageBuffer::<image::Rgb<u16>, _>::new(56, 42)
        .save(path)
        .unwrap();
    let path = place(&mut cases, "alpha", Failure("the image is partly transparent", ""));
    image::RgbaImage::new(56, 42).save(path).unwrap();
    let path = place(
        &mut cases,
        "other-size",
        Failure("wrist/000009.png`: images are 8x8", "correct both"),
    );
    image::RgbImage::new(8, 8).save(path).unwrap();
    // A JPEG under the name of a PNG: neither its colours (CMYK) nor its rotation (EXIF) are guessed.
    let path = place(
        &mut cases,
        "jpeg",
        Failure("wrist/000009.png`: not a readable PNG image", ""),
    );
    image::RgbImage::new(56, 42)
        .save_with_format(path, image::ImageFormat::Jpeg)
        .unwrap();
    let path = place(
        &mut cases,
        "cut",
        Failure("wrist/000009.png`: not a readable PNG image", ""),
    );
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
    let path = place(
        &mut cases,
        "missing",
        Failure("it has 16 PNG files, the episode 17 frames", ""),
    );
    std::fs::remove_file(path).unwrap();

    // Depth as OpenEXR: two 32-bit integers of a window follow the word `box2i` and its length.
    let mut exr = |name: &str, said: Said, damage: &dyn Fn(&mut Vec<u8>)| {
        let folder = cases.add(name, said);
        std::fs::create_dir(folder.join("wrist-depth")).unwrap();
        for frame in 0..17 {
            let mut bytes = exr_image();
            if frame == 9 {
                damage(&mut bytes);
            }
            std::fs::write(folder.join(format!("wrist-depth/{frame:06}.exr")), bytes).unwrap();
        }
        edit(&folder, |episode| {
            episode["cameras"][0]["depth"]["path"] = "wrist-depth".into()
        });
    };
    let window = |values: [i32; 4]| {
        move |bytes: &mut Vec<u8>| {
            let found: Vec<usize> = (0..bytes.len() - 6)
                .filter(|&at| &bytes[at..at + 6] == b"box2i\0")
                .collect();
            assert_eq!(found.len(), 2, "data and display window");
            for at in found {
                for (index, value) in values.iter().enumerate() {
                    bytes[at + 10 + 4 * index..][..4].copy_from_slice(&value.to_le_bytes());
                }
            }
        }
    };
    exr("exr", Nothing, &|_| {});
    exr(
        "exr-huge",
        Failure("wrist-depth/000009.exr", ""),
        &window([0, 0, 1 << 30, 1 << 30]),
    );
    exr(
        "exr-reversed",
        Failure("wrist-depth/000009.exr", ""),
        &window([0, 0, -57, -43]),
    );
    exr("exr-deep", Failure("wrist-depth/000009.exr", ""), &|bytes| {
        bytes[5] |= 0x08
    });
    exr("exr-cut", Failure("not a readable OpenEXR image", ""), &|bytes| {
        bytes.truncate(bytes.len() - 20)
    });
    exr("exr-text", Failure("not a readable OpenEXR image", ""), &|bytes| {
        *bytes = b"no image at all".to_vec()
    });
    let path = cases
        .add("npy", Failure("does not fit its shape", ""))
        .join("depth/ext1.npy");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(path, &bytes[..bytes.len() - 8]).unwrap();
    cases.check();
}

/// Depth of one frame, with a value that is not known.
fn exr_image() -> Vec<u8> {
    use exr::prelude::*;

    let mut values = vec![1.5_f32; 56 * 42];
    values[7] = f32::NAN;
    let channel = AnyChannel::new("Z", FlatSamples::F32(values));
    let channels = AnyChannels::sort(std::iter::once(channel).collect());
    let encoding = Encoding {
        compression: Compression::ZIP16,
        ..Encoding::default()
    };
    let layer = Layer::new((56, 42), LayerAttributes::default(), encoding, channels);
    let mut bytes = std::io::Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

#[test]
fn videos() {
    let has = |program: &str| {
        Command::new(program)
            .arg("-version")
            .output()
            .is_ok_and(|output| output.status.success())
    };
    if !has("ffmpeg") || !has("ffprobe") {
        eprintln!("skipped: no ffmpeg here");
        return;
    }
    let mut cases = Cases::new();
    let mut video = |name: &str, said: Said, options: &[&str], damage: &dyn Fn(&mut Vec<u8>)| {
        let folder = cases.add(name, said);
        let file = if options.contains(&"ffv1") {
            "wrist.mkv"
        } else {
            "wrist.mp4"
        };
        let path = folder.join(file);
        let output = Command::new("ffmpeg")
            .args([
                "-v",
                "error",
                "-framerate",
                "15",
                "-i",
                "wrist/%06d.png",
                "-pix_fmt",
                "yuv420p",
            ])
            .args(options)
            .arg(file)
            .current_dir(&folder)
            .output()
            .unwrap();
        assert!(
            output.status.success(),
            "{name}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
        let mut bytes = std::fs::read(&path).unwrap();
        damage(&mut bytes);
        std::fs::write(path, bytes).unwrap();
        edit(&folder, |episode| episode["cameras"][0]["images"] = file.into());
    };
    // MPEG-4 part 2 is in every build of ffmpeg. The order of decoding differs from that of showing: B-frames.
    let plain = ["-c:v", "mpeg4", "-q:v", "2", "-bf", "2"];
    video("video", Nothing, &plain, &|_| {});
    video(
        "whole-later",
        Failure("wrist.mp4`: ffprobe cannot read the video", ""),
        &plain,
        &|bytes| bytes.truncate(bytes.len() / 2),
    );
    video(
        "empty",
        Failure("wrist.mp4`: ffprobe cannot read the video", ""),
        &plain,
        &Vec::clear,
    );
    let shorter = [&plain[..], &["-frames:v", "16"]].concat();
    video(
        "shorter",
        Failure("it has 16 frames, the episode 17", ""),
        &shorter,
        &|_| {},
    );
    let longer = [&plain[..], &["-vf", "tpad=stop=2"]].concat();
    video(
        "longer",
        Failure("it has 19 frames, the episode 17", ""),
        &longer,
        &|_| {},
    );
    let other = [&plain[..], &["-vf", "scale=112:84"]].concat();
    video(
        "other-size",
        Failure("images are 112x84, the episode says 56x42", ""),
        &other,
        &|_| {},
    );
    // Frames are taken by number: a rate that varies moves none.
    let varies = [
        &plain[..],
        &[
            "-vf",
            "setpts=N*N/15/TB/10",
            "-fps_mode",
            "vfr",
            "-enc_time_base",
            "1/60000",
        ],
    ]
    .concat();
    video("varies", Nothing, &varies, &|_| {});
    // Refused by what it declares, before a frame is decoded.
    let huge = ["-c:v", "ffv1", "-vf", "scale=30000:20"];
    video(
        "huge",
        Failure("frames of 30000x20 pixels are larger than this program reads", ""),
        &huge,
        &|_| {},
    );
    cases.check();
    let rgb = |clip: &str| {
        let path = cases.workspace.path(&format!("run/clips/{clip}/clip.r4c"));
        let (clip, _) = rogs_schemas::read_record::<rogs_schemas::records::clip::Clip>(&path).unwrap();
        clip.cameras[0].rgb.clone().unwrap()
    };
    // Every frame is the one of its number, up to what the encoder lost: one frame off fits much worse.
    let good = rgb(GOOD);
    let area = good.len() / 17;
    for clip in ["video", "varies"] {
        let frames = rgb(clip);
        let difference = |shift: isize| -> u64 {
            let of_frame = |frame: usize| -> u64 {
                let other = frame.saturating_add_signed(shift).min(16);
                let (a, b) = (&frames[frame * area..][..area], &good[other * area..][..area]);
                a.iter().zip(b).map(|(a, b)| u64::from(a.abs_diff(*b))).sum()
            };
            (0..17).map(of_frame).sum()
        };
        let aligned = difference(0);
        for shift in [-1, 1] {
            let shifted = difference(shift);
            assert!(
                2 * shifted > 3 * aligned,
                "{clip}: {aligned} aligned, {shifted} shifted by {shift}"
            );
        }
    }
}

/// Runs a manifest with something replaced in it, and returns exit code and what was said.
fn altered(workspace: &Workspace, from: &str, to: &str) -> (Option<i32>, String) {
    let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    assert!(manifest.contains(from), "`{from}` is not in the manifest");
    workspace.write("altered.toml", &manifest.replacen(from, to, 1));
    let output = workspace.rogs(&["run", "altered.toml", "--no-report"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(!text.contains("panicked"), "{text}");
    (output.status.code(), text)
}

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
            good.replacen("<robot ", &format!("<robot {}", "a='1' ".repeat(40)), 1),
            "attributes",
        ),
        (" ".repeat((1 << 20) + 1), "larger"),
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
        (
            good.replace("<limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/>", ""),
            "no limits",
        ),
        (good.replace("size=\"1 1 1\"", "size=\"1 -1 1\""), "box"),
        ("robot".to_owned(), "bad.urdf"),
    ] {
        let (code, said) = said(&text);
        // The shapes of links are read by those who draw them.
        if words == "box" {
            continue;
        }
        assert_eq!(code, Some(2), "{words}: {said}");
        assert!(said.contains(words), "{words}: {said}");
    }

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
    put("cut.glb", b"glTF\x02\0\0\0\xff\xff\xff\xff");
    assert!(with_mesh("meshes/cut.glb").contains("cut.glb"));
}

#[test]
fn manifests() {
    let workspace = Workspace::small(1);
    let refused = |from: &str, to: &str, words: &str| {
        let (code, text) = altered(&workspace, from, to);
        assert_eq!(code, Some(2), "{to}: {text}");
        assert!(text.contains(words), "{to}: {text}");
        assert!(!workspace.path("run").exists(), "{to}: something was written");
    };
    let episode = |more: &str| format!("[[episodes]]\nroot = \"data/episodes/{GOOD}\"\n{more}\n[robot]\n");
    for id in ["../../etc", "/etc/passwd", "..", ".", "-rf", "a\\nb", "a b", "", "c:d"] {
        refused(
            "[robot]\n",
            &episode(&format!("id = \"{id}\"")),
            "is no name for a clip",
        );
    }
    let long = "x".repeat(129);
    refused("[robot]\n", &episode(&format!("id = \"{long}\"")), "1 to 128");
    refused(
        "[robot]\n",
        &(episode("") + &episode("")).replacen("[robot]\n", "", 1),
        "is named twice",
    );
    refused("[input]\n", "[input]\nrot = \"x\"\n", "did you mean `root`?");
    refused("[run]\n", "[run]\nstages = [\"lfit\"]\n", "did you mean `lift`?");
    refused("[run]\n", "[run]\n\"\\u0000\" = 1\n", "altered.toml:");
    refused("[run]\n", "[run\n", "altered.toml:2");
    refused("data/episodes", "nowhere", "is no folder");
    refused("panda_synth.urdf", "gone.urdf", "gone.urdf");
    refused("lift = \"data/", "lift = \"nowhere/", "nowhere/");
    // A link that leads out of the episode.
    let mut cases = Cases::new();
    let folder = cases.add("link", Failure("leads out of the folder through a link", ""));
    std::fs::remove_file(folder.join("joints.csv")).unwrap();
    std::os::unix::fs::symlink("/etc/passwd", folder.join("joints.csv")).unwrap();
    cases.edited("up", Failure("does not stay inside the folder", ""), |episode| {
        episode["robot"]["states"] = "../../../secret.csv".into();
    });
    cases.edited("control", Failure("no control characters", ""), |episode| {
        episode["episode_id"] = "a\nb".into()
    });
    cases.edited("unknown", Failure("frame_rate", ""), |episode| {
        episode["frame_rate"] = 15.into()
    });
    // Two ids that are one file on some disks, and one that is no file name: each clip has its own folder.
    cases.edited("first", Nothing, |episode| {
        episode["episode_id"] = "LAB+One+12h:00m".into()
    });
    cases.edited("second", Nothing, |episode| {
        episode["episode_id"] = "lab+one+12h:00m".into()
    });
    cases.check();
    let clips: Vec<String> = std::fs::read_dir(cases.workspace.path("run/clips"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap().to_lowercase())
        .filter(|name| name.starts_with("lab+one+12h_00m"))
        .collect();
    assert_eq!(clips.len(), 2, "{clips:?}");
    assert_ne!(clips[0], clips[1]);
}

#[test]
fn containers_and_weights() {
    let workspace = Workspace::small(2);
    let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    workspace.write(
        "manifest.toml",
        &manifest.replacen("[run]\n", "[run]\nstages = [\"robot-maps\"]\n", 1),
    );
    assert_eq!(
        workspace.rogs(&["run", "manifest.toml", "--no-report"]).status.code(),
        Some(0)
    );
    let expected = workspace.outputs("run");
    let clips: Vec<PathBuf> = expected
        .keys()
        .filter(|path| path.ends_with("clip.r4c"))
        .cloned()
        .collect();
    let [a, b] = [&clips[0], &clips[1]].map(|path| workspace.path("run").join(path));
    let inspect = |path: &Path| {
        let output = workspace.rogs(&["inspect", &path.display().to_string()]);
        assert_eq!(output.status.code(), Some(2));
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    // Cut, a flipped bit in the data, a file of the future, a file of another clip.
    let whole = std::fs::read(&a).unwrap();
    std::fs::write(&a, &whole[..whole.len() / 2]).unwrap();
    assert!(inspect(&a).contains("clip.r4c"));
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 4;
    std::fs::write(&a, flipped).unwrap();
    assert!(inspect(&a).contains("clip.r4c"));
    let (code, found) = workspace.rogs_json(&["verify", "run", "--json"]);
    assert_eq!((code, &found["good"]), (Some(1), &json!(3)));
    assert!(
        found["bad"][0]["output"].as_str().unwrap().ends_with("clip.r4c"),
        "{found:#}"
    );
    std::fs::copy(&b, &a).unwrap();
    let (code, found) = workspace.rogs_json(&["verify", "run", "--json"]);
    assert_eq!(code, Some(1), "a file at a wrong place: {found:#}");
    let (code, summary) = workspace.rogs_json(&["run", "manifest.toml", "--no-report", "--json"]);
    assert_eq!((code, &summary["units"]["made"]), (Some(0), &json!(1)), "{summary:#}");
    assert!(workspace.outputs("run") == expected);

    let bytes = |header: &str| [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &[0; 16]].concat();
    let tensor = |more: &str| format!("{{\"a\":{{\"dtype\":\"F32\",\"shape\":[2],\"data_offsets\":[0,8]}}{more}}}");
    for (name, bytes) in [
        ("length", [&(1_u64 << 63).to_le_bytes()[..], &[b' '; 64]].concat()),
        (
            "overlap",
            bytes(&tensor(
                ",\"b\":{\"dtype\":\"F32\",\"shape\":[2],\"data_offsets\":[4,12]}",
            )),
        ),
        ("outside", bytes(&tensor("").replace("[0,8]", "[8000,8008]"))),
        ("kind", bytes(&tensor("").replace("F32", "I64").replace("[2]", "[1]"))),
        ("shape", bytes(&tensor("").replace("[2]", "[4611686018427387904,4]"))),
        ("text", b"no weights".to_vec()),
    ] {
        let file = format!("{name}.safetensors");
        std::fs::write(workspace.path(&file), bytes).unwrap();
        let output = workspace.rogs(&["weights", "list", &file]);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{name}: {said}");
        assert!(said.contains(&file) && !said.contains("panicked"), "{name}: {said}");
    }
    // Good in itself, but of another network: the run says so, for every clip.
    std::fs::write(workspace.path("other.safetensors"), bytes(&tensor(""))).unwrap();
    workspace.write("manifest.toml", &manifest);
    let (code, text) = altered(&workspace, "data/compact-stage1.safetensors", "other.safetensors");
    assert_eq!(code, Some(1), "{text}");
    assert!(
        text.contains("at lift: ") && text.contains("other.safetensors"),
        "{text}"
    );
}

#[test]
fn environments() {
    let workspace = Workspace::small(1);
    let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    let short = manifest.replacen("[run]\n", "[run]\nstages = [\"robot-maps\"]\n", 1);
    workspace.write("manifest.toml", &short);
    assert_eq!(
        workspace.rogs(&["run", "manifest.toml", "--no-report"]).status.code(),
        Some(0)
    );
    let expected = workspace.outputs("run");
    // A decimal comma, another zone, no home, a senseless number of threads.
    workspace.write("strange.toml", &short.replace("/run\"", "/strange\""));
    let output = Command::new(ROGS)
        .args(["run", "strange.toml", "--no-report"])
        .current_dir(workspace.path("."))
        .env_remove("HOME")
        .envs([
            ("LC_ALL", "de_DE.UTF-8"),
            ("LANG", "de_DE.UTF-8"),
            ("TZ", "Pacific/Chatham"),
            ("RAYON_NUM_THREADS", "0"),
        ])
        .output()
        .unwrap();
    assert_eq!(
        output.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(
        workspace.outputs("strange") == expected,
        "the environment changed outputs"
    );
    // A folder whose name is no text: refused in words, or used as it is; never a panic.
    #[cfg(target_os = "linux")]
    {
        use std::os::unix::ffi::OsStrExt as _;
        let folder = workspace.path(".").join(std::ffi::OsStr::from_bytes(b"d\xffr"));
        std::fs::create_dir(&folder).unwrap();
        let output = Command::new(ROGS).arg("status").arg(&folder).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains("is no run folder"), "{said}");
        std::fs::copy(workspace.path("manifest.toml"), folder.join("m.toml")).unwrap();
        let relative = short.replace(&format!("{:?}", workspace.path("run")), "\"out\"");
        std::fs::write(folder.join("m.toml"), relative).unwrap();
        let output = Command::new(ROGS)
            .arg("run")
            .arg(folder.join("m.toml"))
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!said.contains("panicked") && said.contains("error: "), "{said}");
    }
}

#[test]
fn reports_show_names_and_run_none_of_them() {
    let mut cases = Cases::new();
    let script = "<script>alert(1)</script><img src=x onerror=alert(1)>";
    cases.edited("script", Nothing, |episode| {
        episode["episode_id"] = "<b>&\"bold\"".into();
        episode["task"] = script.into();
    });
    cases.edited("failing", Failure("\"<i>\"", ""), |episode| {
        episode["robot"]["states"] = "<i>".into()
    });
    let output = cases.workspace.rogs(&["run", "manifest.toml", "--json"]);
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    let html = std::fs::read_to_string(summary["report"].as_str().unwrap()).unwrap();
    assert!(html.contains("Content-Security-Policy") && html.contains("default-src 'none'"));
    for text in ["<script", "<img src=x", "<b>&", "<i>"] {
        assert!(!html.contains(text), "`{text}` is in the page as it is");
    }
    assert!(html.contains("&lt;i&gt;"), "what failed is told");
}
