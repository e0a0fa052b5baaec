//! One differentiable pass of the network over a clip.

use burn::tensor::{Device, Tensor};
use glam::DVec3;
use rogs_field::MotionGates;
use rogs_schemas::records::conditioning::KAPPA_CHANNELS;
use rogs_schemas::units::UNITS_PER_METRE;
use rogs_stage1::decode::{DEPTH_RANGE_IU, activate_attributes, gate_attributes};
use rogs_stage1::sweep::{SweepDepths, SweptDepth};
use rogs_stage1::{Attention, Encoded, HeadKind, SourceFrames, Stage1};
use rogs_tensors::device;
use rogs_tensors::parameters::from_host;
use rogs_tensors::render::{ColourTensor, GaussianTensors};

use crate::device_copies::DeviceCopies;
use crate::error::Result;
use crate::sample::{Query, Sample};

/// Outputs of a clip. `S` source views.
pub struct Lifted {
    /// Logarithm of the head's depth in internal units, before anchoring. `[S, H, W]`
    pub log_depth: Tensor<3>,
    /// The head's depth within its range, internal units. `[S, H, W]`
    pub depth: Tensor<3>,
    /// What the stem's sweep found, in a network that has one.
    pub sweep: Option<SweepTerms>,
    /// Positions after mesh anchoring, internal units. `[S, 3, H, W]`
    pub position: Tensor<4>,
    /// One a query; none when only the depth head ran.
    pub queries: Vec<LiftedQuery>,
}

/// Outputs of a query time.
pub struct LiftedQuery {
    /// Raw base attributes, the same at all times. `[S, 12, H, W]`
    pub base_raw: Tensor<4>,
    /// Displacement with the FK branch and that of what is held, internal units. `[S, 3, H, W]`
    pub displacement: Tensor<4>,
    /// Raw attributes at the query time after the gates. `[S, 12, H, W]`
    pub raw: Tensor<4>,
}

/// What a plane sweep found, as far as losses and scores read it.
pub struct SweepTerms {
    /// As [`SweptDepth::matches`]. `[S, D, h, w]`
    pub matches: Tensor<4>,
    /// As [`SweptDepth::depths`]. `[S, D, h, w]`
    pub depths: Tensor<4>,
    /// As [`SweptDepth::log_depth_m`]. `[S, 1, h, w]`
    pub log_depth_m: Tensor<4>,
    /// The depths.
    pub scale: SweepDepths,
}

impl Lifted {
    /// These outputs where they lie on the CPU, else copies of them there, without gradients.
    pub(super) fn on_cpu(self) -> Result<Self> {
        if device::is_cpu(&self.depth.device()) {
            return Ok(self);
        }
        self.copied(&mut DeviceCopies::to(Device::flex()))
    }

    /// Copies of these outputs.
    pub(super) fn copied(&self, device_copies: &mut DeviceCopies) -> Result<Self> {
        let queries = self.queries.iter().map(|query| {
            Ok(LiftedQuery {
                base_raw: device_copies.copy(&query.base_raw)?,
                displacement: device_copies.copy(&query.displacement)?,
                raw: device_copies.copy(&query.raw)?,
            })
        });
        Ok(Self {
            queries: queries.collect::<Result<_>>()?,
            log_depth: device_copies.copy(&self.log_depth)?,
            depth: device_copies.copy(&self.depth)?,
            sweep: self
                .sweep
                .as_ref()
                .map(|swept| swept.copied(device_copies))
                .transpose()?,
            position: device_copies.copy(&self.position)?,
        })
    }
}

impl SweepTerms {
    /// Copies of these outputs.
    pub(super) fn copied(&self, device_copies: &mut DeviceCopies) -> Result<Self> {
        Ok(Self {
            matches: device_copies.copy(&self.matches)?,
            depths: device_copies.copy(&self.depths)?,
            log_depth_m: device_copies.copy(&self.log_depth_m)?,
            scale: self.scale,
        })
    }
}

impl From<&SweptDepth> for SweepTerms {
    fn from(found: &SweptDepth) -> Self {
        Self {
            matches: found.matches.clone(),
            depths: found.depths.clone(),
            log_depth_m: found.log_depth_m.clone(),
            scale: found.scale,
        }
    }
}

/// Which of the dense heads run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Heads {
    /// All four, the FK branch, and the gate of what is held.
    All,
    /// The depth head.
    Depth,
}

/// What the network sees of a clip.
#[must_use]
pub fn source_frames(sample: &Sample, device: &Device) -> SourceFrames {
    let [height, width] = sample.size;
    SourceFrames {
        images: from_host(sample.images.clone(), [sample.views.len(), 3, height, width], device),
        cameras: sample.cameras.clone(),
        recon_from_base_iu: sample.recon_from_base_iu,
        times: sample.views.iter().map(|&(_, time)| time).collect(),
        attention: Attention::Joint,
    }
}

/// Runs the network; `conditioned` is false for clips whose conditioning is dropped.
///
/// # Errors
/// When a tensor is missing or has another shape.
pub fn lift(network: &Stage1, sample: &Sample, conditioned: bool, heads: Heads) -> Result<Lifted> {
    let encoded = network.encode(&source_frames(sample, network.parameters.device()))?;
    decode(network, sample, &encoded, conditioned, heads)
}

/// Runs the heads; the rest as [`lift`].
///
/// # Errors
/// When a tensor is missing or has another shape.
pub fn decode(network: &Stage1, sample: &Sample, encoded: &Encoded, conditioned: bool, heads: Heads) -> Result<Lifted> {
    let device = network.parameters.device();
    let [height, width] = sample.size;
    let views = sample.views.len();
    let depth_head = network.head(HeadKind::Depth)?;

    let log_depth = depth_head
        .forward(&depth_head.projections(None), encoded)
        .narrow(1, 0, 1);
    let depth = log_depth.clone().exp().clamp(DEPTH_RANGE_IU[0], DEPTH_RANGE_IU[1]);
    let mesh = from_host(sample.mesh_depth_iu.clone(), [views, 1, height, width], device);
    let selected = depth.clone().mask_where(mesh.clone().greater_elem(0.0), mesh);
    let (rays, origins) = rays(sample);
    let rays = from_host(rays, [views, 3, height, width], device);
    let position = rays * selected + from_host(origins, [views, 3, 1, 1], device);

    let queries = match heads {
        Heads::All => decode_queries(network, sample, encoded, (&depth, &position), conditioned)?,
        Heads::Depth => Vec::new(),
    };
    Ok(Lifted {
        log_depth: log_depth.squeeze_dim(1),
        depth: depth.squeeze_dim(1),
        sweep: encoded
            .local
            .as_ref()
            .and_then(|local| local.sweep.as_ref())
            .map(SweepTerms::from),
        position,
        queries,
    })
}

/// Runs the attribute and motion heads at all query times. `depth: [S, 1, H, W]`, as the head has it; `position:
/// [S, 3, H, W]`, after anchoring
fn decode_queries(
    network: &Stage1,
    sample: &Sample,
    encoded: &Encoded,
    (depth, position): (&Tensor<4>, &Tensor<4>),
    conditioned: bool,
) -> Result<Vec<LiftedQuery>> {
    let device = network.parameters.device();
    let [height, width] = sample.size;
    let views = sample.views.len();
    let (splat_head, motion_head) = (network.head(HeadKind::Splat)?, network.head(HeadKind::Motion)?);
    let timed_head = network.head(HeadKind::MotionSplat)?;
    let branch = network.fk_branch()?;
    let mut base_raw = splat_head.forward(&splat_head.projections(None), encoded);
    if let Some(shortcut) = splat_head.shortcut(from_host(sample.images.clone(), [views, 3, height, width], device)) {
        base_raw = base_raw + shortcut;
    }
    let timed_shortcut = timed_head.shortcut(base_raw.clone().narrow(1, 0, 11));
    let gate = network.held_gate()?.filter(|_| conditioned);
    let holding = gate.zip(sample.queries.first()).map(|(gate, first)| {
        let support = from_host(sample.support.clone(), [views, 1, height, width], device);
        gate.look(&first.held, position.clone(), base_raw.clone(), support)
    });
    let query = |query: &Query| {
        let time = Some(query.time);
        let motion = motion_head.forward(&motion_head.projections(time), encoded);
        let visual = motion.clone().narrow(1, 0, 3);
        let mut displacement = match &branch {
            Some(branch) => {
                let kappa = if conditioned {
                    conditioning(sample, query, depth)
                } else {
                    Tensor::zeros([views, KAPPA_CHANNELS, height, width], device)
                };
                visual + branch.forward(kappa)
            }
            None => visual,
        };
        if let Some(holding) = &holding {
            displacement = displacement + holding.displacement(&query.held, motion.narrow(1, 3, 1));
        }
        let mut timed = timed_head.forward(&timed_head.projections(time), encoded);
        if let Some(shortcut) = &timed_shortcut {
            timed = timed + shortcut.clone();
        }
        let raw = gate_attributes(displacement.clone(), base_raw.clone(), timed, MotionGates::default());
        LiftedQuery {
            base_raw: base_raw.clone(),
            displacement,
            raw,
        }
    };
    Ok(sample.queries.iter().map(query).collect())
}

/// Conditioning maps of a query. Without anchors the FK displacement is that of the points at the network's own depth, as the
/// lift stage has it, so that errors of motion reach the depth. `[S, 1, H, W] -> [S, 7, H, W]`
fn conditioning(sample: &Sample, query: &Query, depth: &Tensor<4>) -> Tensor<4> {
    let (device, [views, _, height, width]) = (depth.device(), depth.dims());
    let map = |values: &[f32], channels: usize| from_host(values.to_vec(), [views, channels, height, width], &device);
    let kappa: Tensor<4> = map(&query.kappa, KAPPA_CHANNELS);
    if sample.anchored {
        return kappa;
    }
    let mesh_iu = kappa.clone().narrow(1, 1, 1) * UNITS_PER_METRE;
    let moved = kappa.clone().narrow(1, 2, 3) + map(&query.fk_slope, 3) * (depth.clone() - mesh_iu);
    Tensor::cat(vec![kappa.clone().narrow(1, 0, 2), moved, kappa.narrow(1, 5, 2)], 1)
}

/// Direction at depth one of every pixel `[S, 3, H, W]`, and the origin of every view `[S, 3]`.
fn rays(sample: &Sample) -> (Vec<f32>, Vec<f32>) {
    let [height, width] = sample.size;
    let area = height * width;
    let mut rays = vec![0.0; sample.cameras.len() * 3 * area];
    let mut origins = Vec::new();
    for (camera, rays) in sample.cameras.iter().zip(rays.chunks_exact_mut(3 * area)) {
        let mut at_origin = *camera;
        at_origin.world_from_camera_iu.translation = DVec3::ZERO;
        let directions = at_origin.unproject(&vec![1.0; area], height, width);
        for (pixel, direction) in directions.chunks_exact(3).enumerate() {
            for axis in 0..3 {
                rays[axis * area + pixel] = direction[axis];
            }
        }
        origins.extend(camera.world_from_camera_iu.translation.as_vec3().to_array());
    }
    (rays, origins)
}

/// Activated attributes `[S, 11, H, W]` of raw ones `[S, 12, H, W]`, the scales of anchored Gaussians capped.
#[must_use]
pub fn attributes(raw: Tensor<4>, sample: &Sample) -> Tensor<4> {
    let [views, _, height, width] = raw.dims();
    let cap = from_host(sample.scale_cap_iu.clone(), [views, 1, height, width], &raw.device());
    let activated = activate_attributes(raw.narrow(1, 0, 11));
    let scale = activated.clone().narrow(1, 3, 3).min_pair(cap.repeat(&[1, 3, 1, 1]));
    Tensor::cat(
        vec![activated.clone().narrow(1, 0, 3), scale, activated.narrow(1, 6, 5)],
        1,
    )
}

/// Gaussians at these positions `[V, 3, H, W]` with activated attributes `[V, 11, H, W]`, and displacements
/// `[V, 3, H, W]` to composite.
#[must_use]
pub fn gaussians(position: Tensor<4>, attributes: Tensor<4>, displacement: Option<Tensor<4>>) -> GaussianTensors {
    let rows = |map: Tensor<4>| {
        let [views, channels, height, width] = map.dims();
        map.permute([0, 2, 3, 1]).reshape([views * height * width, channels])
    };
    let attributes = rows(attributes);
    let part = |first: usize, count: usize| attributes.clone().narrow(1, first, count);
    GaussianTensors {
        means: rows(position),
        colours: ColourTensor::Rgb(part(0, 3)),
        scales: part(3, 3),
        rotations: part(6, 4),
        opacities: part(10, 1).squeeze_dim(1),
        extra: displacement.map(rows),
    }
}
