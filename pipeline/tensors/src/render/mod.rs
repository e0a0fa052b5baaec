//! Rendering of Gaussians inside the autodiff framework: images of several views whose losses train networks.
//!
//! [`render_views`] is one operation of the graph. Its gradients are the hand-written ones of `rogs_splat` (not those of
//! some tensor program), with respect to means, rotations, scales, opacities, colours or harmonics, extra channels and,
//! where they are asked for, the camera poses. Lengths are in the unit of the Gaussians: internal units in training.
//!
//! ```
//! use burn::tensor::{Device, Tensor};
//! use rogs_tensors::render::{ColourTensor, GaussianTensors, render_views};
//! use rogs_splat::{RasterCamera, RasterConfig};
//!
//! let device = Device::flex().autodiff();
//! let means = Tensor::<2>::from_floats([[0.0, 0.0, 2.0], [0.3, 0.1, 2.5]], &device).require_grad();
//! let gaussians = GaussianTensors {
//!     means: means.clone(),
//!     rotations: Tensor::from_floats([[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]], &device),
//!     scales: Tensor::full([2, 3], 0.2, &device),
//!     opacities: Tensor::from_floats([0.8, 0.6], &device),
//!     colours: ColourTensor::Rgb(Tensor::from_floats([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], &device)),
//!     extra: Some(Tensor::zeros([2, 3], &device)), // for example displacements; None for none
//! };
//! let camera = RasterCamera {
//!     width: 32,
//!     height: 24,
//!     fx: 30.0,
//!     fy: 30.0,
//!     cx: 16.0,
//!     cy: 12.0,
//!     rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
//!     translation: [0.0; 3],
//! };
//! let beside = RasterCamera { translation: [-0.2, 0.0, 0.0], ..camera };
//! let views = render_views(&gaussians, &[camera, beside], None, &RasterConfig::default())?;
//! assert_eq!(views.rgb.dims(), [2, 24, 32, 3]); // views, rows, columns, channels
//!
//! let loss = views.rgb.powi_scalar(2).mean() + views.depth.mean();
//! let gradients = loss.backward();
//! assert_eq!(means.grad(&gradients).unwrap().dims(), [2, 3]);
//! # Ok::<(), rogs_tensors::Error>(())
//! ```

mod op;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use burn::tensor::{DType, Device, Tensor};
use rogs_splat::{Counts, RasterCamera, RasterConfig};

use crate::differentiable::node::node;
use crate::{Error, Result};
use op::Call;

/// Gaussians as tensors, all f32 on the CPU. `N` of them.
#[derive(Debug, Clone)]
pub struct GaussianTensors {
    /// Centres. `[N, 3]`
    pub means: Tensor<2>,
    /// Quaternions (w, x, y, z), any length but zero: they are normalised inside. `[N, 4]`
    pub rotations: Tensor<2>,
    /// Standard deviations along the own axes, linear (after the activation). `[N, 3]`
    pub scales: Tensor<2>,
    /// Opacities in 0..1 (after the activation). `[N]`
    pub opacities: Tensor<1>,
    /// Colours.
    pub colours: ColourTensor,
    /// Further channels composited with the same weights, for example displacements. `[N, E]`
    pub extra: Option<Tensor<2>>,
}

/// Colours of Gaussians as a tensor.
#[derive(Debug, Clone)]
pub enum ColourTensor {
    /// Plain RGB, not clamped. `[N, 3]`
    Rgb(Tensor<2>),
    /// Real spherical harmonics of degree 0 to 3; the colour is `max(0, sum_k Y_k c_k + 0.5)`. `[N, (degree + 1)^2, 3]`
    Sh(Tensor<3>),
}

/// Rendered views; gradients pass through all tensors.
#[derive(Debug, Clone)]
pub struct RenderedViews {
    /// Colour over the background. `[V, H, W, 3]`
    pub rgb: Tensor<4>,
    /// Accumulated opacity. `[V, H, W]`
    pub alpha: Tensor<3>,
    /// Expected depth: camera z weighted by contribution, over the accumulated opacity; 0 where nothing is. `[V, H, W]`
    pub depth: Tensor<3>,
    /// Extra channels over the accumulated opacity (multiply by `alpha` for the accumulated ones). `[V, H, W, E]`
    pub extra: Option<Tensor<4>>,
    /// What became of the Gaussians in each view.
    pub counts: Vec<Counts>,
}

/// Renders several views of one size (call once per size where sizes differ).
///
/// `poses` are the views' `camera_from_world` matrices without their last row, in the unit of the Gaussians `[V, 3, 4]`;
/// where they are given they take the place of the cameras' poses and receive gradients, with respect to the twelve
/// numbers as if they were free. Gaussians with values that are not numbers are dropped and counted, and get zeros.
///
/// # Errors
/// When shapes, value types or devices do not fit, and when a camera or a setting makes no sense.
pub fn render_views(
    gaussians: &GaussianTensors,
    cameras: &[RasterCamera],
    poses: Option<&Tensor<3>>,
    config: &RasterConfig,
) -> Result<RenderedViews> {
    let GaussianTensors {
        means,
        rotations,
        scales,
        opacities,
        colours,
        extra,
    } = gaussians;
    let [count] = opacities.dims();
    check("means", means, [count, 3])?;
    check("rotations", rotations, [count, 4])?;
    check("scales", scales, [count, 3])?;
    check("opacities", opacities, [count])?;
    let degree = match colours {
        ColourTensor::Rgb(rgb) => {
            check("colours", rgb, [count, 3])?;
            None
        }
        ColourTensor::Sh(coefficients) => {
            let degree = match coefficients.dims()[1] {
                1 => 0,
                4 => 1,
                9 => 2,
                16 => 3,
                other => {
                    return Err(bad(format!(
                        "spherical harmonics have 1, 4, 9 or 16 coefficients (degree 0 to 3), these have {other}"
                    )));
                }
            };
            check("colours", coefficients, [count, (degree + 1) * (degree + 1), 3])?;
            Some(degree)
        }
    };
    let extra_channels = extra.as_ref().map_or(0, |extra| extra.dims()[1]);
    if let Some(extra) = extra {
        check("extra channels", extra, [count, extra_channels])?;
    }
    let Some(first) = cameras.first() else {
        return Err(bad("a render needs at least one camera".to_owned()));
    };
    for camera in cameras {
        camera.validate().map_err(|error| bad(error.to_string()))?;
        if (camera.width, camera.height) != (first.width, first.height) {
            return Err(bad(format!(
                "the cameras of one render have one size, these have {} x {} and {} x {}: render each size for itself",
                first.width, first.height, camera.width, camera.height
            )));
        }
    }
    config.validate().map_err(|error| bad(error.to_string()))?;
    if let Some(poses) = poses {
        check("poses", poses, [cameras.len(), 3, 4])?;
    }

    let device = means.device();
    let placeholder = || Tensor::<1>::zeros([1], &device).into_dispatch();
    let call = Arc::new(Call::new(cameras, config, degree, extra_channels, poses.is_some()));
    let inputs = [
        means.clone().into_dispatch(),
        rotations.clone().into_dispatch(),
        scales.clone().into_dispatch(),
        opacities.clone().into_dispatch(),
        match colours.clone() {
            ColourTensor::Rgb(rgb) => rgb.into_dispatch(),
            ColourTensor::Sh(coefficients) => coefficients.into_dispatch(),
        },
        match extra {
            Some(extra) if extra_channels > 0 => extra.clone().into_dispatch(),
            _ => placeholder(),
        },
        poses.map_or_else(placeholder, |poses| poses.clone().into_dispatch()),
    ];
    let packed: Tensor<1> = node(inputs, [call.len()], Arc::clone(&call) as Arc<_>);
    let counts = call.counts().map_err(bad)?;
    let (views, height, width) = (cameras.len(), first.height as usize, first.width as usize);
    let pixels = views * height * width;
    let part = |from: usize, channels: usize| packed.clone().narrow(0, from * pixels, channels * pixels);
    Ok(RenderedViews {
        rgb: part(0, 3).reshape([views, height, width, 3]),
        alpha: part(3, 1).reshape([views, height, width]),
        depth: part(4, 1).reshape([views, height, width]),
        extra: (extra_channels > 0).then(|| part(5, extra_channels).reshape([views, height, width, extra_channels])),
        counts,
    })
}

fn bad(what: String) -> Error {
    Error::BadInput(what)
}

fn check<const D: usize>(name: &str, tensor: &Tensor<D>, expected: [usize; D]) -> Result<()> {
    if tensor.dims() != expected {
        return Err(bad(format!(
            "the {name} of a render have shape {:?}, expected {expected:?}",
            tensor.dims()
        )));
    }
    if tensor.dtype() != DType::F32 {
        return Err(bad(format!(
            "the {name} of a render are {:?}, the rasteriser takes 32-bit floats: cast them",
            tensor.dtype()
        )));
    }
    if tensor.device().without_autodiff() != Device::flex() {
        return Err(bad(format!(
            "the {name} of a render are on another device: move them to the CPU"
        )));
    }
    Ok(())
}
