//! Many views of one scene: rendered with tapes, and differentiated into one set of gradients.
//!
//! Forward, the views of a group share the part of the projection that no camera enters. Backward, they are taken one by
//! one, in their order: to keep the tile sums of several at once, so that a Gaussian's inputs and gradients are fetched
//! once, costs more in fresh memory than it saves.

use rayon::prelude::*;

use crate::backward::tile::Touched;
use crate::backward::{Gradients, Pass, RenderGradient, Tape, chain};
use crate::buffers::Pool;
use crate::camera::{RasterCamera, RasterConfig};
use crate::error::{Result, SplatError};
use crate::gaussians::Gaussians;
use crate::project::{CHUNK, for_each_view};
use crate::render::{Render, Work, check_views};
use crate::simd::dispatch;

/// Buffers for the rows of all tiles of a view, up to 256 MB each.
static ROWS: Pool<f32> = Pool::new(1 << 26);

/// Gradient of a loss with respect to the pose of one camera (`p_camera = R p_world + t`).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PoseGradient {
    /// With respect to the nine numbers of R, row-major, as if they were free.
    pub rotation: [f64; 9],
    /// With respect to t.
    pub translation: [f64; 3],
}

/// Renders several views of one scene and keeps what [`backward_views`] needs of each, in the order of the cameras. The
/// images are those of [`crate::render()`], bit for bit.
///
/// # Errors
/// As [`crate::render()`]; the first view with an error.
pub fn render_views_with_tape(
    gaussians: &Gaussians,
    cameras: &[RasterCamera],
    config: &RasterConfig,
) -> Result<(Vec<Render>, Vec<Tape>)> {
    let views = check_views(gaussians, cameras, config)?;
    let rendered = for_each_view(gaussians, &views, config, |_, view, projection| {
        let work = Work {
            gaussians,
            view,
            config,
            projection: &projection,
            eligible: &|_| false,
        };
        let tiles = work.tiles::<true, false>();
        let render = work.image(&tiles);
        let tape = Tape {
            view: *view,
            projection,
            tiles,
            gaussians: gaussians.len(),
            extra_channels: gaussians.extra_channels,
        };
        Ok((render, tape))
    })?;
    Ok(rendered.into_iter().unzip())
}

/// Gradients of a loss on several views: summed over the views in their order, the poses' each for itself (their sum is in
/// the camera fields of [`Gradients`]). `gaussians` and `config` must be those of the forward pass.
///
/// # Errors
/// When there is not one gradient image per view, or when these or the scene do not fit the forward pass.
pub fn backward_views(
    gaussians: &Gaussians,
    config: &RasterConfig,
    tapes: &[Tape],
    gradients: &[RenderGradient<'_>],
) -> Result<(Gradients, Vec<PoseGradient>)> {
    let mut sum = Gradients::zeros(gaussians);
    let poses = add(gaussians, config, tapes, gradients, true, &mut sum)?;
    Ok((sum, poses))
}

/// `fresh`: `into` holds zeros. Reading them would cost a page fault more than writing does.
pub(super) fn add(
    gaussians: &Gaussians,
    config: &RasterConfig,
    tapes: &[Tape],
    gradients: &[RenderGradient<'_>],
    fresh: bool,
    into: &mut Gradients,
) -> Result<Vec<PoseGradient>> {
    gaussians.validate()?;
    config.validate()?;
    SplatError::check("gradient images", gradients.len(), tapes.len(), "one per view")?;
    for (tape, gradient) in tapes.iter().zip(gradients) {
        gradient.validate(tape.view.width * tape.view.height, tape.extra_channels)?;
        let same = "as in the forward pass";
        SplatError::check("the scene of the backward pass", gaussians.len(), tape.gaussians, same)?;
        let (extra, expected) = (gaussians.extra_channels, tape.extra_channels);
        SplatError::check("the extra channels of the backward pass", extra, expected, same)?;
    }
    check_room(gaussians, into)?;
    let mut poses = Vec::with_capacity(tapes.len());
    for (index, (tape, gradient)) in tapes.iter().zip(gradients).enumerate() {
        let pass = Pass {
            gaussians,
            config,
            tape,
            gradient,
        };
        let touched: Vec<Touched> = tape.tiles.par_iter().map(Touched::new).collect();
        let lengths = touched.iter().map(|tile| tile.records.len() * pass.stride());
        let mut buffer = ROWS.take(lengths.clone().sum());
        let mut rest = &mut buffer[..];
        let rows: Vec<&mut [f32]> = lengths
            .map(|length| rest.split_off_mut(..length).unwrap_or_default())
            .collect();
        let backgrounds: Vec<[f64; 3]> = (tape.tiles.par_iter().zip(&touched).zip(rows))
            .map(|((tile, touched), rows)| pass.tile(tile, touched, rows))
            .collect();
        for background in &backgrounds {
            for k in 0..3 {
                into.background[k] += background[k];
            }
        }
        poses.push(gather(&pass, &touched, &buffer, fresh && index == 0, into));
    }
    for pose in &poses {
        for k in 0..9 {
            into.camera_rotation[k] += pose.rotation[k];
        }
        for k in 0..3 {
            into.camera_translation[k] += pose.translation[k];
        }
    }
    Ok(poses)
}

/// Checks that gradients have the sizes of the scene.
fn check_room(gaussians: &Gaussians, into: &Gradients) -> Result<()> {
    let check = |what, found: usize, expected: usize| SplatError::check(what, found, expected, "those of this scene");
    check("gradients of the means", into.means.len(), gaussians.means.len())?;
    check("gradients of the rotations", into.quats.len(), gaussians.quats.len())?;
    check("gradients of the scales", into.scales.len(), gaussians.scales.len())?;
    check("gradients of the opacities", into.opacities.len(), gaussians.len())?;
    let colours = gaussians.colour.values().len();
    check("gradients of the colours", into.colour.len(), colours)?;
    check(
        "gradients of the extra channels",
        into.extra.len(),
        gaussians.extra.len(),
    )?;
    if into.screen.is_empty() {
        return Ok(());
    }
    check(
        "gradients of the centres in the image",
        into.screen.len(),
        2 * gaussians.len(),
    )
}

/// Carries the tiles' sums through the projection, chunk by chunk.
fn gather(pass: &Pass<'_>, touched: &[Touched], rows: &[f32], fresh: bool, into: &mut Gradients) -> PoseGradient {
    let Pass {
        gaussians,
        config,
        tape,
        ..
    } = *pass;
    let channels = gaussians.extra_channels;
    let colours = gaussians.colour.values_per_gaussian();
    let screen = if into.screen.is_empty() { 0 } else { 2 };
    let cameras: Vec<chain::CameraGradient> = (into.means.par_chunks_mut(3 * CHUNK))
        .zip(into.quats.par_chunks_mut(4 * CHUNK))
        .zip(into.scales.par_chunks_mut(3 * CHUNK))
        .zip(into.opacities.par_chunks_mut(CHUNK))
        .zip(into.colour.par_chunks_mut(colours * CHUNK))
        .zip(chunks_or_empty(&mut into.extra, channels, tape.projection.chunks.len()))
        .zip(chunks_or_empty(&mut into.screen, screen, tape.projection.chunks.len()))
        .enumerate()
        .map_init(
            Vec::new,
            |sums, (chunk, ((((((means, quats), scales), opacities), colours), extra), screen))| {
                pass.sums(touched, rows, chunk, sums);
                let first = chunk * CHUNK;
                let visible = tape.projection.chunks[chunk].visible;
                let kernel = chain::Chain {
                    gaussians,
                    view: &tape.view,
                    config,
                    records: &tape.projection.records[first..first + visible],
                    sums,
                    first,
                    fresh,
                    rows: chain::Rows {
                        means,
                        quats,
                        scales,
                        opacities,
                        colours,
                        extra,
                        screen,
                    },
                };
                dispatch(config.simd, kernel)
            },
        )
        .collect();
    let mut pose = PoseGradient::default();
    for camera in &cameras {
        for k in 0..9 {
            pose.rotation[k] += camera.rotation[k];
        }
        for k in 0..3 {
            pose.translation[k] += camera.translation[k];
        }
        into.not_finite += camera.not_finite;
    }
    pose
}

/// Chunks of the extra channels; as many empty ones as there are chunks where there are no channels.
fn chunks_or_empty(values: &mut [f32], channels: usize, chunks: usize) -> Vec<&mut [f32]> {
    if channels == 0 {
        (0..chunks).map(|_| Default::default()).collect()
    } else {
        values.chunks_mut(channels * CHUNK).collect()
    }
}
