//! Exact nearest neighbours in space by a k-d tree.

use rayon::prelude::*;

/// Points in a leaf of the tree.
const LEAF: usize = 12;
/// Queries that one piece of work handles.
const QUERIES: usize = 1024;

/// The `count` nearest points of every point, itself included, by ascending Euclidean distance; equal distances are
/// ordered by index. `[n, min(count, n)]`
///
/// Distances are compared as f32 sums of squares. Points must be finite; others get some neighbours, unspecified which.
#[must_use]
pub fn nearest_neighbours(points: &[[f32; 3]], count: usize) -> Vec<u32> {
    let count = count.min(points.len());
    if count == 0 {
        return Vec::new();
    }
    let tree = Tree::new(points);
    let mut out = vec![0; points.len() * count];
    out.par_chunks_mut(QUERIES * count)
        .enumerate()
        .for_each(|(piece, out)| {
            let mut best = Best::new(count);
            for (offset, row) in out.chunks_exact_mut(count).enumerate() {
                best.clear();
                tree.search(0, points[piece * QUERIES + offset], &mut best);
                for (slot, &(_, index)) in row.iter_mut().zip(&best.found) {
                    *slot = index;
                }
            }
        });
    out
}

/// A node covers `start..end` of the reordered points; inner nodes split at `value` of `axis`: lower coordinates left.
struct Node {
    start: u32,
    end: u32,
    /// Index of the right child, 0 in a leaf; the left child follows its parent.
    right: u32,
    axis: u8,
    value: f32,
}

struct Tree {
    nodes: Vec<Node>,
    /// Coordinates and original index, in leaf order.
    points: Vec<([f32; 3], u32)>,
}

impl Tree {
    fn new(points: &[[f32; 3]]) -> Self {
        let points = points
            .iter()
            .enumerate()
            .map(|(index, &point)| (point, index as u32))
            .collect();
        let mut tree = Self {
            nodes: Vec::new(),
            points,
        };
        tree.build(0, tree.points.len());
        tree
    }

    fn build(&mut self, start: usize, end: usize) {
        let node = self.nodes.len();
        self.nodes.push(Node {
            start: start as u32,
            end: end as u32,
            right: 0,
            axis: 0,
            value: 0.0,
        });
        if end - start <= LEAF {
            return;
        }
        let run = &mut self.points[start..end];
        let mut extent = [0.0; 3];
        for (axis, extent) in extent.iter_mut().enumerate() {
            let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
            for (point, _) in run.iter() {
                low = low.min(point[axis]);
                high = high.max(point[axis]);
            }
            *extent = high - low;
        }
        let widest = |a: usize, b: usize| if extent[b] > extent[a] { b } else { a };
        let axis = widest(widest(0, 1), 2);
        let middle = run.len() / 2;
        // The index breaks ties, so the tree does not depend on the sorting algorithm, and many equal points are no
        // worst case.
        run.select_nth_unstable_by(middle, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
        let value = run[middle].0[axis];
        self.build(start, start + middle);
        let right = self.nodes.len();
        self.build(start + middle, end);
        self.nodes[node] = Node {
            start: start as u32,
            end: end as u32,
            right: right as u32,
            axis: axis as u8,
            value,
        };
    }

    fn search(&self, node: usize, query: [f32; 3], best: &mut Best) {
        let Node {
            start,
            end,
            right,
            axis,
            value,
        } = self.nodes[node];
        if right == 0 {
            for &(point, index) in &self.points[start as usize..end as usize] {
                let d = [query[0] - point[0], query[1] - point[1], query[2] - point[2]];
                best.offer(d[0] * d[0] + d[1] * d[1] + d[2] * d[2], index);
            }
            return;
        }
        let across = query[axis as usize] - value;
        let (near, far) = if across < 0.0 {
            (node + 1, right as usize)
        } else {
            (right as usize, node + 1)
        };
        self.search(near, query, best);
        // Rounding is monotonic, so no point beyond the plane is nearer than this, as computed. Equality may still
        // hold a lower index.
        if across * across <= best.worst {
            self.search(far, query, best);
        }
    }
}

/// The nearest points so far, ascending by (distance, index).
struct Best {
    count: usize,
    found: Vec<(f32, u32)>,
    worst: f32,
}

impl Best {
    fn new(count: usize) -> Self {
        Self {
            count,
            found: Vec::with_capacity(count + 1),
            worst: f32::INFINITY,
        }
    }

    fn clear(&mut self) {
        self.found.clear();
        self.worst = f32::INFINITY;
    }

    fn offer(&mut self, distance: f32, index: u32) {
        if distance > self.worst {
            return;
        }
        let before = |&(d, i): &(f32, u32)| d < distance || (d == distance && i < index);
        let place = self.found.partition_point(before);
        if place == self.count {
            return;
        }
        self.found.insert(place, (distance, index));
        self.found.truncate(self.count);
        if self.found.len() == self.count {
            self.worst = self.found[self.count - 1].0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::weights::uniform;

    fn exhaustive(points: &[[f32; 3]], count: usize) -> Vec<u32> {
        let row = |query: &[f32; 3]| {
            let distance = |p: &[f32; 3]| {
                let d = [query[0] - p[0], query[1] - p[1], query[2] - p[2]];
                d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
            };
            let mut order: Vec<(f32, u32)> = points
                .iter()
                .enumerate()
                .map(|(i, p)| (distance(p), i as u32))
                .collect();
            order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            order
                .into_iter()
                .take(count)
                .map(|(_, index)| index)
                .collect::<Vec<_>>()
        };
        points.iter().flat_map(row).collect()
    }

    #[test]
    fn neighbours_equal_an_exhaustive_search_also_with_ties_and_duplicates() {
        let scattered: Vec<f32> = uniform("points", 3 * 700, 3, 1.0);
        // A coarse lattice with repeated points: nearly every distance is tied.
        let lattice: Vec<f32> = scattered.iter().map(|x| (x * 3.0).round()).collect();
        let flat: Vec<f32> = scattered
            .iter()
            .enumerate()
            .map(|(i, x)| if i % 3 == 2 { 0.5 } else { *x })
            .collect();
        for values in [&scattered, &lattice, &flat, &vec![1.0; 300]] {
            let points: Vec<[f32; 3]> = values.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
            for count in [1, 8, 16] {
                assert_eq!(nearest_neighbours(&points, count), exhaustive(&points, count));
            }
        }
    }

    #[test]
    fn small_sets_have_as_many_neighbours_as_points() {
        assert_eq!(nearest_neighbours(&[], 8), Vec::<u32>::new());
        assert_eq!(nearest_neighbours(&[[0.0; 3], [1.0, 0.0, 0.0]], 8), vec![0, 1, 1, 0]);
        let broken = [[f32::NAN; 3]; 40];
        assert_eq!(nearest_neighbours(&broken, 8).len(), 320, "unspecified, but no panic");
    }
}
