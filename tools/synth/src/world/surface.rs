//! Surfaces of wide worlds: the patterns of the plain cell, or photographs.

use glam::Vec3;

use super::World;
use super::props::Props;
use crate::math::{Draw, hsv};
use crate::render::{Material, Pattern};
use crate::scene::draw_material;

/// Draws materials for one episode.
pub(crate) struct Surfaces<'a> {
    pub(crate) world: &'a World,
    pub(crate) props: &'a Props,
}

impl Surfaces<'_> {
    /// A material for a thing of this size, metres.
    pub(crate) fn thing(&self, draw: &mut Draw, size: f64) -> Material {
        let saturation = draw.range(0.2, 0.95);
        let plain = draw_material(draw, 0.5 * size, saturation);
        self.photographed(draw, plain, [0.5 * size, 2.0 * size])
    }

    /// A material for walls, floors and table tops: calm, and often with little on it.
    pub(crate) fn plane(&self, draw: &mut Draw, period: [f64; 2]) -> Material {
        let hue = draw.range(0.0, 1.0);
        let pale = draw.chance(0.6);
        let colour = if pale {
            hsv(hue, draw.range(0.0, 0.2), draw.range(0.5, 1.0))
        } else {
            hsv(hue, draw.range(0.0, 0.6), draw.range(0.15, 0.9))
        };
        let first = Vec3::from_array(colour);
        let second = if draw.chance(0.7) {
            first * draw.range(0.6, 0.97) as f32
        } else {
            Vec3::from_array(hsv(draw.unit(), draw.range(0.0, 0.5), draw.range(0.2, 0.9)))
        };
        let pattern = match draw.index(10) {
            0..=2 => Pattern::Plain,
            3..=5 => Pattern::Cloud,
            6 => Pattern::Wood,
            7 => Pattern::Tiles,
            8 => Pattern::Stripes(draw.index(3)),
            _ => Pattern::Checker,
        };
        let plain = Material {
            pattern,
            colours: [first, second],
            scale: draw.range(0.5 * period[0], 0.5 * period[1]) as f32,
            offset: Vec3::new(draw.range(0.0, 9.0) as f32, draw.range(0.0, 9.0) as f32, 0.37),
            grain: draw.range(0.0, 0.1) as f32,
            gloss: if draw.chance(0.3) {
                draw.range(0.02, 0.25) as f32
            } else {
                0.0
            },
        };
        self.photographed(draw, plain, period)
    }

    /// The same with a photograph of this period in metres, for a share of surfaces.
    fn photographed(&self, draw: &mut Draw, plain: Material, period: [f64; 2]) -> Material {
        let share = draw.unit();
        let (which, scale) = (
            draw.index(self.props.photos.len().max(1)),
            draw.range(period[0], period[1]),
        );
        let tint = hsv(draw.unit(), draw.range(0.0, 0.25), 1.0);
        let brightness = draw.range(0.6, 1.25) as f32;
        if self.props.photos.is_empty() || share >= self.world.photos {
            return plain;
        }
        Material {
            pattern: Pattern::Photo(which as u16),
            colours: [Vec3::from_array(tint) * brightness; 2],
            scale: scale as f32,
            ..plain
        }
    }
}
