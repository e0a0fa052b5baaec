//! The source frames of a clip as the network sees them: reconstruction frame, internal units.

use burn::tensor::{Device, Tensor};
use rogs_geometry::{Base, Frame, LinkMotions, LinkPoses, Pinhole, Pose, PosedCamera, Recon};
use rogs_schemas::records::clip::{Clip, Observation, SourceView, time_of_frame};
use rogs_schemas::records::conditioning::Conditioning;
use rogs_schemas::records::robot::{NO_LINK, RobotMap, RobotMaps};
use rogs_schemas::units::LengthUnit;
use rogs_schemas::{FrameIndex, RigidPose};
use rogs_stage1::held::{HeldMotion, HeldPath};
use rogs_stage1::{Attention, NetworkCamera, SourceFrames};
use rogs_tensors::parameters::from_host;
use rogs_worker::{StageError, StageResult};

use crate::params::{CrossCamera, LiftParams};
use crate::rgb;

/// One source view with everything that belongs to it.
#[derive(Clone)]
pub(crate) struct View<'a> {
    pub(crate) view: SourceView,
    /// Index among the views of the conditioning record.
    pub(crate) conditioning: usize,
    pub(crate) map: &'a RobotMap,
    pub(crate) camera: NetworkCamera,
    pub(crate) lens: Pinhole,
    image: Observation<'a>,
}

/// The inputs of a clip, checked against each other.
pub(crate) struct Source<'a> {
    pub(crate) clip: &'a Clip,
    pub(crate) robot: &'a RobotMaps,
    pub(crate) conditioning: &'a Conditioning,
    pub(crate) views: Vec<View<'a>>,
    /// Where the base of the robot stands, internal units.
    pub(crate) recon_from_base_iu: Pose<Recon, Base>,
}

/// How the robot moves from one view's time to a query time.
#[derive(Debug, Clone)]
pub struct RobotAtTime {
    /// Conditioning map of the view for the query time. `[7, H, W]`
    pub kappa: Vec<f32>,
    /// Per link: rotation (w, x, y, z) of T(t) T(s)^-1 in the reconstruction frame. Needed for kinematic transport.
    pub link_rotation: Vec<[f32; 4]>,
    /// How the gripper moves what it holds; `None` where that is not asked for or not known.
    pub held: Option<HeldMotion>,
}

impl<'a> Source<'a> {
    /// Gathers the source views of a clip.
    pub(crate) fn new(
        clip: &'a Clip,
        robot: &'a RobotMaps,
        conditioning: &'a Conditioning,
        params: &LiftParams,
    ) -> StageResult<Self> {
        for (what, id) in [("robot maps", &robot.clip_id), ("conditioning", &conditioning.clip_id)] {
            if *id != clip.clip_id {
                return Err(StageError::bad_input(format!(
                    "the {what} are those of clip `{id}`, not of `{}`",
                    clip.clip_id
                )));
            }
        }
        let sizes = [(robot.height, robot.width), (conditioning.height, conditioning.width)];
        if sizes.iter().any(|&size| size != (clip.height, clip.width)) {
            let (height, width) = (clip.height, clip.width);
            return Err(StageError::bad_input(format!(
                "robot maps or conditioning are not {height}x{width} as the clip is"
            )));
        }
        let recon_from_base = pose::<Recon, Base>(&robot.recon_from_base)?;
        let chosen = chosen_views(clip, params)?;
        let views = chosen
            .into_iter()
            .map(|view| gather(clip, robot, conditioning, &recon_from_base, view))
            .collect::<StageResult<_>>()?;
        Ok(Self {
            clip,
            robot,
            conditioning,
            views,
            recon_from_base_iu: recon_from_base.in_unit(LengthUnit::Internal),
        })
    }

    /// The same views where they stand in another gathering of the same clip.
    pub(crate) fn placed_as(&self, other: &Source<'a>) -> Self {
        let views = self.views.iter().map(|view| {
            let same = other.views.iter().find(|own| own.view == view.view);
            same.unwrap_or(view).clone()
        });
        Self {
            views: views.collect(),
            recon_from_base_iu: other.recon_from_base_iu,
            ..*self
        }
    }

    /// Pixels of one image.
    pub(crate) fn area(&self) -> usize {
        self.clip.height as usize * self.clip.width as usize
    }

    /// The frames as network input; images are also returned for the colour shortcut. `[S, 3, H, W]`
    pub(crate) fn frames(&self, params: &LiftParams, device: &Device) -> (SourceFrames, Tensor<4>) {
        let (height, width) = (self.clip.height as usize, self.clip.width as usize);
        let mut images = Vec::with_capacity(self.views.len() * 3 * self.area());
        for view in &self.views {
            let planes = rgb::planar(view.image);
            match params.rgb_downsample {
                1 => images.extend(planes),
                factor => {
                    let degraded = |plane| rgb::degrade(plane, height, width, factor as usize);
                    planes
                        .chunks_exact(self.area())
                        .for_each(|plane| images.extend(degraded(plane)));
                }
            }
        }
        let images = from_host(images, [self.views.len(), 3, height, width], device);
        let attention = match params.attention {
            CrossCamera::Joint | CrossCamera::CameraWise => Attention::Joint,
            CrossCamera::WithinCamera => {
                Attention::WithinCamera(self.views.iter().map(|view| view.view.camera.0).collect())
            }
        };
        let frames = SourceFrames {
            images: images.clone(),
            cameras: self.views.iter().map(|view| view.camera).collect(),
            recon_from_base_iu: self.recon_from_base_iu,
            times: self
                .views
                .iter()
                .map(|view| time_of_frame(view.view.frame, self.clip.frame_count()) as f32)
                .collect(),
            attention,
        };
        (frames, images)
    }

    /// The path of what the gripper holds; `None` where no link carries the tool centre.
    pub(crate) fn held_path(&self) -> StageResult<Option<HeldPath>> {
        HeldPath::of_clip(self.robot, &self.clip.robot.gripper).map_err(bad_pose)
    }

    /// How the robot moves from view `index` to a clip frame. `position_m` are the source positions of the view's pixels
    /// when they are not the mesh's own (no anchoring): the FK displacement is then taken at those. `held` is the path of
    /// what the gripper holds, where weights ask for it.
    pub(crate) fn robot_at(
        &self,
        index: usize,
        frame: FrameIndex,
        position_m: Option<&[f32]>,
        held: Option<&HeldPath>,
    ) -> StageResult<RobotAtTime> {
        let view = &self.views[index];
        let at = |frame: FrameIndex| LinkPoses::at_frame(self.robot, frame).map_err(bad_pose);
        let motions = at(frame)?.motion_from(&at(view.view.frame)?);
        let stored = &self.conditioning.query_frames;
        let query = stored.iter().position(|&stored| stored == frame).ok_or_else(|| {
            StageError::bad_input(format!(
                "the conditioning has no maps for frame {frame}; it stores {stored:?}"
            ))
        })?;
        let robot = RobotAtTime::new(self.conditioning, view.conditioning, query, &motions, position_m);
        Ok(match held {
            Some(path) => robot.with_held(path, view.view.frame, frame.at() as f64, &self.recon_from_base_iu),
            None => robot,
        })
    }
}

impl RobotAtTime {
    /// The conditioning map of a view as it is stored for a query, and how the links turn. Given positions, FK
    /// displacements are those of `motions` at these: where there are no mesh points, and for times that are not stored
    /// (support, depth and prior do not depend on the query). `position_m [H W, 3]`, reconstruction frame
    #[must_use]
    pub fn new(
        conditioning: &Conditioning,
        view: usize,
        query: usize,
        motions: &LinkMotions,
        position_m: Option<&[f32]>,
    ) -> Self {
        let mut kappa = conditioning.dense(view, query);
        if let Some(position_m) = position_m {
            motions.displace(&conditioning.view_maps[view], position_m, &mut kappa);
        }
        Self {
            kappa,
            link_rotation: motions.rotations(),
            held: None,
        }
    }

    /// The same with how the gripper moves what it holds, from a source frame to a place between frames.
    #[must_use]
    pub fn with_held(
        self,
        path: &HeldPath,
        source: FrameIndex,
        position: f64,
        recon_from_base: &Pose<Recon, Base>,
    ) -> Self {
        Self {
            held: HeldMotion::new(path, source, position, recon_from_base),
            ..self
        }
    }
}

/// The views to lift, in token order.
fn chosen_views(clip: &Clip, params: &LiftParams) -> StageResult<Vec<SourceView>> {
    if let Some(frames) = &params.source_frames
        && let Some(unknown) = frames.iter().find(|frame| !clip.source_frames.contains(frame))
    {
        let known = &clip.source_frames;
        return Err(StageError::bad_params(format!(
            "`source_frames` names frame {unknown}, the clip's source frames are {known:?}"
        )));
    }
    let wanted = |view: &SourceView| {
        params
            .source_frames
            .as_ref()
            .is_none_or(|frames| frames.contains(&view.frame))
    };
    let views: Vec<SourceView> = clip.source_views().into_iter().filter(wanted).collect();
    if views.is_empty() {
        return Err(StageError::bad_input("the clip has no source views"));
    }
    Ok(views)
}

/// Everything of one view.
fn gather<'a>(
    clip: &'a Clip,
    robot: &'a RobotMaps,
    conditioning: &Conditioning,
    recon_from_base: &Pose<Recon, Base>,
    view: SourceView,
) -> StageResult<View<'a>> {
    let (camera, frame) = (&clip.cameras[view.camera.at()], view.frame.at());
    let missing = |what: &str| {
        StageError::bad_input(format!(
            "there is no {what} for camera `{}` at frame {frame}",
            camera.id
        ))
    };
    let image = clip.observation(view).ok_or_else(|| missing("source image"))?;
    let same = |map: &&RobotMap| map.camera == view.camera && map.frame == view.frame;
    let map = robot.maps.iter().find(same).ok_or_else(|| missing("robot map"))?;
    let conditioning = conditioning
        .views
        .iter()
        .position(|other| *other == view)
        .ok_or_else(|| missing("conditioning"))?;
    let posed = PosedCamera::of_clip(clip, robot, view.camera, view.frame)
        .map_err(bad_pose)?
        .in_frame(recon_from_base);
    Ok(View {
        view,
        conditioning,
        map,
        camera: NetworkCamera::new(&posed),
        lens: posed.lens,
        image,
    })
}

/// A stored pose with its frames.
fn pose<A: Frame, B: Frame>(stored: &RigidPose) -> StageResult<Pose<A, B>> {
    Pose::from_rigid(stored).map_err(bad_pose)
}

fn bad_pose(error: rogs_geometry::Error) -> StageError {
    StageError::bad_input(error.to_string())
}

/// Mesh depth in metres of a pixel with valid robot support.
pub(crate) fn mesh_depth_m(map: &RobotMap, pixel: usize) -> Option<f32> {
    (map.support[pixel] != 0 && map.link[pixel] != NO_LINK).then(|| map.depth_m[pixel])
}
