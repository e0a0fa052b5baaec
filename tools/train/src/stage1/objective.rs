//! The losses of Stage 1 (`docs/spec/stage1.md` section 14): those of the network's outputs here, those of renders beside.

use burn::tensor::{Device, Int, Tensor, TensorData};
use rogs_field::gates::MOTION_GATE_IU;
use rogs_random::Pcg64;
use rogs_stage1::losses;
use rogs_tensors::device;
use rogs_tensors::parameters::from_host;

use super::forward::{Lifted, SweepTerms};
use super::matching;
use super::renders;
use super::terms::{EPSILON, Losses, Objective, Sum};
use crate::config::LossWeights;
use crate::device_copies::DeviceCopies;
use crate::error::Result;
use crate::sample::{Query, Sample};

/// Most track pixels of a query.
const TRACKS: usize = 1000;
/// Of these, the share that starts on robot and objects when there are enough of them.
const MOVING_SHARE: f64 = 0.75;
/// Pixels that tracks start on: row-major indices into `[S, A]`.
fn track_pixels(sample: &Sample, random: &mut Pcg64) -> Vec<i32> {
    let pixels = |wanted: bool| -> Vec<i32> {
        (0..sample.trackable.len())
            .filter(|&pixel| sample.valid[pixel] > 0.0 && (sample.trackable[pixel] > 0.0) == wanted)
            .map(|pixel| pixel as i32)
            .collect()
    };
    let mut pick = |mut from: Vec<i32>, count: usize| {
        let count = count.min(from.len());
        for k in 0..count {
            let other = k + (random.next_double() * (from.len() - k) as f64) as usize;
            let last = from.len() - 1;
            from.swap(k, other.min(last));
        }
        from.truncate(count);
        from
    };
    let mut chosen = pick(pixels(true), (TRACKS as f64 * MOVING_SHARE) as usize);
    if sample.still {
        let rest = TRACKS - chosen.len();
        chosen.extend(pick(pixels(false), rest.min(TRACKS / 4)));
    }
    chosen
}

/// 1 at pixels beside the robot that move, or at those that are known to stand still within reach of the gripper. `[S, A]`
fn beside_robot(sample: &Sample, query: &Query, moving: bool) -> Vec<f32> {
    let area = sample.size[0] * sample.size[1];
    let wanted = |pixel: usize| {
        let robot = sample.robot[pixel] > 0.0 || sample.support[pixel] > 0.0;
        let tracked = sample.trackable[pixel] > 0.0;
        let moves = tracked && query.moved_iu(pixel, area) > MOTION_GATE_IU;
        let stands = !moves && sample.near_tool[pixel] > 0.0 && (sample.still || tracked);
        !robot && if moving { moves } else { stands }
    };
    (0..sample.robot.len())
        .map(|pixel| f32::from(u8::from(wanted(pixel))))
        .collect()
}

/// The objective of one clip; terms whose weight is 0 are not computed. Wherever the network ran, losses are computed on the
/// CPU, where the rasteriser has its backward pass.
///
/// # Errors
/// When a device or the rasteriser fails.
pub fn objective(sample: &Sample, lifted: &Lifted, judged: Losses<'_>, random: &mut Pcg64) -> Result<Objective> {
    if device::is_cpu(&lifted.depth.device()) {
        of_outputs(sample, lifted, judged, random)
    } else {
        of_copies(sample, lifted, judged, random)
    }
}

/// The objective of copies of a network's outputs on the CPU; its gradients are those of the outputs.
///
/// # Errors
/// As [`objective`].
pub fn of_copies(sample: &Sample, lifted: &Lifted, judged: Losses<'_>, random: &mut Pcg64) -> Result<Objective> {
    let mut device_copies = DeviceCopies::to(Device::flex().autodiff());
    let copies = lifted.copied(&mut device_copies)?;
    let objective = of_outputs(sample, &copies, judged, random)?;
    let loss = device_copies.back(&mut objective.loss.backward())?;
    Ok(Objective {
        loss: loss.unwrap_or_else(|| Tensor::zeros([1], &lifted.depth.device())),
        ..objective
    })
}

fn of_outputs(sample: &Sample, lifted: &Lifted, judged: Losses<'_>, random: &mut Pcg64) -> Result<Objective> {
    let weights = judged.weights;
    let device = lifted.depth.device();
    let [height, width] = sample.size;
    let (views, area) = (sample.views.len(), height * width);
    let mut sum = Sum::new(&device);
    let map = |values: &[f32]| from_host(values.to_vec(), [views, height, width], &device);
    let valid = map(&sample.valid);
    if weights.stereo > 0.0 || weights.stereo_robot > 0.0 {
        let target: Vec<f32> = sample
            .depth_iu
            .iter()
            .map(|&depth| libm::logf(depth.max(1e-3)))
            .collect();
        let error = (lifted.log_depth.clone() - map(&target)).abs();
        let mean = |mask: Tensor<3>| (error.clone() * mask.clone()).sum() / (mask.sum() + EPSILON);
        if weights.stereo > 0.0 {
            sum.add("stereo", weights.stereo, 1.0, mean(valid.clone()))?;
        }
        if weights.stereo_robot > 0.0 {
            let robot = valid.clone() * map(&sample.support);
            sum.add("stereo_robot", weights.stereo_robot, 1.0, mean(robot))?;
        }
    }
    if weights.depth_head > 0.0 {
        let loss = losses::depth(lifted.depth.clone(), map(&sample.depth_iu), valid.clone())?;
        sum.add("depth_head", weights.depth_head, 1.0, loss)?;
    }
    if let Some(found) = &lifted.sweep {
        matching::add_terms(&mut sum, sample, found, weights)?;
    }
    let tracks = track_pixels(sample, random);
    let share = 1.0 / sample.queries.len().max(1) as f64;
    for (query, outputs) in sample.queries.iter().zip(&lifted.queries) {
        // [S, 3, H, W] -> [S A, 3]
        let rows = |map: Tensor<4>| map.permute([0, 2, 3, 1]).reshape([views * area, 3]);
        let reference = from_host(query.displacement_iu.clone(), [views, 3, height, width], &device);
        let (displacement, reference) = (rows(outputs.displacement.clone()), rows(reference));
        if weights.track_head > 0.0 && !tracks.is_empty() {
            let indices: Tensor<1, Int> = Tensor::from_data(TensorData::new(tracks.clone(), [tracks.len()]), &device);
            let predicted = displacement.clone().select(0, indices.clone());
            let target = reference.clone().select(0, indices);
            let loss = losses::motion(predicted.clone(), target.clone(), [predicted, target])?;
            sum.add("track_head", weights.track_head, share, loss)?;
        }
        if weights.held > 0.0 {
            let error = (displacement.clone() - reference.clone()).abs();
            let mean = |pixels: Vec<f32>| {
                let pixels = from_host(pixels, [views * area, 1], &device);
                (error.clone() * pixels.clone()).sum() / (pixels.sum() * 3.0 + EPSILON)
            };
            let [moving, still] = [true, false].map(|moving| mean(beside_robot(sample, query, moving)));
            sum.add("held", weights.held, share, moving + still)?;
        }
        if weights.fk_head > 0.0 {
            let robot = from_host(sample.support.clone(), [views * area, 1], &device);
            let error = (displacement - reference).abs() * robot.clone();
            let loss = error.sum() / (robot.sum() * 3.0 + EPSILON);
            sum.add("fk_head", weights.fk_head, share, loss)?;
        }
        renders::add_terms(&mut sum, (sample, query), (lifted, outputs), judged, &tracks, share)?;
    }
    Ok(sum.objective)
}

/// The same where nothing is judged but what the sweep found.
///
/// # Errors
/// When it found nothing to compare, or the device fails.
pub fn of_sweep(sample: &Sample, found: Option<&SweepTerms>, weights: &LossWeights) -> Result<Objective> {
    let found = found.ok_or_else(|| {
        rogs_tensors::Error::BadInput(format!("no two cameras of {} see the same moment", sample.origin))
    })?;
    let mut sum = Sum::new(&found.depths.device());
    matching::add_terms(&mut sum, sample, found, weights)?;
    Ok(sum.objective)
}
