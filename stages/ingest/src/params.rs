//! Parameters of the stage.

use std::collections::BTreeMap;

use rogs_schemas::{EpisodeFrame, FrameIndex};
use rogs_worker::{StageError, StageResult};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::source::States;

/// What to cut out of an episode, and how. The default is the paper's clip: 17 frames, sources 0, 4, 8, 12, 16, 280x154.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Params {
    /// Layout of the episode folder.
    pub layout: LayoutChoice,
    /// Which episode of the folder: the selector of `rogs list`. Empty when the folder holds only one.
    #[serde(deserialize_with = "text_or_number")]
    pub episode: String,
    /// Episode frame that becomes clip frame 0. `null`: the anchor frame of the episode's tracks where it has tracks;
    /// else 7 (the first frame of the paper's interval) when the clip still fits behind it; else 0.
    pub start_frame: Option<EpisodeFrame>,
    /// Frames of the clip.
    pub frames: u32,
    /// Episode frames from one clip frame to the next.
    pub frame_step: u32,
    /// Source times, clip frames.
    pub source_frames: Vec<FrameIndex>,
    /// Query times.
    pub query: QueryChoice,
    /// Anchor time of displacement scores, a clip frame. `null`: that of the tracks where there are tracks, else the
    /// first source time.
    pub anchor_frame: Option<FrameIndex>,
    /// Image height of the clip, pixels.
    pub height: u32,
    /// Image width of the clip, pixels.
    pub width: u32,
    /// How images of another aspect are brought to this size.
    pub fit: Fit,
    /// Which cameras of the episode become which cameras of the clip, in this order (wrist first). Empty: all that the
    /// layout names.
    pub cameras: Vec<CameraChoice>,
    /// Of raw DROID episodes.
    #[serde(skip_serializing_if = "is_default")]
    pub droid: DroidParams,
    /// Depths outside this open interval are not scored, metres. `null`: what the episode says.
    pub depth_range_m: Option<[f32; 2]>,
    /// Where joint and gripper states are, for layouts that do not say.
    pub states: StateColumns,
    /// How caches of PointWorld are used, where the episode has some.
    pub pointworld: PointWorldParams,
    /// What the clip shows to those who reconstruct it.
    pub observations: Observations,
    /// How the rollout lies on disk, where `observations` are one.
    pub rollout: RolloutParams,
}

/// What a clip shows to those who reconstruct it. Targets and references are the recorded ones in either case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Observations {
    /// The recorded images.
    #[default]
    Recorded,
    /// The frames of a world model (input `rollout`, docs/rollouts.md).
    Rollout,
}

/// How a rollout lies on disk.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RolloutParams {
    /// The world model, in words for reports.
    pub model: String,
    /// Where the views are in its files.
    pub layout: RolloutLayout,
    /// Frame of the files that shows clip frame 0.
    pub first_frame: u32,
    /// Frames that every file has. `null`: those that the clip needs and no more.
    pub frames: Option<u32>,
    /// Frames per second of the files, where their headers do not say or are wrong.
    pub fps: Option<f64>,
    /// Of padded composites: target height and width, content height and width, as Cosmos 3 stores them. `null`: told from
    /// the size of the frames.
    pub image_size: Option<[u32; 4]>,
    /// The first generated frame of a camera must be this close to its first recorded one, dB of PSNR.
    pub min_first_frame_psnr_db: f64,
}

impl Default for RolloutParams {
    fn default() -> Self {
        Self {
            model: String::new(),
            layout: RolloutLayout::Auto,
            first_frame: 0,
            frames: None,
            fps: None,
            image_size: None,
            min_first_frame_psnr_db: 20.0,
        }
    }
}

/// Where the views are in the files of a rollout.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RolloutLayout {
    /// Told by the file: a folder of views, a Ctrl-World replay by its name, else a composite.
    #[default]
    Auto,
    /// One video or folder of PNG files: the wrist above two external cameras of half its size (Cosmos 3).
    Composite,
    /// A folder with one video or folder of PNG files a camera, named by it.
    Views,
    /// A replay as Ctrl-World writes it: recorded above generated, ext1, ext2, wrist from left to right.
    CtrlWorld,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            layout: LayoutChoice::Auto,
            episode: String::new(),
            start_frame: None,
            frames: 17,
            frame_step: 1,
            source_frames: [0, 4, 8, 12, 16].map(FrameIndex).to_vec(),
            query: QueryChoice::Plan(QueryPlanName::Paper),
            anchor_frame: None,
            height: 154,
            width: 280,
            fit: Fit::Cover,
            cameras: Vec::new(),
            droid: DroidParams::default(),
            depth_range_m: None,
            states: StateColumns::default(),
            pointworld: PointWorldParams::default(),
            observations: Observations::Recorded,
            rollout: RolloutParams::default(),
        }
    }
}

/// Layout of an episode folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LayoutChoice {
    /// Told by the files in it.
    #[default]
    Auto,
    /// Our own (`docs/episode-format.md`).
    RogsEpisode,
    /// DROID as Ctrl-World keeps it: `annotation/` and `videos/`.
    DroidCtrlworld,
    /// DROID as it was released: `metadata_*.json`, `trajectory.h5` and `recordings/` (`docs/droid.md`).
    DroidRaw,
    /// LeRobot v2.1 or v3.0.
    Lerobot,
    /// Samples of AgiBot as Genie Envisioner keeps them: images, camera parameters and poses of both hands.
    Agibot,
}

/// Query times of a clip.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum QueryChoice {
    /// A named plan.
    Plan(QueryPlanName),
    /// These clip frames.
    Frames(Vec<FrameIndex>),
}

/// Named query plans.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum QueryPlanName {
    /// The paper's: eight requests drawn from the episode id.
    Paper,
    /// Every clip frame.
    All,
}

/// How an image of another aspect is brought to the clip's size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Fit {
    /// Scaled by one factor until it covers the target, then cut at the centre.
    #[default]
    Cover,
    /// Scaled along each axis on its own; nothing is cut.
    Stretch,
}

/// One camera of the clip.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CameraChoice {
    /// Name in the clip: `wrist`, `ext1`, `ext2`, ...
    pub id: String,
    /// Name in the episode.
    pub from: String,
    /// Nothing is reconstructed from its images: views from it are compared with them.
    #[serde(default, skip_serializing_if = "is_default")]
    pub held_out: bool,
}

/// Where states are in tables that do not follow the usual names.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct StateColumns {
    /// Entries of `observation.state` (by their names in `meta/info.json`) that are the arm's joints, in order. Empty:
    /// `observation.state.joint_position`, or all entries of `observation.state` that are not the gripper.
    pub joints: Vec<String>,
    /// Names of these joints in the URDF. Empty: `panda_joint1` to `panda_joint7` for seven joints of a Franka arm, else
    /// the names in the data.
    pub joint_names: Vec<String>,
    /// Entry of `observation.state` that is the gripper. `null`: `observation.state.gripper_position`, or `gripper`. Empty:
    /// the robot has none; then the table of an own episode needs no column for it either.
    pub gripper: Option<String>,
    /// The data has 1 for open: take 1 - value.
    pub invert_gripper: bool,
    /// Gripper values of the data that mean open and closed, for example `[100, 0]` for percent of opening. `null`: 0 is
    /// open and 1 closed. Values up to 2 % of the range beyond it are taken as its ends.
    pub gripper_range: Option<[f64; 2]>,
    /// Unit of the joint positions in the data, of every layout.
    pub unit: AngleUnit,
}

/// Unit of joint positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AngleUnit {
    /// Radians (and metres).
    #[default]
    Radians,
    /// Degrees, of all joints.
    Degrees,
}

impl StateColumns {
    /// Brings positions and gripper of the data to radians and to 0 (open) to 1 (closed).
    pub(crate) fn convert(&self, states: &mut States) {
        if self.unit == AngleUnit::Degrees {
            states
                .positions
                .iter_mut()
                .for_each(|value| *value = value.to_radians());
        }
        if self.gripper.as_deref() == Some("") {
            return;
        }
        for value in &mut states.gripper {
            if let Some([open, closed]) = self.gripper_range {
                let share = (*value - open) / (closed - open);
                let beyond = (-0.02..=1.02).contains(&share);
                *value = if beyond { share.clamp(0.0, 1.0) } else { share };
            }
            if self.invert_gripper {
                *value = 1.0 - *value;
            }
        }
    }
}

/// How the caches are used.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PointWorldParams {
    /// Take the refined poses of external cameras; `false` keeps the episode's own.
    pub refined_poses: bool,
    /// Refined poses are taken when the optimisation ended below this loss, as PointWorld takes them.
    pub max_loss: f64,
    /// A depth map or track position belongs to an image when their times differ by no more, milliseconds.
    pub tolerance_ms: f64,
}

impl Default for PointWorldParams {
    fn default() -> Self {
        Self {
            refined_poses: true,
            max_loss: 0.10,
            tolerance_ms: 20.0,
        }
    }
}

/// How raw DROID episodes are taken.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DroidParams {
    /// Link of the URDF that is the flange, which carries the wrist camera.
    pub flange_link: String,
    /// What becomes of steps in which nobody moved the robot.
    pub idle: IdleSteps,
    /// Take the right eyes out of the stereo videos, as evaluation cameras.
    pub right_eyes: bool,
    /// Published extrinsics are taken only when the numbers of their quality, by name, are in these bounds.
    pub quality: BTreeMap<String, Quality>,
}

/// Bounds of a number of quality.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Quality {
    /// At least this.
    pub min: Option<f64>,
    /// At most this.
    pub max: Option<f64>,
}

impl Default for DroidParams {
    fn default() -> Self {
        Self {
            flange_link: "panda_link8".to_owned(),
            idle: IdleSteps::Keep,
            right_eyes: true,
            quality: BTreeMap::new(),
        }
    }
}

impl PointWorldParams {
    /// Checks the numbers.
    fn check(&self) -> StageResult<()> {
        let positive = |value: f64| value.is_finite() && value > 0.0;
        if positive(self.max_loss) && positive(self.tolerance_ms) {
            return Ok(());
        }
        Err(StageError::bad_params(
            "`pointworld.max_loss` and `pointworld.tolerance_ms` must be above 0",
        ))
    }
}

/// Idle steps of a raw DROID episode: `movement_enabled` is false, `skip_action` is set, or the step is outside of the
/// published ranges that loaders keep.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum IdleSteps {
    /// They stay: frames are even in time.
    #[default]
    Keep,
    /// Their images and states are left out, as most loaders do.
    Drop,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// A selector that is all digits may come as a number.
fn text_or_number<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Selector {
        Text(String),
        Number(u64),
    }
    Ok(match Selector::deserialize(deserializer)? {
        Selector::Text(text) => text,
        Selector::Number(number) => number.to_string(),
    })
}

impl Params {
    /// Checks what does not depend on an episode.
    pub(crate) fn check(&self) -> StageResult<()> {
        let wrong = |what: String| Err(StageError::bad_params(what));
        if !(1..=4096).contains(&self.frames) || self.frame_step == 0 {
            return wrong(format!(
                "`frames` {} and `frame_step` {} are impossible",
                self.frames, self.frame_step
            ));
        }
        let sides = [self.height, self.width];
        if sides.iter().any(|side| !(1..=8192).contains(side)) {
            return wrong(format!(
                "an image of {}x{} pixels is impossible",
                self.width, self.height
            ));
        }
        let sources = &self.source_frames;
        if sources.is_empty()
            || !sources.is_sorted_by(|a, b| a < b)
            || sources.last().is_some_and(|last| last.0 >= self.frames)
        {
            return wrong(format!(
                "`source_frames` {sources:?} must ascend below `frames` {}",
                self.frames
            ));
        }
        if let QueryChoice::Frames(frames) = &self.query
            && let Some(frame) = frames.iter().find(|frame| frame.0 >= self.frames)
        {
            return wrong(format!("`query` frame {frame} is not below `frames` {}", self.frames));
        }
        if self.anchor_frame.is_some_and(|anchor| anchor.0 >= self.frames) {
            return wrong(format!("`anchor_frame` is not below `frames` {}", self.frames));
        }
        if let Some([open, closed]) = self.states.gripper_range
            && !(open.is_finite() && closed.is_finite() && open != closed)
        {
            return wrong(format!(
                "invalid `states.gripper_range` {open}, {closed}: expected the values for open and closed, e.g. [100, 0]"
            ));
        }
        if let Some([near, far]) = self.depth_range_m
            && !(near.is_finite() && far.is_finite() && 0.0 <= near && near < far)
        {
            return wrong(format!("invalid `depth_range_m` {near} to {far}: expected an interval"));
        }
        self.pointworld.check()?;
        let RolloutParams {
            fps,
            min_first_frame_psnr_db: least,
            ..
        } = self.rollout;
        if let Some(fps) = fps.filter(|fps| !(fps.is_finite() && *fps > 0.0)) {
            return wrong(format!("invalid `rollout.fps` {fps}: expected frames per second"));
        }
        if !least.is_finite() {
            return wrong(format!(
                "invalid `rollout.min_first_frame_psnr_db` {least}: expected e.g. 20"
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_of_other_units_are_converted() {
        let states = |gripper: f64| States {
            joint_names: vec!["a".into()],
            positions: vec![180.0],
            gripper: vec![gripper],
        };
        let percent = StateColumns {
            unit: AngleUnit::Degrees,
            gripper_range: Some([100.0, 0.0]),
            ..StateColumns::default()
        };
        for (gripper, expected) in [
            (100.0, 0.0),
            (0.0, 1.0),
            (25.0, 0.75),
            (101.0, 0.0),
            (-1.5, 1.0),
            (150.0, -0.5),
        ] {
            let mut states = states(gripper);
            percent.convert(&mut states);
            assert_eq!(
                (states.positions[0], states.gripper[0]),
                (std::f64::consts::PI, expected)
            );
        }
        let mut inverted = states(0.25);
        let choice = StateColumns {
            invert_gripper: true,
            ..StateColumns::default()
        };
        choice.convert(&mut inverted);
        assert_eq!((inverted.positions[0], inverted.gripper[0]), (180.0, 0.75));
    }
}
