//! A procedural episode as training cuts clips from it: frames, recorded cameras, links and support.

use rogs_geometry::{Base, Camera, Pose, PosedCamera, Recon};
use rogs_robot_maps::{SupportRule, valid_support};
use rogs_schemas::FrameIndex;
use rogs_schemas::records::robot::NO_LINK;
use rogs_synth::{Episode, EpisodeCamera, FIRST_OBJECT_ID, View};

use crate::config::DataSettings;
use crate::plan::ClipPlan;

/// Cameras whose images the network sees; their right eyes follow them in the episode.
pub(crate) const SOURCE_CAMERAS: usize = 3;
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
        let base_from_first = builder.recorded(0, builder.frame(plan.sources[0]));
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
        let camera = &self.episode.cameras[camera];
        let recorded = EpisodeCamera {
            mount: camera.recorded_mount,
            ..*camera
        };
        recorded.base_from_camera(&self.episode.base_from_flange(frame))
    }

    /// A camera in the reconstruction frame, as its pose is recorded.
    pub(crate) fn posed(&self, camera: usize, frame: usize) -> PosedCamera<Recon> {
        let lens = self.episode.cameras[camera].lens;
        PosedCamera::new(lens, self.recorded(camera, frame)).in_frame(&self.recon_from_base)
    }
}

/// Link of every pixel, [`NO_LINK`] where no robot is seen. `[A]`
pub(crate) fn links(view: &View) -> Vec<u8> {
    let link = |&id: &u8| if id < FIRST_OBJECT_ID { id } else { NO_LINK };
    view.id.iter().map(link).collect()
}

/// Valid robot support by the rule of `robot-maps`, 1 or 0. `[A]`
pub(crate) fn support(view: &View, [height, width]: [u32; 2]) -> Vec<u8> {
    valid_support(&view.depth_m, &links(view), width, height, &SupportRule::default())
}
