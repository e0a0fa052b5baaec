//! An episode in memory: everything but its pictures, which are drawn frame by frame on request.

use std::sync::Arc;

use glam::DVec3;
use rayon::prelude::*;
use rogs_geometry::{Base, Camera, Pose};

use crate::cameras::{CAMERAS, EpisodeCamera, draw_cameras};
use crate::config::SynthConfig;
use crate::error::{Error, Result};
use crate::frame::BodyFrame;
use crate::math::Draw;
use crate::motion::{Action, draw_motion};
use crate::render::{LitScene, PreparedMesh, Sensor, View, render_view};
use crate::robot::{FLANGE_LINK, GRIPPER_LINK, Robot, RobotState, TOOL_Z};
use crate::scene::{Body, Lights, Object, draw_lights, draw_objects, draw_robot_materials, draw_room};

/// Attempts to find objects and a motion that fit together.
const ATTEMPTS: usize = 24;

/// Purposes of the seeded streams.
mod stream {
    pub(super) const ROOM: u64 = 1;
    pub(super) const LIGHT: u64 = 2;
    pub(super) const ROBOT: u64 = 3;
    pub(super) const CAMERAS: u64 = 4;
    pub(super) const SENSORS: u64 = 5;
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
    /// Joint and gripper states. `[F]`
    pub states: Vec<RobotState>,
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
}

/// The pictures of all cameras at one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Number of the frame.
    pub index: usize,
    /// One a camera, in the order of [`crate::CAMERA_NAMES`].
    pub views: Vec<View>,
}

/// Makes the episode of a seed.
///
/// # Errors
/// When the settings are wrong, or when no motion can be found for this seed.
pub fn generate_episode(config: &SynthConfig, seed: u64) -> Result<Episode> {
    config.check()?;
    let robot = Robot::new();
    let room = draw_room(&mut Draw::new(seed, stream::ROOM));
    let lights = draw_lights(&mut Draw::new(seed, stream::LIGHT));
    let frames = config.frames as usize;
    let mut choice = Draw::new(seed, stream::ACTION);
    let drawn = Action::of(choice.unit());
    let action = config.action.unwrap_or(drawn);
    let [fewest, most] = config.objects;
    let count = fewest as usize + choice.index((most - fewest + 1) as usize);
    let found = (0..ATTEMPTS).find_map(|attempt| {
        let mut draw = Draw::new(seed, stream::OBJECTS + attempt as u64);
        let objects = draw_objects(&mut draw, count, room.table_z);
        let enough = objects.len() >= (fewest as usize).min(count);
        let motion = draw_motion(&mut draw, &robot, &objects, room.table_z, frames, config.fps, action)?;
        enough.then_some((objects, motion))
    });
    let Some((objects, motion)) = found else {
        return Err(Error::NoMotion {
            seed,
            attempts: ATTEMPTS,
        });
    };
    let robot_materials = draw_robot_materials(&mut Draw::new(seed, stream::ROBOT));
    let links = robot.links.iter().enumerate().map(|(index, link)| Body {
        id: index as u8,
        mesh: Arc::new(PreparedMesh::new((*link.mesh).clone())),
        materials: robot_materials.clone(),
        fixed: None,
        shadow: true,
    });
    let object_names = objects.iter().map(|object| object.name).collect();
    let poses = (0..frames).map(|frame| {
        body_poses(
            &robot,
            &motion.states[frame],
            &objects,
            motion.target[frame],
            &room.bodies,
        )
    });
    let poses = poses.collect();
    let mut bodies: Vec<Body> = links.collect();
    bodies.extend(objects.into_iter().map(|object| object.body));
    bodies.extend(room.bodies);
    let mut draw = Draw::new(seed, stream::CAMERAS);
    let cameras = draw_cameras(&mut draw, config.resolution, config.calibration_noise, room.table_z);
    let sensors = draw_sensors(&mut Draw::new(seed, stream::SENSORS), config.sensor_noise);
    Ok(Episode {
        config: config.clone(),
        seed,
        action: motion.action,
        states: motion.states,
        cameras,
        held: motion.held,
        bodies,
        poses,
        object_names,
        lights,
        sensors,
    })
}

/// Links, objects, scenery.
fn body_poses(
    robot: &Robot,
    state: &RobotState,
    objects: &[Object],
    target: Pose<Base, BodyFrame>,
    scenery: &[Body],
) -> Vec<Pose<Base, BodyFrame>> {
    let mut poses = robot.fk(state);
    let object = |(index, object): (usize, &Object)| if index == 0 { target } else { object.start };
    poses.extend(objects.iter().enumerate().map(object));
    poses.extend(scenery.iter().map(|body| body.fixed.unwrap_or(Pose::IDENTITY)));
    poses
}

fn draw_sensors(draw: &mut Draw, noisy: bool) -> [Sensor; CAMERAS] {
    let exposure = draw.range(0.75, 1.05);
    let pairs: Vec<Sensor> = (0..3)
        .map(|_| Sensor {
            exposure: (exposure * draw.range(0.9, 1.12)) as f32,
            balance: [draw.range(0.96, 1.04) as f32, 1.0, draw.range(0.96, 1.04) as f32],
            vignette: if noisy { draw.range(0.02, 0.18) as f32 } else { 0.0 },
            noise: if noisy { draw.range(0.6, 2.6) as f32 } else { 0.0 },
        })
        .collect();
    std::array::from_fn(|camera| pairs[camera % 3])
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
        self.poses[frame][FLANGE_LINK]
    }

    /// The tool centre in the base frame at a frame, metres.
    #[must_use]
    pub fn tool(&self, frame: usize) -> DVec3 {
        self.poses[frame][GRIPPER_LINK].point(DVec3::Z * TOOL_Z)
    }

    /// Camera-to-base pose at a frame, as rendered.
    #[must_use]
    pub fn base_from_camera(&self, camera: usize, frame: usize) -> Pose<Base, Camera> {
        self.cameras[camera].base_from_camera(&self.base_from_flange(frame))
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
        let scene = LitScene::new(&self.bodies, &self.poses[shown], &self.lights);
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
