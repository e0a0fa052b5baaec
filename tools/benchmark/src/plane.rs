//! The plane that most points of a cloud lie near.

use glam::{DMat3, DVec3};
use rogs_random::Pcg64;

/// Points as near as this belong to the plane, metres.
const NEAR_M: f64 = 0.015;
/// Triples of points that are tried.
const TRIES: u32 = 500;
/// Steeper planes are no table: rise over run.
const STEEPEST: f64 = 0.58;
/// Fewest points that tell of a plane.
const FEWEST: usize = 50;

/// The plane `z = slope_x x + slope_y y + offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Plane {
    slope: [f64; 2],
    offset: f64,
    /// Share of the points that lie near it.
    pub(crate) share: f64,
}

impl Plane {
    /// The plane that the most points lie near, among those that are not steeper than 30 degrees; none where there are
    /// too few points. The same points give the same plane.
    pub(crate) fn through(points: &[DVec3]) -> Option<Self> {
        let count = u32::try_from(points.len()).ok()?;
        if points.len() < FEWEST {
            return None;
        }
        let mut random = Pcg64::from_seed(1);
        let mut best: Option<(usize, [f64; 3])> = None;
        for _ in 0..TRIES {
            let chosen = [(); 3].map(|()| points[random.lemire(count - 1) as usize]);
            let Some(plane) = solve(&chosen) else { continue };
            let near = points.iter().filter(|point| near(plane, point)).count();
            if best.is_none_or(|(most, _)| near > most) {
                best = Some((near, plane));
            }
        }
        let (_, mut plane) = best?;
        for _ in 0..5 {
            let own: Vec<DVec3> = points.iter().filter(|point| near(plane, point)).copied().collect();
            plane = solve(&own)?;
        }
        let share = points.iter().filter(|point| near(plane, point)).count() as f64 / points.len() as f64;
        let [a, b, offset] = plane;
        Some(Self {
            slope: [a, b],
            offset,
            share,
        })
    }

    /// Angle to the horizontal, degrees.
    pub(crate) fn tilt_deg(&self) -> f64 {
        self.slope[0].hypot(self.slope[1]).atan().to_degrees()
    }

    /// Height at a place, metres.
    pub(crate) fn height_m(&self, x: f64, y: f64) -> f64 {
        self.slope[0] * x + self.slope[1] * y + self.offset
    }
}

fn near([a, b, offset]: [f64; 3], point: &DVec3) -> bool {
    let vertical = (a * point.x + b * point.y + offset - point.z).abs();
    vertical < NEAR_M * (1.0 + a * a + b * b).sqrt()
}

/// Least squares of the heights; none where the points do not tell, or the plane is too steep.
fn solve(points: &[DVec3]) -> Option<[f64; 3]> {
    let mut normal = DMat3::ZERO;
    let mut right = DVec3::ZERO;
    for point in points {
        let row = DVec3::new(point.x, point.y, 1.0);
        normal += DMat3::from_cols(row * row.x, row * row.y, row);
        right += row * point.z;
    }
    if normal.determinant().abs() < 1e-9 {
        return None;
    }
    let [a, b, offset] = (normal.inverse() * right).to_array();
    (a.hypot(b) < STEEPEST).then_some([a, b, offset])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilted_table_is_found_below_clutter() {
        let mut points = Vec::new();
        for i in 0..40 {
            for j in 0..30 {
                let (x, y) = (0.2 + f64::from(i) / 60.0, f64::from(j) / 30.0 - 0.5);
                let table = 0.03 + 0.05 * x - 0.02 * y;
                let clutter = f64::from((7 * i + 13 * j) % 10) / 40.0;
                let above = if (i + j) % 3 == 0 { 0.05 + clutter } else { 0.0 };
                points.push(DVec3::new(x, y, table + above));
            }
        }
        let plane = Plane::through(&points).unwrap();
        assert!((plane.tilt_deg() - 0.05_f64.hypot(0.02).atan().to_degrees()).abs() < 0.05);
        assert!((plane.height_m(0.5, 0.0) - 0.055).abs() < 1e-3);
        assert!((0.55..0.75).contains(&plane.share), "{}", plane.share);
    }

    #[test]
    fn a_wall_is_no_table() {
        let wall: Vec<DVec3> = (0..400)
            .map(|i| DVec3::new(0.5, f64::from(i % 20) / 20.0, f64::from(i) / 400.0))
            .collect();
        assert_eq!(Plane::through(&wall), None);
        assert_eq!(Plane::through(&[]), None);
    }
}
