//! The silhouettes of all images of a level, to a small part of a pixel (`docs/spec/calibration.md` section 4).

use glam::{DVec2, DVec3};
use rayon::prelude::*;
use rogs_agreement::{ContourKind, Surface, contours};
use rogs_geometry::Pinhole;
use rogs_robot::RenderOptions;
use rogs_robot::raster::Renderer;

use crate::Result;
use crate::correction::Correction;
use crate::edges::{Edge, Level};
use crate::moment::Moment;
use crate::outline::{Coverage, Mixing, Outline, values};
use crate::solve::Kind;

/// Where the robot stands on something, up to this height, metres, what lies in the shadow between hides the edge.
const FOOT_M: f64 = 0.05;
/// Silhouettes are drawn in about so many columns.
const SAMPLED: u32 = 1200;
/// Most places of a silhouette that are searched in an image.
const MOST_PLACES: usize = 400;
/// Least standard deviation of such a place, pixels.
const FLOOR_PX: f64 = 0.05;

impl Level<'_> {
    /// Searches the silhouettes of all frames to a small part of a pixel, `range_px` to each side.
    pub(crate) fn outline(&self, correction: &Correction, mixing: Mixing, range_px: f64) -> Result<Vec<Edge>> {
        let values = values(mixing);
        let found: Vec<Result<Vec<Edge>>> = self
            .images
            .par_iter()
            .map_init(
                || Renderer::new(self.takes[0].footage.scene),
                |renderer, image| self.outline_at(renderer, image, correction, &values, range_px),
            )
            .collect();
        let mut edges = Vec::new();
        for found in found {
            edges.extend(found?);
        }
        Ok(edges)
    }

    /// How colours mix in these images: as explains them better.
    pub(crate) fn mixing(&self, correction: &Correction, range_px: f64) -> Result<Mixing> {
        let [light, levels] = [Mixing::Light, Mixing::Levels].map(|mixing| -> Result<f64> {
            let edges = self.outline(correction, mixing, range_px)?;
            let explained = edges.iter().map(|edge| edge.weight * edge.explained);
            Ok(explained.sum::<f64>() / edges.iter().map(|edge| edge.weight).sum::<f64>().max(1e-9))
        });
        Ok(if light? >= levels? {
            Mixing::Light
        } else {
            Mixing::Levels
        })
    }

    fn outline_at(
        &self,
        renderer: &mut Renderer<'_>,
        (clip, frame, rgb): &(usize, usize, Vec<u8>),
        correction: &Correction,
        values: &[f32; 256],
        range_px: f64,
    ) -> Result<Vec<Edge>> {
        let take = &self.takes[*clip];
        let Some(moment) = Moment::new(take, *frame, &self.mount_from_given, correction)? else {
            return Ok(Vec::new());
        };
        let lens = correction.lens(&self.lens);
        let factor = (SAMPLED / lens.width).clamp(2, 4);
        let large = lens.resized(lens.width * factor, lens.height * factor);
        let drawn = renderer.render(&large, &moment.camera_from_link(), &RenderOptions::default(), 1)?;
        let (columns, rows) = (large.width as usize, large.height as usize);
        let coverage = Coverage::new(&drawn.link, columns, rows, factor as usize);
        let outline = Outline {
            rgb,
            width: lens.width as usize,
            height: lens.height as usize,
            values,
            coverage: &coverage,
            range_px,
        };
        let mut points = contours(&Surface::from(&drawn), columns, rows);
        points.retain(|point| point.kind == ContourKind::Silhouette);
        let count = points.len().min(MOST_PLACES);
        let mut edges = Vec::with_capacity(count);
        for number in 0..count {
            let point = &points[number * points.len() / count];
            let Some(place) = outline.place(point).filter(|place| place.weight > 0.05) else {
                continue;
            };
            let pixel = point.pixel / f64::from(factor);
            let depth_m = f64::from(drawn.depth_m[point.index]);
            let link = drawn.link[point.index];
            let base_point = moment.base_from_camera.point(lens.unproject(pixel, depth_m));
            if self.standing[usize::from(link)] && is_contact(&moment, &lens, base_point, pixel, point.normal) {
                continue;
            }
            let [point_there, velocity] = moment.tied(base_point, usize::from(link));
            edges.push(Edge {
                kind: Kind::Outline,
                point: point_there,
                velocity,
                lag: correction.lag_frames,
                target: pixel + point.normal * place.offset_px,
                normal: point.normal,
                sigma: f64::hypot(place.sigma_px, FLOOR_PX),
                weight: place.weight,
                explained: place.explained,
                group: u32::from(link),
            });
        }
        Ok(edges)
    }
}

/// Whether an edge of the robot's foot is where it stands on something: low, and with what is below beside it.
fn is_contact(moment: &Moment, lens: &Pinhole, base_point: DVec3, pixel: DVec2, normal: DVec2) -> bool {
    let below = moment.base_from_camera.inverse().point(base_point - 0.01 * DVec3::Z);
    let down = lens
        .project(below)
        .map(|(below, _)| (below - pixel).normalize_or_zero());
    base_point.z < FOOT_M && down.is_none_or(|down| down.dot(normal) > 0.5)
}
