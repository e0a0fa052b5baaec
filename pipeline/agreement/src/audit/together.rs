//! What holds for all cameras together: the robot's states.

use rayon::prelude::*;

use super::camera::{Found, LAGS};
use super::footage::Footage;
use super::footage::evenly;
use super::mistake::Mistake;
use super::states;
use super::trial::{Supposed, Trials};
use super::{GAIN, Tried};
use crate::Result;

/// Lags of cameras that differ by more frames than this are not those of one clock.
const APART_FRAMES: f64 = 1.5;

/// Cameras beside the robot that tell of its states.
fn beside(found: &[Found]) -> Vec<usize> {
    (0..found.len())
        .filter(|&i| !found[i].on_hand && !found[i].is_blank())
        .collect()
}

/// An offset in time that the motion of the robot shows in all cameras beside it.
pub(super) fn look_at_clock(trials: &Trials<'_>, given: &[Supposed], found: &mut [Found]) {
    let lags: Vec<[f64; 2]> = beside(found).into_iter().filter_map(|i| found[i].lag).collect();
    // Contours are sampled at pixels: a tenth of a frame is the best there is.
    let weights: Vec<f64> = lags.iter().map(|[_, sigma]| 1.0 / (sigma * sigma + 0.01)).collect();
    let total: f64 = weights.iter().sum();
    if lags.is_empty() {
        return;
    }
    let lag = lags
        .iter()
        .zip(&weights)
        .map(|([lag, _], weight)| lag * weight)
        .sum::<f64>()
        / total;
    let one = lags
        .iter()
        .all(|own| (own[0] - lag).abs() < APART_FRAMES.max(3.0 * own[1]));
    if !one || lag.abs() < LAGS || lag.abs() < 4.0 / total.sqrt() {
        return;
    }
    let count = trials.footage.frames();
    let delay = -lag.round() as i64;
    let reach = (delay.unsigned_abs() as usize).min(count / 2);
    let inner: Vec<usize> = (reach..count - reach).collect();
    let inner: Vec<usize> = evenly(inner.len(), 5)
        .into_iter()
        .filter_map(|i| inner.get(i).copied())
        .collect();
    for i in beside(found) {
        let late = Supposed {
            delay,
            ..given[i].clone()
        };
        let overlays: Vec<f64> = [&late, &given[i]]
            .into_par_iter()
            .map(|supposed| trials.overlay(i, supposed, &inner, None))
            .collect();
        found[i].late = true;
        found[i].tried.push(Tried {
            mistake: Mistake::TimeOffset { frames: -lag },
            overlay: found[i].overlay + overlays[0] - overlays[1],
        });
    }
}

/// Other readings of the joints hold for all cameras that stand beside the robot, or for none.
pub(super) fn agree_on_states(found: &mut [Found]) {
    let beside = beside(found);
    let gain_of = |mistake: &Mistake| {
        let gain = |&i: &usize| {
            let tried = found[i].tried.iter().find(|tried| tried.mistake == *mistake);
            tried.map_or(0.0, |tried| tried.overlay - found[i].overlay)
        };
        beside.iter().map(gain).sum::<f64>() / beside.len().max(1) as f64
    };
    let of_joints = |mistake: &Mistake| mistake.is_of_states() && !matches!(mistake, Mistake::TimeOffset { .. });
    let all = found.iter().flat_map(|own| &own.tried).map(|tried| &tried.mistake);
    let refuted: Vec<Mistake> = all
        .filter(|mistake| of_joints(mistake) && gain_of(mistake) < GAIN)
        .cloned()
        .collect();
    for found in found.iter_mut() {
        found.tried.retain(|tried| !refuted.contains(&tried.mistake));
    }
}

/// Looks at the fingers, in the cameras in which the robot lies on the images.
pub(super) fn look_at_gripper(footage: &Footage<'_>, given: &[Supposed], found: &mut [Found]) -> Result<()> {
    let (mistakes, tables) = states::grips(footage)?;
    let fingers = states::fingers(footage)?;
    if !fingers.contains(&true) {
        return Ok(());
    }
    let trials = Trials::of(footage, &tables);
    let frames = evenly(footage.frames(), 6);
    for (index, found) in found.iter_mut().enumerate() {
        if !found.on_hand || found.why.is_some() || found.explained() {
            continue;
        }
        let overlays: Vec<f64> = (0..trials.tables.len())
            .into_par_iter()
            .map(|states| {
                let supposed = Supposed {
                    states,
                    ..given[index].clone()
                };
                trials.overlay(index, &supposed, &frames, Some(&fingers))
            })
            .collect();
        for (mistake, overlay) in mistakes.iter().zip(&overlays[1..]) {
            found.tried.push(Tried {
                mistake: mistake.clone(),
                overlay: found.overlay + overlay - overlays[0],
            });
        }
    }
    Ok(())
}
