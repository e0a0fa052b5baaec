//! The stage.

use std::collections::BTreeMap;
use std::path::PathBuf;

use rogs_r4c::Record;
use rogs_r4c::source::ROBOT_MODEL;
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::records::clip::{CameraMount, Clip};
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::{CameraIndex, SchemaId};
use rogs_worker::{Context, Stage, StageError, StageResult};

use crate::build::{Robot, build};
use crate::params::Params;

/// `robot-maps`: link transforms, camera poses, mesh depth, link ids and support of a clip.
#[derive(Debug)]
pub struct RobotMapsStage {
    params: Params,
    robot: Robot,
}

impl Stage for RobotMapsStage {
    const NAME: &'static str = "robot-maps";
    const SUMMARY: &'static str = "Draws the robot's mesh into every source camera: depth, link ids, support, poses.";
    const VERSION: u32 = 2;
    const OUTPUT: SchemaId = RobotMaps::SCHEMA;
    type Params = Params;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required(ROBOT_MODEL, "file"),
        ]
    }

    fn load(params: &Params, inputs: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        if let Some(problem) = params.support.problem() {
            return Err(StageError::bad_params(problem));
        }
        let missing = || StageError::bad_params(format!("the job names no input `{ROBOT_MODEL}`"));
        let urdf = inputs.get(ROBOT_MODEL).ok_or_else(missing)?;
        Ok(Self {
            params: params.clone(),
            robot: Robot::load(urdf, params)?,
        })
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let clip: Clip = context.timed("read", |context| context.read("clip"))?;
        let maps = context.timed("draw", |context| build(&clip, &self.robot, &self.params, context))?;
        let unseen = |camera: Option<CameraIndex>| {
            let mut of_camera = maps
                .maps
                .iter()
                .filter(|map| camera.is_none_or(|camera| map.camera == camera));
            of_camera.all(|map| map.support.iter().all(|&value| value == 0))
        };
        if unseen(None) {
            context.warn("no source image shows any robot: check the calibration and the robot model");
        } else {
            // A camera on the hand may well see none; one that stands beside the robot does.
            for index in clip.source_cameras() {
                let camera = &clip.cameras[index.at()];
                if matches!(camera.mount, CameraMount::Fixed { .. }) && unseen(Some(index)) {
                    context.warn(format!(
                        "camera `{}` never sees the robot: is its pose camera-to-base (not base-to-camera), in metres, with \
                         x right, y down, z forward?",
                        camera.id
                    ));
                }
            }
        }
        context.write(&maps)
    }
}
