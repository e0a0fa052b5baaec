//! A small scene whose scores are known, and a way to run the program `rogs-score` on it: a wall one metre in front of the
//! wrist camera that moves sideways, half a centimetre a frame.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
#![allow(dead_code)] // Every test program uses a part.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use rogs_geometry::{Base, Camera, Pose};
use rogs_r4c::{Record, read_record, write_record};
use rogs_schemas::key::{KeyMaterial, Provenance};
use rogs_schemas::protocol::{Job, JobId};
use rogs_schemas::records::clip::{
    CameraMount, CameraRole, Clip, ClipCamera, DepthReference, RobotStates, SourceView, Tracks,
};
use rogs_schemas::records::field::{Field, TimeSlice, WeightsInfo};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::records::refinement::{RESIDUAL_CHANNELS, Refinement, RefinementStep, ScaleResidual};
use rogs_schemas::records::robot::{NO_LINK, RobotMap, RobotMaps};
use rogs_schemas::records::scores::Scores;
use rogs_schemas::{CameraIndex, EpisodeFrame, FrameIndex, Intrinsics, RigidPose};
use rogs_worker::Stage as _;

pub(crate) const HEIGHT: usize = 24;
pub(crate) const WIDTH: usize = 32;
pub(crate) const FRAMES: usize = 17;
pub(crate) const QUERIES: [u32; 3] = [0, 4, 9];
pub(crate) const STEP_M: f32 = 0.005;
/// Camera x is base -y, camera y is base -z, camera z is base x: a camera that looks along base x.
pub(crate) const LOOKING_ALONG_X: RigidPose = RigidPose {
    rotation: [0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0],
    translation: [0.3, 0.1, 0.5],
};

pub(crate) fn intrinsics() -> Intrinsics {
    Intrinsics {
        fx: 30.0,
        fy: 30.0,
        cx: 16.0,
        cy: 12.0,
    }
}

pub(crate) fn clip(with_references: bool) -> Clip {
    let camera = |id: &str, role, partner, references: bool| ClipCamera {
        id: id.into(),
        role,
        partner,
        intrinsics: intrinsics(),
        mount: CameraMount::Fixed {
            base_from_camera: LOOKING_ALONG_X,
        },
        recorded: references.then(|| vec![128; FRAMES * HEIGHT * WIDTH * 3]),
        generated: None,
        depth: references.then(|| {
            let mut depth_m = vec![1.02; FRAMES * HEIGHT * WIDTH];
            depth_m[0] = f32::NAN;
            depth_m[1] = 5.0;
            DepthReference {
                depth_m,
                range_m: [0.1, 5.0],
                origin: ReferenceOrigin::DepthCamera,
            }
        }),
    };
    // In camera axes the wall moves along x, which is base -y.
    let position = |frame: usize, column: f32, row: f32| {
        let (x, y) = (
            (column + 0.5 - 16.0) / 30.0 + STEP_M * frame as f32,
            (row + 0.5 - 12.0) / 30.0,
        );
        [0.3 + 1.0, 0.1 - x, 0.5 - y]
    };
    let pixels = [[8.0f32, 9.0], [20.0, 14.0], [12.0, 3.0]];
    let mut position_m: Vec<f32> = pixels
        .iter()
        .flat_map(|p| (0..FRAMES).flat_map(move |frame| position(frame, p[0], p[1])))
        .collect();
    // The third track is lost at frame 9.
    position_m[(2 * FRAMES + 9) * 3] = f32::NAN;
    Clip {
        clip_id: "wall".parse().unwrap(),
        episode_id: "wall".into(),
        layout: "rogs-episode".into(),
        task: String::new(),
        calibration_note: String::new(),
        fps: 15.0,
        episode_frames: (0..FRAMES as u32).map(EpisodeFrame).collect(),
        source_frames: [0, 4, 8, 12, 16].map(FrameIndex).to_vec(),
        query_frames: QUERIES.map(FrameIndex).to_vec(),
        anchor_frame: FrameIndex(0),
        height: HEIGHT as u32,
        width: WIDTH as u32,
        cameras: vec![
            camera("wrist", CameraRole::Source, None, with_references),
            camera("wrist_right", CameraRole::Evaluation, Some(CameraIndex(0)), false),
        ],
        robot: RobotStates {
            joint_names: vec![],
            positions: vec![],
            gripper: vec![0.0; FRAMES],
        },
        tracks: with_references.then(|| Tracks {
            anchor_frame: FrameIndex(0),
            camera: vec![CameraIndex(0); 3],
            pixel: pixels.concat(),
            position_m,
            visible: vec![1; 3 * FRAMES],
            origin: ReferenceOrigin::Exact,
        }),
        rollout: None,
    }
}

pub(crate) fn robot() -> RobotMaps {
    let map = |frame: u32| {
        let mut link = vec![3u8; HEIGHT * WIDTH];
        link[..2 * WIDTH].fill(NO_LINK);
        RobotMap {
            camera: CameraIndex(0),
            frame: FrameIndex(frame),
            depth_m: vec![1.01; HEIGHT * WIDTH],
            support: link.iter().map(|&id| u8::from(id != NO_LINK)).collect(),
            link,
        }
    };
    RobotMaps {
        clip_id: "wall".parse().unwrap(),
        link_names: (0..4).map(|index| format!("link{index}")).collect(),
        base_from_link: vec![RigidPose::IDENTITY; FRAMES * 4],
        base_from_camera: vec![LOOKING_ALONG_X; 2 * FRAMES],
        recon_from_base: recon_from_base(),
        tool_m: vec![0.0; FRAMES * 3],
        height: HEIGHT as u32,
        width: WIDTH as u32,
        maps: (0..FRAMES as u32).map(map).collect(),
    }
}

/// The inverse of the wrist pose.
pub(crate) fn recon_from_base() -> RigidPose {
    let base_from_camera: Pose<Base, Camera> = Pose::from_rigid(&LOOKING_ALONG_X).unwrap();
    base_from_camera.inverse().to_rigid()
}

pub(crate) fn weights() -> WeightsInfo {
    WeightsInfo {
        trained: false,
        configuration: "hand".into(),
        description: "made by hand".into(),
        hash: String::new(),
    }
}

/// One Gaussian a pixel, mid grey, about a pixel and a half wide, nearly opaque.
pub(crate) fn field() -> Field {
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
    let grey = libm::atanhf(2.0 * 128.0 / 255.0 - 1.0);
    let raw = [grey, grey, grey, 170.0, 170.0, 1.0, 1.0, 0.0, 0.0, 0.0, 5.0];
    let slice = |frame: u32| TimeSlice {
        time: f64::from(frame) / 16.0,
        displacement_m: (0..n).flat_map(|_| [STEP_M * frame as f32, 0.0, 0.0]).collect(),
        gate: vec![0; n],
        moving_raw: vec![],
    };
    Field {
        clip_id: "wall".parse().unwrap(),
        frame_count: FRAMES as u32,
        height: HEIGHT as u32,
        width: WIDTH as u32,
        views: vec![SourceView {
            camera: CameraIndex(0),
            frame: FrameIndex(0),
        }],
        recon_from_base: recon_from_base(),
        weights: weights(),
        position_m,
        base_raw: raw.repeat(n),
        support: vec![0; n],
        link: vec![NO_LINK; n],
        scale_cap_iu: vec![f32::INFINITY; n],
        slices: QUERIES.into_iter().map(slice).collect(),
        query_state: vec![],
    }
}

/// Darkens every Gaussian.
pub(crate) fn refinement(field: &KeyMaterial) -> Refinement {
    let n = HEIGHT * WIDTH;
    let mut one = [0.0f32; RESIDUAL_CHANNELS];
    for colour in 0..3 {
        one[11 + 16 * colour] = -0.5;
    }
    let step = |update: u32, factor: f32| RefinementStep {
        update,
        touched: vec![1; n],
        values: one.map(|value| value * factor).repeat(n),
    };
    Refinement {
        clip_id: "wall".parse().unwrap(),
        field_key: field.key(),
        gaussian_count: n as u64,
        updates: 2,
        preset: "ci".into(),
        weights: weights(),
        scale_residual: ScaleResidual::PreActivation,
        steps: vec![step(1, 0.5), step(2, 1.0)],
        resume_state: vec![],
    }
}

/// Input files of a job, with their keys as the plan would name them.
pub(crate) struct Bench {
    pub(crate) folder: tempfile::TempDir,
    pub(crate) inputs: BTreeMap<String, PathBuf>,
    pub(crate) keys: BTreeMap<String, String>,
}

impl Bench {
    pub(crate) fn new(clip: &Clip) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut bench = Self {
            folder,
            inputs: BTreeMap::new(),
            keys: BTreeMap::new(),
        };
        bench.add("clip", clip);
        bench.add("robot", &robot());
        bench.add("field", &field());
        bench
    }

    pub(crate) fn add<T: Record>(&mut self, role: &str, record: &T) {
        let material = material(role, T::SCHEMA.to_string(), &serde_json::json!({}), BTreeMap::new());
        let path = self.folder.path().join(format!("{role}.r4c"));
        write_record(
            &path,
            record,
            &Provenance {
                material: material.clone(),
                input_content: BTreeMap::new(),
            },
        )
        .unwrap();
        self.inputs.insert(role.into(), path);
        self.keys.insert(role.into(), material.key().to_string());
    }

    /// LPIPS weights of a network two channels wide.
    pub(crate) fn add_lpips(&mut self) {
        let path = self.folder.path().join("lpips.safetensors");
        std::fs::write(&path, narrow_lpips()).unwrap();
        let hash = rogs_r4c::source::hash_source("lpips", &path).unwrap();
        self.keys.insert("lpips".into(), hash.to_string());
        self.inputs.insert("lpips".into(), path);
    }

    pub(crate) fn add_refinement(&mut self) {
        let field = material(
            "field",
            Field::SCHEMA.to_string(),
            &serde_json::json!({}),
            BTreeMap::new(),
        );
        self.add("refinement", &refinement(&field));
    }

    /// Runs one job and returns the last event and the scores, if there are any.
    pub(crate) fn run(
        &self,
        params: &serde_json::Value,
        threads: &str,
    ) -> (serde_json::Value, Option<Scores>, Vec<u8>) {
        let output = self.folder.path().join("scores.r4c");
        let _ = std::fs::remove_file(&output);
        let filled: rogs_score::ScoreParams = serde_json::from_value(params.clone()).unwrap();
        let params = serde_json::to_value(filled).unwrap();
        let material = material("score", Scores::SCHEMA.to_string(), &params, self.keys.clone());
        let job = Job {
            job: JobId(1),
            clip_id: "wall".parse().unwrap(),
            inputs: self.inputs.clone(),
            output: output.clone(),
            params,
            key: material.key(),
            material,
        };
        let mut child = Command::new(env!("CARGO_BIN_EXE_rogs-score"))
            .arg("worker")
            .env("RAYON_NUM_THREADS", threads)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        writeln!(child.stdin.take().unwrap(), "{}", serde_json::to_string(&job).unwrap()).unwrap();
        let answer = child.wait_with_output().unwrap();
        let text = String::from_utf8(answer.stdout).unwrap();
        let last = serde_json::from_str(text.lines().last().unwrap()).unwrap();
        (last, scores(&output), std::fs::read(&output).unwrap_or_default())
    }
}

/// A weights file of VGG16's layout, two channels wide, with made-up values.
pub(crate) fn narrow_lpips() -> Vec<u8> {
    let value = |seed: usize| ((seed * 37 % 17) as f32 - 7.5) / 10.0;
    let mut tensors: Vec<(String, Vec<usize>, Vec<u8>)> = Vec::new();
    let mut add = |name: String, shape: Vec<usize>, values: Vec<f32>| {
        tensors.push((name, shape, values.iter().flat_map(|v| v.to_le_bytes()).collect()));
    };
    for (layer, place) in [0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28].into_iter().enumerate() {
        let inputs = if layer == 0 { 3 } else { 2 };
        let weight = (0..2 * inputs * 9).map(|k| value(k + layer)).collect();
        add(format!("features.{place}.weight"), vec![2, inputs, 3, 3], weight);
        add(format!("features.{place}.bias"), vec![2], vec![0.1, 0.2]);
    }
    for layer in 0..5 {
        add(format!("lin{layer}.model.1.weight"), vec![1, 2, 1, 1], vec![0.5, 0.25]);
    }
    let views = tensors.iter().map(|(name, shape, bytes)| {
        let view = safetensors::tensor::TensorView::new(safetensors::Dtype::F32, shape.clone(), bytes).unwrap();
        (name.as_str(), view)
    });
    safetensors::serialize(views, None).unwrap()
}

pub(crate) fn scores(path: &Path) -> Option<Scores> {
    path.exists().then(|| read_record::<Scores>(path).unwrap().0)
}

pub(crate) fn material(
    stage: &str,
    schema: String,
    params: &serde_json::Value,
    inputs: BTreeMap<String, String>,
) -> KeyMaterial {
    KeyMaterial {
        stage: stage.into(),
        stage_version: match stage == rogs_score::Score::NAME {
            true => rogs_score::Score::VERSION,
            false => 1,
        },
        schema,
        params: params.to_string(),
        inputs,
    }
}
