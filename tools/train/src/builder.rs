//! A procedural episode as training cuts clips from it: frames, recorded cameras, links and support.

use rogs_geometry::{Base, Camera, Pose, PosedCamera, Recon};
use rogs_robot_maps::{SupportRule, valid_support};
use rogs_schemas::FrameIndex;
use rogs_schemas::records::robot::NO_LINK;
use rogs_synth::{Episode, FIRST_OBJECT_ID, View};

use crate::config::DataSettings;
use crate::plan::ClipPlan;

/// References outside this interval take no part in depth losses, metres (as in scoring).
pub(crate) const DEPTH_RANGE_M: [f32; 2] = [0.1, 5.0];

/// What clips for training are made from: the plan, the settings, the episode.
pub(crate) struct ClipBuilder<'a> {
    pub(crate) plan: &'a ClipPlan,
    pub(crate) data: &'a DataSettings,
    pub(crate) episode: &'a Episode,
    /// Where the base of the robot stands, metres.
    pub(crate) recon_from_base: Pose<Recon, Base>,
}

impl<'a> ClipBuilder<'a> {
    pub(crate) fn new(plan: &'a ClipPlan, data: &'a DataSettings, episode: &'a Episode) -> Self {
        let mut builder = Self {
            plan,
            data,
            episode,
            recon_from_base: Pose::IDENTITY,
        };
        let base_from_first = builder.recorded(plan.cameras[0], builder.frame(plan.sources[0]));
        // The reconstruction frame is that of the first camera at the first source time.
        builder.recon_from_base = base_from_first.inverse().relabelled();
        builder
    }

    /// Episode frame of a clip frame.
    pub(crate) fn frame(&self, clip_frame: FrameIndex) -> usize {
        self.plan.first.at() + clip_frame.at()
    }

    /// Camera-to-base pose as it is recorded.
    pub(crate) fn recorded(&self, camera: usize, frame: usize) -> Pose<Base, Camera> {
        self.episode.recorded_from_camera(camera, frame)
    }

    /// A camera in the reconstruction frame, as its pose is recorded.
    pub(crate) fn posed(&self, camera: usize, frame: usize) -> PosedCamera<Recon> {
        let lens = self.episode.cameras[camera].recorded_lens;
        PosedCamera::new(lens, self.recorded(camera, frame)).in_frame(&self.recon_from_base)
    }
}

/// What is known of the robot in a view: its mesh as the recorded camera has it.
pub(crate) struct RobotSeen {
    /// Camera z, metres; 0 where there is no robot. `[A]`
    pub(crate) depth_m: Vec<f32>,
    /// Link, [`NO_LINK`] where no robot is. `[A]`
    pub(crate) link: Vec<u8>,
    /// Valid support by the rule of `robot-maps`, 1 or 0. `[A]`
    pub(crate) support: Vec<u8>,
    /// Whether it lies beside the robot of the picture, because the calibration is wrong.
    pub(crate) displaced: bool,
}

impl ClipBuilder<'_> {
    /// The robot in a view of a camera. With an exact calibration it is the robot of the picture, where nothing hides it.
    pub(crate) fn robot_seen(&self, view: &View, camera: usize, frame: usize) -> RobotSeen {
        let eye = &self.episode.cameras[camera];
        let displaced = self.data.world.is_some() && (eye.mount, eye.lens) != (eye.recorded_mount, eye.recorded_lens);
        let (depth_m, id) = if displaced {
            self.episode.robot_as_recorded(camera, frame)
        } else {
            (view.depth_m.clone(), view.id.clone())
        };
        let [height, width] = self.plan.size;
        let link: Vec<u8> = id
            .iter()
            .map(|&id| if id < FIRST_OBJECT_ID { id } else { NO_LINK })
            .collect();
        let support = valid_support(&depth_m, &link, width, height, &SupportRule::default());
        let depth_m = depth_m
            .iter()
            .zip(&link)
            .map(|(&depth, &link)| if link == NO_LINK { 0.0 } else { depth });
        RobotSeen {
            depth_m: depth_m.collect(),
            link,
            support,
            displaced,
        }
    }
}
