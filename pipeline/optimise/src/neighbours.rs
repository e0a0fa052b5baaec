//! Nearest neighbours of points.

use glam::DVec3;
use rayon::prelude::*;

/// Mean distance of every point to its `count` nearest others; of fewer, where there are not so many; 0 for a single one.
///
/// Points are sorted by their first coordinate, and both sides are searched until that coordinate alone is farther than the
/// farthest of the nearest so far.
#[must_use]
pub fn mean_distances(points: &[DVec3], count: usize) -> Vec<f64> {
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.sort_by(|&a, &b| points[a as usize].x.total_cmp(&points[b as usize].x).then(a.cmp(&b)));
    let mut found: Vec<(u32, f64)> = (0..order.len())
        .into_par_iter()
        .map(|place| (order[place], mean_distance(points, &order, place, count)))
        .collect();
    found.sort_unstable_by_key(|(index, _)| *index);
    found.into_iter().map(|(_, mean)| mean).collect()
}

fn mean_distance(points: &[DVec3], order: &[u32], place: usize, count: usize) -> f64 {
    let at = |place: usize| points[order[place] as usize];
    let own = at(place);
    // Squares of the smallest distances, ascending.
    let mut nearest: Vec<f64> = Vec::with_capacity(count + 1);
    let (mut below, mut above) = (place, place + 1);
    loop {
        let limit = if nearest.len() < count {
            f64::INFINITY
        } else {
            nearest.last().copied().unwrap_or(0.0)
        };
        let gap = |other: Option<usize>| other.map_or(f64::INFINITY, |other| (at(other).x - own.x).powi(2));
        let lower = gap(below.checked_sub(1));
        let upper = gap((above < order.len()).then_some(above));
        let next = if lower <= upper {
            if lower >= limit {
                break;
            }
            below -= 1;
            below
        } else {
            if upper >= limit {
                break;
            }
            above += 1;
            above - 1
        };
        let square = own.distance_squared(at(next));
        if square < limit {
            let to = nearest.partition_point(|&known| known <= square);
            nearest.insert(to, square);
            nearest.truncate(count);
        }
    }
    nearest.iter().map(|square| square.sqrt()).sum::<f64>() / nearest.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_those_of_comparing_all_with_all() {
        let number = |k: usize, step: usize| ((k * step) % 1009) as f64 / 1009.0;
        let mut points: Vec<DVec3> = (0..300)
            .map(|k| DVec3::new(number(k, 37), number(k, 411), number(k, 703)))
            .collect();
        points.push(points[7]);
        let found = mean_distances(&points, 3);
        for (index, own) in points.iter().enumerate() {
            let others = points.iter().enumerate().filter(|(other, _)| *other != index);
            let mut all: Vec<f64> = others.map(|(_, other)| own.distance(*other)).collect();
            all.sort_by(f64::total_cmp);
            let expected = all[..3].iter().sum::<f64>() / 3.0;
            assert!(
                (found[index] - expected).abs() < 1e-12,
                "{index}: {} {expected}",
                found[index]
            );
        }
        assert_eq!(mean_distances(&points[..1], 3), [0.0]);
        assert!(mean_distances(&[], 3).is_empty());
    }
}
