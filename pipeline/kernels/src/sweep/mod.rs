//! The plane sweep: how alike the features of a cell are to those of other frames at the points of its ray.
//!
//! Features stand on a grid twice as fine as the cells; a cell's own are the mean of the four on it. The point of cell
//! (x, y) at a depth has the homogeneous grid coordinates `depth * turn (x, y, 1) + shift` in another frame, whose features
//! are interpolated there. The similarity is the inner product within each group of features, averaged over the frames that
//! have the point in their image.

mod taps;

use rayon::prelude::*;

use crate::vectorised;

pub use taps::BilinearTaps;

/// Features of a place of the grid.
pub const FEATURES: usize = 16;
/// Groups of features that are compared apart.
pub const GROUPS: usize = 2;
/// Features of a group.
const OF_GROUP: usize = FEATURES / GROUPS;
/// Places of the grid along the side of a cell.
pub const FINER: usize = 2;
/// Points nearer to the plane of another camera than this are not seen by it, internal units.
const NEAREST_IU: f32 = 1e-3;

/// Share of a place of the grid in the features of its cell.
const OWN_SHARE: f32 = 1.0 / (FINER * FINER) as f32;

type Features = [f32; FEATURES];

/// Another frame, as a frame's cells and depths are seen in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Partner {
    /// Its index.
    pub frame: usize,
    /// Homogeneous coordinates of cells here to those of the grid there, points at infinity. Row-major.
    pub turn: [f32; 9],
    /// What a depth of zero adds: this frame's centre seen there.
    pub shift: [f32; 3],
}

/// The plan of a sweep over the frames of a clip.
#[derive(Debug, Clone)]
pub struct Sweep {
    /// Rows and columns of cells.
    pub size: [usize; 2],
    /// Rows and columns of the grid of features.
    pub grid: [usize; 2],
    /// The same of the image in places of the grid, which need not be whole.
    pub image: [f32; 2],
    /// Depths along the camera's z axis, internal units. `[D]`
    pub depths_iu: Vec<f32>,
    /// The frames that each frame is compared with. `[S]`
    pub partners: Vec<Vec<Partner>>,
}

/// Four places of the grid and their weights in a bilinear interpolation.
type Corners = [(usize, f32); 4];

impl Sweep {
    /// Size of the similarity. `[S, G D, h, w]`
    #[must_use]
    pub fn shape(&self) -> [usize; 4] {
        let [frames, depths, rows, columns] = self.shape_of_visible();
        [frames, GROUPS * depths, rows, columns]
    }

    /// Size of the shares of frames. `[S, D, h, w]`
    #[must_use]
    pub fn shape_of_visible(&self) -> [usize; 4] {
        let [rows, columns] = self.size;
        [self.partners.len(), self.depths_iu.len(), rows, columns]
    }

    /// Share of the other frames that have the point in their image. `[S, D, h, w]`
    #[must_use]
    pub fn visible(&self) -> Vec<f32> {
        self.each_cell(
            self.depths_iu.len(),
            #[inline(always)]
            |frame, _, counts, column| {
                let partners = self.partners[frame].len() as f32;
                for (share, count) in column.iter_mut().zip(counts) {
                    *share = count / partners;
                }
            },
        )
    }

    /// Mean similarity to the frames that have the point in their image, 0 where none has; depths of a group follow each
    /// other. `[S, F, rows, columns] -> [S, G D, h, w]`
    #[must_use]
    pub fn similarity(&self, features: &[f32]) -> Vec<f32> {
        let grid = self.by_place(features);
        let depths = self.depths_iu.len();
        self.each_cell(
            GROUPS * depths,
            #[inline(always)]
            |frame, cell, counts, column| {
                let own = self.own(frame, cell, &grid);
                self.compare(
                    frame,
                    cell,
                    &grid,
                    #[inline(always)]
                    |_, depth, _, there| {
                        for (group, value) in inner(&own, &there).into_iter().enumerate() {
                            column[group * depths + depth] += value;
                        }
                    },
                );
                for depths in column.chunks_exact_mut(depths) {
                    for (sum, &count) in depths.iter_mut().zip(counts) {
                        *sum /= count.max(1.0);
                    }
                }
            },
        )
    }

    /// Gradient of the features, given that of the similarity. `[S, G D, h, w] -> [S, F, rows, columns]`
    #[must_use]
    pub fn gradient(&self, slopes: &[f32], features: &[f32]) -> Vec<f32> {
        let grid = self.by_place(features);
        let (cells, places, depths) = (self.cells(), self.places(), self.depths_iu.len());
        // Each frame adds to its own places and to those of its partners; these sums are joined in the order of frames.
        let parts: Vec<Vec<(usize, Vec<Features>)>> = (0..self.partners.len())
            .into_par_iter()
            .map(|frame| {
                let partners = self.partners[frame].iter().map(|partner| partner.frame);
                let frames = std::iter::once(frame).chain(partners);
                let mut sums: Vec<_> = frames.map(|frame| (frame, vec![[0.0; FEATURES]; places])).collect();
                vectorised(
                    #[inline(always)]
                    || {
                        let mut counts = vec![0.0f32; depths];
                        for cell in 0..cells {
                            self.count(frame, cell, &mut counts);
                            let own = self.own(frame, cell, &grid);
                            let mut of_own = [0.0; FEATURES];
                            self.compare(
                                frame,
                                cell,
                                &grid,
                                #[inline(always)]
                                |partner, depth, corners, there| {
                                    let slope = |group: usize| {
                                        let channel = (frame * GROUPS + group) * depths + depth;
                                        slopes[channel * cells + cell] / counts[depth]
                                    };
                                    let slopes: [f32; GROUPS] = std::array::from_fn(slope);
                                    add(&mut of_own, 1.0, &by_group(&there, slopes));
                                    let of_there = by_group(&own, slopes);
                                    for (corner, weight) in corners {
                                        add(&mut sums[1 + partner].1[corner], weight, &of_there);
                                    }
                                },
                            );
                            for place in self.places_of(cell) {
                                add(&mut sums[0].1[place], OWN_SHARE, &of_own);
                            }
                        }
                    },
                );
                sums
            })
            .collect();
        let mut total = vec![[0.0f32; FEATURES]; grid.len()];
        for (frame, part) in parts.into_iter().flatten() {
            for (sum, part) in total[frame * places..].iter_mut().zip(&part) {
                add(sum, 1.0, part);
            }
        }
        let mut gradient = vec![0.0f32; features.len()];
        for (map, grid) in gradient
            .chunks_exact_mut(FEATURES * places)
            .zip(total.chunks_exact(places))
        {
            for (place, values) in grid.iter().enumerate() {
                for (channel, &value) in values.iter().enumerate() {
                    map[channel * places + place] = value;
                }
            }
        }
        gradient
    }

    fn cells(&self) -> usize {
        self.size[0] * self.size[1]
    }

    fn places(&self) -> usize {
        self.grid[0] * self.grid[1]
    }

    /// Features with those of a place side by side. `[S, F, rows, columns] -> [S * rows * columns]`
    fn by_place(&self, features: &[f32]) -> Vec<Features> {
        let places = self.places();
        features
            .chunks_exact(FEATURES * places)
            .flat_map(|map| (0..places).map(|place| std::array::from_fn(|channel| map[channel * places + place])))
            .collect()
    }

    /// The places of the grid on a cell; the last row or column stands twice where a cell reaches over the border.
    #[inline(always)]
    fn places_of(&self, cell: usize) -> [usize; FINER * FINER] {
        let [rows, columns] = self.grid;
        let (y, x) = (cell / self.size[1] * FINER, cell % self.size[1] * FINER);
        std::array::from_fn(|k| {
            let (row, column) = (y + k / FINER, x + k % FINER);
            row.min(rows - 1) * columns + column.min(columns - 1)
        })
    }

    /// The features of a cell.
    #[inline(always)]
    fn own(&self, frame: usize, cell: usize, grid: &[Features]) -> Features {
        let mut own = [0.0; FEATURES];
        for place in self.places_of(cell) {
            add(&mut own, OWN_SHARE, &grid[frame * self.places() + place]);
        }
        own
    }

    /// Fills the channels of every cell: `fill(frame, cell, counts of the depths, values, zeros at first)`. `[S, channels, h, w]`
    #[inline(always)]
    fn each_cell(&self, channels: usize, fill: impl Fn(usize, usize, &[f32], &mut [f32]) + Sync) -> Vec<f32> {
        let (cells, depths) = (self.cells(), self.depths_iu.len());
        let mut out = vec![0.0f32; self.partners.len() * channels * cells];
        out.par_chunks_mut((channels * cells).max(1))
            .enumerate()
            .filter(|(frame, _)| !self.partners[*frame].is_empty())
            .for_each(|(frame, out)| {
                vectorised(
                    #[inline(always)]
                    || {
                        let (mut counts, mut column) = (vec![0.0f32; depths], vec![0.0f32; channels]);
                        for cell in 0..cells {
                            self.count(frame, cell, &mut counts);
                            column.fill(0.0);
                            fill(frame, cell, &counts, &mut column);
                            for (channel, &value) in column.iter().enumerate() {
                                out[channel * cells + cell] = value;
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
        grid: &[Features],
        mut visit: impl FnMut(usize, usize, Corners, Features),
    ) {
        let places = self.places();
        for (index, partner) in self.partners[frame].iter().enumerate() {
            let there = &grid[partner.frame * places..][..places];
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
        let [rows, columns] = self.grid;
        let (x, y) = ((cell % self.size[1]) as f32, (cell / self.size[1]) as f32);
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

/// The places before and after a coordinate, and the share of the latter; the border continues outwards.
#[inline(always)]
fn neighbours(coordinate: f32, size: usize) -> (usize, usize, f32) {
    let last = size - 1;
    let coordinate = coordinate.clamp(0.0, last as f32);
    let low = coordinate as usize;
    (low, (low + 1).min(last), coordinate - low as f32)
}

#[inline(always)]
fn interpolated(grid: &[Features], corners: &Corners) -> Features {
    let mut sum = [0.0; FEATURES];
    for &(corner, weight) in corners {
        add(&mut sum, weight, &grid[corner]);
    }
    sum
}

/// Inner products of the groups.
#[inline(always)]
fn inner(a: &Features, b: &Features) -> [f32; GROUPS] {
    std::array::from_fn(|group| {
        let products: [f32; OF_GROUP] = std::array::from_fn(|k| a[group * OF_GROUP + k] * b[group * OF_GROUP + k]);
        products.iter().sum()
    })
}

/// Features times a number for each group.
#[inline(always)]
fn by_group(features: &Features, shares: [f32; GROUPS]) -> Features {
    std::array::from_fn(|channel| features[channel] * shares[channel / OF_GROUP])
}

#[inline(always)]
fn add(sum: &mut Features, share: f32, values: &Features) {
    for (sum, value) in sum.iter_mut().zip(values) {
        *sum += share * value;
    }
}
