//! Where an episode plays: the plain robot cell, or a wide world.

use std::sync::Arc;

use glam::DVec3;
use rogs_geometry::Pose;

use crate::cameras::{CAMERAS, EpisodeCamera, draw_cameras};
use crate::config::SynthConfig;
use crate::math::Draw;
use crate::render::{Material, PreparedMesh, Sensor};
use crate::scene::{Body, Builder, Lights, Object, draw_lights, draw_material, draw_robot_materials, draw_room};
use crate::world::{
    GuestArm, GuestMotion, Keep, Outline, Props, Surfaces, WideRoom, World, draw_clutter, draw_guest_motion,
    draw_wide_cameras, draw_wide_lights, draw_wide_room, draw_wide_sensors, furnish,
};

/// Purposes of the seeded streams.
mod stream {
    pub(super) const ROOM: u64 = 1;
    pub(super) const LIGHT: u64 = 2;
    pub(super) const ROBOT: u64 = 3;
    pub(super) const CAMERAS: u64 = 4;
    pub(super) const SENSORS: u64 = 5;
    pub(super) const WORLD: u64 = 20;
    pub(super) const FURNITURE: u64 = 21;
    pub(super) const CLUTTER: u64 = 22;
    pub(super) const GUEST: u64 = 23;
}

/// Everything of an episode that stands before its objects and motion are drawn.
pub(crate) struct Setting {
    pub(crate) scenery: Builder,
    /// Height of the table top in the base frame, metres; where it is tilted, at its pivot.
    pub(crate) table_z: f64,
    pub(crate) lights: Lights,
    pub(crate) cameras: [EpisodeCamera; CAMERAS],
    pub(crate) sensors: [Sensor; CAMERAS],
    wide: Option<WideRoom>,
}

/// A robot in an episode: its links, and how it moves where it is not the generator's own.
pub(crate) struct Cast {
    pub(crate) links: Vec<Body>,
    pub(crate) guest: Option<(GuestMotion, Vec<String>)>,
}

impl Setting {
    /// Draws the setting of a seed.
    pub(crate) fn draw(config: &SynthConfig, seed: u64, props: &Props) -> Self {
        let mut draw = Draw::new(seed, stream::WORLD);
        let wide = config
            .world
            .as_ref()
            .and_then(|world| Some((world, world.outline(&mut draw)?)));
        match wide {
            Some((world, outline)) => Self::wide(config, seed, (world, outline), props, &mut draw),
            None => Self::plain(config, seed),
        }
    }

    fn plain(config: &SynthConfig, seed: u64) -> Self {
        let room = draw_room(&mut Draw::new(seed, stream::ROOM));
        let mut draw = Draw::new(seed, stream::CAMERAS);
        Self {
            table_z: room.table_z,
            scenery: Builder { bodies: room.bodies },
            lights: draw_lights(&mut Draw::new(seed, stream::LIGHT)),
            cameras: draw_cameras(&mut draw, config.resolution, config.calibration_noise, room.table_z),
            sensors: draw_sensors(&mut Draw::new(seed, stream::SENSORS), config.sensor_noise),
            wide: None,
        }
    }

    fn wide(
        config: &SynthConfig,
        seed: u64,
        (world, outline): (&World, Outline),
        props: &Props,
        draw: &mut Draw,
    ) -> Self {
        let surfaces = Surfaces { world, props };
        let heights = outline.heights(world, draw);
        let mut of_cameras = Draw::new(seed, stream::CAMERAS);
        let cameras = draw_wide_cameras(&mut of_cameras, (world, outline), config.resolution, heights);
        let mut of_room = Draw::new(seed, stream::ROOM);
        let seen = (cameras.eyes.as_slice(), cameras.ahead);
        let (mut scenery, room) = draw_wide_room(&mut of_room, &surfaces, outline, seen, heights);
        let in_room = outline.is_room();
        let keep = Keep {
            eyes: &cameras.eyes,
            sights: &cameras.sights,
            robot: !in_room,
            ahead: in_room.then_some((cameras.eyes[0], cameras.ahead)),
        };
        let mut of_furniture = Draw::new(seed, stream::FURNITURE);
        furnish(&mut of_furniture, &surfaces, &mut scenery, (&room, outline), &keep);
        let middle = cameras.eyes[0] + cameras.ahead * (2.0 * outline.scale);
        let mut of_light = Draw::new(seed, stream::LIGHT);
        Self {
            table_z: room.table_height(0.5, 0.0),
            scenery,
            lights: draw_wide_lights(&mut of_light, &surfaces, outline, middle),
            cameras: cameras.cameras,
            sensors: draw_wide_sensors(&mut Draw::new(seed, stream::SENSORS), world),
            wide: Some(room),
        }
    }

    /// Height of the table at a place, base frame, metres.
    pub(crate) fn table_height(&self, place: DVec3) -> f64 {
        self.wide
            .as_ref()
            .map_or(self.table_z, |room| room.table_height(place.x, place.y))
    }

    /// Puts objects of a level table on a tilted one; the first, which the gripper takes from above, stays upright.
    pub(crate) fn place(&self, objects: &mut [Object]) {
        let Some(room) = &self.wide else { return };
        let tilt = room.tilt();
        for (index, object) in objects.iter_mut().enumerate() {
            let foot = object
                .start
                .translation
                .with_z(self.table_height(object.start.translation));
            let up = DVec3::Z * object.half.z;
            object.start = if index == 0 {
                Pose::new(object.start.rotation, foot + up)
            } else {
                Pose::new(tilt * object.start.rotation, foot + tilt * up)
            };
        }
    }

    /// The robot of a seed: the generator's own, or in a share of wide worlds one of the arms at hand for which a motion is
    /// found.
    pub(crate) fn cast(&self, config: &SynthConfig, seed: u64, own: &[Arc<PreparedMesh>], props: &Props) -> Cast {
        let mut draw = Draw::new(seed, stream::GUEST);
        let share = draw.unit();
        let which = draw.index(props.arms.len().max(1));
        let wanted = (self.wide.is_some() && config.world.as_ref().is_some_and(|world| share < world.arms))
            .then(|| props.arms.get(which))
            .flatten();
        let moved = wanted.and_then(|arm: &GuestArm| {
            let motion = draw_guest_motion(&mut draw, arm, self.table_z, config.frames as usize)?;
            Some((arm, motion))
        });
        let of_link = |(index, (mesh, materials))| Body {
            id: index as u8,
            mesh,
            materials,
            fixed: None,
            shadow: true,
        };
        let Some((arm, motion)) = moved else {
            let materials = draw_robot_materials(&mut Draw::new(seed, stream::ROBOT));
            let links = own.iter().map(|mesh| (mesh.clone(), materials.clone()));
            return Cast {
                links: links.enumerate().map(of_link).collect(),
                guest: None,
            };
        };
        // Links of an arm have few colours.
        let mut of_colours = Draw::new(seed, stream::ROBOT);
        let own = draw_robot_materials(&mut of_colours);
        let bright = draw_material(&mut of_colours, 0.3, 0.7);
        let palette = [own[0], own[1], own[2], Material { grain: 0.02, ..bright }];
        let links = arm.meshes().map(|(mesh, parts)| {
            let first = of_colours.index(8);
            let colour = |part: usize| palette[[0, 0, 0, 1, 1, 2, 3, 0][(first + 3 * part) % 8]];
            (mesh, (0..parts).map(colour).collect())
        });
        Cast {
            links: links.enumerate().map(of_link).collect(),
            guest: Some((motion, arm.joint_names().to_vec())),
        }
    }

    /// Puts clutter on the table of a wide world, where neither the hand nor objects come.
    pub(crate) fn clutter(
        &mut self,
        config: &SynthConfig,
        seed: u64,
        props: &Props,
        tools: &[DVec3],
        objects: &[Object],
    ) {
        let (Some(room), Some(world)) = (&self.wide, &config.world) else {
            return;
        };
        let discs: Vec<(DVec3, f64)> = objects
            .iter()
            .map(|object| (object.start.translation, object.radius))
            .collect();
        let surfaces = Surfaces { world, props };
        let mut draw = Draw::new(seed, stream::CLUTTER);
        draw_clutter(&mut draw, &surfaces, &mut self.scenery, room, (tools, &discs));
    }
}

fn draw_sensors(draw: &mut Draw, noisy: bool) -> [Sensor; CAMERAS] {
    let exposure = draw.range(0.75, 1.05);
    let pairs: Vec<Sensor> = (0..3)
        .map(|_| Sensor {
            exposure: (exposure * draw.range(0.9, 1.12)) as f32,
            balance: [draw.range(0.96, 1.04) as f32, 1.0, draw.range(0.96, 1.04) as f32],
            vignette: if noisy { draw.range(0.02, 0.18) as f32 } else { 0.0 },
            noise: if noisy { draw.range(0.6, 2.6) as f32 } else { 0.0 },
            finish: None,
        })
        .collect();
    std::array::from_fn(|camera| pairs[camera % 3])
}
