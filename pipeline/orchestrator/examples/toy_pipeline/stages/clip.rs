//! Stages that tell of the clip: `ingest`, `robot-maps`, `conditioning`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use rogs_orchestrator::stage::StageId;
use rogs_r4c::Record;
use rogs_r4c::source::ROBOT_MODEL;
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::records::clip::{CameraMount, CameraRole, Clip, ClipCamera, DepthReference, RobotStates};
use rogs_schemas::records::conditioning::{Conditioning, GripperPrior, ViewConditioning};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::records::robot::{NO_LINK, RobotMap, RobotMaps, RobotSpec};
use rogs_schemas::{CameraIndex, EpisodeFrame, FrameIndex, SchemaId};
use rogs_schemas::{Intrinsics, RigidPose};
use rogs_worker::{Context, Stage, StageError, StageResult};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{FRAMES, HEIGHT, WIDTH, disc, picture, seed_of};
use crate::misbehaviour::{misbehave, write};

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct IngestParams {
    /// Selector.
    episode: String,
    /// Added to the clip's frame rate.
    faster: f32,
    /// First episode frame.
    start_frame: Option<u32>,
    /// Frames that a plan counts with.
    frames: u32,
    /// Episode frames from one to the next.
    frame_step: u32,
}

impl Default for IngestParams {
    fn default() -> Self {
        Self {
            episode: String::new(),
            faster: 0.0,
            start_frame: None,
            frames: FRAMES as u32,
            frame_step: 1,
        }
    }
}

pub(crate) struct Ingest(IngestParams);

impl Stage for Ingest {
    const NAME: &'static str = StageId::Ingest.name();
    const SUMMARY: &'static str = "Reads a text file";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = Clip::SCHEMA;
    type Params = IngestParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("episode", "folder"),
            InputDescription::optional("calibration", "file"),
        ]
    }

    fn load(params: &IngestParams, _: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        Ok(Self(params.clone()))
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let file = context.input("episode")?.join(format!("{}.txt", self.0.episode));
        let text = std::fs::read_to_string(&file)
            .map_err(|error| StageError::bad_input(format!("cannot read `{}`: {error}", file.display())))?;
        misbehave(&text, Self::NAME, context)?;
        let camera = |id: &str, role, partner| ClipCamera {
            id: id.into(),
            role,
            partner,
            intrinsics: Intrinsics {
                fx: 40.0,
                fy: 40.0,
                cx: 20.0,
                cy: 11.0,
            },
            mount: CameraMount::Fixed {
                base_from_camera: RigidPose::IDENTITY,
            },
            recorded: Some((0..FRAMES).flat_map(|frame| picture(seed_of(&text), frame)).collect()),
            generated: None,
            depth: Some(DepthReference {
                depth_m: vec![1.5; FRAMES * HEIGHT * WIDTH],
                range_m: [0.1, 5.0],
                origin: ReferenceOrigin::Exact,
            }),
        };
        let clip = Clip {
            clip_id: context.clip_id().clone(),
            episode_id: self.0.episode.clone(),
            layout: "toy".into(),
            task: text.clone(),
            calibration_note: "exact".into(),
            fps: 15.0 + f64::from(self.0.faster),
            episode_frames: (0..FRAMES as u32).map(EpisodeFrame).collect(),
            source_frames: [0, 2].map(FrameIndex).to_vec(),
            query_frames: [1, 2].map(FrameIndex).to_vec(),
            anchor_frame: FrameIndex(0),
            height: HEIGHT as u32,
            width: WIDTH as u32,
            cameras: vec![
                camera("wrist", CameraRole::Source, None),
                camera("wrist_right", CameraRole::Evaluation, Some(CameraIndex(0))),
            ],
            robot: RobotStates {
                joint_names: vec!["j".into()],
                positions: vec![0.1; FRAMES],
                gripper: vec![0.5; FRAMES],
            },
            tracks: None,
            rollout: None,
        };
        context.progress(0.5, "reading");
        write(context, Self::NAME, &clip)
    }
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct MapsParams {
    /// The robot.
    robot: RobotSpec,
}

pub(crate) struct Maps;

impl Stage for Maps {
    const NAME: &'static str = StageId::RobotMaps.name();
    const SUMMARY: &'static str = "Draws a disc";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = RobotMaps::SCHEMA;
    type Params = MapsParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required(ROBOT_MODEL, "file"),
        ]
    }

    fn load(_: &MapsParams, _: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        Ok(Self)
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let clip: Clip = context.read("clip")?;
        misbehave(&clip.task, Self::NAME, context)?;
        let map = |frame: usize| {
            let hit: Vec<bool> = (0..HEIGHT * WIDTH)
                .map(|index| disc(index / WIDTH, index % WIDTH, frame))
                .collect();
            RobotMap {
                camera: CameraIndex(0),
                frame: FrameIndex(frame as u32),
                depth_m: hit
                    .iter()
                    .enumerate()
                    .map(|(index, &hit)| if hit { 1.0 + index as f32 * 1e-3 } else { 0.0 })
                    .collect(),
                link: hit
                    .iter()
                    .enumerate()
                    .map(|(index, &hit)| if hit { (index % WIDTH > 17) as u8 } else { NO_LINK })
                    .collect(),
                support: hit.iter().map(|&hit| u8::from(hit)).collect(),
            }
        };
        write(
            context,
            Self::NAME,
            &RobotMaps {
                clip_id: clip.clip_id,
                link_names: vec!["a".into(), "b".into()],
                base_from_link: vec![RigidPose::IDENTITY; 2 * FRAMES],
                base_from_camera: vec![RigidPose::IDENTITY; 2 * FRAMES],
                recon_from_base: RigidPose::IDENTITY,
                tool_m: vec![0.0; 3 * FRAMES],
                height: HEIGHT as u32,
                width: WIDTH as u32,
                maps: (0..FRAMES).map(map).collect(),
            },
        )
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct SigmaParams {
    /// A number.
    sigma_m: f32,
}

impl Default for SigmaParams {
    fn default() -> Self {
        Self { sigma_m: 0.1 }
    }
}

pub(crate) struct Kappa(SigmaParams);

impl Stage for Kappa {
    const NAME: &'static str = StageId::Conditioning.name();
    const SUMMARY: &'static str = "Conditions on nothing";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = Conditioning::SCHEMA;
    type Params = SigmaParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required("robot", RobotMaps::SCHEMA.name),
        ]
    }

    fn load(params: &SigmaParams, _: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        Ok(Self(params.clone()))
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let clip: Clip = context.read("clip")?;
        let _: RobotMaps = context.read("robot")?;
        misbehave(&clip.task, Self::NAME, context)?;
        let queries = clip.field_frames();
        let view = ViewConditioning {
            pixels: vec![5],
            link: vec![0],
            depth_m: vec![1.0],
            displacement_iu: vec![0.0; 3 * queries.len()],
            available: vec![1; queries.len()],
            prior: GripperPrior {
                centre_px: [1.0; 2],
                depth_m: 1.0,
                focal_px: [40.0; 2],
                sigma_m: f64::from(self.0.sigma_m),
            },
        };
        let views = clip.source_views();
        write(
            context,
            Self::NAME,
            &Conditioning {
                clip_id: clip.clip_id.clone(),
                height: clip.height,
                width: clip.width,
                view_maps: vec![view; views.len()],
                views,
                query_frames: queries,
            },
        )
    }
}
