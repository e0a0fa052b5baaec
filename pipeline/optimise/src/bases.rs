//! Gaussians moved by a mixture of shared rigid motions (`docs/spec/baseline-som.md` section 5), and its gradients.

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use rogs_geometry::{quaternion, quaternion_product, wxyz_f32};

use crate::error::{Result, expect};
use crate::six::{rotation, rotation_gradient};

/// Numbers of one base at one frame: six of its rotation, three of its translation.
pub const BASE_NUMBERS: usize = 9;
/// Gaussians of one piece of work; fixed, because it sets the order of sums.
const PIECE: usize = 1024;

/// One base at one frame: rotation in six numbers, then translation.
pub type BaseMotion = [f32; BASE_NUMBERS];

/// K rigid motions over T frames.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MotionBases {
    /// Frames.
    pub frames: usize,
    /// Rotations, two columns each. `[K, T, 6]`
    pub rotations: Vec<f32>,
    /// Translations. `[K, T, 3]`
    pub translations: Vec<f32>,
}

impl MotionBases {
    /// Number of bases.
    #[must_use]
    pub fn len(&self) -> usize {
        self.translations.len().checked_div(3 * self.frames).unwrap_or(0)
    }

    /// Whether the set has no bases.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// All bases at a frame.
    ///
    /// # Errors
    /// For a frame out of range, or arrays whose lengths disagree.
    pub fn at(&self, frame: usize) -> Result<Vec<BaseMotion>> {
        let (bases, frames) = (self.len(), self.frames);
        expect("rotations of the bases", self.rotations.len(), 6 * bases * frames)?;
        expect("translations of the bases", self.translations.len(), 3 * bases * frames)?;
        if frame >= frames {
            return Err(crate::OptimiseError::Length {
                array: "frames of the bases",
                found: frames,
                expected: frame + 1,
            });
        }
        let one = |base: usize| {
            let at = base * frames + frame;
            std::array::from_fn(|k| {
                if k < 6 {
                    self.rotations[6 * at + k]
                } else {
                    self.translations[3 * at + k - 6]
                }
            })
        };
        Ok((0..bases).map(one).collect())
    }
}

/// Gaussians at a frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Moved {
    /// `[G, 3]`
    pub means: Vec<f32>,
    /// (w, x, y, z), as long as those that went in. `[G, 4]`
    pub quats: Vec<f32>,
}

/// Gradients of a loss with respect to what [`move_gaussians`] was given.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MotionGradient {
    /// Canonical means. `[G, 3]`
    pub means: Vec<f32>,
    /// Canonical quaternions. `[G, 4]`
    pub quats: Vec<f32>,
    /// Logits of the mixture. `[G, K]`
    pub logits: Vec<f32>,
    /// The bases. `[K]`
    pub bases: Vec<[f64; BASE_NUMBERS]>,
}

/// Shares of the bases: the softmax of each row of logits. `[G, K]`
#[must_use]
pub fn shares(logits: &[f32], bases: usize) -> Vec<f32> {
    let mut shares = logits.to_vec();
    for row in shares.chunks_exact_mut(bases.max(1)) {
        let largest = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        row.iter_mut().for_each(|value| *value = libm::expf(*value - largest));
        let total: f32 = row.iter().sum();
        row.iter_mut().for_each(|value| *value /= total);
    }
    shares
}

/// The motion of one Gaussian: the mixture of the bases by its shares.
#[must_use]
pub fn mixed(bases: &[BaseMotion], shares: &[f32]) -> (DMat3, DVec3) {
    let (six, translation) = blend(bases, shares);
    (rotation(six), translation)
}

fn blend(bases: &[BaseMotion], shares: &[f32]) -> ([f64; 6], DVec3) {
    let mut sum = [0.0; BASE_NUMBERS];
    for (base, &share) in bases.iter().zip(shares) {
        for (sum, &value) in sum.iter_mut().zip(base) {
            *sum += f64::from(share) * f64::from(value);
        }
    }
    let [a, b, c, d, e, f, x, y, z] = sum;
    ([a, b, c, d, e, f], DVec3::new(x, y, z))
}

/// Moves canonical Gaussians: `R mean + t`, `quaternion(R) * quaternion`. `shares [G, K]`, `means [G, 3]`, `quats [G, 4]`
///
/// # Errors
/// When the lengths differ.
pub fn move_gaussians(bases: &[BaseMotion], shares: &[f32], means: &[f32], quats: &[f32]) -> Result<Moved> {
    let count = check(bases, shares, means, quats)?;
    let mut moved = Moved {
        means: vec![0.0; 3 * count],
        quats: vec![0.0; 4 * count],
    };
    let k = bases.len();
    (moved.means.par_chunks_mut(3 * PIECE))
        .zip(moved.quats.par_chunks_mut(4 * PIECE))
        .enumerate()
        .for_each(|(piece, (to_means, to_quats))| {
            for local in 0..to_means.len() / 3 {
                let index = piece * PIECE + local;
                let (turn, shift) = mixed(bases, &shares[k * index..k * (index + 1)]);
                let mean = turn * vector(&means[3 * index..]) + shift;
                to_means[3 * local..3 * local + 3].copy_from_slice(&mean.as_vec3().to_array());
                let turned = quaternion_product(wxyz_f32(quaternion(&turn)), four(&quats[4 * index..]));
                to_quats[4 * local..4 * local + 4].copy_from_slice(&turned);
            }
        });
    Ok(moved)
}

/// Gradients of [`move_gaussians`]: `moved` is what it gave, `means_gradient [G, 3]` and `quats_gradient [G, 4]` are the
/// gradients with respect to that.
///
/// # Errors
/// When the lengths differ.
pub fn move_gradient(
    bases: &[BaseMotion],
    shares: &[f32],
    means: &[f32],
    quats: &[f32],
    moved: &Moved,
    means_gradient: &[f32],
    quats_gradient: &[f32],
) -> Result<MotionGradient> {
    let count = check(bases, shares, means, quats)?;
    expect("gradients of the moved means", means_gradient.len(), 3 * count)?;
    expect("gradients of the moved quaternions", quats_gradient.len(), 4 * count)?;
    expect("moved quaternions", moved.quats.len(), 4 * count)?;
    let k = bases.len();
    let mut gradient = MotionGradient {
        means: vec![0.0; 3 * count],
        quats: vec![0.0; 4 * count],
        logits: vec![0.0; k * count],
        bases: vec![[0.0; BASE_NUMBERS]; k],
    };
    let pieces: Vec<Vec<[f64; BASE_NUMBERS]>> = (gradient.means.par_chunks_mut(3 * PIECE))
        .zip(gradient.quats.par_chunks_mut(4 * PIECE))
        .zip(gradient.logits.par_chunks_mut(k.max(1) * PIECE))
        .enumerate()
        .map(|(piece, ((to_means, to_quats), to_logits))| {
            let mut sums = vec![[0.0; BASE_NUMBERS]; k];
            for local in 0..to_means.len() / 3 {
                let index = piece * PIECE + local;
                let own = &shares[k * index..k * (index + 1)];
                let (six, _) = blend(bases, own);
                let turn = rotation(six);
                let g = vector(&means_gradient[3 * index..]);
                let mean = vector(&means[3 * index..]);
                let gq = four(&quats_gradient[4 * index..]).map(f64::from);
                let to_mean = turn.transpose() * g;
                to_means[3 * local..3 * local + 3].copy_from_slice(&to_mean.as_vec3().to_array());
                let [w, x, y, z] = wxyz_f32(quaternion(&turn)).map(f64::from);
                let to_quat = quaternion_product([w, -x, -y, -z], gq).map(|value| value as f32);
                to_quats[4 * local..4 * local + 4].copy_from_slice(&to_quat);
                // A small turn w before R moves the quaternion by (0, w/2) q.
                let q = four(&moved.quats[4 * index..]).map(f64::from);
                let turned = |axis: [f64; 4]| {
                    let moved = quaternion_product(axis, q);
                    0.5 * moved.iter().zip(gq).map(|(a, b)| a * b).sum::<f64>()
                };
                let small = DVec3::new(
                    turned([0.0, 1.0, 0.0, 0.0]),
                    turned([0.0, 0.0, 1.0, 0.0]),
                    turned([0.0, 0.0, 0.0, 1.0]),
                );
                let by_matrix = DMat3::from_cols(g * mean.x, g * mean.y, g * mean.z) + skew(0.5 * small) * turn;
                let [a, b, c, d, e, f] = rotation_gradient(six, &by_matrix);
                let blended = [a, b, c, d, e, f, g.x, g.y, g.z];
                let by_share = |base: &BaseMotion| -> f64 {
                    base.iter().zip(blended).map(|(&value, g)| f64::from(value) * g).sum()
                };
                let mean_share: f64 = own
                    .iter()
                    .zip(bases)
                    .map(|(&share, base)| f64::from(share) * by_share(base))
                    .sum();
                for (base, &share) in own.iter().enumerate() {
                    let share = f64::from(share);
                    to_logits[k * local + base] = (share * (by_share(&bases[base]) - mean_share)) as f32;
                    for (sum, value) in sums[base].iter_mut().zip(blended) {
                        *sum += share * value;
                    }
                }
            }
            sums
        })
        .collect();
    for piece in pieces {
        for (to, from) in gradient.bases.iter_mut().flatten().zip(piece.iter().flatten()) {
            *to += from;
        }
    }
    Ok(gradient)
}

fn check(bases: &[BaseMotion], shares: &[f32], means: &[f32], quats: &[f32]) -> Result<usize> {
    let count = means.len() / 3;
    expect("canonical means", means.len(), 3 * count)?;
    expect("canonical quaternions", quats.len(), 4 * count)?;
    expect("shares of the bases", shares.len(), bases.len() * count)?;
    Ok(count)
}

fn vector(values: &[f32]) -> DVec3 {
    DVec3::new(values[0].into(), values[1].into(), values[2].into())
}

fn four(values: &[f32]) -> [f32; 4] {
    [values[0], values[1], values[2], values[3]]
}

/// The matrix of `v cross`.
fn skew(v: DVec3) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(0.0, v.z, -v.y),
        DVec3::new(-v.z, 0.0, v.x),
        DVec3::new(v.y, -v.x, 0.0),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAUSSIANS: usize = 5;
    const BASES: usize = 3;

    /// Parameters in a row: bases, logits, means, quaternions.
    fn parameters() -> Vec<f32> {
        let mut values: Vec<f32> = (0..BASES * 9 + GAUSSIANS * (BASES + 7))
            .map(|k| ((k * 7919 % 101) as f32 / 101.0 - 0.5) * 1.6)
            .collect();
        for base in 0..BASES {
            values[9 * base] += 1.0;
            values[9 * base + 4] += 1.0;
        }
        values
    }

    fn split(values: &[f32]) -> (Vec<BaseMotion>, &[f32], &[f32], &[f32]) {
        let (bases, rest) = values.split_at(9 * BASES);
        let (logits, rest) = rest.split_at(GAUSSIANS * BASES);
        let (means, quats) = rest.split_at(3 * GAUSSIANS);
        let bases = bases
            .chunks_exact(9)
            .map(|base| std::array::from_fn(|k| base[k]))
            .collect();
        (bases, logits, means, quats)
    }

    fn weight(k: usize) -> f32 {
        (k * 31 % 17) as f32 / 17.0 - 0.4
    }

    /// A loss with weights of its own on all that comes out; the sign of a quaternion must not matter.
    fn loss(values: &[f32]) -> f64 {
        let (bases, logits, means, quats) = split(values);
        let moved = move_gaussians(&bases, &shares(logits, BASES), means, quats).unwrap();
        let sum = |values: &[f32], from: usize| -> f64 {
            values
                .iter()
                .enumerate()
                .map(|(k, &v)| f64::from(v) * f64::from(weight(from + k)))
                .sum()
        };
        sum(&moved.means, 0) + sum(&moved.quats, 100)
    }

    #[test]
    fn gradients_are_those_of_central_differences() {
        let values = parameters();
        let (bases, logits, means, quats) = split(&values);
        let shares = shares(logits, BASES);
        let moved = move_gaussians(&bases, &shares, means, quats).unwrap();
        let g_means: Vec<f32> = (0..3 * GAUSSIANS).map(weight).collect();
        let g_quats: Vec<f32> = (0..4 * GAUSSIANS).map(|k| weight(100 + k)).collect();
        let found = move_gradient(&bases, &shares, means, quats, &moved, &g_means, &g_quats).unwrap();
        let mut all: Vec<f32> = found.bases.iter().flatten().map(|&v| v as f32).collect();
        all.extend(found.logits.iter().chain(&found.means).chain(&found.quats));
        for (k, &found) in all.iter().enumerate() {
            let at = |step: f32| {
                let mut moved = values.clone();
                moved[k] += step;
                (loss(&moved), f64::from(moved[k]))
            };
            let ((above, high), (below, low)) = (at(2e-3), at(-2e-3));
            let expected = (above - below) / (high - low);
            assert!(
                (f64::from(found) - expected).abs() < 2e-4 * (1.0 + expected.abs()),
                "{k}: {found} {expected}"
            );
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let count = 3 * PIECE + 17;
        let values =
            |n: usize, step: usize| -> Vec<f32> { (0..n).map(|k| (k * step % 113) as f32 / 113.0 - 0.3).collect() };
        let (bases, _, _, _) = split(&parameters());
        let (logits, means, quats) = (values(count * BASES, 7), values(3 * count, 11), values(4 * count, 13));
        let shares = shares(&logits, BASES);
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let moved = move_gaussians(&bases, &shares, &means, &quats).unwrap();
                let gradient =
                    move_gradient(&bases, &shares, &means, &quats, &moved, &moved.means, &moved.quats).unwrap();
                (moved, gradient)
            })
        };
        assert_eq!(run(1), run(4));
    }
}
