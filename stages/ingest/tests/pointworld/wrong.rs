//! Every way of getting a cache wrong, with the message.

use std::path::PathBuf;

use rogs_ingest::PointWorldFiles;
use rogs_synth::{Hdf5Group, Hdf5Kind};
use serde_json::{Value, json};

use crate::{Cached, changed};

/// What is said of the episode with this file instead of the right one.
fn said(cached: &Cached, role: &str, file: PathBuf) -> String {
    let mut files = PointWorldFiles::default();
    match role {
        "cameras" => files.cameras = Some(file),
        "depth" => files.depth = Some(file),
        _ => {
            files.depth = cached.files().depth;
            files.flows = Some(file);
        }
    }
    cached.read(&files).unwrap_err()
}

#[track_caller]
fn has(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "`{part}` is not in: {message}");
    }
}

#[test]
fn cameras() {
    let cached = Cached::new();
    let path = cached.files().cameras.unwrap();
    let with = |change: &dyn Fn(&mut Value)| {
        let file = changed(&path, |bytes| {
            let mut value: Value = serde_json::from_slice(bytes).unwrap();
            change(&mut value);
            *bytes = value.to_string().into_bytes();
        });
        said(&cached, "cameras", file)
    };
    // The other direction: camera-to-base where base-to-camera is kept.
    let inverted = with(&|file| {
        let own = crate::camera_pose(&cached, 1);
        file["ext1"]["optimized_extrinsics"] = json!(own);
    });
    has(
        &inverted,
        &[
            "`optimized_extrinsics` of `ext1` is camera-to-base",
            "invert the matrix",
        ],
    );
    let millimetres = with(&|file| {
        for row in 0..3 {
            let value = file["ext1"]["optimized_extrinsics"][row][3].as_f64().unwrap();
            file["ext1"]["optimized_extrinsics"][row][3] = json!(1000.0 * value);
        }
    });
    has(&millimetres, &["`optimized_extrinsics` of `ext1`", "millimetres?"]);
    let exchanged = with(&|file| {
        let (first, second) = (file["ext1"].clone(), file["ext2"].clone());
        file["ext1"] = second;
        file["ext2"] = first;
    });
    has(
        &exchanged,
        &[
            "`optimized_extrinsics` of `ext1` stands where the episode has `ext2`",
            "are the serials of two cameras exchanged",
        ],
    );
    let gate = with(&|file| file["optimization_summary"]["final_loss"] = json!(0.1));
    has(&gate, &["a loss of 0.1; below 0.1 is taken", "pointworld.max_loss"]);
    let failed = with(&|file| file["optimization_success"] = json!(false));
    has(&failed, &["ended without success, with a loss of 0.01"]);
    let no_loss = with(&|file| file["optimization_summary"] = json!(null));
    has(&no_loss, &["no `optimization_summary.final_loss`"]);
    let other = with(&|file| file["uuid"] = json!("LAB+x"));
    has(&other, &["it is of episode `LAB+x`, not of `synth-00000011`"]);
    let rows = with(&|file| file["ext1"]["optimized_extrinsics"] = json!([[1, 0, 0, 0]]));
    has(&rows, &["`optimized_extrinsics` of `ext1`"]);
    let none = with(&|file| {
        file.as_object_mut().unwrap().remove("ext1");
        file.as_object_mut().unwrap().remove("ext2");
    });
    has(
        &none,
        &["no `optimized_extrinsics` of a fixed camera of the episode (wrist, ext1, ext2"],
    );
    let cut = changed(&path, |bytes| bytes.truncate(bytes.len() / 2));
    has(&said(&cached, "cameras", cut), &["not a PointWorld camera file"]);
}

/// A depth file of one camera.
fn depth_file(maps: usize, change: impl FnOnce(&mut Hdf5Group)) -> Vec<u8> {
    let mut root = Hdf5Group::default();
    root.group("metadata")
        .text("uuid", "synth-00000011")
        .truth("write_complete", true);
    let group = root.group("ext1+ext");
    let values: Vec<u8> = std::iter::repeat_n(1500_u16.to_le_bytes(), maps * 42 * 70)
        .flatten()
        .collect();
    group.dataset("depth", &[maps, 42, 70], Hdf5Kind::U16, values, Some(true));
    let times: Vec<u8> = (0..maps)
        .flat_map(|frame| ((frame * 1000 / 15) as i64).to_le_bytes())
        .collect();
    group.dataset("timestamps", &[maps], Hdf5Kind::I64, times, Some(true));
    change(&mut root);
    root.file()
}

#[test]
fn depth() {
    let cached = Cached::new();
    let path = cached.files().depth.unwrap();
    let with = |change: &dyn Fn(&mut Hdf5Group)| {
        said(
            &cached,
            "depth",
            changed(&path, |bytes| *bytes = depth_file(33, change)),
        )
    };
    let u16s = |value: u16| -> Vec<u8> {
        std::iter::repeat_n(value.to_le_bytes(), 33 * 42 * 70)
            .flatten()
            .collect()
    };
    let flag = with(&|root| {
        root.group("ext1+ext")
            .dataset("depth", &[33, 42, 70], Hdf5Kind::U16, u16s(900), None)
    });
    has(
        &flag,
        &[
            "`ext1+ext/depth`: `write_complete` is missing: its writer did not finish",
            "fetch or make",
        ],
    );
    let unfinished = with(&|root| {
        root.group("ext1+ext")
            .dataset("depth", &[33, 42, 70], Hdf5Kind::U16, u16s(900), Some(false));
    });
    has(&unfinished, &["`write_complete` is false"]);
    let metres = with(&|root| {
        root.group("ext1+ext")
            .dataset("depth", &[33, 42, 70], Hdf5Kind::U16, u16s(2), Some(true));
    });
    has(&metres, &["reaches 2 mm at most", "were these metres?"]);
    let floats = with(&|root| {
        let values: Vec<u8> = std::iter::repeat_n(1.5_f32.to_le_bytes(), 33 * 42 * 70)
            .flatten()
            .collect();
        root.group("ext1+ext")
            .dataset("depth", &[33, 42, 70], Hdf5Kind::F32, values, Some(true));
    });
    has(&floats, &["holds fractions: expected whole millimetres (uint16)"]);
    let aspect = with(&|root| {
        root.group("ext1+ext").dataset(
            "depth",
            &[33, 42, 56],
            Hdf5Kind::U16,
            u16s(900)[..33 * 42 * 56 * 2].to_vec(),
            Some(true),
        );
    });
    has(&aspect, &["maps of 56x42, the images of camera `ext1` are 70x42"]);
    for shape in [[33, 0, 70], [33, 42, 0], [33, 0, 0]] {
        let empty = with(&|root| {
            root.group("ext1+ext")
                .dataset("depth", &shape, Hdf5Kind::U16, Vec::new(), Some(true));
        });
        has(&empty, &["pixels: impossible"]);
    }
    let clock = with(&|root| {
        let times: Vec<u8> = (0..33_i64)
            .flat_map(|frame| (1_690_000_000_000 + 66 * frame).to_le_bytes())
            .collect();
        root.group("ext1+ext")
            .dataset("timestamps", &[33], Hdf5Kind::I64, times, Some(true));
    });
    has(&clock, &["none of its 33 maps is within 20 ms of an image"]);
    let order = with(&|root| {
        let times: Vec<u8> = (0..33_i64).rev().flat_map(|frame| (66 * frame).to_le_bytes()).collect();
        root.group("ext1+ext")
            .dataset("timestamps", &[33], Hdf5Kind::I64, times, Some(true));
    });
    has(&order, &["its timestamps do not ascend"]);
    let other = with(&|root| {
        *root = Hdf5Group::default();
        root.group("metadata")
            .text("uuid", "LAB+x")
            .truth("write_complete", true);
    });
    has(&other, &["it is of episode `LAB+x`"]);
    let cut = changed(&path, |bytes| bytes.truncate(bytes.len() - 1000));
    has(&said(&cached, "depth", cut), &["cut off"]);
    let text = changed(&path, |bytes| *bytes = b"no HDF5".to_vec());
    has(&said(&cached, "depth", text), &["synth-00000011_depth.h5"]);
}

/// A file of tracks with two points of one camera in one clip.
fn flows_file(cached: &Cached, name: &str, change: impl FnOnce(&mut Hdf5Group)) -> Vec<u8> {
    let mut root = Hdf5Group::default();
    let clock: Vec<i64> = (0..17).map(|frame| 2000 * frame / 15).collect();
    root.text("uuid", "synth-00000011")
        .text("canonical_timestamps", &format!("{clock:?}"));
    if !name.is_empty() {
        let clip = root.group(name);
        let states = (0..11).map(|frame| &cached.episode.states[2 * frame]);
        let joints: Vec<u8> = states
            .flat_map(|state| state.joints)
            .flat_map(|joint| (joint as f32).to_le_bytes())
            .collect();
        clip.dataset("joint_positions", &[11, 7], Hdf5Kind::F32, joints, Some(true));
        let camera = clip.group("camera_ext1_ext");
        let points: Vec<u8> = std::iter::repeat_n([0.5_f32, 0.0, 0.3], 22)
            .flatten()
            .flat_map(f32::to_le_bytes)
            .collect();
        camera.dataset("scene_flows", &[11, 2, 3], Hdf5Kind::F32, points, Some(true));
        camera.dataset("scene_visibility", &[11, 2], Hdf5Kind::Truth, vec![1; 22], Some(true));
        camera.dataset(
            "scene_depth_valid_mask",
            &[11, 2],
            Hdf5Kind::Truth,
            vec![1; 22],
            Some(true),
        );
        camera.dataset(
            "initial_depth",
            &[42, 70],
            Hdf5Kind::U16,
            vec![1; 2 * 42 * 70],
            Some(true),
        );
        let k = cached.episode.cameras[1].lens.intrinsics;
        let intrinsic = [k.fx, 0.0, k.cx - 0.5, 0.0, k.fy, k.cy - 0.5, 0.0, 0.0, 1.0];
        let bytes = |values: &[f64]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
        camera.dataset("intrinsic", &[3, 3], Hdf5Kind::F64, bytes(&intrinsic), Some(true));
        let world_to_camera = crate::inverse_pose(cached, 1);
        camera.dataset(
            "extrinsic",
            &[4, 4],
            Hdf5Kind::F64,
            bytes(&world_to_camera.concat()),
            Some(true),
        );
    }
    change(&mut root);
    root.file()
}

#[test]
fn flows() {
    let cached = Cached::new();
    let path = cached.files().flows.unwrap();
    let with = |name: &str, change: &dyn Fn(&mut Hdf5Group)| {
        said(
            &cached,
            "flows",
            changed(&path, |bytes| *bytes = flows_file(&cached, name, change)),
        )
    };
    let camera = |root: &mut Hdf5Group| root.group("0:11").group("camera_ext1_ext").clone();
    let put = |root: &mut Hdf5Group, camera: Hdf5Group| *root.group("0:11").group("camera_ext1_ext") = camera;
    has(
        &with("7:18", &|_| {}),
        &["the clip `7:18` lies outside of the 17 canonical frames"],
    );
    has(&with("11:0", &|_| {}), &["the clip `11:0` lies outside"]);
    has(&with("first", &|_| {}), &["invalid clip `first`: expected START:END"]);
    has(&with("", &|_| {}), &["it has no clips"]);
    let flag = with("0:11", &|root| {
        let mut own = camera(root);
        own.dataset("scene_visibility", &[11, 2], Hdf5Kind::Truth, vec![1; 22], None);
        put(root, own);
    });
    has(
        &flag,
        &["`0:11/camera_ext1_ext/scene_visibility`: `write_complete` is missing"],
    );
    let millimetres = with("0:11", &|root| {
        let mut own = camera(root);
        let points: Vec<u8> = std::iter::repeat_n([500.0_f32, 0.0, 300.0], 22)
            .flatten()
            .flat_map(f32::to_le_bytes)
            .collect();
        own.dataset("scene_flows", &[11, 2, 3], Hdf5Kind::F32, points, Some(true));
        put(root, own);
    });
    has(&millimetres, &["has a point 500 m away", "were these millimetres?"]);
    let inverted = with("0:11", &|root| {
        let mut own = camera(root);
        let pose: Vec<u8> = crate::camera_pose(&cached, 1)
            .concat()
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        own.dataset("extrinsic", &[4, 4], Hdf5Kind::F64, pose, Some(true));
        put(root, own);
    });
    has(&inverted, &["extrinsic` is camera-to-base"]);
    let joints = with("0:11", &|root| {
        root.group("0:11").dataset(
            "joint_positions",
            &[11, 7],
            Hdf5Kind::F32,
            vec![0; 11 * 7 * 4],
            Some(true),
        );
    });
    has(
        &joints,
        &[
            "`0:11/joint_positions` is 0.000 rad for `panda_joint",
            "the clocks differ",
        ],
    );
    let shape = with("0:11", &|root| {
        root.group("0:11").dataset(
            "joint_positions",
            &[10, 7],
            Hdf5Kind::F32,
            vec![0; 10 * 7 * 4],
            Some(true),
        );
    });
    has(&shape, &["0:11/joint_positions"]);
    let clock = with("0:11", &|root| {
        root.text("canonical_timestamps", "soon");
    });
    has(&clock, &["canonical_timestamps"]);
}

#[test]
fn clips_are_ordered_by_their_numbers_and_the_best_one_is_taken() {
    // As texts, 100:111 comes before 20:31. Both are there, and only the second lies in the clip.
    let cached = Cached::new();
    let path = cached.files().flows.unwrap();
    let file = changed(&path, |bytes| {
        *bytes = flows_file(&cached, "0:11", |root| {
            let clock: Vec<i64> = (0..140).map(|frame| 2000 * frame / 15).collect();
            root.text("canonical_timestamps", &format!("{clock:?}"));
            root.group("100:111");
            root.group("20:31");
        });
    });
    let files = PointWorldFiles {
        depth: cached.files().depth,
        flows: Some(file),
        cameras: None,
    };
    let (clip, _) = cached.read(&files).unwrap();
    let tracks = clip.tracks.unwrap();
    // A file that does not say what made it is PointWorld's own.
    assert_eq!((tracks.camera.len(), tracks.origin.name()), (2, "point-tracker"));
}

#[test]
fn shards() {
    let cached = Cached::new();
    let shard = cached.path("cache/000000.tar");
    rogs_synth::write_pointworld_shard(&shard, &cached.episode).unwrap();
    let told = |change: &dyn Fn(&mut Vec<u8>)| said(&cached, "flows", changed(&shard, change));
    has(
        &told(&|bytes| bytes.truncate(bytes.len() - 1024)),
        &["it is cut off: an archive ends in a block of zeros"],
    );
    has(&told(&|bytes| bytes.truncate(bytes.len() / 2)), &["it is cut off"]);
    has(
        &told(&|bytes| bytes[0] = b'x'),
        &["no tar archive: a damaged header at byte 0"],
    );
    // Names without their checksum are not believed; here both are changed.
    let renamed = |from: &str, to: &str| {
        told(&|bytes| {
            let starts: Vec<usize> = (0..bytes.len()).step_by(512).collect();
            for at in starts {
                let header = &mut bytes[at..at + 512];
                if header[257..262] != *b"ustar" {
                    continue;
                }
                let end = header.iter().position(|&byte| byte == 0).unwrap();
                let name = String::from_utf8(header[..end].to_vec()).unwrap().replace(from, to);
                header[..100].fill(0);
                header[..name.len()].copy_from_slice(name.as_bytes());
                header[148..156].fill(b' ');
                let sum: u32 = header.iter().map(|&byte| u32::from(byte)).sum();
                header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
            }
        })
    };
    has(
        &renamed("synth-00000011", "synth-00000012"),
        &["it has no clips of `synth-00000011`"],
    );
    has(
        &renamed("-0:11", "-11:0"),
        &["the clip `synth-00000011-11:0` lies outside"],
    );
    has(
        &renamed("_scene_visibility", "_scene_seen"),
        &["camera_ext1_ext_scene_visibility.npy`: it is missing"],
    );
    has(
        &renamed("joint_positions", "joints"),
        &["joint_positions.npy`: it is missing"],
    );
}

#[test]
fn two_files_of_one_kind_are_refused() {
    let cached = Cached::new();
    let own = cached.files().depth.unwrap();
    let other = cached.path("cache/copies").join(own.file_name().unwrap());
    std::fs::create_dir(cached.path("cache/copies")).unwrap();
    std::fs::copy(own, other).unwrap();
    let error = rogs_ingest::list_references(&cached.path("cache"))
        .unwrap_err()
        .to_string();
    has(&error, &["is of the same episode and kind", "_depth.h5"]);
}
