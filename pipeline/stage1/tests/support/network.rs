//! The tiny network on the frames of `full_forward`.

use burn::tensor::{Device, Tensor};
use rogs_geometry::Pose;
use rogs_stage1::decode::activate_depth;
use rogs_stage1::{Attention, Encoded, HeadKind, SourceFrames, Stage1};

use super::Golden;

/// Names and channels of the attributes in a raw map.
pub const ATTRIBUTES: [(&str, usize, usize); 5] = [
    ("color", 0, 3),
    ("scale", 3, 3),
    ("rotation", 6, 4),
    ("opacity", 10, 1),
    ("conf", 11, 1),
];

/// The source frames of a golden file.
pub fn frames(golden: &Golden, device: &Device) -> SourceFrames {
    SourceFrames {
        images: golden.tensor("in.images", [4, 3, 28, 42], device),
        cameras: golden.cameras("in.C2W", "in.fxfycxcy"),
        recon_from_base_iu: Pose::IDENTITY,
        times: golden.values("in.input_timesteps").to_vec(),
        attention: Attention::Joint,
    }
}

/// Outputs of the network as the reference lists them.
pub struct Outputs {
    pub depth: Tensor<4>,
    pub base: Tensor<4>,
    pub motion: Vec<Tensor<4>>,
    pub timed: Vec<Tensor<4>>,
}

/// Runs every head; those with time at some times.
pub fn run(network: &Stage1, encoded: &Encoded, images: Tensor<4>, times: &[f32]) -> Outputs {
    let head = |kind| network.head(kind).unwrap();
    let (depth, splat, motion, timed) = (
        head(HeadKind::Depth),
        head(HeadKind::Splat),
        head(HeadKind::Motion),
        head(HeadKind::MotionSplat),
    );
    let base = splat.forward(&splat.projections(None), encoded) + splat.shortcut(images).unwrap();
    let shortcut = timed.shortcut(base.clone().narrow(1, 0, 11)).unwrap();
    Outputs {
        depth: activate_depth(depth.forward(&depth.projections(None), encoded)),
        base,
        motion: times
            .iter()
            .map(|&time| motion.forward(&motion.projections(Some(time)), encoded))
            .collect(),
        timed: times
            .iter()
            .map(|&time| timed.forward(&timed.projections(Some(time)), encoded) + shortcut.clone())
            .collect(),
    }
}
