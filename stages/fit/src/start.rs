//! What a fit starts from: the Gaussians of a field in three groups, and how each group moves
//! (`docs/spec/fit.md` section 2).

use glam::DVec3;
use rogs_field::attributes::{self, COLOUR, OPACITY, ROTATION, SCALE};
use rogs_geometry::{LinkPoses, quaternion_product};
use rogs_optimise::clusters::k_means;
use rogs_schemas::FrameIndex;
use rogs_schemas::records::clip::time_of_frame;
use rogs_schemas::records::field::{Field, GATE_ATTRIBUTES, RAW_CHANNELS};
use rogs_schemas::records::refinement::{RESIDUAL_CHANNELS, Refinement, ScaleResidual};
use rogs_schemas::records::robot::{NO_LINK, RobotMaps};
use rogs_splat::sh;
use rogs_worker::{StageError, StageResult};

use crate::params::{FitParams, RobotMotion};

/// Logit of a Gaussian's own rigid motion at the start; those of the others are 0.
const OWN_LOGIT: f32 = 4.0;
/// How near to 0 and 1 a colour may come that is turned back into a raw value.
const COLOUR_MARGIN: f32 = 1e-3;

/// How a Gaussian moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Group {
    /// With the robot: displacements are given.
    Robot,
    /// Not at all.
    Static,
    /// As in the field, and by the rigid motions: place in the list of those that do.
    Moving(u32),
}

/// What no parameter changes of one time.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FixedSlice {
    /// Normalised time.
    pub(crate) time: f64,
    /// Displacements in the field, of static Gaussians 0, metres. `[N, 3]`
    pub(crate) displacement_m: Vec<f32>,
    /// Gates in the field, of static Gaussians closed. `[N]`
    pub(crate) gate: Vec<u8>,
    /// Raw attributes at this time where the gate is open, in index order. `[M, RAW_CHANNELS]`
    pub(crate) moving_raw: Vec<f32>,
}

/// A field taken apart.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Start {
    /// Group of every Gaussian. `[N]`
    pub(crate) groups: Vec<Group>,
    /// Gaussians that the rigid motions move.
    pub(crate) moving: Vec<u32>,
    /// Slice of the source time of every Gaussian. `[N]`
    pub(crate) own_slice: Vec<u32>,
    /// Source positions, metres. `[N, 3]`
    pub(crate) position_m: Vec<f32>,
    /// Raw base attributes. `[N, RAW_CHANNELS]`
    pub(crate) raw: Vec<f32>,
    /// Caps of activated scales, internal units. `[N]`
    pub(crate) scale_cap_iu: Vec<f32>,
    /// The stored times.
    pub(crate) slices: Vec<FixedSlice>,
    /// Number of rigid motions; all are the identity at the start.
    pub(crate) bases: usize,
    /// Logits of the mixture. `[moving, K]`
    pub(crate) logits: Vec<f32>,
}

impl Start {
    /// Takes a field apart, the last corrections of a refinement added to it.
    ///
    /// # Errors
    /// When the records do not belong together.
    pub(crate) fn new(
        field: &Field,
        refinement: Option<&Refinement>,
        robot: &RobotMaps,
        params: &FitParams,
    ) -> StageResult<Self> {
        let n = field.len();
        let own_slice = own_slices(field)?;
        let mut start = Self {
            groups: Vec::with_capacity(n),
            moving: Vec::new(),
            own_slice,
            position_m: field.position_m.clone(),
            raw: field.base_raw.clone(),
            scale_cap_iu: field.scale_cap_iu.clone(),
            slices: Vec::with_capacity(field.slices.len()),
            bases: 0,
            logits: Vec::new(),
        };
        start.sort(field, params);
        start.fix(field);
        if let Some(refinement) = refinement {
            start.correct(field, refinement)?;
        }
        start.settle(field);
        start.share(field, params);
        if params.robot == RobotMotion::Kinematics {
            start.follow_links(field, robot)?;
        }
        Ok(start)
    }

    /// Number of Gaussians.
    pub(crate) fn len(&self) -> usize {
        self.groups.len()
    }

    /// Puts every Gaussian into its group.
    fn sort(&mut self, field: &Field, params: &FitParams) {
        let limit = params.static_below_m * params.static_below_m;
        let still = |index: usize| {
            field.slices.iter().all(|slice| {
                let d = &slice.displacement_m[3 * index..3 * index + 3];
                d.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>() < limit
            })
        };
        for index in 0..field.len() {
            self.groups.push(if field.support[index] != 0 {
                Group::Robot
            } else if still(index) {
                Group::Static
            } else {
                self.moving.push(index as u32);
                Group::Moving(self.moving.len() as u32 - 1)
            });
        }
    }

    /// Keeps displacements, gates and query-time attributes of all that is not static.
    fn fix(&mut self, field: &Field) {
        for slice in &field.slices {
            let mut fixed = FixedSlice {
                time: slice.time,
                displacement_m: slice.displacement_m.clone(),
                gate: slice.gate.clone(),
                moving_raw: Vec::new(),
            };
            let mut raw = slice.moving_raw.chunks_exact(RAW_CHANNELS);
            for (index, &gate) in slice.gate.iter().enumerate() {
                let own = if gate == 0 { None } else { raw.next() };
                if self.groups[index] == Group::Static {
                    fixed.displacement_m[3 * index..3 * index + 3].fill(0.0);
                    fixed.gate[index] = 0;
                } else {
                    fixed.moving_raw.extend_from_slice(own.unwrap_or(&[]));
                }
            }
            self.slices.push(fixed);
        }
    }

    /// Adds the corrections of Stage 2. Of the harmonics the field can hold the constant one; the others are left out.
    fn correct(&mut self, field: &Field, refinement: &Refinement) -> StageResult<()> {
        if refinement.clip_id != field.clip_id || refinement.gaussian_count != field.len() as u64 {
            return Err(StageError::bad_input(format!(
                "the refinement is one of clip `{}` with {} Gaussians, the field has {}",
                refinement.clip_id,
                refinement.gaussian_count,
                field.len()
            )));
        }
        let Some(step) = refinement.steps.last() else {
            return Ok(());
        };
        let touched = step.touched.iter().filter(|&&touched| touched != 0).count();
        if step.touched.len() != field.len() || step.values.len() != RESIDUAL_CHANNELS * touched {
            return Err(StageError::bad_input(
                "the corrections of the refinement do not fit its Gaussians",
            ));
        }
        let mut values = step.values.chunks_exact(RESIDUAL_CHANNELS);
        let mut rows = vec![None; field.len()];
        for (row, _) in rows.iter_mut().zip(&step.touched).filter(|(_, touched)| **touched != 0) {
            *row = values.next();
        }
        let mode = refinement.scale_residual;
        for (index, row) in rows.iter().enumerate() {
            let Some(row) = row else { continue };
            for axis in 0..3 {
                self.position_m[3 * index + axis] += row[axis];
            }
            corrected(&mut self.raw[RAW_CHANNELS * index..][..RAW_CHANNELS], row, mode);
        }
        for slice in &mut self.slices {
            let mut raw = slice.moving_raw.chunks_exact_mut(RAW_CHANNELS);
            for (row, _) in rows.iter().zip(&slice.gate).filter(|(_, gate)| **gate != 0) {
                if let (Some(raw), Some(row)) = (raw.next(), row) {
                    corrected(raw, row, mode);
                }
            }
        }
        Ok(())
    }

    /// Static Gaussians stand where they are at their source time.
    fn settle(&mut self, field: &Field) {
        for index in (0..self.len()).filter(|&index| self.groups[index] == Group::Static) {
            let slice = &field.slices[self.own_slice[index] as usize];
            for axis in 3 * index..3 * index + 3 {
                self.position_m[axis] += slice.displacement_m[axis];
            }
        }
    }

    /// Gaussians that move alike in the field share a rigid motion.
    fn share(&mut self, field: &Field, params: &FitParams) {
        let displaced = |index: u32, slice: usize, axis: usize| {
            let at = 3 * index as usize + axis;
            field.slices[slice].displacement_m[at] - field.slices[0].displacement_m[at]
        };
        let width = 3 * field.slices.len();
        let rows: Vec<f32> = self
            .moving
            .iter()
            .flat_map(|&index| (0..width).map(move |k| displaced(index, k / 3, k % 3)))
            .collect();
        let (labels, clusters) = k_means(&rows, width, params.bases as usize);
        self.bases = clusters;
        self.logits = vec![0.0; labels.len() * clusters];
        for (row, &label) in self.logits.chunks_exact_mut(clusters.max(1)).zip(&labels) {
            row[label as usize] = OWN_LOGIT;
        }
    }

    /// Takes displacements and rotations of the robot's Gaussians from their links.
    fn follow_links(&mut self, field: &Field, robot: &RobotMaps) -> StageResult<()> {
        let wrong = |error: rogs_geometry::Error| StageError::bad_input(error.to_string());
        let frames = field.frame_count as usize;
        let frame_of = |time: f64| {
            let frame = FrameIndex((time * (frames.max(2) - 1) as f64).round() as u32);
            if time_of_frame(frame, frames) == time {
                return Ok(frame);
            }
            Err(
                StageError::bad_input(format!("time {time} of the field lies between frames"))
                    .with_hint("lift at whole frames, or set `robot = \"field\"`"),
            )
        };
        let poses = (self.slices.iter())
            .map(|slice| LinkPoses::at_frame(robot, frame_of(slice.time)?).map_err(wrong))
            .collect::<StageResult<Vec<_>>>()?;
        for (slice, fixed) in self.slices.iter_mut().enumerate() {
            let motions: Vec<_> = poses.iter().map(|source| poses[slice].motion_from(source)).collect();
            let turns: Vec<_> = motions.iter().map(rogs_geometry::LinkMotions::rotations).collect();
            let stored = std::mem::take(&mut fixed.moving_raw);
            let mut stored = stored.chunks_exact(RAW_CHANNELS);
            for index in 0..self.groups.len() {
                let kept = if fixed.gate[index] == 0 { None } else { stored.next() };
                if self.groups[index] != Group::Robot || field.link[index] == NO_LINK {
                    fixed.moving_raw.extend_from_slice(kept.unwrap_or(&[]));
                    continue;
                }
                let own = self.own_slice[index] as usize;
                let link = usize::from(field.link[index]);
                let at = 3 * index..3 * index + 3;
                let point = DVec3::from_array([0, 1, 2].map(|axis| f64::from(self.position_m[3 * index + axis])));
                let Some(moved) = motions[own].moved(link, point) else {
                    return Err(StageError::bad_input(format!(
                        "the field has link {link}, the robot maps do not"
                    )));
                };
                fixed.displacement_m[at].copy_from_slice(&(moved - point).as_vec3().to_array());
                fixed.gate[index] = GATE_ATTRIBUTES;
                let mut raw = [0.0; RAW_CHANNELS];
                raw.copy_from_slice(&self.raw[RAW_CHANNELS * index..][..RAW_CHANNELS]);
                turn_raw(&mut raw, turns[own][link]);
                fixed.moving_raw.extend_from_slice(&raw);
            }
        }
        Ok(())
    }
}

/// Slice of the source time of every Gaussian.
fn own_slices(field: &Field) -> StageResult<Vec<u32>> {
    let area = field.height as usize * field.width as usize;
    let mut slices = Vec::with_capacity(field.len());
    for view in &field.views {
        let time = time_of_frame(view.frame, field.frame_count as usize);
        let slice = field
            .slices
            .iter()
            .position(|slice| slice.time == time)
            .ok_or_else(|| {
                StageError::bad_input(format!(
                    "the field has no values at its own source frame {}",
                    view.frame
                ))
            })?;
        slices.extend(std::iter::repeat_n(slice as u32, area));
    }
    Ok(slices)
}

/// Turns the rotation of raw attributes.
fn turn_raw(raw: &mut [f32], turn: [f32; 4]) {
    let own = [raw[6], raw[7], raw[8], raw[9]];
    raw[ROTATION].copy_from_slice(&quaternion_product(turn, own));
}

/// Adds residuals of Stage 2 to raw attributes.
fn corrected(raw: &mut [f32], row: &[f32], mode: ScaleResidual) {
    for (k, channel) in SCALE.enumerate() {
        raw[channel] = match mode {
            ScaleResidual::PreActivation => raw[channel] + row[3 + k],
            ScaleResidual::Linear => {
                let own = attributes::scale_iu(raw[channel]);
                let wanted = (own + row[3 + k]).max(attributes::MIN_LINEAR_SCALE_IU);
                attributes::rescaled(raw[channel], f64::from(wanted) / f64::from(own))
            }
        };
    }
    for (k, channel) in ROTATION.enumerate() {
        raw[channel] += row[6 + k];
    }
    raw[OPACITY] += 0.5 * row[10];
    for (k, channel) in COLOUR.enumerate() {
        let coefficient = sh::coefficient_from_colour(attributes::colour(raw[channel])) + row[11 + 16 * k];
        let colour = 0.5 + sh::C0 * coefficient;
        let colour = colour.clamp(COLOUR_MARGIN, 1.0 - COLOUR_MARGIN);
        raw[channel] = libm::atanhf(2.0 * colour - 1.0);
    }
}
