//! Small records of every schema, with every optional part.

#![allow(dead_code, reason = "each test file uses some of it")]

use std::collections::BTreeMap;
use std::path::PathBuf;

use rogs_schemas::records::agreement::{
    Agreements, CameraAgreement, Estimate, Offset, TriedMistake, Verdict, ViewAgreement, ViewState,
};
use rogs_schemas::records::clip::{
    CameraMount, CameraRole, Clip, ClipCamera, DepthReference, RobotStates, Rollout, SourceView, Tracks,
};
use rogs_schemas::records::conditioning::{Conditioning, GripperPrior, ViewConditioning};
use rogs_schemas::records::field::{Field, NamedArray, RAW_CHANNELS, TimeSlice, WeightsInfo};
use rogs_schemas::records::motion_bases::{BasisGaussians, MotionBasisField};
use rogs_schemas::records::origin::{ReferenceKind, ReferenceOrigin, ReferenceUse};
use rogs_schemas::records::polynomial::{PolynomialField, Polynomials};
use rogs_schemas::records::progress::Progress;
use rogs_schemas::records::references::{MadeDepth, References};
use rogs_schemas::records::refinement::{RESIDUAL_CHANNELS, Refinement, RefinementStep, ScaleResidual};
use rogs_schemas::records::robot::{NO_LINK, RobotMap, RobotMaps};
use rogs_schemas::records::scores::{
    CrossViewScore, ImageScore, RenderedView, RobotDepthScore, ScoreSheet, Scores, TrackScore,
};
use rogs_schemas::{
    CacheKey, CameraIndex, ContentHash, EpisodeFrame, FrameIndex, Intrinsics, KeyMaterial, Provenance, RigidPose,
};

/// A folder that goes away with the value.
pub(crate) struct Scratch(pub(crate) PathBuf);

impl Scratch {
    pub(crate) fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("rogs-schemas-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

pub(crate) fn provenance(stage: &str) -> Provenance {
    let material = KeyMaterial {
        stage: stage.into(),
        stage_version: 1,
        schema: format!("rogs.{stage} 1.0"),
        params: r#"{"frames":3}"#.into(),
        inputs: BTreeMap::from([("episode".into(), "0123".into())]),
    };
    Provenance {
        material,
        input_content: BTreeMap::from([("clip".into(), ContentHash([7; 32]))]),
    }
}

/// A repeatable sequence of numbers in [0, 1) with 24 bits.
pub(crate) fn noise(seed: u64) -> impl Iterator<Item = f32> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    std::iter::from_fn(move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        Some((state >> 40) as f32 / (1 << 24) as f32)
    })
}

pub(crate) fn floats(seed: u64, count: usize) -> Vec<f32> {
    noise(seed).take(count).collect()
}

pub(crate) fn small_bytes(seed: u64, count: usize, below: f32) -> Vec<u8> {
    noise(seed).take(count).map(|value| (value * below) as u8).collect()
}

pub(crate) fn pose(x: f64) -> RigidPose {
    RigidPose {
        translation: [x, 0.5, -0.25],
        ..RigidPose::IDENTITY
    }
}

pub(crate) fn weights() -> WeightsInfo {
    WeightsInfo {
        trained: false,
        configuration: "compact".into(),
        description: "seeded weights, seed 42".into(),
        hash: String::new(),
    }
}

const HEIGHT: u32 = 3;
const WIDTH: u32 = 5;
const AREA: usize = 15;
const FRAMES: usize = 3;

pub(crate) fn clip() -> Clip {
    let intrinsics = Intrinsics {
        fx: 4.0,
        fy: 4.5,
        cx: 2.5,
        cy: 1.5,
    };
    let mut depth_m = floats(1, FRAMES * AREA);
    depth_m[7] = f32::NAN;
    let camera = |id: &str, role, partner, mount, rgb, depth| ClipCamera {
        id: id.into(),
        role,
        partner,
        intrinsics,
        mount,
        recorded: rgb,
        generated: None,
        depth,
    };
    let rgb = |seed| Some(small_bytes(seed, FRAMES * AREA * 3, 256.0));
    let hand_eye = CameraMount::HandEye {
        link: "panda_link8".into(),
        link_from_camera: pose(0.1),
    };
    let fixed = CameraMount::Fixed {
        base_from_camera: pose(1.0),
    };
    let trajectory = CameraMount::Trajectory {
        base_from_camera: vec![pose(1.0), pose(1.1), pose(1.2)],
    };
    Clip {
        clip_id: "LAB+a1+2026-01-31-12h-00m-00s".parse().unwrap(),
        episode_id: "LAB+a1+2026-01-31-12h:00m:00s".into(),
        layout: "rogs-episode".into(),
        task: "put the cup on the plate".into(),
        calibration_note: "exact".into(),
        fps: 15.0,
        episode_frames: [7, 8, 9].map(EpisodeFrame).to_vec(),
        source_frames: [0, 2].map(FrameIndex).to_vec(),
        query_frames: [1, 2].map(FrameIndex).to_vec(),
        anchor_frame: FrameIndex(0),
        height: HEIGHT,
        width: WIDTH,
        cameras: vec![
            camera("wrist", CameraRole::Source, None, hand_eye, rgb(2), None),
            camera(
                "ext1",
                CameraRole::Source,
                None,
                fixed,
                rgb(3),
                Some(DepthReference {
                    depth_m,
                    range_m: [0.1, 5.0],
                    origin: ReferenceOrigin::FoundationStereo,
                }),
            ),
            camera(
                "ext1_right",
                CameraRole::Evaluation,
                Some(CameraIndex(1)),
                trajectory,
                None,
                None,
            ),
        ],
        robot: RobotStates {
            joint_names: vec!["panda_joint1".into(), "panda_joint2".into()],
            positions: vec![0.0, 0.1, 0.2, 0.3, -0.4, 0.5],
            gripper: vec![0.0, 0.5, 1.0],
        },
        tracks: Some(Tracks {
            anchor_frame: FrameIndex(0),
            camera: [0, 1].map(CameraIndex).to_vec(),
            pixel: vec![1.0, 2.0, 3.0, 0.0],
            position_m: floats(4, 2 * FRAMES * 3),
            visible: vec![1, 1, 0, 1, 0, 0],
            origin: ReferenceOrigin::Kinematics,
        }),
        rollout: None,
    }
}

/// The clip with observations of a world model.
pub(crate) fn rollout_clip() -> Clip {
    let mut clip = clip();
    for (seed, camera) in [5, 6].into_iter().zip(&mut clip.cameras) {
        camera.generated = Some(small_bytes(seed, FRAMES * AREA * 3, 256.0));
    }
    clip.rollout = Some(Rollout {
        model: "a world model".into(),
        layout: "composite".into(),
        frames: [0, 1],
        first_frame_psnr_db: vec![Some(31.25), Some(28.5), None],
    });
    clip
}

pub(crate) fn robot() -> RobotMaps {
    let map = |camera, frame| RobotMap {
        camera: CameraIndex(camera),
        frame: FrameIndex(frame),
        depth_m: floats(u64::from(10 + camera + frame), AREA),
        link: (0..AREA as u8)
            .map(|i| if i % 3 == 0 { NO_LINK } else { i % 2 })
            .collect(),
        support: small_bytes(20, AREA, 2.0),
    };
    RobotMaps {
        clip_id: "clip".parse().unwrap(),
        link_names: vec!["panda_link0".into(), "panda_link1".into()],
        base_from_link: (0..2 * FRAMES).map(|i| pose(i as f64)).collect(),
        base_from_camera: (0..2 * FRAMES).map(|i| pose(-(i as f64))).collect(),
        recon_from_base: pose(9.0),
        tool_m: (0..3 * FRAMES).map(|i| i as f64 / 8.0).collect(),
        height: HEIGHT,
        width: WIDTH,
        maps: vec![map(0, 0), map(0, 2), map(1, 0), map(1, 2)],
    }
}

fn views() -> Vec<SourceView> {
    vec![
        SourceView {
            camera: CameraIndex(0),
            frame: FrameIndex(0),
        },
        SourceView {
            camera: CameraIndex(0),
            frame: FrameIndex(2),
        },
    ]
}

pub(crate) fn polynomial() -> PolynomialField {
    let count = 2 * AREA;
    let info = |configuration: &str| WeightsInfo {
        trained: false,
        configuration: configuration.into(),
        description: "generated from seed 1".into(),
        hash: String::new(),
    };
    PolynomialField {
        clip_id: "clip".parse().unwrap(),
        height: HEIGHT,
        width: WIDTH,
        views: [0, 2]
            .map(|frame| SourceView {
                camera: CameraIndex(1),
                frame: FrameIndex(frame),
            })
            .to_vec(),
        weights: vec![info("4DGT"), info("DINOv2")],
        gaussians: Polynomials {
            centre_m: floats(70, 3 * count),
            time_s: floats(71, count),
            variance_s2: floats(72, count),
            velocity: floats(73, 12 * count),
            angular: floats(74, 6 * count),
            rotation: floats(75, 4 * count),
            scale_m: floats(76, 3 * count),
            opacity: floats(77, count),
            rgb: floats(78, 3 * count),
        },
    }
}

pub(crate) fn motion_bases() -> MotionBasisField {
    let camera = |camera: u32, bases: usize, foreground: usize, background: usize| {
        let (frames, n) = (3, foreground + background);
        let gaussians = BasisGaussians {
            bases,
            frames,
            rotations: floats(80, bases * frames * 6),
            translations: floats(81, bases * frames * 3),
            coefficients: floats(82, foreground * bases),
            means: floats(83, 3 * n),
            quats: floats(84, 4 * n),
            scales: floats(85, 3 * n),
            opacities: floats(86, n),
            colours: floats(87, 3 * n),
        };
        (CameraIndex(camera), gaussians)
    };
    MotionBasisField {
        clip_id: "clip".parse().unwrap(),
        frame_count: 3,
        weights: WeightsInfo {
            trained: true,
            configuration: "som".into(),
            description: "optimised".into(),
            hash: String::new(),
        },
        cameras: vec![camera(0, 2, 4, 3), camera(2, 1, 2, 1)],
    }
}

pub(crate) fn progress() -> Progress {
    let array = |name: &str, length: usize| NamedArray {
        name: name.into(),
        shape: vec![length as u32],
        data: floats(90, length),
    };
    Progress {
        clip_id: "clip".parse().unwrap(),
        counters: vec![("updates".into(), 300), ("camera".into(), 1)],
        arrays: vec![array("means", 12), array("none", 0), array("logits", 5)],
    }
}

pub(crate) fn references() -> References {
    let mut depth_m = floats(60, 2 * AREA);
    depth_m[3] = f32::NAN;
    let made = |camera, origin| MadeDepth {
        camera: CameraIndex(camera),
        depth_m: depth_m.clone(),
        range_m: [0.1, 5.0],
        origin,
    };
    References {
        clip_id: "clip".parse().unwrap(),
        frame_count: FRAMES as u32,
        height: HEIGHT,
        width: WIDTH,
        frames: vec![FrameIndex(0), FrameIndex(2)],
        depth: vec![
            made(0, ReferenceOrigin::ClassicalStereo),
            made(2, ReferenceOrigin::DepthCamera),
        ],
        tracks: clip().tracks,
        notes: vec!["stereo pair `ext1`, `ext1_right`: no stereo depth".into()],
    }
}

pub(crate) fn agreement() -> Agreements {
    let told = |at: f32| ViewAgreement {
        state: ViewState::Measured,
        shift_px: [0.5 * at, -0.25],
        sigma_px: 0.125,
        offset_m: 0.002,
        sigma_m: 0.0005,
        overlay: 0.75,
    };
    let tried = |name: &str, overlay| TriedMistake {
        name: name.into(),
        words: format!("it is {name}"),
        overlay,
    };
    let camera = |camera, verdict, mistake: Option<TriedMistake>| CameraAgreement {
        camera: CameraIndex(camera),
        name: format!("camera {camera}"),
        verdict,
        tried: mistake.iter().cloned().chain([tried("other", -0.01)]).collect(),
        mistake,
        why: String::new(),
        overlay: 0.25,
        offset: Some(Offset {
            px: 0.75,
            sigma_px: 0.125,
            m: 0.002,
        }),
        lag_frames: Some(Estimate {
            value: -1.5,
            sigma: 0.25,
        }),
        drift_m: None,
        views: (0..FRAMES)
            .map(|frame| match frame {
                0 => ViewAgreement::unknown(ViewState::TooFewEdges),
                _ => told(frame as f32),
            })
            .collect(),
        link_px: [f32::NAN, 0.5].repeat(FRAMES),
        link_m: [f32::NAN, 0.001].repeat(FRAMES),
    };
    Agreements {
        clip_id: "clip".parse().unwrap(),
        setting: "recorded".into(),
        frame_count: FRAMES as u32,
        link_names: vec!["base".into(), "hand".into()],
        cameras: vec![
            camera(0, Verdict::Good, None),
            camera(2, Verdict::Wrong, Some(tried("inverted-pose", 0.5))),
        ],
    }
}

pub(crate) fn conditioning() -> Conditioning {
    let prior = GripperPrior {
        centre_px: [2.0, 1.0],
        depth_m: 0.4,
        focal_px: [4.0, 4.5],
        sigma_m: 0.1,
    };
    let view = |pixels: Vec<u32>| ViewConditioning {
        link: vec![1; pixels.len()],
        depth_m: floats(30, pixels.len()),
        displacement_iu: floats(31, 2 * pixels.len() * 3),
        pixels,
        available: vec![1, 0],
        prior,
    };
    Conditioning {
        clip_id: "clip".parse().unwrap(),
        height: HEIGHT,
        width: WIDTH,
        views: views(),
        query_frames: [0, 1].map(FrameIndex).to_vec(),
        view_maps: vec![view(vec![0, 3, 4, 14]), view(vec![])],
    }
}

pub(crate) fn field() -> Field {
    let total = 2 * AREA;
    let slice = |time, seed| {
        let gate = small_bytes(seed, total, 4.0);
        let open = gate.iter().filter(|&&gate| gate != 0).count();
        let moving_raw = floats(seed + 1, open * RAW_CHANNELS);
        TimeSlice {
            time,
            displacement_m: floats(seed + 2, 3 * total),
            gate,
            moving_raw,
        }
    };
    let mut base_raw = floats(41, total * RAW_CHANNELS);
    base_raw[3] = -0.0;
    Field {
        clip_id: "clip".parse().unwrap(),
        frame_count: 3,
        height: HEIGHT,
        width: WIDTH,
        views: views(),
        recon_from_base: pose(9.0),
        weights: weights(),
        position_m: floats(40, 3 * total),
        base_raw,
        support: small_bytes(42, total, 2.0),
        link: small_bytes(43, total, 3.0),
        scale_cap_iu: (0..total)
            .map(|i| if i % 2 == 0 { f32::INFINITY } else { 0.25 })
            .collect(),
        slices: vec![slice(0.0, 50), slice(0.5, 60), slice(1.0, 70)],
        query_state: vec![
            NamedArray {
                name: "tokens".into(),
                shape: vec![2, 3],
                data: floats(80, 6),
            },
            NamedArray {
                name: "nothing".into(),
                shape: vec![0, 3],
                data: vec![],
            },
        ],
    }
}

pub(crate) fn refinement() -> Refinement {
    let step = |update, seed| {
        let touched = small_bytes(seed, 30, 2.0);
        let count = touched.iter().filter(|&&flag| flag == 1).count();
        RefinementStep {
            update,
            touched,
            values: floats(seed + 1, count * RESIDUAL_CHANNELS),
        }
    };
    Refinement {
        clip_id: "clip".parse().unwrap(),
        field_key: CacheKey([3; 16]),
        gaussian_count: 30,
        updates: 4,
        preset: "ci".into(),
        weights: weights(),
        scale_residual: ScaleResidual::Linear,
        steps: vec![step(2, 90), step(4, 95)],
        resume_state: vec![NamedArray {
            name: "hidden".into(),
            shape: vec![4],
            data: floats(99, 4),
        }],
    }
}

pub(crate) fn scores() -> Scores {
    let image = ImageScore {
        camera: "ext1".into(),
        source_view: true,
        frame: FrameIndex(1),
        psnr: Some(21.5),
        ssim: None,
        lpips: None,
        absrel: Some(0.125),
        rmse_m: None,
        delta1: Some(0.75),
        absrel_scaled: None,
        far_absrel: None,
        support_n: 12,
    };
    let view = |height: u32, width: u32| RenderedView {
        camera: "ext1".into(),
        frame: FrameIndex(1),
        height,
        width,
        rgb: small_bytes(100, (3 * height * width) as usize, 256.0),
        depth_m: vec![0.0; (height * width) as usize],
    };
    let summary = ScoreSheet {
        clip_id: "clip".parse().unwrap(),
        method: "stage1".into(),
        setting: "recorded".into(),
        ssim_variant: "gaussian".into(),
        lpips_note: Some("no weights given".into()),
        weights: vec![weights()],
        images: vec![image],
        tracks: vec![TrackScore {
            anchor: FrameIndex(0),
            frame: FrameIndex(1),
            epe_mm: Some(1.5),
            n_tracks: 2,
        }],
        robot_depth: vec![RobotDepthScore {
            frame: FrameIndex(1),
            robot_depth_mm: None,
            core_n: 0,
        }],
        n_empty_support: 1,
        invalid_gaussians: 0,
        references: vec![
            ReferenceUse {
                kind: ReferenceKind::Depth,
                camera: "ext1".into(),
                origin: ReferenceOrigin::ClassicalStereo,
            },
            ReferenceUse {
                kind: ReferenceKind::Tracks,
                camera: String::new(),
                origin: ReferenceOrigin::Kinematics,
            },
        ],
        cross_view: vec![
            CrossViewScore {
                camera: "ext1".into(),
                frame: FrameIndex(1),
                psnr: Some(14.5),
                shown: 0.75,
            },
            CrossViewScore {
                camera: "wrist".into(),
                frame: FrameIndex(1),
                psnr: None,
                shown: 0.0,
            },
        ],
    };
    Scores {
        summary,
        renders: vec![view(2, 4), view(1, 3)],
    }
}
