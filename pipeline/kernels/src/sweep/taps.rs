//! What a sweep reads of the grid of features, as numbers for the operations of a framework.

use super::{FINER, OWN_SHARE, Sweep};

/// Places that a point reads.
const PLACES: usize = FINER * FINER;

/// What points read of the features of a frame: a weighted sum of four places each.
#[derive(Debug, Clone, PartialEq)]
pub struct BilinearTaps {
    /// First, second, third and fourth place of every point.
    pub places: [Vec<i32>; PLACES],
    /// Their weights.
    pub weights: [Vec<f32>; PLACES],
}

impl BilinearTaps {
    /// Points that read nothing.
    fn none(points: usize) -> Self {
        Self {
            places: std::array::from_fn(|_| vec![0; points]),
            weights: std::array::from_fn(|_| vec![0.0; points]),
        }
    }

    fn set(&mut self, point: usize, reads: [(usize, f32); PLACES]) {
        for (k, (place, weight)) in reads.into_iter().enumerate() {
            self.places[k][point] = place as i32;
            self.weights[k][point] = weight;
        }
    }
}

impl Sweep {
    /// What cells read of their own frame: the same in all frames. `[h, w]`
    #[must_use]
    pub fn own_taps(&self) -> BilinearTaps {
        let mut taps = BilinearTaps::none(self.cells());
        for cell in 0..self.cells() {
            taps.set(cell, self.places_of(cell).map(|place| (place, OWN_SHARE)));
        }
        taps
    }

    /// What a frame reads of each of its partners at the points of its rays, so that the sum over partners is a mean over those
    /// that have the point in their image; nothing where a partner has not. `[D, h, w]` each
    #[must_use]
    pub fn partner_taps(&self, frame: usize) -> Vec<BilinearTaps> {
        let (cells, partners) = (self.cells(), &self.partners[frame]);
        let mut taps = vec![BilinearTaps::none(self.depths_iu.len() * cells); partners.len()];
        let mut counts = vec![0.0f32; self.depths_iu.len()];
        for cell in 0..cells {
            self.count(frame, cell, &mut counts);
            for (partner, taps) in partners.iter().zip(&mut taps) {
                self.project(partner, cell, |depth, corners| {
                    let mean = |(place, weight)| (place, weight / counts[depth]);
                    taps.set(depth * cells + cell, corners.map(mean));
                });
            }
        }
        taps
    }
}
