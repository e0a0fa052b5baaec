//! A camera as the files say, at all frames.

use rayon::prelude::*;
use rogs_robot::raster::Renderer;

use super::trial::{Supposed, Trials};
use crate::Result;
use crate::agreement::{Agreeing, Agreement, Why, agreement, median};
use crate::following::{Following, MovedView, follow};
use crate::measure::Settings;
use crate::view::{Surface, View};

/// Most frames that are looked at.
const MOST_FRAMES: usize = 17;

/// What was seen.
pub(super) struct Watched {
    /// Why it cannot be told, where that holds for most frames.
    pub why: Option<Why>,
    /// Offsets of the frames that tell: length, standard deviation, pixels, and the length in millimetres.
    pub offsets: Vec<[f64; 3]>,
    /// Median over frames of the median distance of edges from the contours, pixels.
    pub edges_px: f64,
    /// Lag in frames, drift in metres.
    pub following: Following,
}

/// Measures a camera at up to 17 frames, evenly from the first to the last.
///
/// # Errors
/// When arrays and camera do not fit together.
pub(super) fn watch(trials: &Trials<'_>, camera: usize, given: &Supposed) -> Result<Watched> {
    let count = trials.footage.frames();
    let stride = count.saturating_sub(1).div_ceil(MOST_FRAMES - 1).max(1);
    let frames: Vec<usize> = (0..count).step_by(stride).collect();
    let drawn: Vec<_> = frames
        .par_iter()
        .map_init(
            || Renderer::new(trials.footage.scene),
            |renderer, &frame| trials.draw(renderer, given, frame),
        )
        .collect();
    let views: Vec<Option<View<'_>>> = frames
        .iter()
        .zip(&drawn)
        .map(|(&frame, drawn)| {
            let drawn = drawn.as_ref()?;
            Some(View {
                rgb: trials.footage.cameras[camera].images[frame],
                camera: drawn.camera,
                surface: Surface::from(&drawn.image),
                base_from_link: drawn.links,
                sensor_depth_m: None,
            })
        })
        .collect();
    let told: Vec<Option<Agreement>> = views
        .par_iter()
        .map(|view| {
            view.as_ref()
                .map(|view| agreement(view, &Settings::default()))
                .transpose()
        })
        .collect::<Result<_>>()?;
    let found: Vec<Option<&Agreeing>> = told
        .iter()
        .map(|told| match told {
            Some(Agreement::Measured(found)) => Some(found),
            _ => None,
        })
        .collect();
    let moved: Vec<Option<MovedView<'_>>> = views
        .iter()
        .zip(&found)
        .map(|(view, found)| {
            Some(MovedView {
                view: (*view)?,
                samples: &(*found)?.samples,
            })
        })
        .collect();
    let mut following = follow(&moved)?;
    following.lag_frames = following.lag_frames.map(|lag| lag.map(|own| own * stride as f64));
    let mut edges: Vec<f64> = found
        .iter()
        .flatten()
        .map(|found| {
            let clear = found.samples.iter().filter(|sample| sample.weight > 0.05);
            median(&mut clear.map(|sample| sample.offset_px.abs()).collect::<Vec<f64>>())
        })
        .collect();
    let of_why = |why: Why| {
        told.iter()
            .filter(|told| **told == Some(Agreement::CannotTell { why }))
            .count()
    };
    let why = [Why::BlankImage, Why::HardlyVisible]
        .into_iter()
        .find(|&why| 2 * of_why(why) > frames.len());
    Ok(Watched {
        why,
        offsets: (found.iter().flatten())
            .map(|found| [found.offset_px[0], found.offset_px[1], found.offset_mm[0]])
            .collect(),
        edges_px: median(&mut edges),
        following,
    })
}
