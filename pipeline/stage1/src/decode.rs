//! From raw head outputs to Gaussians: activations and motion gates (`docs/spec/stage1.md` section 7).

use burn::tensor::{Tensor, activation};

/// Depths of the depth head are clamped to this range, internal units.
pub const DEPTH_RANGE_IU: [f32; 2] = [0.001, 100.0];
/// Largest activated scale of an axis, internal units.
pub const SCALE_CAP_IU: f32 = 0.3;
/// Activated scale per unit of softplus, internal units.
pub const SCALE_UNIT_IU: f32 = 0.001;
/// Displacements of at least this many internal units take query-time attributes, by default.
pub const MOTION_GATE_IU: f32 = 0.005;

/// Plain RGB from a raw value: sigmoid(2 raw).
#[must_use]
pub fn color(raw: f32) -> f32 {
    0.5 * libm::tanhf(raw) + 0.5
}

/// Opacity from a raw value: sigmoid(2 raw - 2).
#[must_use]
pub fn opacity(raw: f32) -> f32 {
    0.5 * libm::tanhf(raw - 1.0) + 0.5
}

/// Scale of one axis from a raw value, internal units.
#[must_use]
pub fn scale_iu(raw: f32) -> f32 {
    let softplus = if raw > 20.0 { raw } else { libm::log1pf(libm::expf(raw)) };
    (SCALE_UNIT_IU * softplus).min(SCALE_CAP_IU)
}

/// Unit quaternion (w, x, y, z) from raw values; the identity when they are all 0.
#[must_use]
pub fn rotation(raw: [f32; 4]) -> [f32; 4] {
    let norm = raw.iter().map(|value| value * value).sum::<f32>().sqrt();
    if norm > 0.0 {
        raw.map(|value| value / norm)
    } else {
        [1.0, 0.0, 0.0, 0.0]
    }
}

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

/// Thresholds of the motion gates, internal units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionGates {
    /// For colour, scale and rotation.
    pub attributes_iu: f32,
    /// For opacity.
    pub opacity_iu: f32,
}

impl Default for MotionGates {
    fn default() -> Self {
        Self {
            attributes_iu: MOTION_GATE_IU,
            opacity_iu: MOTION_GATE_IU,
        }
    }
}

impl MotionGates {
    /// Gate bits of a displacement ([`rogs_schemas::records::field::GATE_ATTRIBUTES`] and `GATE_OPACITY`).
    #[must_use]
    pub fn bits(&self, displacement_iu: [f32; 3]) -> u8 {
        use rogs_schemas::records::field::{GATE_ATTRIBUTES, GATE_OPACITY};
        let [x, y, z] = displacement_iu;
        let norm = (x * x + y * y + z * z).sqrt();
        let bit = |open: bool, value: u8| if open { value } else { 0 };
        bit(norm >= self.attributes_iu, GATE_ATTRIBUTES) | bit(norm >= self.opacity_iu, GATE_OPACITY)
    }
}

/// Activated depth and confidence of the depth head. `[S, 2, H, W]` to itself
#[must_use]
pub fn activate_depth(raw: Tensor<4>) -> Tensor<4> {
    let [depth, confidence] = [0, 1].map(|channel| raw.clone().narrow(1, channel, 1).exp());
    Tensor::cat(vec![depth, confidence + 1.0], 1)
}

/// Activated attributes of raw channels in tensors, for training. `[S, 11, H, W]` to itself
#[must_use]
pub fn activate_attributes(raw: Tensor<4>) -> Tensor<4> {
    let color = activation::tanh(raw.clone().narrow(1, 0, 3)) * 0.5 + 0.5;
    let scale = (activation::softplus(raw.clone().narrow(1, 3, 3), 1.0) * SCALE_UNIT_IU).clamp_max(SCALE_CAP_IU);
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
