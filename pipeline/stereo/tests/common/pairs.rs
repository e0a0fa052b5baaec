//! Pairs with known depth: procedural ones, whose truth is exact, and recorded ones with the depth of their camera; and what
//! OpenCV's SGBM makes of them.

#![allow(dead_code)] // Every program takes what it needs.

use std::path::{Path, PathBuf};
use std::process::Command;

use rogs_needs::shared;
use rogs_stereo::{Concern, Grey, MatcherParams, Rig, diagnose, match_offset_pair};
use rogs_synth::{CAMERA_NAMES, SynthConfig, generate_episode};

use super::common::{Agreement, compare};

/// Seeds of the procedural episodes that settings are searched on, and whose figures docs/references.md has.
pub(crate) const TUNED: [u64; 2] = [501, 503];
/// Seeds of episodes that no setting was chosen with.
pub(crate) const HELD_OUT: [u64; 4] = [601, 607, 613, 617];
/// Cameras with a right eye.
pub(crate) const CAMERAS: [&str; 3] = ["wrist", "ext1", "ext2"];

/// A pair with its true depth.
pub(crate) struct Pair {
    pub(crate) name: String,
    eyes: [Grey; 2],
    rig: Rig,
    pub(crate) params: MatcherParams,
    /// Camera z of the left eye, metres, NaN where unknown. `[H, W]`
    pub(crate) truth_m: Vec<f64>,
}

impl Pair {
    /// Depth of the left eye by the matcher, metres.
    pub(crate) fn ours(&self) -> Vec<f64> {
        self.matched(&self.params)
    }

    /// The same with other settings.
    pub(crate) fn matched(&self, params: &MatcherParams) -> Vec<f64> {
        let [left, right] = &self.eyes;
        let found = match_offset_pair(left, right, self.rows_px(), &self.rig, params).unwrap();
        found
            .left_px
            .iter()
            .map(|&value| f64::from(self.rig.depth_m(value)))
            .collect()
    }

    /// By how many rows the right eye shows everything lower, 0 where it is rectified.
    pub(crate) fn rows_px(&self) -> f32 {
        let [left, right] = &self.eyes;
        match diagnose(left, right, &self.rig, &self.params).unwrap()[..] {
            [] => 0.0,
            [Concern::Rows { rows_px, .. }] => rows_px,
            ref concerns => panic!("{}: {concerns:?}", self.name),
        }
    }

    /// Depth of the left eye by OpenCV, which is given the same offset of rows, by the script in `tests/peers`.
    pub(crate) fn peers(pairs: &[Self]) -> Vec<Vec<f64>> {
        let folder = tempfile::tempdir().unwrap();
        let path = |index: usize, what: &str| folder.path().join(format!("{index}-{what}"));
        let python = std::env::var("ROGS_PEER_PYTHON").unwrap_or_else(|_| "python3".into());
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/sgbm.py");
        let mut command = Command::new(python);
        command.arg(script);
        for (index, pair) in pairs.iter().enumerate() {
            for (eye, image) in ["left.png", "right.png"].iter().zip(&pair.eyes) {
                let (width, height) = (image.width() as u32, image.height() as u32);
                image::save_buffer(path(index, eye), image.pixels(), width, height, image::ColorType::L8).unwrap();
                command.arg(path(index, eye));
            }
            let nearest = pair.rig.disparity_px(pair.params.near_m).ceil();
            command
                .arg(nearest.min(256.0).to_string())
                .arg(pair.rows_px().to_string());
            command.arg(path(index, "out"));
        }
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let read = |(index, pair): (usize, &Self)| {
            let bytes = std::fs::read(path(index, "out")).unwrap();
            let values = bytes.as_chunks::<4>().0.iter().map(|&bytes| f32::from_le_bytes(bytes));
            values.map(|value| f64::from(pair.rig.depth_m(value))).collect()
        };
        pairs.iter().enumerate().map(read).collect()
    }

    pub(crate) fn agreement(&self, found: &[f64]) -> Agreement {
        compare(found.iter().copied(), self.truth_m.iter().copied())
    }
}

/// The mean over pairs.
pub(crate) fn mean(agreements: &[Agreement]) -> Agreement {
    let of = |value: fn(&Agreement) -> f64| agreements.iter().map(value).sum::<f64>() / agreements.len() as f64;
    Agreement {
        coverage: of(|own| own.coverage),
        absrel: of(|own| own.absrel),
        median: of(|own| own.median),
        count: agreements.iter().map(|own| own.count).sum(),
    }
}

/// Left and right eyes of one camera of procedural episodes of some seeds, at two frames each.
pub(crate) fn procedural(camera: &str, seeds: &[u64]) -> Vec<Pair> {
    let config = SynthConfig {
        frames: 8,
        ..SynthConfig::default()
    };
    let at = CAMERA_NAMES.iter().position(|name| *name == camera).unwrap();
    let mut pairs = Vec::new();
    for &seed in seeds {
        let episode = generate_episode(&config, seed).unwrap();
        for frame in [0, 5] {
            let views = episode.render_cameras(frame, &[at, at + 3]);
            let lens = episode.cameras[at].lens;
            let eye =
                |index: usize| Grey::of_rgb(lens.width as usize, lens.height as usize, &views[index].rgb).unwrap();
            let pose = |index: usize| episode.base_from_camera(index, frame);
            let left_from_right = pose(at).inverse() * pose(at + 3);
            let rig = Rig::new(&lens, &episode.cameras[at + 3].lens, &left_from_right).unwrap();
            pairs.push(Pair {
                name: format!("{camera} of seed {seed}, frame {frame}"),
                eyes: [eye(0), eye(1)],
                rig,
                params: MatcherParams::default(),
                truth_m: views[0].depth_m.iter().map(|&depth| f64::from(depth)).collect(),
            });
        }
    }
    pairs
}

/// The real pairs of an LBR Med7 before a ZED 2i, with the ZED's own depth.
pub(crate) fn recorded() -> Vec<Pair> {
    let root: PathBuf = shared!("data/roboreg_lbr");
    let text = std::fs::read_to_string(root.join("extrinsics.json")).unwrap();
    let about: serde_json::Value = serde_json::from_str(&text).unwrap();
    let rig = Rig {
        focal_px: about["cameras"]["left"]["intrinsic"][0][0].as_f64().unwrap(),
        baseline_m: about["cameras"]["right"]["left_from_right_translation_m"][0]
            .as_f64()
            .unwrap(),
        shift_px: 0.0,
    };
    let pair = |number: usize| {
        let open = |path: String| image::open(root.join(path)).unwrap();
        let eye = |side: &str| {
            let image = open(format!("images/{side}_image_{number}.png")).into_luma8();
            Grey::new(image.width() as usize, image.height() as usize, image.into_raw()).unwrap()
        };
        let millimetres = open(format!("depth/left_depth_{number}.png")).into_luma16().into_raw();
        let metres = |value: u16| {
            if value == 0 {
                f64::NAN
            } else {
                f64::from(value) / 1000.0
            }
        };
        Pair {
            name: format!("LBR pair {number}"),
            eyes: [eye("left"), eye("right")],
            rig,
            params: MatcherParams {
                near_m: 0.5,
                ..MatcherParams::default()
            },
            truth_m: millimetres.into_iter().map(metres).collect(),
        }
    };
    (0..5).map(pair).collect()
}
