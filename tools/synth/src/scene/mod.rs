//! What stands in a scene: the bodies, their materials, and the lights, drawn from a seed.

mod objects;
mod room;

use std::sync::Arc;

use glam::Vec3;
use rogs_geometry::{Base, Pose};

use crate::frame::BodyFrame;
use crate::math::{Draw, hsv};
use crate::render::{Material, Pattern, PreparedMesh, ShadowRegion};
use crate::world::Sky;

pub(crate) use objects::{Object, draw_objects};
pub(crate) use room::{Builder, draw_room};

/// Id of the first movable object in the id maps; robot links come before.
pub const FIRST_OBJECT_ID: u8 = 64;

/// Id of the first piece of scenery (table, floor, walls, furniture).
pub const FIRST_SCENERY_ID: u8 = 128;

/// One rigid body.
#[derive(Debug, Clone)]
pub(crate) struct Body {
    pub id: u8,
    pub mesh: Arc<PreparedMesh>,
    pub materials: Vec<Material>,
    /// Pose where it never moves; the episode has the others.
    pub fixed: Option<Pose<Base, BodyFrame>>,
    /// Whether it throws shadows: walls and floor would shut the light out.
    pub shadow: bool,
}

/// The lights of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Lights {
    /// Unit vector towards the key light.
    pub towards_key: Vec3,
    pub key: Vec3,
    /// Half width of the key light's penumbra, metres.
    pub softness: f32,
    /// Unit vector towards the fill light, which throws no shadow.
    pub towards_fill: Vec3,
    pub fill: Vec3,
    pub sky: Vec3,
    pub ground: Vec3,
    /// Light from all around instead of sky and ground; `sky` is then its strength.
    pub around: Option<Sky>,
    /// Where things throw shadows.
    pub shadows: ShadowRegion,
}

pub(crate) fn draw_lights(draw: &mut Draw) -> Lights {
    let azimuth = draw.range(0.0, std::f64::consts::TAU);
    let elevation = draw.range(0.75, 1.35);
    let level = libm::cos(elevation);
    let towards_key = Vec3::new(
        (level * libm::cos(azimuth)) as f32,
        (level * libm::sin(azimuth)) as f32,
        libm::sin(elevation) as f32,
    );
    let other = azimuth + std::f64::consts::PI + draw.range(-0.8, 0.8);
    let towards_fill = Vec3::new(libm::cos(other) as f32, libm::sin(other) as f32, 0.7).normalize();
    let warmth = draw.range(-0.12, 0.14) as f32;
    let tint = |w: f32| Vec3::new(1.0 + w, 1.0, 1.0 - w);
    let key = draw.range(0.45, 0.95) as f32;
    let sky = draw.range(0.38, 0.62) as f32;
    Lights {
        towards_key,
        key: tint(warmth) * key,
        softness: draw.range(0.004, 0.022) as f32,
        towards_fill,
        fill: tint(-0.5 * warmth) * draw.range(0.05, 0.22) as f32,
        sky: tint(-0.6 * warmth) * sky,
        ground: tint(0.5 * warmth) * sky * draw.range(0.35, 0.6) as f32,
        around: None,
        shadows: ShadowRegion::WORKSPACE,
    }
}

/// Colours of the robot's materials as they are written to the model.
pub(crate) fn default_robot_colours() -> [[f32; 3]; 6] {
    [
        [0.82, 0.83, 0.84],
        [0.07, 0.07, 0.08],
        [0.45, 0.46, 0.48],
        [0.025, 0.025, 0.028],
        [0.05, 0.05, 0.055],
        [0.10, 0.25, 0.75],
    ]
}

/// Materials of the robot in one episode: mostly white and black, at times tinted.
pub(crate) fn draw_robot_materials(draw: &mut Draw) -> Vec<Material> {
    let mut colours = default_robot_colours();
    let (shade, hue) = (draw.range(0.6, 1.08) as f32, draw.unit());
    let tint = if draw.chance(0.3) {
        draw.range(0.05, 0.6)
    } else {
        0.03 * draw.unit()
    };
    let [r, g, b] = hsv(hue, tint, 1.0);
    colours[0] = [
        colours[0][0] * shade * r,
        colours[0][1] * shade * g,
        colours[0][2] * shade * b,
    ];
    colours[5] = hsv(draw.unit(), 0.8, 0.9);
    let lift = draw.range(0.8, 2.5) as f32;
    colours[3] = colours[3].map(|c| c * lift);
    let gloss = [draw.range(0.05, 0.3) as f32, 0.1, 0.4, 0.12, 0.03, 0.1];
    let material = |(index, colour): (usize, [f32; 3])| Material {
        gloss: gloss[index],
        grain: if index == 3 { 0.15 } else { 0.03 },
        ..Material::plain(colour)
    };
    colours.into_iter().enumerate().map(material).collect()
}

/// A random material for an object or a piece of furniture; `scale` is the size of its pattern in metres.
pub(crate) fn draw_material(draw: &mut Draw, scale: f64, saturation: f64) -> Material {
    let hue = draw.unit();
    let first = hsv(hue, saturation * draw.range(0.3, 1.0), draw.range(0.35, 1.0));
    let away = hue + draw.range(-0.15, 0.5);
    let second = hsv(away, saturation * draw.range(0.1, 1.0), draw.range(0.2, 1.0));
    let pattern = match draw.index(12) {
        0..=4 => Pattern::Plain,
        5 => Pattern::Checker,
        6 => Pattern::Stripes(2),
        7 => Pattern::Stripes(draw.index(2)),
        8 | 9 => Pattern::Cloud,
        10 => Pattern::Dots,
        _ => Pattern::Patches,
    };
    Material {
        pattern,
        colours: [Vec3::from_array(first), Vec3::from_array(second)],
        scale: (scale * draw.range(0.6, 1.6)) as f32,
        offset: Vec3::new(
            draw.range(0.0, 9.0) as f32,
            draw.range(0.0, 9.0) as f32,
            draw.range(0.0, 9.0) as f32,
        ),
        grain: draw.range(0.0, 0.12) as f32,
        gloss: if draw.chance(0.5) {
            draw.range(0.02, 0.25) as f32
        } else {
            0.0
        },
    }
}
