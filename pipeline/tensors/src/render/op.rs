//! Rendering as one operation of the backend, with the rasteriser's hand-written backward pass.

use std::fmt;
use std::sync::{Arc, OnceLock};

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients as Graph;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Flex, backend_extension};
use burn::tensor::TensorData;
use rogs_splat::{
    Colour, Counts, Gaussians, RasterCamera, RasterConfig, Render, RenderGradient, SplatError, Tape, backward_views,
    render_views, render_views_with_tape,
};

/// Inputs of the operation, in the order of its arguments: means, rotations, scales, opacities, colours, extra channels,
/// poses.
const INPUTS: usize = 7;

/// One call of the operation: what is not a tensor, and what the forward pass leaves behind.
pub(super) struct Call {
    /// The views, all of one size.
    pub(super) cameras: Vec<RasterCamera>,
    pub(super) config: RasterConfig,
    /// Degree of the harmonics; `None` for RGB.
    pub(super) degree: Option<usize>,
    /// 0 where the extra channels are a placeholder.
    pub(super) extra_channels: usize,
    /// Whether the poses are taken from the tensor.
    pub(super) poses: bool,
    outcome: OnceLock<Outcome>,
}

/// What the forward pass leaves behind.
struct Outcome {
    counts: Result<Vec<Counts>, SplatError>,
    saved: Option<Saved>,
}

/// What the backward pass needs.
struct Saved {
    gaussians: Gaussians,
    tapes: Vec<Tape>,
}

impl Call {
    pub(super) fn new(
        cameras: &[RasterCamera],
        config: &RasterConfig,
        degree: Option<usize>,
        extra_channels: usize,
        poses: bool,
    ) -> Self {
        Self {
            cameras: cameras.to_vec(),
            config: *config,
            degree,
            extra_channels,
            poses,
            outcome: OnceLock::new(),
        }
    }

    /// What became of the Gaussians in each view, after the forward pass.
    pub(super) fn counts(&self) -> Result<Vec<Counts>, String> {
        match self.outcome.get().map(|outcome| &outcome.counts) {
            Some(Ok(counts)) => Ok(counts.clone()),
            Some(Err(error)) => Err(error.to_string()),
            None => Err("the render was not run".to_owned()),
        }
    }

    fn pixels(&self) -> usize {
        self.cameras.first().map_or(0, RasterCamera::pixels)
    }

    /// Channels of a pixel in the packed result: colour, opacity, depth, extra channels.
    fn channels(&self) -> usize {
        5 + self.extra_channels
    }
}

impl fmt::Debug for Call {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Call")
            .field("views", &self.cameras.len())
            .finish_non_exhaustive()
    }
}

/// The packed result: `rgb [V, H, W, 3]`, then `alpha [V, H, W]`, expected depth `[V, H, W]`, normalised extra channels
/// `[V, H, W, E]`, one after the other.
#[backend_extension(Flex, Autodiff)]
pub(super) trait Rasterise: Backend {
    /// Renders all views of a call. `keep`: whether a backward pass will follow.
    fn rasterise(
        means: FloatTensor<Self>,
        rotations: FloatTensor<Self>,
        scales: FloatTensor<Self>,
        opacities: FloatTensor<Self>,
        colours: FloatTensor<Self>,
        extra: FloatTensor<Self>,
        poses: FloatTensor<Self>,
        call: Arc<Call>,
        keep: bool,
    ) -> FloatTensor<Self>;
}

/// Gradients of [`Rasterise`] on a backend that has them.
pub(super) trait RasteriseBackward: Backend {
    /// Gradients with respect to all inputs, in the order of the arguments; `None` for placeholders.
    fn gradients(gradient: FloatTensor<Self>, call: &Call) -> [Option<FloatTensor<Self>>; INPUTS];
}

type Host = FloatTensor<Flex>;

impl Rasterise for Flex {
    fn rasterise(
        means: Host,
        rotations: Host,
        scales: Host,
        opacities: Host,
        colours: Host,
        extra: Host,
        poses: Host,
        call: Arc<Call>,
        keep: bool,
    ) -> Host {
        let colours = values(&colours);
        let gaussians = Gaussians {
            means: values(&means),
            quats: values(&rotations),
            scales: values(&scales),
            opacities: values(&opacities),
            colour: match call.degree {
                None => Colour::Rgb(colours),
                Some(degree) => Colour::Sh {
                    degree,
                    coefficients: colours,
                },
            },
            extra: if call.extra_channels == 0 {
                Vec::new()
            } else {
                values(&extra)
            },
            extra_channels: call.extra_channels,
        };
        let mut cameras = call.cameras.clone();
        if call.poses {
            for (camera, pose) in cameras.iter_mut().zip(values(&poses).chunks_exact(12)) {
                camera.rotation = std::array::from_fn(|k| f64::from(pose[4 * (k / 3) + k % 3]));
                camera.translation = std::array::from_fn(|k| f64::from(pose[4 * k + 3]));
            }
        }
        let rendered = if keep {
            render_views_with_tape(&gaussians, &cameras, &call.config).map(|(renders, tapes)| (renders, Some(tapes)))
        } else {
            render_views(&gaussians, &cameras, &call.config).map(|renders| (renders, None))
        };
        let length = call.cameras.len() * call.pixels() * call.channels();
        let (packed, outcome) = match rendered {
            Ok((renders, tapes)) => (
                pack(&renders, length),
                Outcome {
                    counts: Ok(renders.iter().map(|render| render.counts).collect()),
                    saved: tapes.map(|tapes| Saved { gaussians, tapes }),
                },
            ),
            Err(error) => (
                vec![0.0; length],
                Outcome {
                    counts: Err(error),
                    saved: None,
                },
            ),
        };
        // A call is run once: it is made for this operation.
        let _ = call.outcome.set(outcome);
        host(packed, vec![length])
    }
}

fn pack(renders: &[Render], length: usize) -> Vec<f32> {
    let mut packed = Vec::with_capacity(length);
    let parts: [fn(&Render) -> &[f32]; 4] = [|r| &r.rgb, |r| &r.alpha, |r| &r.depth_expected, |r| &r.extra];
    for part in parts {
        renders.iter().for_each(|render| packed.extend_from_slice(part(render)));
    }
    packed
}

impl RasteriseBackward for Flex {
    fn gradients(gradient: Host, call: &Call) -> [Option<Host>; INPUTS] {
        let Some(Outcome {
            saved: Some(Saved { gaussians, tapes }),
            ..
        }) = call.outcome.get()
        else {
            // The forward pass failed, and its caller has been told.
            return [const { None }; INPUTS];
        };
        let gradient = values(&gradient);
        let (views, pixels) = (tapes.len(), call.pixels());
        let (rgb, rest) = gradient.split_at(views * pixels * 3);
        let (alpha, rest) = rest.split_at(views * pixels);
        let (depth, extra) = rest.split_at(views * pixels);
        let of = |all: &'_ [f32], view: usize, channels: usize| -> std::ops::Range<usize> {
            debug_assert_eq!(all.len(), views * pixels * channels);
            view * pixels * channels..(view + 1) * pixels * channels
        };
        let images: Vec<RenderGradient<'_>> = (0..views)
            .map(|view| RenderGradient {
                rgb: &rgb[of(rgb, view, 3)],
                alpha: &alpha[of(alpha, view, 1)],
                depth_expected: &depth[of(depth, view, 1)],
                extra: &extra[of(extra, view, call.extra_channels)],
                ..RenderGradient::default()
            })
            .collect();
        let (sums, poses) = backward_views(gaussians, &call.config, tapes, &images)
            .expect("scene, settings and image sizes are those of the forward pass, which accepted them");
        let count = gaussians.len();
        let colours = match call.degree {
            None => vec![count, 3],
            Some(degree) => vec![count, (degree + 1) * (degree + 1), 3],
        };
        let poses = call.poses.then(|| {
            let numbers = poses.iter().flat_map(|pose| {
                (0..12).map(|k| match k % 4 {
                    3 => pose.translation[k / 4],
                    column => pose.rotation[3 * (k / 4) + column],
                } as f32)
            });
            host(numbers.collect(), vec![views, 3, 4])
        });
        [
            Some(host(sums.means, vec![count, 3])),
            Some(host(sums.quats, vec![count, 4])),
            Some(host(sums.scales, vec![count, 3])),
            Some(host(sums.opacities, vec![count])),
            Some(host(sums.colour, colours)),
            (call.extra_channels > 0).then(|| host(sums.extra, vec![count, call.extra_channels])),
            poses,
        ]
    }
}

/// The backward pass of the autodiff graph.
#[derive(Debug)]
struct RasteriseStep;

impl<B: RasteriseBackward> Backward<B, INPUTS> for RasteriseStep {
    type State = Arc<Call>;

    fn backward(self, ops: Ops<Self::State, INPUTS>, graph: &mut Graph, _: &mut Checkpointer) {
        let gradient = graph.consume::<B>(&ops.node);
        let gradients = B::gradients(gradient, &ops.state);
        for (parent, gradient) in ops.parents.into_iter().zip(gradients) {
            if let (Some(parent), Some(gradient)) = (parent, gradient) {
                graph.register::<B>(parent.id, gradient);
            }
        }
    }
}

impl<B: Rasterise + RasteriseBackward, C: CheckpointStrategy> Rasterise for Autodiff<B, C> {
    fn rasterise(
        means: FloatTensor<Self>,
        rotations: FloatTensor<Self>,
        scales: FloatTensor<Self>,
        opacities: FloatTensor<Self>,
        colours: FloatTensor<Self>,
        extra: FloatTensor<Self>,
        poses: FloatTensor<Self>,
        call: Arc<Call>,
        keep: bool,
    ) -> FloatTensor<Self> {
        let inputs = [means, rotations, scales, opacities, colours, extra, poses];
        let nodes = inputs.each_ref().map(|input| input.node());
        let run = |keep: bool| {
            let [means, rotations, scales, opacities, colours, extra, poses] =
                inputs.map(|input| input.into_primitive());
            B::rasterise(
                means,
                rotations,
                scales,
                opacities,
                colours,
                extra,
                poses,
                Arc::clone(&call),
                keep,
            )
        };
        match RasteriseStep.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prepared) => {
                let image = run(true);
                prepared.finish(call, image)
            }
            OpsKind::UnTracked(prepared) => prepared.finish(run(keep)),
        }
    }
}

/// The values of a tensor, in row-major order.
fn values(tensor: &Host) -> Vec<f32> {
    tensor.to_contiguous().as_slice::<f32>().unwrap_or_default().to_vec()
}

fn host(values: Vec<f32>, shape: Vec<usize>) -> Host {
    Host::from_data(TensorData::new(values, shape))
}
