//! What the gripper holds follows it (`docs/spec/stage1.md` section 11): the displacement of a point that moves with the
//! hand, and a small convolutional gate that says where it applies.

use burn::tensor::{Tensor, activation};
use glam::{DMat3, DVec3};
use rogs_geometry::{Base, Pose, Recon};
use rogs_schemas::FrameIndex;
use rogs_schemas::units::UNITS_PER_METRE;
use rogs_tensors::ops::Conv;
use rogs_tensors::parameters::{Scope, from_host};

use crate::Result;
pub use crate::held_path::HeldPath;

/// Channels that the gate reads: colour 3, place beside the tool 3, nearness to the tool, robot support.
pub const INPUTS: usize = 8;
/// Place of the nearness among them.
pub const NEARNESS: usize = 6;
/// Channels between its layers.
pub const HIDDEN: usize = 16;
/// What is nearer to the tool centre than this can be held whole, what is farther than [`REACH_M`] cannot, metres.
const WHOLE_M: f64 = 0.15;
/// Nothing is held farther from the tool centre than this, metres.
pub const REACH_M: f64 = 0.30;
/// Standard deviation of the nearness, metres.
const NEAR_M: f64 = 0.05;
/// What the gate sees as 1 of a place beside the tool, metres.
const PLACE_M: f64 = 0.10;
/// Places are clamped to this, in those units.
const FARTHEST_PLACE: f64 = 3.0;
/// Distance to the tool of every point of a view without a hand, internal units.
const NOWHERE_IU: f32 = 1e4;

/// An affine map of points of the reconstruction frame, internal units, row-major 3x4.
type Affine = [f32; 12];

/// How what is held moves from a source time to a query time, and where the tool is at the source time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeldMotion {
    /// From a point to its displacement.
    displacement: Affine,
    /// From a point to its place beside the tool centre, along the axes of the robot's base.
    place: Affine,
}

impl HeldMotion {
    /// From a source frame to a place between frames; `None` outside the clip.
    #[must_use]
    pub fn new(
        path: &HeldPath,
        source: FrameIndex,
        position: f64,
        recon_from_base: &Pose<Recon, Base>,
    ) -> Option<Self> {
        let (motion, tool_m) = (path.motion(source, position)?, path.tool(source)?);
        let base_from_recon = recon_from_base.rotation.transpose();
        Some(Self {
            displacement: affine(motion.rotation - DMat3::IDENTITY, motion.translation),
            place: affine(base_from_recon, base_from_recon * -tool_m),
        })
    }
}

/// The map `matrix p + offset_m` as f32 in internal units. The difference of a rotation to the identity is small: taken in
/// f64 it keeps its digits.
fn affine(matrix: DMat3, offset_m: DVec3) -> Affine {
    let offset = offset_m * UNITS_PER_METRE;
    std::array::from_fn(|entry| match (entry / 4, entry % 4) {
        (row, 3) => offset[row] as f32,
        (row, column) => matrix.col(column)[row] as f32,
    })
}

/// Applies a map to the points of each view. `[S, 3, H, W]`
fn map_points(maps: impl Iterator<Item = Affine>, points: &Tensor<4>) -> Tensor<4> {
    let [views, _, height, width] = points.dims();
    let device = points.device();
    let maps: Vec<Affine> = maps.collect();
    let matrix = maps
        .iter()
        .flat_map(|map| (0..9).map(move |at| map[at / 3 * 4 + at % 3]));
    let offset = maps.iter().flat_map(|map| [map[3], map[7], map[11]]);
    let matrix: Tensor<3> = from_host(matrix.collect(), [views, 3, 3], &device);
    let offset: Tensor<3> = from_host(offset.collect(), [views, 3, 1], &device);
    let points = points.clone().reshape([views, 3, height * width]);
    (matrix.matmul(points) + offset).reshape([views, 3, height, width])
}

/// The weights of the gate: three 3x3 convolutions.
#[derive(Debug, Clone)]
pub struct HeldGate {
    layers: [Conv; 3],
}

/// What the gate makes of source views, whatever time is asked for.
#[derive(Debug, Clone)]
pub struct Holding {
    /// `[S, 1, H, W]`
    logit: Tensor<4>,
    /// 1 near the tool, 0 out of its reach and on the robot. `[S, 1, H, W]`
    reach: Tensor<4>,
    /// Source positions, internal units. `[S, 3, H, W]`
    position: Tensor<4>,
}

impl HeldGate {
    /// Reads `held`.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn load(scope: &Scope<'_>) -> Result<Self> {
        let conv = |name: &str, channels| Conv::load(&scope.child(name), channels, 3, 1);
        Ok(Self {
            layers: [
                conv("conv1", [HIDDEN, INPUTS])?,
                conv("conv2", [HIDDEN, HIDDEN])?,
                conv("conv3", [1, HIDDEN])?,
            ],
        })
    }

    /// Looks at source views: positions (internal units) `[S, 3, H, W]`, raw base attributes `[S, 3 or more, H, W]` and robot
    /// support `[S, 1, H, W]`; a motion of each view, to any time. Depth and colours get no gradient from here.
    #[must_use]
    pub fn look(
        &self,
        motions: &[Option<HeldMotion>],
        position: Tensor<4>,
        base_raw: Tensor<4>,
        support: Tensor<4>,
    ) -> Holding {
        let nowhere: Affine = std::array::from_fn(|entry| if entry % 4 == 3 { NOWHERE_IU } else { 0.0 });
        let places = motions
            .iter()
            .map(|motion| motion.map_or(nowhere, |motion| motion.place));
        let position = position.detach();
        let place = map_points(places, &position);
        let square = (place.clone() * place.clone()).sum_dim(1);
        let iu = |metres: f64| metres * UNITS_PER_METRE;
        let nearness = (square.clone() * (-0.5 / (iu(NEAR_M) * iu(NEAR_M)))).exp();
        let left = (square.sqrt() * -1.0 + iu(REACH_M)) / iu(REACH_M - WHOLE_M);
        let left = left.clamp(0.0, 1.0);
        let reach = left.clone() * left.clone() * (left * -2.0 + 3.0) * (support.clone() * -1.0 + 1.0);
        let colour = activation::tanh(base_raw.detach().narrow(1, 0, 3));
        let place = (place / iu(PLACE_M)).clamp(-FARTHEST_PLACE, FARTHEST_PLACE);
        let seen = Tensor::cat(vec![colour, place, nearness, support], 1);
        let [first, second, third] = &self.layers;
        Holding {
            logit: third.forward_of_relu(second.forward_of_relu(first.forward(seen))),
            reach,
            position,
        }
    }
}

impl Holding {
    /// The displacement that views owe to what is held, internal units; `confidence` is the last channel of the motion
    /// head. `[S, 1, H, W] -> [S, 3, H, W]`
    #[must_use]
    pub fn displacement(&self, motions: &[Option<HeldMotion>], confidence: Tensor<4>) -> Tensor<4> {
        let still = [0.0; 12];
        let moves = motions
            .iter()
            .map(|motion| motion.map_or(still, |motion| motion.displacement));
        let share = activation::sigmoid(self.logit.clone() + confidence) * self.reach.clone();
        map_points(moves, &self.position) * share
    }
}
