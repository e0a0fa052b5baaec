//! The objective of a corrected field, and its gradient in the corrections.

use burn::tensor::{Device, Gradients as TensorGradients, Tensor};
use rogs_field::Correction;
use rogs_schemas::records::field::{Field, TimeSlice};
use rogs_schemas::records::refinement::RESIDUAL_CHANNELS;
use rogs_schemas::units::m_from_iu;
use rogs_splat::backward::{Gradients, RenderGradient, Tape, backward_into, render_with_tape};
use rogs_splat::{Gaussians, RasterConfig};
use rogs_stage2::objective::{RenderedMotion, RenderedView, RobotPositions, UpdateOutcome, update_objective};
use rogs_tensors::parameters::{from_host, to_host};
use rogs_worker::StageResult;

use super::chain::{add_chained, bound_gradient, scene_at};
use super::targets::{MotionTarget, TargetTime, Targets};
use super::{TermValues, TrainingOptions};
use crate::RefineParams;
use crate::refinement::internal;

/// A scene with the renders made of it.
struct Rendered<'a> {
    slice: &'a TimeSlice,
    scene: Gaussians,
    tapes: Vec<Tape>,
}

/// Terms of the objective, and its gradient in the corrections before the bound, position in internal units. `[N, 59]`
pub(super) fn correction_gradient(
    field: &Field,
    targets: &Targets<'_>,
    correction: &Correction,
    params: &RefineParams,
    options: &TrainingOptions<'_>,
    device: &Device,
    shortening: &[f32],
) -> StageResult<(TermValues, Vec<f32>)> {
    let (mut views, mut rendered) = (Vec::new(), Vec::new());
    for time in &targets.times {
        let (mut new_views, new_rendered) = render_time(field, time, correction, params, device)?;
        views.append(&mut new_views);
        rendered.push(new_rendered);
    }
    let (motion, moved) = render_motion(field, &targets.motion, correction, params, device)?;
    let robot = robot_positions(field, &targets.times, correction, device);
    let outcome = UpdateOutcome { views, robot, motion };
    let terms = update_objective(&outcome, &options.weights, options.perceptual);
    let number = |tensor: Tensor<1>| to_host(tensor).map(|values| f64::from(values[0])).map_err(internal);
    let values = terms.clone().try_map(number)?;
    let gradients = terms.total.backward();

    let mut total = vec![0.0; field.len() * RESIDUAL_CHANNELS];
    let mut add = |rendered: &Rendered<'_>, gradients: &Gradients| {
        let mode = params.scale_residual;
        add_chained(
            field,
            rendered.slice,
            &rendered.scene,
            correction,
            mode,
            gradients,
            &mut total,
        );
    };
    let mut first = 0;
    for rendered in &rendered {
        let views = &outcome.views[first..first + rendered.tapes.len()];
        first += views.len();
        add(rendered, &view_gradients(rendered, views, &gradients)?);
    }
    if let Some(motion) = &outcome.motion {
        let of_displacement = gradient_of(&motion.displacement, &gradients)?;
        let mut rows = of_displacement.chunks_exact(3);
        for (target, rendered) in targets.motion.iter().zip(&moved) {
            let area = (field.height * field.width) as usize;
            let mut extra = vec![0.0; area * target.channels];
            for (&sample, row) in target.samples.iter().zip(&mut rows) {
                for axis in 0..3 {
                    extra[sample + axis] += row[axis];
                }
            }
            let gradient = RenderGradient {
                extra: &extra,
                ..RenderGradient::default()
            };
            let mut into = Gradients::zeros(&rendered.scene);
            for tape in &rendered.tapes {
                backward_into(&rendered.scene, &RasterConfig::default(), tape, &gradient, &mut into)
                    .map_err(internal)?;
            }
            add(rendered, &into);
        }
    }
    if let Some(robot) = &outcome.robot {
        // Centres and the stored corrections are in metres, residuals in internal units.
        let of_centre = gradient_of(&robot.centre_m, &gradients)?;
        let gaussians = targets.times.iter().flat_map(|time| &time.robot.gaussians);
        for (&gaussian, row) in gaussians.zip(of_centre.chunks_exact(3)) {
            for axis in 0..3 {
                total[gaussian as usize * RESIDUAL_CHANNELS + axis] += m_from_iu(row[axis]);
            }
        }
    }
    for ((n, row), &factor) in total.chunks_exact_mut(RESIDUAL_CHANNELS).enumerate().zip(shortening) {
        if factor < 1.0 {
            bound_gradient(&mut row[..3], &correction.row(n)[..3], factor);
        }
    }
    Ok((values, total))
}

/// The views of one query time.
fn render_time<'a>(
    field: &Field,
    time: &TargetTime<'a>,
    correction: &Correction,
    params: &RefineParams,
    device: &Device,
) -> StageResult<(Vec<RenderedView>, Rendered<'a>)> {
    let scene = scene_at(field, correction, params.scale_residual, time.slice.time)?;
    let (mut views, mut tapes) = (Vec::new(), Vec::new());
    for target in &time.views {
        let (render, tape) = render_with_tape(&scene, &target.camera, &RasterConfig::default()).map_err(internal)?;
        let pixels = render.alpha.len();
        let line = |values: Vec<f32>| from_host::<1>(values, [pixels], device);
        let depth_m = render.depth_expected.iter().map(|&depth| m_from_iu(depth)).collect();
        views.push(RenderedView {
            side: target.side,
            size: [render.height, render.width],
            rgb: from_host(render.rgb, [pixels, 3], device).require_grad(),
            observed_rgb: from_host(target.rgb.clone(), [pixels, 3], device),
            depth_m: line(depth_m).require_grad(),
            observed_depth_m: line(target.depth_m.clone()),
            depth_valid: line(target.depth_valid.clone()),
            covered: line(target.covered.clone()),
            alpha: line(render.alpha).require_grad(),
        });
        tapes.push(tape);
    }
    let slice = time.slice;
    Ok((views, Rendered { slice, scene, tapes }))
}

/// Gradients of the objective in the Gaussians of one query time.
fn view_gradients(
    rendered: &Rendered<'_>,
    views: &[RenderedView],
    gradients: &TensorGradients,
) -> StageResult<Gradients> {
    let mut into = Gradients::zeros(&rendered.scene);
    for (view, tape) in views.iter().zip(&rendered.tapes) {
        let rgb = gradient_of(&view.rgb, gradients)?;
        let alpha = gradient_of(&view.alpha, gradients)?;
        let mut depth = gradient_of(&view.depth_m, gradients)?;
        // dL/d(internal units) from dL/d(metres).
        depth.iter_mut().for_each(|value| *value = m_from_iu(*value));
        let gradient = RenderGradient {
            rgb: &rgb,
            alpha: &alpha,
            depth_expected: &depth,
            ..RenderGradient::default()
        };
        backward_into(&rendered.scene, &RasterConfig::default(), tape, &gradient, &mut into).map_err(internal)?;
    }
    Ok(into)
}

/// Rendered displacements at all track pixels.
fn render_motion<'a>(
    field: &Field,
    targets: &[MotionTarget<'a>],
    correction: &Correction,
    params: &RefineParams,
    device: &Device,
) -> StageResult<(Option<RenderedMotion>, Vec<Rendered<'a>>)> {
    let (mut displacement, mut reference, mut stage1, mut rendered) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for target in targets {
        let mut scene = scene_at(field, correction, params.scale_residual, target.anchor.time)?;
        scene.extra.clone_from(&target.displacement_iu);
        scene.extra_channels = target.channels;
        let (render, tape) = render_with_tape(&scene, &target.camera, &RasterConfig::default()).map_err(internal)?;
        displacement.extend(
            target
                .samples
                .iter()
                .flat_map(|&sample| &render.extra[sample..sample + 3]),
        );
        reference.extend_from_slice(&target.reference_iu);
        stage1.extend_from_slice(&target.stage1_iu);
        rendered.push(Rendered {
            slice: target.anchor,
            scene,
            tapes: vec![tape],
        });
    }
    if displacement.is_empty() {
        return Ok((None, Vec::new()));
    }
    let rows = displacement.len() / 3;
    let table = |values: Vec<f32>| from_host::<2>(values, [rows, 3], device);
    let motion = RenderedMotion {
        displacement: table(displacement).require_grad(),
        reference: table(reference),
        stage1: table(stage1),
    };
    Ok((Some(motion), rendered))
}

/// Corrected centres of mesh-anchored Gaussians at all query times, and where their links take them.
fn robot_positions(
    field: &Field,
    times: &[TargetTime<'_>],
    correction: &Correction,
    device: &Device,
) -> Option<RobotPositions> {
    let (mut centre, mut reference) = (Vec::new(), Vec::new());
    for time in times {
        for &gaussian in &time.robot.gaussians {
            let gaussian = gaussian as usize;
            for axis in 0..3 {
                let place = 3 * gaussian + axis;
                let stage1 = field.position_m[place] + time.slice.displacement_m[place];
                centre.push(stage1 + correction.row(gaussian)[axis]);
            }
        }
        reference.extend_from_slice(&time.robot.reference_m);
    }
    let rows = centre.len() / 3;
    (rows > 0).then(|| RobotPositions {
        centre_m: from_host::<2>(centre, [rows, 3], device).require_grad(),
        reference_m: from_host(reference, [rows, 3], device),
    })
}

/// Gradient of a leaf on the host; empty (zeros) where the objective does not depend on it.
fn gradient_of<const D: usize>(tensor: &Tensor<D>, gradients: &TensorGradients) -> StageResult<Vec<f32>> {
    let found = tensor.grad(gradients).map(to_host).transpose().map_err(internal)?;
    Ok(found.unwrap_or_default())
}
