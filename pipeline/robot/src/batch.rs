//! Forward kinematics of many states at once, f32, structure of arrays: for caches over whole cohorts.
//!
//! States are processed in blocks of [`BLOCK`]; within a block every matrix entry is an array over the states, which the
//! compiler turns into vector instructions. No fused operations are used, so every instruction set gives the same bits.

use rayon::prelude::*;

use crate::model::{JointKind, RobotModel};

/// States per block.
pub const BLOCK: usize = 64;
/// Numbers per link transform: row-major 3x4.
pub const ENTRIES: usize = 12;

type Lane = [f32; BLOCK];

/// A robot prepared for batched forward kinematics.
#[derive(Debug, Clone)]
pub struct BatchFk {
    steps: Vec<Step>,
    driven: Vec<usize>,
    link_count: usize,
    root_link: usize,
}

/// One joint: child = parent * origin * motion.
#[derive(Debug, Clone)]
struct Step {
    parent: usize,
    child: usize,
    /// Row-major 3x4.
    origin: [f32; ENTRIES],
    turned: bool,
    motion: Motion,
}

#[derive(Debug, Clone)]
enum Motion {
    Fixed,
    /// Rotation about an axis; the angle is `multiplier * q[driver] + offset`.
    Rotation {
        axis: [f32; 3],
        driver: usize,
        multiplier: f32,
        offset: f32,
    },
    Translation {
        axis: [f32; 3],
        driver: usize,
        multiplier: f32,
        offset: f32,
    },
}

/// Link transforms of many states. Entry `e` (row-major 3x4, root from link) of link `l` of state `n` is
/// `data[((n / BLOCK * links + l) * ENTRIES + e) * BLOCK + n % BLOCK]`.
#[derive(Debug, Clone, Default)]
pub struct BatchTransforms {
    /// The numbers; the last block is padded with copies of state zero joints.
    pub data: Vec<f32>,
    /// Number of links.
    pub links: usize,
    /// Number of states.
    pub states: usize,
}

impl BatchTransforms {
    /// The row-major 3x4 transform of a link in a state.
    #[must_use]
    pub fn get(&self, state: usize, link: usize) -> [f32; ENTRIES] {
        let start = (state / BLOCK * self.links + link) * ENTRIES * BLOCK + state % BLOCK;
        std::array::from_fn(|entry| self.data[start + entry * BLOCK])
    }
}

impl BatchFk {
    /// Prepares a robot. Transforms are relative to the ROOT link.
    #[must_use]
    pub fn new(model: &RobotModel) -> Self {
        let driven: Vec<usize> = model.driven_joints().collect();
        let column = |joint: usize| driven.iter().position(|&candidate| candidate == joint);
        let step = |(index, joint): (usize, &crate::model::Joint)| {
            let (driver, multiplier, offset) = match joint.mimic {
                Some(mimic) => (mimic.driver, mimic.multiplier as f32, mimic.offset as f32),
                None => (index, 1.0, 0.0),
            };
            let axis = joint.axis.as_vec3().to_array();
            let motion = match (joint.kind, column(driver)) {
                (JointKind::Rotational, Some(driver)) => Motion::Rotation {
                    axis,
                    driver,
                    multiplier,
                    offset,
                },
                (JointKind::Linear, Some(driver)) => Motion::Translation {
                    axis,
                    driver,
                    multiplier,
                    offset,
                },
                _ => Motion::Fixed,
            };
            let origin = joint.parent_from_origin.to_matrix4();
            let turned = joint.parent_from_origin.rotation != glam::DMat3::IDENTITY;
            Step {
                parent: joint.parent,
                child: joint.child,
                origin: std::array::from_fn(|e| origin[e] as f32),
                turned,
                motion,
            }
        };
        let steps = model.joints.iter().enumerate().map(step).collect();
        Self {
            steps,
            driven,
            link_count: model.links.len(),
            root_link: model.root_link(),
        }
    }

    /// Indices (in the model) of the joints whose values are the columns of the input.
    #[must_use]
    pub fn driven_joints(&self) -> &[usize] {
        &self.driven
    }

    /// Transforms of all links for `states` states. `positions` holds one array per driven joint, `[J, N]`.
    ///
    /// # Panics
    /// When `positions` does not have that size.
    #[must_use]
    pub fn run(&self, positions: &[f32], states: usize) -> BatchTransforms {
        let mut transforms = BatchTransforms::default();
        self.run_into(positions, states, &mut transforms);
        transforms
    }

    /// The same into buffers that are used again.
    ///
    /// # Panics
    /// As [`BatchFk::run`].
    pub fn run_into(&self, positions: &[f32], states: usize, transforms: &mut BatchTransforms) {
        assert_eq!(
            positions.len(),
            self.driven.len() * states,
            "joint values must be [J, N]"
        );
        let block_size = self.link_count * ENTRIES * BLOCK;
        transforms.links = self.link_count;
        transforms.states = states;
        transforms.data.resize(states.div_ceil(BLOCK) * block_size, 0.0);
        let arch = pulp::Arch::new();
        transforms
            .data
            .par_chunks_mut(block_size)
            .enumerate()
            .for_each(|(block, out)| {
                let first = block * BLOCK;
                let count = BLOCK.min(states - first);
                let mut columns = vec![[0.0f32; BLOCK]; self.driven.len()];
                for (joint, column) in columns.iter_mut().enumerate() {
                    column[..count].copy_from_slice(&positions[joint * states + first..joint * states + first + count]);
                }
                arch.dispatch(|| self.block(&columns, out));
            });
    }

    #[inline(always)]
    fn block(&self, columns: &[Lane], out: &mut [f32]) {
        let (lanes, _) = out.as_chunks_mut::<BLOCK>();
        for entry in 0..ENTRIES {
            lanes[self.root_link * ENTRIES + entry] = [if entry % 5 == 0 { 1.0 } else { 0.0 }; BLOCK];
        }
        let mut moved = [[0.0f32; BLOCK]; ENTRIES];
        for step in &self.steps {
            apply_origin(&lanes[step.parent * ENTRIES..][..ENTRIES], step, &mut moved);
            match &step.motion {
                Motion::Fixed => {}
                Motion::Rotation {
                    axis,
                    driver,
                    multiplier,
                    offset,
                } => {
                    rotate(&mut moved, *axis, &columns[*driver], *multiplier, *offset);
                }
                Motion::Translation {
                    axis,
                    driver,
                    multiplier,
                    offset,
                } => {
                    translate(&mut moved, *axis, &columns[*driver], *multiplier, *offset);
                }
            }
            lanes[step.child * ENTRIES..][..ENTRIES].copy_from_slice(&moved);
        }
    }
}

/// `moved = parent * origin`.
#[inline(always)]
fn apply_origin(parent: &[Lane], step: &Step, moved: &mut [Lane; ENTRIES]) {
    let origin = &step.origin;
    for row in 0..3 {
        let [p0, p1, p2, p3] = [
            &parent[row * 4],
            &parent[row * 4 + 1],
            &parent[row * 4 + 2],
            &parent[row * 4 + 3],
        ];
        if step.turned {
            for column in 0..3 {
                let [o0, o1, o2] = [origin[column], origin[4 + column], origin[8 + column]];
                for i in 0..BLOCK {
                    moved[row * 4 + column][i] = p0[i] * o0 + p1[i] * o1 + p2[i] * o2;
                }
            }
        } else {
            (moved[row * 4], moved[row * 4 + 1], moved[row * 4 + 2]) = (*p0, *p1, *p2);
        }
        let [o0, o1, o2] = [origin[3], origin[7], origin[11]];
        for i in 0..BLOCK {
            moved[row * 4 + 3][i] = p0[i] * o0 + p1[i] * o1 + p2[i] * o2 + p3[i];
        }
    }
}

#[inline(always)]
fn rotate(moved: &mut [Lane; ENTRIES], axis: [f32; 3], column: &Lane, multiplier: f32, offset: f32) {
    let (mut sin, mut cos) = ([0.0f32; BLOCK], [0.0f32; BLOCK]);
    for i in 0..BLOCK {
        (sin[i], cos[i]) = sin_cos(multiplier * column[i] + offset);
    }
    // About a coordinate axis only two columns change.
    let along = (0..3).find(|&k| axis[k].abs() == 1.0 && axis[(k + 1) % 3] == 0.0 && axis[(k + 2) % 3] == 0.0);
    if let Some(k) = along {
        let (a, b, sign) = ((k + 1) % 3, (k + 2) % 3, axis[k]);
        for row in 0..3 {
            for i in 0..BLOCK {
                let (u, v, s) = (moved[row * 4 + a][i], moved[row * 4 + b][i], sign * sin[i]);
                moved[row * 4 + a][i] = u * cos[i] + v * s;
                moved[row * 4 + b][i] = v * cos[i] - u * s;
            }
        }
        return;
    }
    let [x, y, z] = axis;
    for row in 0..3 {
        for i in 0..BLOCK {
            let (s, c) = (sin[i], cos[i]);
            let rest = 1.0 - c;
            let (u, v, w) = (moved[row * 4][i], moved[row * 4 + 1][i], moved[row * 4 + 2][i]);
            moved[row * 4][i] = u * (c + x * x * rest) + v * (x * y * rest + z * s) + w * (x * z * rest - y * s);
            moved[row * 4 + 1][i] = u * (x * y * rest - z * s) + v * (c + y * y * rest) + w * (y * z * rest + x * s);
            moved[row * 4 + 2][i] = u * (x * z * rest + y * s) + v * (y * z * rest - x * s) + w * (c + z * z * rest);
        }
    }
}

#[inline(always)]
fn translate(moved: &mut [Lane; ENTRIES], axis: [f32; 3], column: &Lane, multiplier: f32, offset: f32) {
    for row in 0..3 {
        for i in 0..BLOCK {
            let along = moved[row * 4][i] * axis[0] + moved[row * 4 + 1][i] * axis[1] + moved[row * 4 + 2][i] * axis[2];
            moved[row * 4 + 3][i] += along * (multiplier * column[i] + offset);
        }
    }
}

/// Sine and cosine of an angle of moderate size, to about 1e-7: reduction to a quarter turn around 0 and the Taylor
/// polynomials of degree 9 and 10 there (remainder below 4e-9 up to pi/4).
#[inline(always)]
fn sin_cos(angle: f32) -> (f32, f32) {
    // Adding 1.5 * 2^23 rounds to the nearest integer, which is then in the low bits.
    const ROUNDING: f32 = 12_582_912.0;
    let shifted = angle * std::f32::consts::FRAC_2_PI + ROUNDING;
    let quarter = shifted.to_bits();
    let turns = shifted - ROUNDING;
    // pi/2 in two parts, the first with few bits so that the product is exact.
    let x = (angle - turns * 1.570_312_5) - turns * 4.838_267_9e-4;
    let z = x * x;
    let sin = x + x * z * (-1.0 / 6.0 + z * (1.0 / 120.0 + z * (-1.0 / 5040.0 + z * (1.0 / 362_880.0))));
    let cos = 1.0 - 0.5 * z + z * z * (1.0 / 24.0 + z * (-1.0 / 720.0 + z * (1.0 / 40320.0 - z * (1.0 / 3_628_800.0))));
    let (s, c) = if quarter & 1 == 0 { (sin, cos) } else { (cos, sin) };
    let s = f32::from_bits(s.to_bits() ^ (quarter & 2) << 30);
    let c = f32::from_bits(c.to_bits() ^ (quarter.wrapping_add(1) & 2) << 30);
    (s, c)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_are_accurate() {
        let mut worst = 0.0f64;
        for step in -40_000..40_000 {
            let angle = step as f32 * 2.5e-4;
            let (sin, cos) = sin_cos(angle);
            let exact = f64::from(angle);
            worst = worst
                .max((f64::from(sin) - exact.sin()).abs())
                .max((f64::from(cos) - exact.cos()).abs());
        }
        assert!(worst < 3e-7, "{worst}");
    }
}
