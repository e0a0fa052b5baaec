//! How the robot of the images follows the states over a clip (`docs/spec/agreement.md` section 8).

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::Result;
use crate::agreement::median;
use crate::measure::{EdgeSample, Settings, measure};
use crate::shift::{TOGETHER, TUKEY};
use crate::solve::{inverse, solve};
use crate::view::View;

/// Longest lag that is looked for, frames.
const LONGEST: i64 = 6;
/// Standard deviation of a lag before anything is measured, frames: where nothing moves the lag is not known.
const PRIOR_FRAMES: f64 = 4.0;
/// A lag is told when its standard deviation is below this, frames.
const TELLS_FRAMES: f64 = 0.6;
/// And when this share of the weighted edges agrees.
const AGREES: f64 = 0.4;
/// Fewer frames tell no lag and no drift.
const FEWEST_FRAMES: usize = 4;
/// Edges that fewer frames than this see are few.
const FEWEST_EDGES: usize = 60;

/// One frame of a camera that stands still or moves as its poses say, with the edges found near the drawn contours.
#[derive(Debug, Clone, Copy)]
pub struct MovedView<'a> {
    /// The image and the robot as it should look in it.
    pub view: View<'a>,
    /// Its edges, as [`agreement`](crate::agreement) found them.
    pub samples: &'a [EdgeSample],
}

/// What is known of lag and drift; each with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Following {
    /// Frames by which the robot of the images lags behind the states; `None` where its motion does not tell.
    pub lag_frames: Option<[f64; 2]>,
    /// How far the robot of the images has gone from the drawn one between the first and the last frame, beyond what the
    /// lag explains, metres across the line of sight.
    pub drift_m: Option<[f64; 2]>,
}

/// An edge as a linear equation in lag (frames), offset and drift (metres across the line of sight, right and down).
#[derive(Debug, Clone, Copy)]
struct Row {
    factors: [f64; 5],
    offset_px: f64,
    sigma_px: f64,
    weight: f64,
}

/// Solution of the equations.
#[derive(Debug, Clone, Copy)]
struct Fit {
    values: [f64; 5],
    covariance: [[f64; 5]; 5],
    /// Share of the weighted edges that lie within 1.5 px of where the fit has them.
    agreeing: f64,
}

/// Lag and drift of one camera over the frames of a clip, `None` for frames that do not tell. `[F]`
///
/// # Errors
/// When arrays and cameras of the views do not fit together.
pub fn follow(views: &[Option<MovedView<'_>>]) -> Result<Following> {
    let told = views.iter().flatten().count();
    if told < FEWEST_FRAMES {
        return Ok(Following::default());
    }
    let own: Vec<Row> = (0..views.len())
        .flat_map(|frame| views[frame].map_or_else(Vec::new, |moved| rows(views, frame, 0, moved.samples)))
        .collect();
    let Some(plain) = fit(&own) else {
        return Ok(Following::default());
    };
    let (mut best, mut shown) = (plain, 0);
    // A lag of a frame or more, or one that hides under the search: the robot is drawn as it was earlier and later.
    if plain.values[0].abs() > 0.6 || plain.agreeing < 0.5 {
        let others: Vec<Option<(i64, Fit)>> = (-LONGEST..=LONGEST)
            .into_par_iter()
            .filter(|delay| *delay != 0)
            .map(|delay| Ok(delayed(views, delay)?.map(|fit| (delay, fit))))
            .collect::<Result<_>>()?;
        for (delay, found) in others.into_iter().flatten() {
            let nearer = found.values[0].abs() < 1.0;
            if nearer && found.agreeing > 1.02 * best.agreeing {
                (best, shown) = (found, delay);
            }
        }
    }
    let [lag, _, _, x, y] = best.values;
    let sigma = |at: usize| best.covariance[at][at].max(0.0).sqrt();
    let lag_sigma = sigma(0);
    let drift = DVec2::new(x, y);
    // Along its direction; the larger one where there is none.
    let drift_sigma = drift.try_normalize().map_or_else(
        || sigma(3).max(sigma(4)),
        |along| {
            let c = &best.covariance;
            let variance =
                along.x * along.x * c[3][3] + 2.0 * along.x * along.y * c[3][4] + along.y * along.y * c[4][4];
            variance.max(0.0).sqrt()
        },
    );
    Ok(Following {
        lag_frames: (lag_sigma < TELLS_FRAMES && best.agreeing > AGREES).then_some([lag - shown as f64, lag_sigma]),
        drift_m: Some([drift.length(), drift_sigma]),
    })
}

/// The fit to images compared with the robot as it was drawn `delay` frames later.
fn delayed(views: &[Option<MovedView<'_>>], delay: i64) -> Result<Option<Fit>> {
    let settings = Settings {
        most_samples: 200,
        ..Settings::default()
    };
    let (mut all, mut told) = (Vec::new(), 0);
    for (frame, moved) in views.iter().enumerate() {
        let other = usize::try_from(frame as i64 + delay)
            .ok()
            .and_then(|other| *views.get(other)?);
        let (Some(moved), Some(other)) = (moved, other) else {
            continue;
        };
        let view = View {
            camera: other.view.camera,
            surface: other.view.surface,
            base_from_link: other.view.base_from_link,
            sensor_depth_m: None,
            ..moved.view
        };
        let measured = measure(&view, &settings)?;
        all.extend(rows(views, frame, delay, &measured.samples));
        told += 1;
    }
    Ok(if told < FEWEST_FRAMES { None } else { fit(&all) })
}

/// The equations of the edges of image `frame`, found near contours drawn `delay` frames later.
fn rows(views: &[Option<MovedView<'_>>], frame: usize, delay: i64, samples: &[EdgeSample]) -> Vec<Row> {
    let last = views.len().saturating_sub(1).max(1) as f64;
    let drawn = (frame as i64 + delay).max(0) as usize;
    let Some(here) = views[frame] else { return Vec::new() };
    // The frames before and after that the drawn one, for how fast its contours move.
    let near = |step: i64| {
        let at = usize::try_from(drawn as i64 + step).ok()?;
        views.get(at).copied().flatten().map(|moved| (at, moved.view))
    };
    let (before, after) = (near(-1).or_else(|| near(0)), near(1).or_else(|| near(0)));
    let (Some(before), Some(after)) = (before, after) else {
        return Vec::new();
    };
    let span = after.0 as f64 - before.0 as f64;
    let time = frame as f64 / last;
    let place = |view: &View<'_>, sample: &EdgeSample| -> Option<DVec2> {
        let base: DVec3 = view
            .base_from_link
            .get(usize::from(sample.link))?
            .point(sample.link_point);
        let camera = view.camera.world_from_camera.inverse().point(base);
        (camera.z > 1e-3).then(|| {
            let k = view.camera.lens.intrinsics;
            DVec2::new(k.fx * camera.x / camera.z + k.cx, k.fy * camera.y / camera.z + k.cy)
        })
    };
    let row = |sample: &EdgeSample| {
        let speed = if span > 0.0 {
            (place(&after.1, sample)? - place(&before.1, sample)?) / span
        } else {
            DVec2::ZERO
        };
        let k = here.view.camera.lens.intrinsics;
        let across = DVec2::new(sample.normal.x * k.fx, sample.normal.y * k.fy) / sample.depth_m.max(1e-3);
        Some(Row {
            // A robot that lags by one frame is where it was: the edge lies back along its motion.
            factors: [
                -sample.normal.dot(speed),
                across.x,
                across.y,
                time * across.x,
                time * across.y,
            ],
            offset_px: sample.offset_px,
            sigma_px: sample.sigma_px,
            weight: sample.weight,
        })
    };
    let used = samples.iter().filter(|sample| sample.weight > 0.05);
    used.filter_map(row).collect()
}

/// Iteratively reweighted least squares with Tukey's weights, from wide to narrow.
fn fit(rows: &[Row]) -> Option<Fit> {
    if rows.len() < FEWEST_EDGES {
        return None;
    }
    let mut values = [0.0; 5];
    let mut scale: f64 = 3.0;
    let mut covariance = None;
    for round in 0..12 {
        let mut matrix = [[0.0; 5]; 5];
        let mut right = [0.0; 5];
        for row in rows {
            let u = residual(row, &values) / (TUKEY * scale.hypot(row.sigma_px));
            let tukey = if u.abs() < 1.0 {
                (1.0 - u * u) * (1.0 - u * u)
            } else {
                0.0
            };
            let weight = row.weight * tukey / (row.sigma_px * row.sigma_px + scale * scale);
            for i in 0..5 {
                for j in 0..5 {
                    matrix[i][j] += weight * row.factors[i] * row.factors[j];
                }
                right[i] += weight * row.factors[i] * row.offset_px;
            }
        }
        matrix[0][0] += 1.0 / (PRIOR_FRAMES * PRIOR_FRAMES);
        for (i, row) in matrix.iter_mut().enumerate().skip(1) {
            // 0.3 m: nothing is farther off and still found.
            row[i] += 1.0 / (0.3 * 0.3);
        }
        values = solve(matrix, right)?;
        let mut residuals: Vec<f64> = rows.iter().map(|row| residual(row, &values).abs()).collect();
        residuals.retain(|own| *own < TUKEY * (scale + 0.5));
        if residuals.is_empty() {
            return None;
        }
        let narrowest = if round < 4 { 1.5 } else { 0.3 };
        scale = (1.4826 * median(&mut residuals)).clamp(narrowest, 3.0);
        covariance = inverse(&matrix);
    }
    let all: f64 = rows.iter().map(|row| row.weight).sum();
    let within = rows.iter().filter(|row| residual(row, &values).abs() < 1.5);
    Some(Fit {
        values,
        covariance: covariance?.map(|row| row.map(|value| value * TOGETHER)),
        agreeing: within.map(|row| row.weight).sum::<f64>() / all,
    })
}

fn residual(row: &Row, values: &[f64; 5]) -> f64 {
    let expected: f64 = row
        .factors
        .iter()
        .zip(values)
        .map(|(factor, value)| factor * value)
        .sum();
    row.offset_px - expected
}

/// Median distance of a link's edges from where they should be, along their normals: pixels, and metres at their depth for
/// a focal length in pixels. `None` where fewer than 6 are found.
#[must_use]
pub fn link_offsets(samples: &[EdgeSample], focal_px: f64, link: usize) -> Option<[f64; 2]> {
    let own = samples
        .iter()
        .filter(|sample| usize::from(sample.link) == link && sample.weight > 0.05);
    let (mut px, mut m): (Vec<f64>, Vec<f64>) = own
        .map(|sample| {
            (
                sample.offset_px.abs(),
                sample.offset_px.abs() * sample.depth_m / focal_px,
            )
        })
        .unzip();
    (px.len() >= 6).then(|| [median(&mut px), median(&mut m)])
}
