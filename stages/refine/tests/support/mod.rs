//! A small clip made from formulas: three cameras before a bumpy wall, and a field that fits it roughly.

#![allow(dead_code, reason = "every test and example uses a part of this")]

use rogs_refine::{ClipInputs, LoadedRefiner};
use rogs_schemas::key::CacheKey;
use rogs_schemas::records::clip::{CameraMount, CameraRole, Clip, ClipCamera, RobotStates, SourceView, time_of_frame};
use rogs_schemas::records::field::{Field, RAW_CHANNELS, TimeSlice, WeightsInfo};
use rogs_schemas::records::robot::{NO_LINK, RobotMap, RobotMaps};
use rogs_schemas::{CameraIndex, EpisodeFrame, FrameIndex, Intrinsics, RigidPose};
use rogs_stage2::weights::uniform;
use rogs_stage2::{Device, Refiner, RefinerConfig, seeded_parameters};

/// Sizes of an example clip.
#[derive(Clone, Copy)]
pub(crate) struct Sizes {
    /// Image rows.
    pub(crate) height: u32,
    /// Image columns.
    pub(crate) width: u32,
    /// Frames of the clip.
    pub(crate) frames: usize,
    /// Every how many frames there is a source time.
    pub(crate) step: usize,
}

/// A row count that is not a multiple of four, as in the paper.
const SMALL: Sizes = Sizes {
    height: 14,
    width: 20,
    frames: 5,
    step: 4,
};

/// The records of one clip.
pub(crate) struct Example {
    pub(crate) clip: Clip,
    pub(crate) robot: RobotMaps,
    pub(crate) field: Field,
}

impl Example {
    /// The inputs of a refinement.
    pub(crate) fn inputs(&self) -> ClipInputs<'_> {
        ClipInputs {
            clip: &self.clip,
            robot: &self.robot,
            field: &self.field,
            field_key: CacheKey([7; 16]),
            resume: None,
        }
    }
}

/// A small clip whose random parts depend on a seed.
pub(crate) fn example(seed: u64) -> Example {
    example_of(SMALL, seed)
}

/// The same at any size.
pub(crate) fn example_of(sizes: Sizes, seed: u64) -> Example {
    let Sizes {
        height,
        width,
        frames,
        step,
    } = sizes;
    let focal = 0.9 * f64::from(width);
    let intrinsics = Intrinsics {
        fx: focal,
        fy: focal,
        cx: f64::from(width) / 2.0,
        cy: f64::from(height) / 2.0,
    };
    let source_frames: Vec<FrameIndex> = FrameIndex::first(frames).step_by(step).collect();
    let cameras: Vec<ClipCamera> = (0..3)
        .map(|index| ClipCamera {
            id: ["wrist", "ext1", "ext2"][index].into(),
            role: CameraRole::Source,
            partner: None,
            intrinsics,
            mount: CameraMount::Fixed {
                base_from_camera: pose(index),
            },
            recorded: Some(image(sizes, index, seed)),
            generated: None,
            depth: None,
        })
        .collect();
    let clip = Clip {
        clip_id: "wall".parse().unwrap(),
        episode_id: "wall".into(),
        layout: "test".into(),
        task: String::new(),
        calibration_note: String::new(),
        fps: 15.0,
        episode_frames: (0..frames as u32).map(EpisodeFrame).collect(),
        query_frames: source_frames.clone(),
        source_frames,
        anchor_frame: FrameIndex(0),
        height,
        width,
        cameras,
        robot: RobotStates {
            joint_names: Vec::new(),
            positions: Vec::new(),
            gripper: vec![0.0; frames],
        },
        tracks: None,
        rollout: None,
    };
    let robot = RobotMaps {
        clip_id: "wall".parse().unwrap(),
        link_names: vec!["base".into()],
        base_from_link: vec![RigidPose::IDENTITY; frames],
        base_from_camera: (0..3).flat_map(|camera| vec![pose(camera); frames]).collect(),
        recon_from_base: RigidPose::IDENTITY,
        tool_m: vec![0.0; 3 * frames],
        height,
        width,
        maps: maps(sizes),
    };
    Example {
        field: field(sizes, &clip, &intrinsics, seed),
        clip,
        robot,
    }
}

fn maps(sizes: Sizes) -> Vec<RobotMap> {
    let area = (sizes.height * sizes.width) as usize;
    let map = |camera: u32, frame: u32| RobotMap {
        camera: CameraIndex(camera),
        frame: FrameIndex(frame),
        depth_m: vec![0.0; area],
        link: vec![NO_LINK; area],
        support: vec![0; area],
    };
    (0..3)
        .flat_map(|camera| (0..sizes.frames as u32).map(move |frame| (camera, frame)))
        .map(|(camera, frame)| map(camera, frame))
        .collect()
}

/// Cameras side by side; the first is the frame of the reconstruction.
fn pose(camera: usize) -> RigidPose {
    RigidPose {
        translation: [0.08 * camera as f64, -0.05 * camera as f64, 0.0],
        ..RigidPose::IDENTITY
    }
}

/// A wall one metre away whose texture depends on the seed, seen by a camera, with noise of its own in every frame.
fn image(sizes: Sizes, camera: usize, seed: u64) -> Vec<u8> {
    let Sizes {
        height, width, frames, ..
    } = sizes;
    let focal = 0.9 * f64::from(width);
    let texture = uniform("texture", 9, seed, 1.0);
    let noise = uniform(
        "image",
        frames * (height * width * 3) as usize,
        seed + camera as u64,
        12.0,
    );
    let shift = pose(camera).translation;
    let pixel = |index: usize| {
        let (row, column) = (index / 3 / width as usize % height as usize, index / 3 % width as usize);
        let x = ((column as f64 + 0.5 - f64::from(width) / 2.0) / focal + shift[0]) as f32;
        let y = ((row as f64 + 0.5 - f64::from(height) / 2.0) / focal + shift[1]) as f32;
        let waves = (x * (12.0 + 6.0 * texture[0]) + 3.0 * texture[1]).sin()
            + (y * (12.0 + 6.0 * texture[2]) + 3.0 * texture[3]).cos();
        let base = 125.0 + 20.0 * texture[4] + 60.0 * waves * texture[5 + index % 3];
        (base + noise[index]).clamp(0.0, 255.0) as u8
    };
    (0..noise.len()).map(pixel).collect()
}

fn field(sizes: Sizes, clip: &Clip, intrinsics: &Intrinsics, seed: u64) -> Field {
    let Sizes {
        height, width, frames, ..
    } = sizes;
    let views: Vec<SourceView> = clip.source_views();
    let count = views.len() * (height * width) as usize;
    let depths = uniform("depth", count, seed, 0.08);
    let attributes = uniform("attributes", count * RAW_CHANNELS, seed, 0.3);
    let mut position_m = Vec::with_capacity(3 * count);
    let mut base_raw = Vec::with_capacity(RAW_CHANNELS * count);
    for n in 0..count {
        let (view, row, column) = (
            n / (height * width) as usize,
            n / width as usize % height as usize,
            n % width as usize,
        );
        // Some lie behind the cameras, where no pixel sees them.
        let depth = if n % 11 == 3 { -1.0 } else { 1.0 + depths[n] };
        let camera = pose(views[view].camera.at()).translation;
        position_m.push(((column as f64 + 0.5 - intrinsics.cx) / intrinsics.fx) as f32 * depth + camera[0] as f32);
        position_m.push(((row as f64 + 0.5 - intrinsics.cy) / intrinsics.fy) as f32 * depth + camera[1] as f32);
        position_m.push(depth);
        let noise = &attributes[n * RAW_CHANNELS..(n + 1) * RAW_CHANNELS];
        base_raw.extend_from_slice(&noise[..3]);
        // About half a pixel at a depth of 3.5 internal units; the activation is 0.001 softplus.
        let half_pixel = (1750.0 / intrinsics.fx) as f32;
        base_raw.extend(noise[3..6].iter().map(|value| half_pixel * (1.0 + value)));
        base_raw.extend([1.0 + noise[6], noise[7], noise[8], noise[9], 1.2 + noise[10]]);
    }
    let slice = |frame: FrameIndex| {
        let time = time_of_frame(frame, frames);
        let displacement_m = uniform(
            &format!("displacement {frame}"),
            3 * count,
            seed,
            0.03 * time as f32 + 0.001,
        );
        let moves = uniform(&format!("gate {frame}"), count, seed, 1.0);
        let gate: Vec<u8> = moves
            .iter()
            .map(|&value| if value > 0.8 { 3 } else { u8::from(value > 0.6) })
            .collect();
        let open = gate.iter().enumerate().filter(|(_, gate)| **gate != 0);
        let shifts = uniform(&format!("moving {frame}"), count * RAW_CHANNELS, seed, 0.2);
        let moving_raw = open
            .flat_map(|(n, _)| (0..RAW_CHANNELS).map(move |c| n * RAW_CHANNELS + c))
            .map(|i| base_raw[i] + shifts[i]);
        TimeSlice {
            time,
            displacement_m,
            moving_raw: moving_raw.collect(),
            gate,
        }
    };
    Field {
        clip_id: clip.clip_id.clone(),
        frame_count: frames as u32,
        height,
        width,
        recon_from_base: RigidPose::IDENTITY,
        weights: WeightsInfo {
            trained: false,
            configuration: "test".into(),
            description: "formulas".into(),
            hash: String::new(),
        },
        support: vec![0; count],
        link: vec![NO_LINK; count],
        scale_cap_iu: vec![f32::INFINITY; count],
        slices: FrameIndex::first(frames).step_by(2).map(slice).collect(),
        query_state: Vec::new(),
        views,
        position_m,
        base_raw,
    }
}

/// A network whose head is random instead of zero, so that it does something.
pub(crate) fn random_network(preset: &str, seed: u64) -> LoadedRefiner {
    let config = RefinerConfig::preset(preset).unwrap();
    let mut parameters = seeded_parameters(&config, seed, &Device::flex()).unwrap();
    for (name, shape) in [
        ("weight", vec![config.residuals(), config.state]),
        ("bias", vec![config.residuals()]),
    ] {
        let name = format!("encoder.update_head.6.{name}");
        let values = uniform(&name, shape.iter().product(), seed, 2.0);
        parameters.insert(&name, &shape, values).unwrap();
    }
    let info = WeightsInfo {
        trained: false,
        configuration: preset.into(),
        description: "random head".into(),
        hash: String::new(),
    };
    LoadedRefiner {
        refiner: Refiner::load(&parameters, &config).unwrap(),
        info,
        warnings: Vec::new(),
    }
}
