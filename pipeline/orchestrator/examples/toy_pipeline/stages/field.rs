//! Stages that tell of the field: `lift`, `refine`, `score`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use rogs_orchestrator::stage::StageId;
use rogs_r4c::Record;
use rogs_schemas::SchemaId;
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::conditioning::Conditioning;
use rogs_schemas::records::field::{Field, RAW_CHANNELS, TimeSlice, WeightsInfo};
use rogs_schemas::records::refinement::{Refinement, ScaleResidual};
use rogs_schemas::records::robot::{NO_LINK, RobotMaps};
use rogs_schemas::records::scores::{ImageScore, RenderedView, RobotDepthScore, ScoreSheet, Scores, TrackScore};
use rogs_schemas::{FrameIndex, RigidPose};
use rogs_worker::{Context, Stage, StageResult};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{FRAMES, HEIGHT, WIDTH, picture, seed_of};
use crate::misbehaviour::{misbehave, write};

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct LiftParams {
    /// Leave the anchor out.
    no_anchor: bool,
    /// A seed.
    seed: u32,
}

pub(crate) struct Lift(LiftParams);

fn weights() -> WeightsInfo {
    WeightsInfo {
        trained: false,
        configuration: "toy".into(),
        description: "seed 0".into(),
        hash: String::new(),
    }
}

impl Stage for Lift {
    const NAME: &'static str = StageId::Lift.name();
    const SUMMARY: &'static str = "Lifts nothing";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = Field::SCHEMA;
    type Params = LiftParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required("robot", RobotMaps::SCHEMA.name),
            InputDescription::required("conditioning", Conditioning::SCHEMA.name),
            InputDescription::optional("weights", "file"),
        ]
    }

    fn load(params: &LiftParams, _: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        Ok(Self(params.clone()))
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let clip: Clip = context.read("clip")?;
        let _: RobotMaps = context.read("robot")?;
        let _: Conditioning = context.read("conditioning")?;
        misbehave(&clip.task, Self::NAME, context)?;
        let views = clip.source_views();
        let count = views.len() * HEIGHT * WIDTH;
        let slice = |frame: FrameIndex| TimeSlice {
            time: rogs_schemas::records::clip::time_of_frame(frame, FRAMES),
            displacement_m: vec![0.01 * frame.0 as f32; 3 * count],
            gate: vec![0; count],
            moving_raw: vec![],
        };
        context.warn("the weights are not trained");
        write(
            context,
            Self::NAME,
            &Field {
                clip_id: clip.clip_id.clone(),
                frame_count: FRAMES as u32,
                height: clip.height,
                width: clip.width,
                recon_from_base: RigidPose::IDENTITY,
                weights: weights(),
                position_m: vec![if self.0.no_anchor { 2.0 } else { 1.0 }; 3 * count],
                base_raw: vec![self.0.seed as f32; RAW_CHANNELS * count],
                support: vec![0; count],
                link: vec![NO_LINK; count],
                scale_cap_iu: vec![f32::INFINITY; count],
                slices: clip.field_frames().into_iter().map(slice).collect(),
                query_state: vec![],
                views,
            },
        )
    }
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct NoParams {}

pub(crate) struct Refine;

impl Stage for Refine {
    const NAME: &'static str = StageId::Refine.name();
    const SUMMARY: &'static str = "Refines nothing";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = Refinement::SCHEMA;
    type Params = NoParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required("robot", RobotMaps::SCHEMA.name),
            InputDescription::required("field", Field::SCHEMA.name),
        ]
    }

    fn load(_: &NoParams, _: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        Ok(Self)
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let clip: Clip = context.read("clip")?;
        let field: Field = context.read("field")?;
        misbehave(&clip.task, Self::NAME, context)?;
        let field_key = context.input_key("field").unwrap_or_default();
        write(
            context,
            Self::NAME,
            &Refinement {
                clip_id: clip.clip_id,
                field_key,
                gaussian_count: field.len() as u64,
                updates: 0,
                preset: "toy".into(),
                weights: weights(),
                scale_residual: ScaleResidual::default(),
                steps: vec![],
                resume_state: vec![],
            },
        )
    }
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct ScoreParams {
    /// Method name.
    method: String,
}

pub(crate) struct Score(ScoreParams);

impl Stage for Score {
    const NAME: &'static str = StageId::Score.name();
    const SUMMARY: &'static str = "Scores a gradient";
    const VERSION: u32 = 1;
    const OUTPUT: SchemaId = Scores::SCHEMA;
    type Params = ScoreParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required("robot", RobotMaps::SCHEMA.name),
            InputDescription::required("field", Field::SCHEMA.name),
            InputDescription::optional("refinement", Refinement::SCHEMA.name),
            InputDescription::optional("lpips", "file"),
        ]
    }

    fn load(params: &ScoreParams, _: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        Ok(Self(params.clone()))
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let clip: Clip = context.read("clip")?;
        let field: Field = context.read("field")?;
        let refined = context.optional_input("refinement").is_some();
        misbehave(&clip.task, Self::NAME, context)?;
        let seed = seed_of(&clip.task);
        let image = |camera: &str, frame: FrameIndex| ImageScore {
            camera: camera.into(),
            source_view: camera == "wrist",
            frame,
            psnr: Some(20.0 + seed as f64 / 100.0 + f64::from(u8::from(refined)) - f64::from(field.position_m[0])),
            ssim: Some(0.5),
            lpips: None,
            absrel: Some(0.2),
            rmse_m: Some(0.1),
            delta1: Some(0.5),
            absrel_scaled: None,
            far_absrel: None,
            support_n: 10,
        };
        let render = |camera: &str, frame: FrameIndex| RenderedView {
            camera: camera.into(),
            frame,
            height: clip.height,
            width: clip.width,
            rgb: picture(seed + 3, frame.at()),
            depth_m: (0..HEIGHT * WIDTH).map(|index| 1.0 + index as f32 / 1000.0).collect(),
        };
        let pairs: Vec<(&str, FrameIndex)> = ["wrist", "wrist_right"]
            .into_iter()
            .flat_map(|camera| [(camera, FrameIndex(1)), (camera, FrameIndex(2))])
            .collect();
        write(
            context,
            Self::NAME,
            &Scores {
                summary: ScoreSheet {
                    clip_id: clip.clip_id.clone(),
                    method: self.0.method.clone(),
                    setting: clip.setting().to_owned(),
                    ssim_variant: "toy".into(),
                    lpips_note: Some("no weights".into()),
                    weights: vec![field.weights],
                    images: pairs.iter().map(|&(camera, frame)| image(camera, frame)).collect(),
                    tracks: vec![TrackScore {
                        anchor: FrameIndex(0),
                        frame: FrameIndex(2),
                        epe_mm: None,
                        n_tracks: 0,
                    }],
                    robot_depth: vec![RobotDepthScore {
                        frame: FrameIndex(2),
                        robot_depth_mm: Some(12.5),
                        core_n: 40,
                    }],
                    n_empty_support: 0,
                    invalid_gaussians: 0,
                    references: Vec::new(),
                    cross_view: Vec::new(),
                },
                renders: pairs.iter().map(|&(camera, frame)| render(camera, frame)).collect(),
            },
        )
    }
}
