//! How alike the features of frames are along the rays of a sweep: by the kernel on the CPU, with gradients on other devices by
//! operations of the framework.

use std::sync::Arc;

use burn::tensor::{Device, Int, Tensor, TensorData};

use rogs_kernels::sweep::{FEATURES, GROUPS};
use rogs_kernels::{BilinearTaps, Sweep};

use crate::parameters::{from_host, to_host};
use crate::{Result, differentiable, host};

/// Numbers of a tensor on a GPU; many refuse buffers of more than 128 MiB.
const MOST_NUMBERS: usize = 24 << 20;

/// Similarities of all depths, those of a group one after the other. `[S, F, rows, columns] -> [S, G D, h, w]`
///
/// # Errors
/// When a device cannot hand over values.
pub fn similarity(features: Tensor<4>, plan: Arc<Sweep>) -> Result<Tensor<4>> {
    if differentiable::usable(&features) {
        return Ok(differentiable::sweep(features, plan));
    }
    if features.is_autodiff() {
        let depths_at_a_time = (MOST_NUMBERS / features.dims()[1..].iter().product::<usize>()).max(1);
        return Ok(by_gathering(&features, &plan, depths_at_a_time));
    }
    let device = features.device();
    let values = if host::usable(&features) {
        host::with_values(&features, |features| plan.similarity(features))
    } else {
        plan.similarity(&to_host(features)?)
    };
    Ok(from_host(values, plan.shape(), &device))
}

/// The same by operations of the framework: frame by frame, for a few depths at a time, partner by partner.
fn by_gathering(features: &Tensor<4>, plan: &Sweep, depths_at_a_time: usize) -> Tensor<4> {
    let ([frames, _, grid_rows, grid_columns], device) = (features.dims(), features.device());
    let [_, channels, rows, columns] = plan.shape();
    let (depths, cells) = (plan.depths_iu.len(), rows * columns);
    let grid = features.clone().reshape([frames, FEATURES, grid_rows * grid_columns]);
    let of_frame = |frame: usize| grid.clone().narrow(0, frame, 1);
    let of_cells = Points::new(&plan.own_taps(), 0, [1, cells], &device);
    let compared = |frame: usize| {
        let (own, taps) = (of_cells.read(of_frame(frame)), plan.partner_taps(frame));
        // [d, G, 1, h w], unless there is no partner
        let at_depths = |first: usize| {
            let shape = [depths_at_a_time.min(depths - first), cells];
            let with_partners = plan.partners[frame].iter().zip(&taps).map(|(partner, taps)| {
                let there = Points::new(taps, first * cells, shape, &device).read(of_frame(partner.frame));
                (own.clone() * there)
                    .reshape([shape[0], GROUPS, FEATURES / GROUPS, cells])
                    .sum_dim(2)
            });
            with_partners.reduce(|sum, similarity| sum + similarity)
        };
        let pieces: Option<Vec<Tensor<4>>> = (0..depths).step_by(depths_at_a_time).map(at_depths).collect();
        let map = pieces.map_or_else(
            || Tensor::zeros([depths, GROUPS, 1, cells], &device),
            |pieces| Tensor::cat(pieces, 0),
        );
        map.swap_dims(0, 1).reshape([1, channels, rows, columns])
    };
    Tensor::cat((0..frames).map(compared).collect(), 0)
}

/// Points of some depths on the grid of a frame.
struct Points {
    /// The four places that each point reads, and their weights. `[d, 1, points]` each
    reads: [(Tensor<3, Int>, Tensor<3>); 4],
}

impl Points {
    /// The points from the `first` one on. `shape`: depths, points of a depth
    fn new(taps: &BilinearTaps, first: usize, shape: [usize; 2], device: &Device) -> Self {
        let (range, shape) = (first..first + shape[0] * shape[1], [shape[0], 1, shape[1]]);
        let read = |k: usize| {
            let places = TensorData::new(taps.places[k][range.clone()].to_vec(), shape);
            let weights = from_host(taps.weights[k][range.clone()].to_vec(), shape, device);
            (Tensor::from_data(places, device), weights)
        };
        Self {
            reads: std::array::from_fn(read),
        }
    }

    /// Features of a frame at these points. `[1, F, places] -> [d, F, points]`
    fn read(&self, grid: Tensor<3>) -> Tensor<3> {
        let [_, features, places] = grid.dims();
        let read = |(indices, weights): &(Tensor<3, Int>, Tensor<3>)| {
            let [depths, _, points] = indices.dims();
            // Gradients of a depth are added up in a grid of its own, side by side with those of the others.
            let grid = grid.clone().expand([depths, features, places]);
            grid.gather(2, indices.clone().expand([depths, features, points])) * weights.clone()
        };
        let [first, second, third, fourth] = self.reads.each_ref().map(read);
        first + second + third + fourth
    }
}

#[cfg(test)]
mod tests {
    use rogs_kernels::Partner;

    use super::*;

    /// Four frames side by side, all but the last of which see each other.
    fn plan(grid: [usize; 2]) -> Sweep {
        let partner = |frame: usize, other: usize| Partner {
            frame: other,
            turn: [2.0, 0.1, 0.5, 0.0, 1.9, 0.5, 0.0, 0.01, 1.0],
            shift: [3.0 * (frame as f32 - other as f32), 0.5, 0.1],
        };
        let partners = |frame: usize| match frame {
            3 => Vec::new(),
            _ => (0..3)
                .filter(|&other| other != frame)
                .map(|other| partner(frame, other))
                .collect(),
        };
        Sweep {
            size: [grid[0] / 2, grid[1].div_ceil(2)],
            grid,
            image: [grid[0] as f32, grid[1] as f32 - 0.5],
            depths_iu: vec![0.4, 0.7, 1.0, 2.0, 5.0],
            partners: (0..4).map(partners).collect(),
        }
    }

    /// Against the kernel: values, and gradients under the same slopes. The frame without company gets neither.
    #[test]
    fn gathering_compares_like_the_kernel() {
        let device = Device::flex().autodiff();
        let (grid, noise) = ([16, 23], |k: usize| ((k * 7919 + 13) % 1009) as f32 / 504.5 - 1.0);
        let map = |shape: [usize; 4], seed: usize| -> Tensor<4> {
            from_host(
                (0..shape.iter().product()).map(|k| noise(k + seed)).collect(),
                shape,
                &device,
            )
        };
        let plan = Arc::new(plan(grid));
        let features = map([4, FEATURES, grid[0], grid[1]], 0).require_grad();
        let slopes = map(plan.shape(), 5);
        let of = |similarity: Tensor<4>| {
            let gradients = (similarity.clone() * slopes.clone()).sum().backward();
            [similarity, features.grad(&gradients).unwrap()].map(|map| to_host(map).unwrap())
        };
        let expected = of(differentiable::sweep(features.clone(), plan.clone()));
        for depths_at_a_time in [2, 5] {
            let found = of(by_gathering(&features, &plan, depths_at_a_time));
            for (found, expected) in found.iter().zip(&expected) {
                assert_eq!(found.len(), expected.len());
                assert!(expected.iter().any(|value| value.abs() > 0.1));
                for (a, b) in found.iter().zip(expected) {
                    // Sums of some hundred products of numbers around one.
                    assert!((a - b).abs() < 1e-4, "{a} {b}");
                }
            }
        }
    }
}
