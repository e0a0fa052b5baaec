//! Wide worlds: what an episode may look like beyond the plain robot cell. Shares and ranges are settings, an episode draws
//! from them; the plain cell is not touched by anything here.

mod cameras;
mod check;
mod clutter;
mod furniture;
mod guest;
mod props;
mod room;
mod sensor;
mod surface;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::Draw;

pub(crate) use cameras::draw_wide_cameras;
pub(crate) use clutter::draw_clutter;
pub use guest::{GuestArm, GuestMesh, Kinematics, MOST_LINKS};
pub(crate) use guest::{GuestMotion, draw_guest_motion};
pub use props::{Model, Props, Sky};
pub(crate) use room::{Keep, WideRoom, draw_wide_lights, draw_wide_room, furnish};
pub(crate) use sensor::draw_wide_sensors;
pub(crate) use surface::Surfaces;

/// How wide the worlds of episodes are. A range is drawn from evenly; lengths are metres, angles degrees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct World {
    /// Share of episodes with a wide world; the others are plain robot cells, as without these settings.
    pub share: f64,
    /// How often each arrangement of cameras comes.
    pub layouts: Layouts,
    /// Share of robot cells in which the second external camera sees the room instead of the robot.
    pub look_away: f64,
    /// Horizontal field of view of external cameras and of those of rooms.
    pub field_of_view_deg: [f64; 2],
    /// Horizontal field of view of the wrist camera.
    pub wrist_field_of_view_deg: [f64; 2],
    /// Distance of external cameras from the workspace in the layouts `near` and `ring`.
    pub distance_m: [f64; 2],
    /// Distance from the first to each other camera in the layouts `near` and `room`; in rooms it scales with them.
    pub baseline_m: [f64; 2],
    /// From the base of the robot to the first camera in the layout `room`.
    pub base_distance_m: [f64; 2],
    /// Factor on all lengths of a scene in the layout `room`.
    pub room_scale: [f64; 2],
    /// Sides of rooms.
    pub room_m: [f64; 2],
    /// Pieces of furniture in a room.
    pub furniture: [u32; 2],
    /// Height of the base above the floor; below 0.35 m the robot stands on the floor itself.
    pub base_height_m: [f64; 2],
    /// Height of the table above the base.
    pub table_height_m: [f64; 2],
    /// Tilt of the table.
    pub table_tilt_deg: [f64; 2],
    /// Things on the table that nobody touches, beside the objects.
    pub clutter: [u32; 2],
    /// Share of surfaces with a photograph, where there are photographs.
    pub photos: f64,
    /// Share of pieces of furniture and clutter that are models, where there are models.
    pub models: f64,
    /// Share of scenes lit by a light probe, where there are light probes.
    pub probes: f64,
    /// Share of episodes with another arm, where there are other arms.
    pub arms: f64,
    /// Imperfections of pictures.
    pub sensor: SensorRanges,
    /// Errors of what is recorded of cameras.
    pub calibration: CalibrationRanges,
}

/// Weights of the arrangements of cameras; what counts are their ratios.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Layouts {
    /// One external camera on each side of the robot.
    pub cell: f64,
    /// External cameras side by side.
    pub near: f64,
    /// External cameras anywhere around the workspace.
    pub ring: f64,
    /// All cameras stand still, see a room and turn their backs to the robot.
    pub room: f64,
}

/// Imperfections of pictures, the same for both eyes of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SensorRanges {
    /// Factor on linear light.
    pub exposure: [f64; 2],
    /// Largest deviation of the gains of red and blue from 1.
    pub balance: f64,
    /// Exponent of the encoded picture: contrast.
    pub contrast: [f64; 2],
    /// Darkening at the corners, a share.
    pub vignette: [f64; 2],
    /// Standard deviation of the noise, 8-bit levels.
    pub noise: [f64; 2],
    /// Standard deviation of blur along rows and along columns, each drawn, in thousandths of the width of the image.
    pub blur: [f64; 2],
    /// Share of cameras whose pictures were compressed.
    pub compressed: f64,
    /// Quality of the compression, as JPEG counts: 1 to 100.
    pub quality: [f64; 2],
}

/// Errors of recorded cameras: a deviation is drawn for every camera between 0 and the largest, then the error of that
/// deviation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CalibrationRanges {
    /// Share of episodes with errors.
    pub share: f64,
    /// Largest deviation of positions of fixed cameras.
    pub external_m: f64,
    /// Largest deviation of directions of fixed cameras.
    pub external_deg: f64,
    /// Largest deviation of the position of the wrist camera on the hand.
    pub wrist_m: f64,
    /// Largest deviation of its direction.
    pub wrist_deg: f64,
    /// Largest deviation of focal lengths, a share.
    pub focal: f64,
}

impl Default for World {
    fn default() -> Self {
        Self {
            share: 0.85,
            layouts: Layouts::default(),
            look_away: 0.1,
            field_of_view_deg: [45.0, 105.0],
            wrist_field_of_view_deg: [60.0, 100.0],
            distance_m: [0.45, 1.8],
            baseline_m: [0.08, 0.7],
            base_distance_m: [1.0, 6.0],
            room_scale: [0.4, 1.0],
            room_m: [3.0, 9.0],
            furniture: [6, 24],
            base_height_m: [0.0, 1.0],
            table_height_m: [-0.15, 0.06],
            table_tilt_deg: [0.0, 2.0],
            clutter: [0, 12],
            photos: 0.6,
            models: 0.5,
            probes: 0.5,
            arms: 0.3,
            sensor: SensorRanges::default(),
            calibration: CalibrationRanges::default(),
        }
    }
}

impl Default for Layouts {
    fn default() -> Self {
        Self {
            cell: 3.0,
            near: 1.0,
            ring: 2.0,
            room: 2.0,
        }
    }
}

impl Default for SensorRanges {
    fn default() -> Self {
        Self {
            exposure: [0.55, 1.35],
            balance: 0.15,
            contrast: [0.8, 1.25],
            vignette: [0.0, 0.35],
            noise: [0.3, 4.0],
            blur: [0.0, 5.0],
            compressed: 0.6,
            quality: [35.0, 92.0],
        }
    }
}

impl Default for CalibrationRanges {
    fn default() -> Self {
        Self {
            share: 0.5,
            external_m: 0.01,
            external_deg: 1.0,
            wrist_m: 0.01,
            wrist_deg: 2.0,
            focal: 0.01,
        }
    }
}

/// An arrangement of cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Layout {
    Cell,
    Near,
    Ring,
    Room,
}

impl Layouts {
    fn weights(&self) -> [(Layout, f64); 4] {
        [
            (Layout::Cell, self.cell),
            (Layout::Near, self.near),
            (Layout::Ring, self.ring),
            (Layout::Room, self.room),
        ]
    }

    /// The layout of a number in [0, 1).
    fn of(&self, share: f64) -> Layout {
        let total: f64 = self.weights().iter().map(|(_, weight)| weight).sum();
        let mut left = share * total;
        for (layout, weight) in self.weights() {
            if left < weight {
                return layout;
            }
            left -= weight;
        }
        Layout::Cell
    }
}

/// What is settled first of a wide world.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Outline {
    pub layout: Layout,
    /// Factor on the lengths of what stands in the room.
    pub scale: f64,
}

impl Outline {
    /// Whether cameras see a room and no robot.
    pub(crate) fn is_room(self) -> bool {
        self.layout == Layout::Room
    }

    /// Height of the table over the base and of the base over the floor, metres. Where a room is seen and no robot, every
    /// other base stands on the floor.
    pub(crate) fn heights(self, world: &World, draw: &mut Draw) -> (f64, f64) {
        let height = within(draw, world.base_height_m);
        let low = draw.range(0.0, 0.1);
        let on_floor = draw.chance(0.5) && self.is_room();
        let base_height = if on_floor { low } else { height };
        let table_z = within(draw, world.table_height_m).max(-base_height);
        (table_z, base_height)
    }
}

impl World {
    /// Whether the next episode has a wide world, and which; `None` for a plain cell.
    pub(crate) fn outline(&self, draw: &mut Draw) -> Option<Outline> {
        if !draw.chance(self.share) {
            return None;
        }
        let layout = self.layouts.of(draw.unit());
        let [low, high] = self.room_scale;
        let scale = draw.range(low, high);
        let scale = if layout == Layout::Room { scale } else { 1.0 };
        Some(Outline { layout, scale })
    }
}

/// Evenly from a range.
pub(crate) fn within(draw: &mut Draw, [low, high]: [f64; 2]) -> f64 {
    draw.range(low, high)
}

/// A number of things, both ends included.
pub(crate) fn count(draw: &mut Draw, [fewest, most]: [u32; 2]) -> usize {
    fewest as usize + draw.index((most - fewest + 1) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_possible_and_nonsense_is_named() {
        World::default().check().unwrap();
        let refused = |change: fn(&mut World)| {
            let mut world = World::default();
            change(&mut world);
            world.check().unwrap_err().to_string()
        };
        assert!(refused(|w| w.share = 1.5).starts_with("world.share: `1.5`"));
        assert!(refused(|w| w.room_m = [6.0, 3.0]).starts_with("world.room_m: `6 to 3`"));
        assert!(refused(|w| w.distance_m = [f64::NAN, 1.0]).starts_with("world.distance_m"));
        assert!(refused(|w| w.clutter = [0, 400]).starts_with("world.clutter"));
        assert!(refused(|w| w.sensor.noise = [0.0, f64::INFINITY]).starts_with("world.sensor.noise"));
        assert!(refused(|w| w.calibration.wrist_deg = -1.0).starts_with("world.calibration.wrist_deg"));
        let none = Layouts {
            cell: 0.0,
            near: 0.0,
            ring: 0.0,
            room: 0.0,
        };
        let world = World {
            layouts: none,
            ..World::default()
        };
        assert!(world.check().unwrap_err().to_string().starts_with("world.layouts"));
    }

    #[test]
    fn layouts_come_as_often_as_they_weigh() {
        let layouts = Layouts {
            cell: 0.0,
            near: 1.0,
            ring: 0.0,
            room: 3.0,
        };
        let rooms = (0..1000)
            .filter(|&k| layouts.of(f64::from(k) / 1000.0) == Layout::Room)
            .count();
        assert_eq!(rooms, 750);
        assert_eq!(layouts.of(0.1), Layout::Near);
    }
}
