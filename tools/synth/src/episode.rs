//! An episode in memory: everything but its pictures, which are drawn frame by frame on request.

use std::sync::{Arc, OnceLock};

use glam::DVec3;
use rayon::prelude::*;
use rogs_geometry::{Base, Camera, Pose};

use crate::cameras::{CAMERAS, EpisodeCamera};
use crate::config::SynthConfig;
use crate::error::{Error, Result};
use crate::frame::BodyFrame;
use crate::math::{Draw, rot_z};
use crate::motion::{Action, Motion, draw_motion};
use crate::render::{LitScene, Photo, PreparedMesh, Sensor, View, render_geometry, render_view};
use crate::robot::{ARM_JOINTS, FLANGE_LINK, GRIPPER_LINK, Robot, RobotState, TOOL_Z};
use crate::scene::{Body, FIRST_OBJECT_ID, Lights, Object, draw_objects};
use crate::setting::{Cast, Setting};
use crate::world::{GuestMotion, Props};

/// Attempts to find objects and a motion that fit together.
const ATTEMPTS: usize = 24;

/// Purposes of the seeded streams; `setting` has the others.
mod stream {
    pub(super) const ACTION: u64 = 6;
    /// Plus the attempt.
    pub(super) const OBJECTS: u64 = 1000;
}

/// A procedural episode: geometry and motion are exact, pictures come from [`Episode::render_frame`].
#[derive(Debug, Clone)]
pub struct Episode {
    /// Settings it was made with.
    pub config: SynthConfig,
    /// Its seed.
    pub seed: u64,
    /// What happens.
    pub action: Action,
    /// Joint and gripper states. `[F]` Of another arm the joints are in `guest`, and zero here.
    pub states: Vec<RobotState>,
    /// Joints of another arm than the generator's own.
    pub guest: Option<GuestStates>,
    /// The cameras in the order of [`crate::CAMERA_NAMES`].
    pub cameras: [EpisodeCamera; CAMERAS],
    /// Frames `[from, to)` in which the first object is rigid to the flange.
    pub held: Option<[usize; 2]>,
    pub(crate) bodies: Vec<Body>,
    /// Body-to-base. `[F][body]`
    pub(crate) poses: Vec<Vec<Pose<Base, BodyFrame>>>,
    object_names: Vec<&'static str>,
    lights: Lights,
    sensors: [Sensor; CAMERAS],
    photos: Arc<Vec<Photo>>,
}

/// The pictures of all cameras at one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Number of the frame.
    pub index: usize,
    /// One a camera, in the order of [`crate::CAMERA_NAMES`].
    pub views: Vec<View>,
}

/// How another arm than the generator's own moves.
#[derive(Debug, Clone, PartialEq)]
pub struct GuestStates {
    /// Names of its driven joints. `[J]`
    pub joint_names: Vec<String>,
    /// Their positions, radians or metres. `[F][J]`
    pub joints: Vec<Vec<f64>>,
    /// The frame that carries the wrist camera, its z towards the tool. `[F]`
    base_from_flange: Vec<Pose<Base, BodyFrame>>,
    /// The place between the fingers, base frame, metres. `[F]`
    tool: Vec<DVec3>,
}

/// The generator's own robot, made once.
fn own_robot() -> &'static (Robot, Vec<Arc<PreparedMesh>>) {
    static OWN: OnceLock<(Robot, Vec<Arc<PreparedMesh>>)> = OnceLock::new();
    OWN.get_or_init(|| {
        let robot = Robot::new();
        let prepared = robot
            .links
            .iter()
            .map(|link| Arc::new(PreparedMesh::new((*link.mesh).clone())));
        let prepared = prepared.collect();
        (robot, prepared)
    })
}

/// Makes the episode of a seed.
///
/// # Errors
/// When the settings are wrong, or when no motion can be found for this seed.
pub fn generate_episode(config: &SynthConfig, seed: u64) -> Result<Episode> {
    generate_episode_with(config, seed, &Props::default())
}

/// Makes the episode of a seed; wide worlds use what is at hand.
///
/// # Errors
/// As [`generate_episode`].
pub fn generate_episode_with(config: &SynthConfig, seed: u64, props: &Props) -> Result<Episode> {
    config.check()?;
    let (robot, own_meshes) = own_robot();
    let mut setting = Setting::draw(config, seed, props);
    let frames = config.frames as usize;
    let mut choice = Draw::new(seed, stream::ACTION);
    let drawn = Action::of(choice.unit());
    let action = config.action.unwrap_or(drawn);
    let [fewest, most] = config.objects;
    let count = fewest as usize + choice.index((most - fewest + 1) as usize);
    let Cast { links, guest } = setting.cast(config, seed, own_meshes, props);
    let found = (0..ATTEMPTS).find_map(|attempt| {
        let mut draw = Draw::new(seed, stream::OBJECTS + attempt as u64);
        let mut objects = draw_objects(&mut draw, count, setting.table_z);
        setting.place(&mut objects);
        let enough = objects.len() >= (fewest as usize).min(count);
        let motion = match &guest {
            None => {
                let table_z = setting.table_height(objects[0].start.translation);
                draw_motion(&mut draw, robot, &objects, table_z, frames, config.fps, action)?
            }
            Some((moved, _)) => carried(&mut draw, moved, &objects),
        };
        enough.then_some((objects, motion))
    });
    let Some((objects, motion)) = found else {
        return Err(Error::NoMotion {
            seed,
            attempts: ATTEMPTS,
        });
    };
    let object_names = objects.iter().map(|object| object.name).collect();
    let robot_poses: Vec<Vec<Pose<Base, BodyFrame>>> = match &guest {
        None => motion.states.iter().map(|state| robot.fk(state)).collect(),
        Some((moved, _)) => moved.links.clone(),
    };
    let tools: Vec<DVec3> = match &guest {
        None => {
            let tool = |poses: &Vec<Pose<Base, BodyFrame>>| poses[GRIPPER_LINK].point(DVec3::Z * TOOL_Z);
            robot_poses.iter().map(tool).collect()
        }
        Some((moved, _)) => moved.tool.clone(),
    };
    setting.clutter(config, seed, props, &tools, &objects);
    let scenery = &setting.scenery.bodies;
    let poses = robot_poses
        .into_iter()
        .zip(&motion.target)
        .map(|(links, target)| body_poses(links, &objects, *target, scenery))
        .collect();
    let mut bodies = links;
    bodies.extend(objects.into_iter().map(|object| object.body));
    bodies.extend(setting.scenery.bodies);
    Ok(Episode {
        config: config.clone(),
        seed,
        action: motion.action,
        states: motion.states,
        guest: guest.map(|(moved, joint_names)| GuestStates {
            joint_names,
            joints: moved.joints,
            base_from_flange: moved.flange,
            tool: moved.tool,
        }),
        cameras: setting.cameras,
        held: motion.held,
        bodies,
        poses,
        object_names,
        lights: setting.lights,
        sensors: setting.sensors,
        photos: props.photos.clone(),
    })
}

/// The motion of objects beside another arm: where its gripper keeps still, which is half of the time, the first one is in
/// it from beginning to end.
fn carried(draw: &mut Draw, moved: &GuestMotion, objects: &[Object]) -> Motion {
    let states = moved.gripper.iter().map(|&gripper| RobotState {
        joints: [0.0; ARM_JOINTS],
        gripper,
    });
    let frames = moved.flange.len();
    let held = moved.holds;
    let turn = draw.range(-std::f64::consts::PI, std::f64::consts::PI);
    let first = moved.flange[0].inverse();
    let in_hand = first * Pose::<Base, BodyFrame>::new(rot_z(turn), moved.tool[0]);
    let target = |frame: usize| {
        if held {
            moved.flange[frame] * in_hand
        } else {
            objects[0].start
        }
    };
    Motion {
        action: if held { Action::Carry } else { Action::Reach },
        states: states.collect(),
        target: (0..frames).map(target).collect(),
        held: held.then_some([0, frames]),
    }
}

/// Links, objects, scenery.
fn body_poses(
    links: Vec<Pose<Base, BodyFrame>>,
    objects: &[Object],
    target: Pose<Base, BodyFrame>,
    scenery: &[Body],
) -> Vec<Pose<Base, BodyFrame>> {
    let mut poses = links;
    let object = |(index, object): (usize, &Object)| if index == 0 { target } else { object.start };
    poses.extend(objects.iter().enumerate().map(object));
    poses.extend(scenery.iter().map(|body| body.fixed.unwrap_or(Pose::IDENTITY)));
    poses
}

impl Episode {
    /// Name of the episode: the kind of motion and the seed.
    #[must_use]
    pub fn id(&self) -> String {
        format!("synth-{:08}", self.seed)
    }

    /// Number of frames.
    #[must_use]
    pub fn frame_count(&self) -> usize {
        self.states.len()
    }

    /// What happens, in words.
    #[must_use]
    pub fn task(&self) -> String {
        let object = self.object_names[0];
        match self.action {
            Action::Reach => format!("reach for the {object}"),
            Action::Grasp => format!("pick up the {object}"),
            Action::Carry => format!("move the {object}"),
            Action::Push => format!("push the {object}"),
        }
    }

    /// Flange-to-base pose at a frame.
    #[must_use]
    pub fn base_from_flange(&self, frame: usize) -> Pose<Base, BodyFrame> {
        match &self.guest {
            None => self.poses[frame][FLANGE_LINK],
            Some(guest) => guest.base_from_flange[frame],
        }
    }

    /// The tool centre in the base frame at a frame, metres.
    #[must_use]
    pub fn tool(&self, frame: usize) -> DVec3 {
        match &self.guest {
            None => self.poses[frame][GRIPPER_LINK].point(DVec3::Z * TOOL_Z),
            Some(guest) => guest.tool[frame],
        }
    }

    /// Camera-to-base pose at a frame, as rendered.
    #[must_use]
    pub fn base_from_camera(&self, camera: usize, frame: usize) -> Pose<Base, Camera> {
        self.cameras[camera].base_from_camera(&self.base_from_flange(frame))
    }

    /// Camera-to-base pose at a frame, as it is recorded.
    #[must_use]
    pub fn recorded_from_camera(&self, camera: usize, frame: usize) -> Pose<Base, Camera> {
        let camera = &self.cameras[camera];
        let recorded = EpisodeCamera {
            mount: camera.recorded_mount,
            ..*camera
        };
        recorded.base_from_camera(&self.base_from_flange(frame))
    }

    /// Depth and link ids of the robot alone, drawn with what is recorded of a camera: what whoever knows robot and
    /// calibration computes, hidden by nothing. As [`View`] has them.
    #[must_use]
    pub fn robot_as_recorded(&self, camera: usize, frame: usize) -> (Vec<f32>, Vec<u8>) {
        let robot = self.bodies.iter().take_while(|body| body.id < FIRST_OBJECT_ID).count();
        let lens = &self.cameras[camera].recorded_lens;
        render_geometry(
            &self.bodies[..robot],
            &self.poses[frame][..robot],
            &self.recorded_from_camera(camera, frame),
            &lens.intrinsics,
            [lens.height as usize, lens.width as usize],
        )
    }

    /// Pose of the link, object or piece of scenery of this id at a frame, body-to-base; `None` where no body has the id.
    #[must_use]
    pub fn body_pose(&self, id: u8, frame: usize) -> Option<Pose<Base, BodyFrame>> {
        let index = self.bodies.iter().position(|body| body.id == id)?;
        Some(self.poses[frame][index])
    }

    /// Displacement in the base frame from one frame to another of a point of the body of this id, metres.
    #[must_use]
    pub fn displacement(&self, id: u8, point_in_base: DVec3, from: usize, to: usize) -> Option<DVec3> {
        let (a, b) = (self.body_pose(id, from)?, self.body_pose(id, to)?);
        Some(b.point(a.inverse().point(point_in_base)) - point_in_base)
    }

    /// Draws the cameras of these numbers at one frame; cameras are drawn in parallel, the result is the same for any
    /// number of threads.
    #[must_use]
    pub fn render_cameras(&self, frame: usize, cameras: &[usize]) -> Vec<View> {
        self.render_moved(frame, frame, cameras, &|_| Pose::IDENTITY)
    }

    /// Draws the world of frame `shown` with the sensor noise of another frame, from cameras that have moved in their own
    /// frames.
    pub(crate) fn render_moved(
        &self,
        shown: usize,
        frame: usize,
        cameras: &[usize],
        moved: &(dyn Fn(usize) -> Pose<Camera, Camera> + Sync),
    ) -> Vec<View> {
        let scene = LitScene::new(&self.bodies, &self.poses[shown], &self.lights, &self.photos);
        let view = |&camera: &usize| {
            let pose = self.base_from_camera(camera, shown) * moved(camera);
            let lens = &self.cameras[camera].lens;
            let key = (self.seed as u32).wrapping_mul(0x9e37_79b9) ^ ((frame as u32) << 4) ^ camera as u32;
            let size = [lens.height as usize, lens.width as usize];
            render_view(&scene, &pose, &lens.intrinsics, size, &self.sensors[camera], key)
        };
        cameras.par_iter().map(view).collect()
    }

    /// Draws all six cameras at one frame.
    #[must_use]
    pub fn render_frame(&self, frame: usize) -> Frame {
        Frame {
            index: frame,
            views: self.render_cameras(frame, &[0, 1, 2, 3, 4, 5]),
        }
    }

    /// All frames, one after the other: for training without files.
    pub fn frames(&self) -> impl Iterator<Item = Frame> + '_ {
        (0..self.frame_count()).map(|frame| self.render_frame(frame))
    }
}
