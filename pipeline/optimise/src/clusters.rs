//! Points that move alike: clusters of trajectories, and how much a point speaks for its cluster
//! (`docs/spec/baseline-som.md` section 4).

use glam::DVec3;
use rayon::prelude::*;

use crate::statistics::{lower_median, quantile};

/// Rounds of assignment; fewer where nothing changes any more.
const ROUNDS: usize = 50;
/// Points of one piece of work; fixed, because it sets the order of sums.
const PIECE: usize = 4096;

/// Cluster of every row by k-means: the first centre is the row nearest to the mean, each next the row farthest from all
/// centres so far; of equals the first. There are fewer than `clusters` where fewer rows differ. `rows [N, width]`
#[must_use]
pub fn k_means(rows: &[f32], width: usize, clusters: usize) -> (Vec<u32>, usize) {
    let count = rows.len() / width.max(1);
    if count == 0 || clusters == 0 {
        return (Vec::new(), 0);
    }
    let row = |index: usize| &rows[index * width..(index + 1) * width];
    let everything = vec![0; count];
    let mean = means(rows, width, &everything, 1, &[vec![0.0; width]]);
    let mut nearest: Vec<f64> = (0..count)
        .into_par_iter()
        .map(|index| distance(row(index), &mean[0]))
        .collect();
    let first = (1..count).fold(0, |best, k| if nearest[k] < nearest[best] { k } else { best });
    let mut centres = vec![to_f64(row(first))];
    nearest
        .par_iter_mut()
        .enumerate()
        .for_each(|(index, to)| *to = distance(row(index), &centres[0]));
    while centres.len() < clusters {
        let next = (1..count).fold(0, |best, k| if nearest[k] > nearest[best] { k } else { best });
        if nearest[next] <= 0.0 {
            break;
        }
        let centre = to_f64(row(next));
        nearest
            .par_iter_mut()
            .enumerate()
            .for_each(|(index, to)| *to = to.min(distance(row(index), &centre)));
        centres.push(centre);
    }
    let mut labels = vec![u32::MAX; count];
    for _ in 0..ROUNDS {
        let assigned: Vec<u32> = (0..count)
            .into_par_iter()
            .map(|index| {
                let distances = centres.iter().map(|centre| distance(row(index), centre)).enumerate();
                distances
                    .fold(
                        (0, f64::INFINITY),
                        |best, (k, d)| if d < best.1 { (k as u32, d) } else { best },
                    )
                    .0
            })
            .collect();
        if assigned == labels {
            break;
        }
        labels = assigned;
        centres = means(rows, width, &labels, centres.len(), &centres);
    }
    (labels, centres.len())
}

/// Means of the rows of every label; `otherwise` where a label has none.
fn means(rows: &[f32], width: usize, labels: &[u32], clusters: usize, otherwise: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let pieces: Vec<Vec<f64>> = (rows.par_chunks(PIECE * width))
        .zip(labels.par_chunks(PIECE))
        .map(|(rows, labels)| {
            let mut sums = vec![0.0; clusters * (width + 1)];
            for (row, &label) in rows.chunks_exact(width).zip(labels) {
                let to = &mut sums[label as usize * (width + 1)..][..=width];
                to[width] += 1.0;
                for (to, &from) in to.iter_mut().zip(row) {
                    *to += f64::from(from);
                }
            }
            sums
        })
        .collect();
    let mut total = vec![0.0; clusters * (width + 1)];
    for piece in pieces {
        for (to, from) in total.iter_mut().zip(piece) {
            *to += from;
        }
    }
    (total.chunks_exact(width + 1).zip(otherwise))
        .map(|(sums, otherwise)| {
            if sums[width] > 0.0 {
                sums[..width].iter().map(|sum| sum / sums[width]).collect()
            } else {
                otherwise.clone()
            }
        })
        .collect()
}

fn distance(row: &[f32], centre: &[f64]) -> f64 {
    row.iter()
        .zip(centre)
        .map(|(&a, b)| (f64::from(a) - b) * (f64::from(a) - b))
        .sum()
}

fn to_f64(row: &[f32]) -> Vec<f64> {
    row.iter().map(|&value| f64::from(value)).collect()
}

/// How much every point of a cluster speaks for it at every frame: `exp(-d / median d)` over its mean, times visibility; 0
/// for the tenth of all that lies farthest out. `points [T][N]`, `visible [T][N]`; gives `[T][N]`.
#[must_use]
pub fn point_weights(points: &[Vec<DVec3>], visible: &[Vec<bool>]) -> Vec<Vec<f64>> {
    let distances: Vec<Vec<f64>> = points
        .iter()
        .map(|points| {
            let coordinate = |axis: usize| points.iter().map(|point| point[axis]).collect::<Vec<_>>();
            let middle = DVec3::from_array([0, 1, 2].map(|axis| lower_median(&coordinate(axis)).unwrap_or(0.0)));
            let distances: Vec<f64> = points.iter().map(|&point| point.distance(middle)).collect();
            let median = lower_median(&distances).unwrap_or(0.0);
            distances.iter().map(|distance| distance / median).collect()
        })
        .collect();
    let all: Vec<f64> = distances
        .iter()
        .flatten()
        .copied()
        .filter(|ratio| !ratio.is_nan())
        .collect();
    let limit = quantile(&all, 0.9).unwrap_or(0.0);
    (distances.iter().zip(visible))
        .map(|(ratios, visible)| {
            let near: Vec<f64> = ratios
                .iter()
                .map(|&ratio| if ratio.is_nan() { 0.0 } else { libm::exp(-ratio) })
                .collect();
            let mean = near.iter().sum::<f64>() / near.len().max(1) as f64;
            (near.iter().zip(ratios).zip(visible))
                .map(|((near, ratio), &visible)| {
                    let seen = if visible { 1.0 } else { 0.0 };
                    if *ratio <= limit {
                        near / (mean + 1e-6) * (seen + 1e-6)
                    } else {
                        0.0
                    }
                })
                .collect()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_are_alike_share_a_cluster() {
        let rows: Vec<f32> = (0..3000)
            .flat_map(|k| {
                let middle = [[0.0, 0.0], [5.0, 1.0], [-4.0, 6.0]][k % 3];
                let off = |step: usize| (k * step % 97) as f32 / 97.0 - 0.5;
                [middle[0] + off(31), middle[1] + off(57)]
            })
            .collect();
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| k_means(&rows, 2, 3))
        };
        let (labels, clusters) = run(1);
        assert_eq!(clusters, 3);
        for (k, label) in labels.iter().enumerate() {
            assert_eq!(*label, labels[k % 3]);
        }
        assert_eq!(run(4), (labels, clusters));
        assert_eq!(
            k_means(&[1.0, 2.0, 1.0, 2.0], 2, 5),
            (vec![0, 0], 1),
            "no two rows differ"
        );
        assert_eq!(k_means(&[], 2, 5).1, 0);
    }
}
