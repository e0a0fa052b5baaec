//! Rendering as one operation of the backend, with the rasteriser's hand-written backward pass.

use std::fmt;
use std::sync::OnceLock;

use rogs_splat::{
    Colour, Counts, Gaussians, RasterCamera, RasterConfig, Render, RenderGradient, SplatError, Tape, backward_views,
    render_views, render_views_with_tape,
};

use crate::differentiable::node::HostOperation;

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

    /// Numbers of the packed result.
    pub(super) fn len(&self) -> usize {
        self.cameras.len() * self.pixels() * self.channels()
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
/// `[V, H, W, E]`, one after the other. Zeros where rendering fails, which [`Call::counts`] tells.
impl HostOperation<INPUTS> for Call {
    fn forward(&self, inputs: [&[f32]; INPUTS]) -> Vec<f32> {
        self.render(inputs, false)
    }

    fn forward_kept(&self, inputs: [&[f32]; INPUTS]) -> Vec<f32> {
        self.render(inputs, true)
    }

    #[expect(clippy::expect_used, reason = "the forward pass accepted the same arguments")]
    fn backward(&self, gradient: &[f32], _: [&[f32]; INPUTS], _: [bool; INPUTS]) -> [Option<Vec<f32>>; INPUTS] {
        let Some(Outcome {
            saved: Some(Saved { gaussians, tapes }),
            ..
        }) = self.outcome.get()
        else {
            // The forward pass failed, and its caller has been told.
            return [const { None }; INPUTS];
        };
        let (views, pixels) = (tapes.len(), self.pixels());
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
                extra: &extra[of(extra, view, self.extra_channels)],
                ..RenderGradient::default()
            })
            .collect();
        let (sums, poses) = backward_views(gaussians, &self.config, tapes, &images)
            .expect("scene, settings and image sizes are those of the forward pass, which accepted them");
        let poses = self.poses.then(|| {
            let numbers = poses.iter().flat_map(|pose| {
                (0..12).map(|k| match k % 4 {
                    3 => pose.translation[k / 4],
                    column => pose.rotation[3 * (k / 4) + column],
                } as f32)
            });
            numbers.collect()
        });
        [
            Some(sums.means),
            Some(sums.quats),
            Some(sums.scales),
            Some(sums.opacities),
            Some(sums.colour),
            (self.extra_channels > 0).then_some(sums.extra),
            poses,
        ]
    }
}

impl Call {
    /// Renders all views. `keep`: whether a backward pass will follow.
    fn render(&self, inputs: [&[f32]; INPUTS], keep: bool) -> Vec<f32> {
        let [means, rotations, scales, opacities, colours, extra, poses] = inputs;
        let colours = colours.to_vec();
        let gaussians = Gaussians {
            means: means.to_vec(),
            quats: rotations.to_vec(),
            scales: scales.to_vec(),
            opacities: opacities.to_vec(),
            colour: match self.degree {
                None => Colour::Rgb(colours),
                Some(degree) => Colour::Sh {
                    degree,
                    coefficients: colours,
                },
            },
            extra: if self.extra_channels == 0 {
                Vec::new()
            } else {
                extra.to_vec()
            },
            extra_channels: self.extra_channels,
        };
        let mut cameras = self.cameras.clone();
        if self.poses {
            for (camera, pose) in cameras.iter_mut().zip(poses.chunks_exact(12)) {
                camera.rotation = std::array::from_fn(|k| f64::from(pose[4 * (k / 3) + k % 3]));
                camera.translation = std::array::from_fn(|k| f64::from(pose[4 * k + 3]));
            }
        }
        let rendered = if keep {
            render_views_with_tape(&gaussians, &cameras, &self.config).map(|(renders, tapes)| (renders, Some(tapes)))
        } else {
            render_views(&gaussians, &cameras, &self.config).map(|renders| (renders, None))
        };
        let (packed, outcome) = match rendered {
            Ok((renders, tapes)) => (
                pack(&renders, self.len()),
                Outcome {
                    counts: Ok(renders.iter().map(|render| render.counts).collect()),
                    saved: tapes.map(|tapes| Saved { gaussians, tapes }),
                },
            ),
            Err(error) => (
                vec![0.0; self.len()],
                Outcome {
                    counts: Err(error),
                    saved: None,
                },
            ),
        };
        // A call is run once: it is made for this operation.
        let _ = self.outcome.set(outcome);
        packed
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
