//! Contours of the drawn robot: silhouette, occlusions and borders of links (`docs/spec/agreement.md` section 1).

use glam::DVec2;
use rogs_schemas::records::robot::NO_LINK;

use crate::view::Surface;

/// Radius of the disc that normal and place of a contour point come from, pixels.
const RADIUS: f64 = 4.2;
/// Two surfaces are apart when their depths differ by this share.
const APART: f32 = 0.03;

/// What a contour separates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ContourKind {
    /// The robot from what is behind it.
    Silhouette,
    /// A part of the robot from a part clearly behind it.
    Occlusion,
    /// Two links that touch.
    LinkBorder,
}

/// A point of a contour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContourPoint {
    /// Where it lies, pixels, to a fraction of a pixel.
    pub pixel: DVec2,
    /// Unit normal, away from the nearer surface.
    pub normal: DVec2,
    /// Index of the pixel of the nearer surface beside it.
    pub index: usize,
    /// What it separates.
    pub kind: ContourKind,
}

/// Contour points of a surface, in order of rows; none within five pixels of the image border, where the border cuts the
/// robot.
#[must_use]
pub fn contours(surface: &Surface<'_>, width: usize, height: usize) -> Vec<ContourPoint> {
    let mut points = Vec::new();
    let margin = RADIUS as usize;
    for row in margin..height.saturating_sub(margin) {
        for column in margin..width.saturating_sub(margin) {
            let here = row * width + column;
            for (there, step) in [(here + 1, DVec2::X), (here + width, DVec2::Y)] {
                if surface.link[here] == surface.link[there] && !apart(surface, here, there) {
                    continue;
                }
                let pixel = DVec2::new(column as f64 + 0.5, row as f64 + 0.5) + 0.5 * step;
                points.extend(point(surface, [width, height], pixel, here, there));
            }
        }
    }
    points
}

fn apart(surface: &Surface<'_>, a: usize, b: usize) -> bool {
    let (a, b) = (surface.depth_m[a], surface.depth_m[b]);
    a > 0.0 && b > 0.0 && (a - b).abs() > APART * a.min(b)
}

/// The contour point between two neighbouring pixels that differ.
fn point(surface: &Surface<'_>, size: [usize; 2], middle: DVec2, a: usize, b: usize) -> Option<ContourPoint> {
    let (la, lb) = (surface.link[a], surface.link[b]);
    let kind = if la == NO_LINK || lb == NO_LINK {
        ContourKind::Silhouette
    } else if apart(surface, a, b) {
        ContourKind::Occlusion
    } else {
        ContourKind::LinkBorder
    };
    let near = match (la, lb) {
        (NO_LINK, _) => b,
        (_, NO_LINK) => a,
        _ if surface.depth_m[a] <= surface.depth_m[b] => a,
        _ => b,
    };
    let depth = surface.depth_m[near];
    // A part of the nearer surface: all of the robot at a silhouette, what is not clearly behind at an occlusion, the
    // same link where links touch.
    let inside = |pixel: usize| match kind {
        ContourKind::Silhouette => surface.link[pixel] != NO_LINK,
        ContourKind::Occlusion => {
            surface.link[pixel] != NO_LINK && surface.depth_m[pixel] < depth * (1.0 + 0.5 * APART)
        }
        ContourKind::LinkBorder => surface.link[pixel] == surface.link[near],
    };
    let [width, height] = size.map(|side| side as i32);
    let (left, right) = reach(middle.x);
    let (top, bottom) = reach(middle.y);
    if left < 0 || top < 0 || right > width || bottom > height {
        return None;
    }
    let (mut sum, mut balance, mut count) = (DVec2::ZERO, 0.0, 0.0);
    for row in top..bottom {
        for column in left..right {
            let away = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5) - middle;
            if away.length_squared() <= RADIUS * RADIUS {
                let side = if inside((row * width + column) as usize) {
                    1.0
                } else {
                    -1.0
                };
                sum -= side * away;
                balance += side;
                count += 1.0;
            }
        }
    }
    let normal = sum.try_normalize()?;
    // Of a straight edge through the disc, half the surplus of inside pixels over the edge's length is how far outside of
    // the middle the edge lies. The first moment of a halved disc is 4/3 R^3; a thin or torn part has less.
    let shift = 0.25 * balance / RADIUS;
    let halved = 4.0 / 3.0 * RADIUS * RADIUS * RADIUS;
    (count > 0.0 && shift.abs() < 1.5 && sum.length() > 0.3 * halved).then_some(ContourPoint {
        pixel: middle + normal * shift.clamp(-1.0, 1.0),
        normal,
        index: near,
        kind,
    })
}

/// First and last (exclusive) pixel of the disc around a coordinate.
fn reach(middle: f64) -> (i32, i32) {
    ((middle - RADIUS).floor() as i32, (middle + RADIUS).ceil() as i32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disc of radius `r` around `(cx, cy)`, sampled at pixel centres.
    fn disc(size: usize, centre: DVec2, radius: f64) -> (Vec<f32>, Vec<u8>) {
        let inside = |i: usize| DVec2::new((i % size) as f64 + 0.5, (i / size) as f64 + 0.5).distance(centre) < radius;
        let link: Vec<u8> = (0..size * size).map(|i| if inside(i) { 1 } else { NO_LINK }).collect();
        (link.iter().map(|&l| if l == 1 { 1.0 } else { 0.0 }).collect(), link)
    }

    #[test]
    fn contour_points_of_a_disc_lie_on_its_circle() {
        let centre = DVec2::new(30.3, 31.1);
        let (depth_m, link) = disc(64, centre, 20.0);
        let surface = Surface {
            depth_m: &depth_m,
            link: &link,
        };
        let points = contours(&surface, 64, 64);
        assert!(points.len() > 120, "{}", points.len());
        let off: Vec<f64> = points.iter().map(|p| p.pixel.distance(centre) - 20.0).collect();
        let mean = off.iter().sum::<f64>() / off.len() as f64;
        assert!(mean.abs() < 0.15, "{mean}");
        for (point, off) in points.iter().zip(&off) {
            assert!(off.abs() < 0.6, "{point:?}: {off}");
            assert!(point.normal.dot((point.pixel - centre).normalize()) > 0.97, "{point:?}");
            assert_eq!(point.kind, ContourKind::Silhouette);
        }
    }

    #[test]
    fn where_the_image_ends_is_no_contour() {
        let (depth_m, link) = (vec![1.0; 400], vec![0; 400]);
        let surface = Surface {
            depth_m: &depth_m,
            link: &link,
        };
        assert!(contours(&surface, 20, 20).is_empty());
    }

    #[test]
    fn parts_of_the_robot_that_hide_each_other_have_an_occlusion_between_them() {
        let link: Vec<u8> = (0..400).map(|i| u8::from(i % 20 >= 10)).collect();
        let far: Vec<f32> = link.iter().map(|&l| if l == 0 { 1.0 } else { 1.5 }).collect();
        let kinds = |depth_m: &[f32]| -> Vec<ContourKind> {
            let surface = Surface { depth_m, link: &link };
            contours(&surface, 20, 20).iter().map(|p| p.kind).collect()
        };
        assert!(kinds(&far).iter().all(|&kind| kind == ContourKind::Occlusion));
        assert!(!kinds(&far).is_empty());
        assert!(kinds(&[1.0; 400]).iter().all(|&kind| kind == ContourKind::LinkBorder));
    }
}
