//! A small own episode.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
#![allow(dead_code, reason = "each test file uses some of it")]

pub(crate) mod tables;

use std::path::{Path, PathBuf};

use rogs_schemas::episode::{
    EPISODE_FORMAT, Episode, EpisodeCamera, EpisodeCameraRole, EpisodeDepth, EpisodeMount, EpisodeRobot, EpisodeTracks,
    PixelCentres,
};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::{EpisodeFrame, Intrinsics, RigidPose, WrittenPose};

pub(crate) const FRAMES: u32 = 20;
pub(crate) const WIDTH: u32 = 40;
pub(crate) const HEIGHT: u32 = 22;

/// A folder that goes away with the value.
pub(crate) struct Scratch(pub(crate) PathBuf);

impl Scratch {
    pub(crate) fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("rogs-ingest-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Colour of a pixel of camera `camera` at a frame: smooth, so that resizing keeps it.
pub(crate) fn colour(camera: u8, frame: u32, x: u32, y: u32) -> [u8; 3] {
    [(4 * x) as u8, (8 * y) as u8, 40 * camera + 3 * frame as u8]
}

fn camera(id: &str, role: EpisodeCameraRole, mount: EpisodeMount) -> EpisodeCamera {
    EpisodeCamera {
        id: id.into(),
        role,
        partner: None,
        images: Some(id.into()),
        width: WIDTH,
        height: HEIGHT,
        intrinsics: Intrinsics {
            fx: 20.0,
            fy: 21.0,
            cx: 20.0,
            cy: 11.0,
        },
        pixel_centres: PixelCentres::Half,
        mount,
        depth: None,
    }
}

pub(crate) fn pose(x: f64) -> RigidPose {
    RigidPose {
        rotation: [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        translation: [x, 0.25, 0.5],
    }
}

/// The description of the small episode.
pub(crate) fn description() -> Episode {
    let matrix = |x| WrittenPose::from(pose(x));
    let hand_eye = EpisodeMount::HandEye {
        link: "panda_link8".into(),
        link_from_camera: matrix(0.0),
    };
    let mut ext1 = camera(
        "ext1",
        EpisodeCameraRole::Source,
        EpisodeMount::Fixed {
            base_from_camera: matrix(1.0),
        },
    );
    ext1.depth = Some(EpisodeDepth {
        path: "ext1_depth.npy".into(),
        unit_m: None,
        range_m: [0.2, 4.0],
        origin: ReferenceOrigin::DepthCamera,
    });
    let trajectory = EpisodeMount::Trajectory {
        base_from_camera: "right.npy".into(),
    };
    let mut right = camera("ext1_right", EpisodeCameraRole::Evaluation, trajectory);
    right.partner = Some("ext1".into());
    right.pixel_centres = PixelCentres::Integer;
    right.depth = Some(EpisodeDepth {
        path: "right_depth".into(),
        unit_m: None,
        range_m: [0.1, 5.0],
        origin: ReferenceOrigin::NotStated,
    });
    Episode {
        format: EPISODE_FORMAT.into(),
        episode_id: "LAB+a+2026-01-31-12h:00m".into(),
        fps: 15.0,
        frame_count: FRAMES,
        task: "turn".into(),
        calibration_note: "exact".into(),
        robot: EpisodeRobot {
            joint_names: vec!["j1".into(), "j2".into()],
            states: "joints.csv".into(),
            model: None,
        },
        cameras: vec![camera("wrist", EpisodeCameraRole::Source, hand_eye), ext1, right],
        tracks: Some(EpisodeTracks {
            anchor_frame: EpisodeFrame(2),
            camera: "tracks/camera.npy".into(),
            pixel: "tracks/pixel.npy".into(),
            position_m: "tracks/position.npy".into(),
            visible: "tracks/visible.npy".into(),
            origin: ReferenceOrigin::PointTracker,
        }),
    }
}

pub(crate) fn write_description(folder: &Path, episode: &Episode) {
    std::fs::write(
        folder.join("episode.json"),
        serde_json::to_string_pretty(episode).unwrap(),
    )
    .unwrap();
}

/// `descr` is numpy's name of the type.
pub(crate) fn npy(path: &Path, descr: &str, shape: &[usize], bytes: &[u8]) {
    let dims: String = shape.iter().map(|dim| format!("{dim}, ")).collect();
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({dims}), }}");
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((header.len() as u16).to_le_bytes());
    file.extend(header.as_bytes());
    file.extend(bytes);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, file).unwrap();
}

pub(crate) fn f32_bytes(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    values.into_iter().flat_map(f32::to_le_bytes).collect()
}

pub(crate) fn write_png(path: &Path, camera: u8, frame: u32) {
    image::RgbImage::from_fn(WIDTH, HEIGHT, |x, y| image::Rgb(colour(camera, frame, x, y)))
        .save(path)
        .unwrap();
}

/// Depth in metres of camera ext1.
pub(crate) fn depth(frame: u32, x: u32, y: u32) -> f32 {
    if x == 0 {
        0.0
    } else {
        0.5 + frame as f32 * 0.01 + y as f32 * 0.001
    }
}

/// Writes the whole episode.
pub(crate) fn write_episode(folder: &Path) {
    let episode = description();
    write_description(folder, &episode);
    for (number, camera) in (0u8..).zip(&episode.cameras) {
        let images = folder.join(&camera.id);
        std::fs::create_dir_all(&images).unwrap();
        (0..FRAMES).for_each(|frame| write_png(&images.join(format!("{frame:06}.png")), number, frame));
    }
    let mut csv = "time,gripper,j2,j1\n".to_owned();
    for frame in 0..FRAMES {
        let t = f64::from(frame);
        csv += &format!("{},{},{},{}\n", t / 15.0, t / 19.0, -0.02 * t, 0.01 * t);
    }
    std::fs::write(folder.join("joints.csv"), csv).unwrap();
    let pixels = || (0..FRAMES).flat_map(|f| (0..HEIGHT).flat_map(move |y| (0..WIDTH).map(move |x| (f, x, y))));
    let metres = f32_bytes(pixels().map(|(f, x, y)| depth(f, x, y)));
    npy(
        &folder.join("ext1_depth.npy"),
        "<f4",
        &[FRAMES as usize, HEIGHT as usize, WIDTH as usize],
        &metres,
    );
    std::fs::create_dir_all(folder.join("right_depth")).unwrap();
    for frame in 0..FRAMES {
        let path = folder.join(format!("right_depth/{frame:06}.png"));
        image::ImageBuffer::<image::Luma<u16>, _>::from_fn(WIDTH, HEIGHT, |x, _| image::Luma([x as u16 * 100]))
            .save(path)
            .unwrap();
    }
    let matrices = (0..FRAMES).flat_map(|frame| {
        let WrittenPose::Matrix(rows) = WrittenPose::from(pose(f64::from(frame) * 0.1)) else {
            panic!("a matrix")
        };
        rows.into_iter().flatten()
    });
    npy(
        &folder.join("right.npy"),
        "<f8",
        &[FRAMES as usize, 4, 4],
        &matrices.flat_map(f64::to_le_bytes).collect::<Vec<u8>>(),
    );
    let tracks = folder.join("tracks");
    npy(
        &tracks.join("camera.npy"),
        "<i8",
        &[3],
        &[0i64, 1, 1].into_iter().flat_map(i64::to_le_bytes).collect::<Vec<u8>>(),
    );
    npy(
        &tracks.join("pixel.npy"),
        "<f4",
        &[3, 2],
        &f32_bytes([10.5, 3.5, 39.5, 21.5, 0.5, 0.5]),
    );
    let positions = (0..3 * FRAMES * 3).map(|value| value as f32 * 0.001);
    npy(
        &tracks.join("position.npy"),
        "<f4",
        &[3, FRAMES as usize, 3],
        &f32_bytes(positions),
    );
    let visible: Vec<u8> = (0..3 * FRAMES).map(|value| u8::from(value % 2 == 0)).collect();
    npy(&tracks.join("visible.npy"), "|b1", &[3, FRAMES as usize], &visible);
}
