//! One pass of the network over a clip: the base field, and its state at the stored times.

use std::sync::OnceLock;

use burn::tensor::{Device, Tensor};
use rayon::prelude::*;
use rogs_field::MotionGates;
use rogs_field::attributes::MAX_SCALE_IU;
use rogs_geometry::quaternion_product;
use rogs_schemas::records::conditioning::{KAPPA_CHANNELS, plane};
use rogs_schemas::records::field::{GATE_ATTRIBUTES, RAW_CHANNELS, TimeSlice};
use rogs_schemas::records::robot::NO_LINK;
use rogs_schemas::units::{iu_from_m, m_from_iu};
use rogs_stage1::decode::{self, activate_depth};
use rogs_stage1::head::{DenseHead, FkBranch};
use rogs_stage1::held::{HeldGate, Holding};
use rogs_stage1::{Encoded, HeadKind, Stage1};
use rogs_tensors::device;
use rogs_tensors::parameters::{from_host, to_host};

use crate::params::{LiftParams, RobotMotion};
use crate::source::{RobotAtTime, Source, mesh_depth_m};

/// The part of a field that does not depend on a query time; arrays as in `Field`.
pub(crate) struct Base {
    pub(crate) position_m: Vec<f32>,
    pub(crate) raw: Vec<f32>,
    pub(crate) support: Vec<u8>,
    pub(crate) link: Vec<u8>,
    pub(crate) scale_cap_iu: Vec<f32>,
}

impl Base {
    /// Adds the Gaussians of further views.
    pub(crate) fn append(&mut self, other: Self) {
        self.position_m.extend(other.position_m);
        self.raw.extend(other.raw);
        self.support.extend(other.support);
        self.link.extend(other.link);
        self.scale_cap_iu.extend(other.scale_cap_iu);
    }
}

/// Depth and base attributes of every view. `images [S, 3, H, W]`
pub(crate) fn lift_base(
    network: &Stage1,
    encoded: &Encoded,
    images: &Tensor<4>,
    source: &Source<'_>,
    params: &LiftParams,
) -> rogs_tensors::Result<Base> {
    let [depth_head, splat_head] = [HeadKind::Depth, HeadKind::Splat].map(|kind| network.head(kind));
    let (depth_head, splat_head) = (depth_head?, splat_head?);
    let (depth_projections, splat_projections) = (depth_head.projections(None), splat_head.projections(None));
    let frame = |index: usize| -> rogs_tensors::Result<(Vec<f32>, Vec<f32>)> {
        let one = encoded.frames_at(index, 1);
        let depth = activate_depth(depth_head.forward(&depth_projections, &one));
        let mut raw = splat_head.forward(&splat_projections, &one);
        if let Some(shortcut) = splat_head.shortcut(images.clone().narrow(0, index, 1)) {
            raw = raw + shortcut;
        }
        Ok((to_host(depth.narrow(1, 0, 1))?, to_host(raw)?))
    };
    let maps = for_every(encoded.frames(), network.parameters.device(), frame)?;

    let (area, width) = (source.area(), source.clip.width as usize);
    let count = maps.len() * area;
    let mut base = Base {
        position_m: Vec::with_capacity(3 * count),
        raw: Vec::with_capacity(RAW_CHANNELS * count),
        support: vec![0; count],
        link: vec![NO_LINK; count],
        scale_cap_iu: vec![f32::INFINITY; count],
    };
    for (index, (view, (depth, raw))) in source.views.iter().zip(maps).enumerate() {
        let mut selected = Vec::with_capacity(area);
        let focal = view.lens.intrinsics.fx.min(view.lens.intrinsics.fy) as f32;
        for pixel in 0..area {
            let mesh = if params.anchoring {
                mesh_depth_m(view.map, pixel)
            } else {
                None
            };
            let depth = decode::select_depth_iu(mesh, decode::depth_iu(depth[pixel]));
            selected.push(depth);
            if mesh.is_some() {
                let gaussian = index * area + pixel;
                base.support[gaussian] = 1;
                base.link[gaussian] = view.map.link[pixel];
                if let Some(pixels) = params.footprint_px {
                    base.scale_cap_iu[gaussian] = (pixels * depth / focal).min(MAX_SCALE_IU);
                }
            }
        }
        let points = view.camera.unproject(&selected, area / width, width);
        base.position_m.extend(points.into_iter().map(m_from_iu));
        interleave(&raw, area, RAW_CHANNELS, &mut base.raw);
    }
    Ok(base)
}

/// Runs a function for every frame: at the same time on the CPU, one after the other on a GPU, which has
/// one queue and whose memory several frames would share.
fn for_every<T: Send>(
    frames: usize,
    device: &Device,
    function: impl Fn(usize) -> rogs_tensors::Result<T> + Send + Sync,
) -> rogs_tensors::Result<Vec<T>> {
    if device::is_cpu(device) {
        (0..frames).into_par_iter().map(function).collect()
    } else {
        (0..frames).map(function).collect()
    }
}

/// Appends planar channels pixel by pixel.
fn interleave(planar: &[f32], area: usize, channels: usize, out: &mut Vec<f32>) {
    out.extend((0..area).flat_map(|pixel| (0..channels).map(move |channel| planar[channel * area + pixel])));
}

/// The heads that answer query times, with what of them does not depend on the time.
pub(crate) struct MotionHeads {
    motion: DenseHead,
    attributes: DenseHead,
    fk: Option<FkBranch>,
    held: Option<HeldGate>,
    /// Shortcut of the attribute head per view, made when first needed.
    shortcuts: Vec<OnceLock<Tensor<4>>>,
    /// What the gate makes of each view, made when first needed.
    holdings: Vec<OnceLock<Holding>>,
}

/// How slices are made of the heads' answers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionOptions {
    /// Motion gates.
    pub gates: MotionGates,
    /// Where the motion of robot pixels comes from.
    pub robot_motion: RobotMotion,
}

/// What the FK-conditioning branch sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Branch {
    /// The conditioning maps.
    Maps,
    /// Zeros (the ablation without FK conditioning).
    Zeros,
}

/// What a slice is made from besides the heads.
pub(crate) struct Anchor<'a> {
    /// As in `Field`.
    pub(crate) position_m: &'a [f32],
    pub(crate) base_raw: &'a [f32],
    /// Robot support of each Gaussian, for kinematic transport.
    pub(crate) link: &'a [u8],
}

impl MotionHeads {
    pub(crate) fn load(network: &Stage1, views: usize) -> rogs_tensors::Result<Self> {
        let (motion, attributes) = (network.head(HeadKind::Motion)?, network.head(HeadKind::MotionSplat)?);
        Ok(Self {
            motion,
            attributes,
            fk: network.fk_branch()?,
            held: network.held_gate()?,
            shortcuts: (0..views).map(|_| OnceLock::new()).collect(),
            holdings: (0..views).map(|_| OnceLock::new()).collect(),
        })
    }

    /// Whether the weights say where the gripper holds something.
    pub(crate) fn has_held_gate(&self) -> bool {
        self.held.is_some()
    }

    /// Whether the weights have an FK-conditioning branch.
    pub(crate) fn has_fk_branch(&self) -> bool {
        self.fk.is_some()
    }

    /// The field at one time. `robot` gives the conditioning of each view; without it the branch sees zeros.
    pub(crate) fn slice(
        &self,
        encoded: &Encoded,
        anchor: &Anchor<'_>,
        time: f64,
        options: MotionOptions,
        robot: &[Option<RobotAtTime>],
        branch: Branch,
    ) -> rogs_tensors::Result<TimeSlice> {
        let time_f32 = Some(time as f32);
        let (motion, attributes) = (self.motion.projections(time_f32), self.attributes.projections(time_f32));
        let [height, width] = encoded.size;
        let area = height * width;
        let view = |index: usize| -> rogs_tensors::Result<ViewSlice> {
            let one = encoded.frames_at(index, 1);
            let raw = self.motion.forward(&motion, &one);
            let (visual, device) = (raw.clone().narrow(1, 0, 3), raw.device());
            let shown = robot[index].as_ref().filter(|_| branch == Branch::Maps);
            let mut total = match &self.fk {
                Some(fk) => {
                    let kappa = shown.map_or_else(|| vec![0.0; KAPPA_CHANNELS * area], |robot| robot.kappa.clone());
                    visual + fk.forward(from_host(kappa, [1, KAPPA_CHANNELS, height, width], &device))
                }
                None => visual,
            };
            if let Some((gate, robot)) = self.held.as_ref().zip(shown.filter(|robot| robot.held.is_some())) {
                let holding =
                    self.holdings[index].get_or_init(|| look(gate, robot, anchor, index, encoded.size, &device));
                total = total + holding.displacement(std::slice::from_ref(&robot.held), raw.narrow(1, 3, 1));
            }
            let mut displacement_iu = to_host(total)?;
            let links = &anchor.link[index * area..][..area];
            let base = &anchor.base_raw[index * area * RAW_CHANNELS..][..area * RAW_CHANNELS];
            let transport = (options.robot_motion == RobotMotion::Kinematics)
                .then_some(robot[index].as_ref())
                .flatten();
            if let Some(robot) = transport {
                move_with_links(&mut displacement_iu, robot, links, area);
            }
            let at = |pixel: usize| std::array::from_fn(|axis| displacement_iu[axis * area + pixel]);
            let carried = |pixel: usize| transport.and_then(|robot| robot.link_rotation.get(usize::from(links[pixel])));
            let mut gate: Vec<u8> = (0..area).map(|pixel| options.gates.bits(at(pixel))).collect();
            let asked = (0..area).any(|pixel| gate[pixel] != 0 && carried(pixel).is_none());
            let timed = if asked {
                Some(self.timed_attributes(index, &one, &attributes, base)?)
            } else {
                None
            };
            let mut moving_raw = Vec::new();
            for pixel in 0..area {
                if let Some(rotation) = carried(pixel) {
                    // Kinematic transport keeps colour, scale and opacity and turns the covariance with the link.
                    gate[pixel] = GATE_ATTRIBUTES;
                    let mut raw: [f32; RAW_CHANNELS] =
                        std::array::from_fn(|channel| base[pixel * RAW_CHANNELS + channel]);
                    let turned = quaternion_product(*rotation, [raw[6], raw[7], raw[8], raw[9]]);
                    raw[6..10].copy_from_slice(&turned);
                    moving_raw.extend(raw);
                } else if let (true, Some(timed)) = (gate[pixel] != 0, &timed) {
                    moving_raw.extend((0..RAW_CHANNELS).map(|channel| timed[channel * area + pixel]));
                }
            }
            let displacement_m = (0..area).flat_map(at).map(m_from_iu).collect();
            Ok(ViewSlice {
                displacement_m,
                gate,
                moving_raw,
            })
        };
        let views = for_every(encoded.frames(), &encoded.taps[0].device(), view)?;
        let mut slice = TimeSlice {
            time,
            displacement_m: Vec::new(),
            gate: Vec::new(),
            moving_raw: Vec::new(),
        };
        slice.displacement_m.reserve_exact(3 * area * views.len());
        for view in views {
            slice.displacement_m.extend(view.displacement_m);
            slice.gate.extend(view.gate);
            slice.moving_raw.extend(view.moving_raw);
        }
        Ok(slice)
    }

    /// Raw query-time attributes of one view, planar. `[12, H, W]`
    fn timed_attributes(
        &self,
        index: usize,
        one: &Encoded,
        projections: &rogs_stage1::head::Projections,
        base: &[f32],
    ) -> rogs_tensors::Result<Vec<f32>> {
        let [height, width] = one.size;
        let area = height * width;
        let mut raw = self.attributes.forward(projections, one);
        let shortcut = self.shortcuts[index].get_or_init(|| {
            let planar =
                (0..RAW_CHANNELS).flat_map(|channel| (0..area).map(move |pixel| base[pixel * RAW_CHANNELS + channel]));
            let input = from_host(planar.collect(), [1, RAW_CHANNELS, height, width], &raw.device());
            self.attributes.shortcut(input).unwrap_or_else(|| raw.zeros_like())
        });
        raw = raw + shortcut.clone();
        to_host(raw)
    }
}

/// One view's part of a slice.
struct ViewSlice {
    displacement_m: Vec<f32>,
    gate: Vec<u8>,
    moving_raw: Vec<f32>,
}

/// What the gate makes of one view.
fn look(
    gate: &HeldGate,
    robot: &RobotAtTime,
    anchor: &Anchor<'_>,
    index: usize,
    [height, width]: [usize; 2],
    device: &Device,
) -> Holding {
    let area = height * width;
    let planes = |values: &[f32], stride: usize, unit: fn(f32) -> f32| -> Tensor<4> {
        let of_view = &values[index * area * stride..][..area * stride];
        let planar =
            (0..3).flat_map(|channel| of_view[channel..].iter().step_by(stride).map(move |&value| unit(value)));
        from_host(planar.collect(), [1, 3, height, width], device)
    };
    let support = robot.kappa[plane::SUPPORT * area..][..area].to_vec();
    gate.look(
        std::slice::from_ref(&robot.held),
        planes(anchor.position_m, 3, iu_from_m),
        planes(anchor.base_raw, RAW_CHANNELS, |value| value),
        from_host(support, [1, 1, height, width], device),
    )
}

/// Replaces the displacement of robot pixels by that of their link. Planar `[3, H, W]`
fn move_with_links(displacement_iu: &mut [f32], robot: &RobotAtTime, links: &[u8], area: usize) {
    for (pixel, &link) in links.iter().enumerate() {
        if link == NO_LINK {
            continue;
        }
        for axis in 0..3 {
            displacement_iu[axis * area + pixel] = robot.kappa[(plane::DISPLACEMENT + axis) * area + pixel];
        }
    }
}
