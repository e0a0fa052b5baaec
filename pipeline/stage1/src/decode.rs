//! From raw head outputs to depths and, on tensors, to the attributes that `rogs_field` defines
//! (`docs/spec/stage1.md` section 7).

use burn::tensor::{Tensor, activation};
use rogs_field::attributes::{MAX_SCALE_IU, SCALE_STEP_IU};
use rogs_field::gates::MotionGates;

/// Depths of the depth head are clamped to this range, internal units.
pub const DEPTH_RANGE_IU: [f32; 2] = [0.001, 100.0];

/// Optical-axis depth in internal units from the activated output of the depth head.
#[must_use]
pub fn depth_iu(activated: f32) -> f32 {
    activated.clamp(DEPTH_RANGE_IU[0], DEPTH_RANGE_IU[1])
}

/// Source anchoring: mesh depth (metres) where the pixel has valid robot support, the head's depth elsewhere. Internal units.
#[must_use]
pub fn select_depth_iu(mesh_m: Option<f32>, head_iu: f32) -> f32 {
    mesh_m.map_or(head_iu, rogs_schemas::units::iu_from_m)
}

/// Activated depth and confidence of the depth head. `[S, 2, H, W]` to itself
#[must_use]
pub fn activate_depth(raw: Tensor<4>) -> Tensor<4> {
    let [depth, confidence] = [0, 1].map(|channel| raw.clone().narrow(1, channel, 1).exp());
    Tensor::cat(vec![depth, confidence + 1.0], 1)
}

/// Activated attributes of raw channels in tensors, for training: those of [`rogs_field::attributes`]. `[S, 11, H, W]` to itself
#[must_use]
pub fn activate_attributes(raw: Tensor<4>) -> Tensor<4> {
    let color = activation::tanh(raw.clone().narrow(1, 0, 3)) * 0.5 + 0.5;
    let scale = (activation::softplus(raw.clone().narrow(1, 3, 3), 1.0) * SCALE_STEP_IU).clamp_max(MAX_SCALE_IU);
    let rotation = raw.clone().narrow(1, 6, 4);
    let norm = rotation.clone().powf_scalar(2.0).sum_dim(1).sqrt().clamp_min(1e-12);
    let opacity = activation::tanh(raw.narrow(1, 10, 1) - 1.0) * 0.5 + 0.5;
    Tensor::cat(vec![color, scale, rotation / norm, opacity], 1)
}

/// Attributes at a query time: `timed` where the displacement reaches the gate, `base` elsewhere, on raw values. No
/// gradient flows through the choice. `displacement [S, 3, H, W]`, attributes `[S, 11, H, W]` (or 12 with confidence, which follows the
/// attribute gate)
#[must_use]
pub fn gate_attributes(displacement: Tensor<4>, base: Tensor<4>, timed: Tensor<4>, gates: MotionGates) -> Tensor<4> {
    let norm = displacement.detach().powf_scalar(2.0).sum_dim(1).sqrt();
    let channels = base.dims()[1];
    let choose = |first: usize, count: usize, threshold: f32| {
        let [frames, _, height, width] = norm.dims();
        let open = norm
            .clone()
            .greater_equal_elem(threshold)
            .expand([frames, count, height, width]);
        base.clone()
            .narrow(1, first, count)
            .mask_where(open, timed.clone().narrow(1, first, count))
    };
    let mut parts = vec![choose(0, 10, gates.attributes_iu), choose(10, 1, gates.opacity_iu)];
    if channels > 11 {
        parts.push(choose(11, channels - 11, gates.attributes_iu));
    }
    Tensor::cat(parts, 1)
}
