//! The plane sweep: how alike the features of a cell are to those of other frames at the points of its ray.
//!
//! The point of cell (x, y) at a depth has the homogeneous cell coordinates `depth * turn (x, y, 1) + shift` in another
//! frame, whose features are interpolated there. The similarity is the inner product, averaged over the frames that have
//! the point in their image.

use rayon::prelude::*;

use super::vectorised;

/// Features of a cell.
pub(crate) const FEATURES: usize = 16;
/// Points nearer to the plane of another camera than this are not seen by it, internal units.
const NEAREST_IU: f32 = 1e-3;

type Features = [f32; FEATURES];

/// Another frame, as a frame's cells and depths are seen in it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Partner {
    /// Its index.
    pub frame: usize,
    /// Homogeneous cell coordinates here to those there, points at infinity. Row-major.
    pub turn: [f32; 9],
    /// What a depth of zero adds: this frame's centre seen there.
    pub shift: [f32; 3],
}

/// The plan of a sweep over the frames of a clip.
#[derive(Debug, Clone)]
pub(crate) struct Sweep {
    /// Rows and columns of the map of cells.
    pub size: [usize; 2],
    /// The same of the image in cells, which need not be whole.
    pub image: [f32; 2],
    /// Depths along the camera's z axis, internal units. `[D]`
    pub depths_iu: Vec<f32>,
    /// The frames that each frame is compared with. `[S]`
    pub partners: Vec<Vec<Partner>>,
}

/// Four cells and their weights in a bilinear interpolation.
type Corners = [(usize, f32); 4];

impl Sweep {
    /// Numbers of the result. `[S, D, h, w]`
    #[must_use]
    pub(crate) fn shape(&self) -> [usize; 4] {
        let [rows, columns] = self.size;
        [self.partners.len(), self.depths_iu.len(), rows, columns]
    }

    /// Share of the other frames that have the point in their image. `[S, D, h, w]`
    #[must_use]
    pub(crate) fn visible(&self) -> Vec<f32> {
        self.each_cell(
            #[inline(always)]
            |frame, _, counts, column| {
                let partners = self.partners[frame].len() as f32;
                for (share, count) in column.iter_mut().zip(counts) {
                    *share = count / partners;
                }
            },
        )
    }

    /// Mean similarity to the frames that have the point in their image, 0 where none has. `[S, F, h, w] -> [S, D, h, w]`
    #[must_use]
    pub(crate) fn similarity(&self, features: &[f32]) -> Vec<f32> {
        let features = self.by_cell(features);
        let area = self.area();
        self.each_cell(
            #[inline(always)]
            |frame, cell, counts, column| {
                let own = &features[frame * area + cell];
                self.compare(
                    frame,
                    cell,
                    &features,
                    #[inline(always)]
                    |_, depth, _, there| column[depth] += inner(own, &there),
                );
                for (sum, &count) in column.iter_mut().zip(counts) {
                    *sum /= count.max(1.0);
                }
            },
        )
    }

    /// Gradient of the features, given that of the similarity. `[S, D, h, w] -> [S, F, h, w]`
    #[must_use]
    pub(crate) fn gradient(&self, slopes: &[f32], features: &[f32]) -> Vec<f32> {
        let cells = self.by_cell(features);
        let (area, depths) = (self.area(), self.depths_iu.len());
        // Each frame adds to its own cells and to those of its partners; these sums are joined in the order of frames.
        let parts: Vec<Vec<(usize, Vec<Features>)>> = (0..self.partners.len())
            .into_par_iter()
            .map(|frame| {
                let partners = self.partners[frame].iter().map(|partner| partner.frame);
                let frames = std::iter::once(frame).chain(partners);
                let mut sums: Vec<_> = frames.map(|frame| (frame, vec![[0.0; FEATURES]; area])).collect();
                vectorised(
                    #[inline(always)]
                    || {
                        let mut counts = vec![0.0f32; depths];
                        for cell in 0..area {
                            self.count(frame, cell, &mut counts);
                            let own = &cells[frame * area + cell];
                            self.compare(
                                frame,
                                cell,
                                &cells,
                                #[inline(always)]
                                |partner, depth, corners, there| {
                                    let slope = slopes[(frame * depths + depth) * area + cell] / counts[depth];
                                    add(&mut sums[0].1[cell], slope, &there);
                                    for (corner, weight) in corners {
                                        add(&mut sums[1 + partner].1[corner], slope * weight, own);
                                    }
                                },
                            );
                        }
                    },
                );
                sums
            })
            .collect();
        let mut total = vec![[0.0f32; FEATURES]; cells.len()];
        for (frame, part) in parts.into_iter().flatten() {
            for (sum, part) in total[frame * area..].iter_mut().zip(&part) {
                add(sum, 1.0, part);
            }
        }
        let mut gradient = vec![0.0f32; features.len()];
        for (map, cells) in gradient.chunks_exact_mut(FEATURES * area).zip(total.chunks_exact(area)) {
            for (cell, values) in cells.iter().enumerate() {
                for (channel, &value) in values.iter().enumerate() {
                    map[channel * area + cell] = value;
                }
            }
        }
        gradient
    }

    fn area(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// Features with those of a cell side by side. `[S, F, h, w] -> [S * h * w]`
    fn by_cell(&self, features: &[f32]) -> Vec<Features> {
        let area = self.area();
        features
            .chunks_exact(FEATURES * area)
            .flat_map(|map| (0..area).map(|cell| std::array::from_fn(|channel| map[channel * area + cell])))
            .collect()
    }

    /// Fills the depths of every cell: `fill(frame, cell, counts, values of the depths, zeros at first)`. `[S, D, h, w]`
    #[inline(always)]
    fn each_cell(&self, fill: impl Fn(usize, usize, &[f32], &mut [f32]) + Sync) -> Vec<f32> {
        let (area, depths) = (self.area(), self.depths_iu.len());
        let mut out = vec![0.0f32; self.partners.len() * depths * area];
        out.par_chunks_mut((depths * area).max(1))
            .enumerate()
            .filter(|(frame, _)| !self.partners[*frame].is_empty())
            .for_each(|(frame, out)| {
                vectorised(
                    #[inline(always)]
                    || {
                        let (mut counts, mut column) = (vec![0.0f32; depths], vec![0.0f32; depths]);
                        for cell in 0..area {
                            self.count(frame, cell, &mut counts);
                            column.fill(0.0);
                            fill(frame, cell, &counts, &mut column);
                            for (depth, &value) in column.iter().enumerate() {
                                out[depth * area + cell] = value;
                            }
                        }
                    },
                );
            });
        out
    }

    /// How many frames have each point of a cell's ray in their image. `[D]`
    #[inline(always)]
    fn count(&self, frame: usize, cell: usize, counts: &mut [f32]) {
        counts.fill(0.0);
        for partner in &self.partners[frame] {
            self.project(
                partner,
                cell,
                #[inline(always)]
                |depth, _| counts[depth] += 1.0,
            );
        }
    }

    /// Visits the points of a cell's ray that other frames have in their image, with the features there:
    /// `visit(index among the partners, depth, corners, features)`.
    #[inline(always)]
    fn compare(
        &self,
        frame: usize,
        cell: usize,
        features: &[Features],
        mut visit: impl FnMut(usize, usize, Corners, Features),
    ) {
        let area = self.area();
        for (index, partner) in self.partners[frame].iter().enumerate() {
            let there = &features[partner.frame * area..][..area];
            self.project(
                partner,
                cell,
                #[inline(always)]
                |depth, corners| visit(index, depth, corners, interpolated(there, &corners)),
            );
        }
    }

    /// Visits the points of a cell's ray that lie in the image of another frame.
    #[inline(always)]
    fn project(&self, partner: &Partner, cell: usize, mut visit: impl FnMut(usize, Corners)) {
        let [rows, columns] = self.size;
        let (x, y) = ((cell % columns) as f32, (cell / columns) as f32);
        let Partner { turn, shift, .. } = partner;
        let ray: [f32; 3] = std::array::from_fn(|k| turn[3 * k] * x + turn[3 * k + 1] * y + turn[3 * k + 2]);
        for (depth, &distance) in self.depths_iu.iter().enumerate() {
            let there: [f32; 3] = std::array::from_fn(|k| ray[k] * distance + shift[k]);
            if there[2] < NEAREST_IU {
                continue;
            }
            let (x, y) = (there[0] / there[2], there[1] / there[2]);
            let inside = |value: f32, size: f32| (-0.5..=size - 0.5).contains(&value);
            if !inside(x, self.image[1]) || !inside(y, self.image[0]) {
                continue;
            }
            let (low_x, high_x, share_x) = neighbours(x, columns);
            let (low_y, high_y, share_y) = neighbours(y, rows);
            visit(
                depth,
                [
                    (low_y * columns + low_x, (1.0 - share_y) * (1.0 - share_x)),
                    (low_y * columns + high_x, (1.0 - share_y) * share_x),
                    (high_y * columns + low_x, share_y * (1.0 - share_x)),
                    (high_y * columns + high_x, share_y * share_x),
                ],
            );
        }
    }
}

/// The cells before and after a place, and the share of the latter; the border continues outwards.
#[inline(always)]
fn neighbours(place: f32, size: usize) -> (usize, usize, f32) {
    let last = size - 1;
    let place = place.clamp(0.0, last as f32);
    let low = place as usize;
    (low, (low + 1).min(last), place - low as f32)
}

#[inline(always)]
fn interpolated(cells: &[Features], corners: &Corners) -> Features {
    let mut sum = [0.0; FEATURES];
    for &(corner, weight) in corners {
        add(&mut sum, weight, &cells[corner]);
    }
    sum
}

#[inline(always)]
fn inner(a: &Features, b: &Features) -> f32 {
    let products: Features = std::array::from_fn(|k| a[k] * b[k]);
    products.iter().sum()
}

#[inline(always)]
fn add(sum: &mut Features, share: f32, values: &Features) {
    for (sum, value) in sum.iter_mut().zip(values) {
        *sum += share * value;
    }
}
