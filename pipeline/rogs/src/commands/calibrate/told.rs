//! What a calibration says: a table, or JSON.

use std::path::PathBuf;

use rogs_agreement::audit::Mount;
use rogs_calibration::{Fit, Refined};
use rogs_orchestrator::columns;
use schemars::JsonSchema;
use serde::Serialize;

use super::Args;
use super::camera::Calibrated;
use super::clips::Clips;

/// What is printed.
#[derive(Serialize, JsonSchema)]
pub(crate) struct Told {
    /// The file that was written.
    calibration: PathBuf,
    episodes: Vec<String>,
    /// Where the start comes from.
    start: String,
    /// Size of the images that pixels are of.
    image_size: (u32, u32),
    cameras: Vec<Camera>,
    seconds: f64,
}

#[derive(Serialize, JsonSchema)]
struct Camera {
    camera: String,
    /// `fixed` or `hand`.
    mount: &'static str,
    /// Why it could not be calibrated.
    why: Option<String>,
    /// Overlay of the pose that a search found, and of the best other one.
    searched: Option<Searched>,
    before: Option<Quality>,
    after: Option<Quality>,
    /// From the start, or from what a search found.
    correction: Option<Numbers>,
    /// Standard deviations.
    sigma: Option<Numbers>,
    frames: Option<usize>,
    matches: Option<usize>,
    picture: Option<PathBuf>,
}

#[derive(Serialize, JsonSchema)]
struct Searched {
    overlay: f64,
    other: Option<f64>,
}

#[derive(Serialize, JsonSchema)]
struct Quality {
    edge_px: f64,
    overlay: f64,
    epipolar_px: Option<f64>,
}

/// By unknown, in the camera's axes.
#[derive(Serialize, JsonSchema)]
struct Numbers {
    shift_mm: [f64; 3],
    turn_degrees: [f64; 3],
    focal_percent: f64,
    principal_px: [f64; 2],
    lag_frames: f64,
}

impl Quality {
    fn of(fit: &Fit) -> Self {
        Self {
            edge_px: fit.edge_px,
            overlay: fit.overlay,
            epipolar_px: fit.epipolar_px,
        }
    }
}

impl Numbers {
    fn of(vector: &[f64; 10], (width, height): (u32, u32)) -> Self {
        let [a, b, c, x, y, z, focal, column, row, lag_frames] = *vector;
        Self {
            shift_mm: [x, y, z].map(|metres| 1000.0 * metres),
            turn_degrees: [a, b, c].map(f64::to_degrees),
            focal_percent: 100.0 * focal,
            principal_px: [column * f64::from(width), row * f64::from(height)],
            lag_frames,
        }
    }

    fn shift(&self) -> f64 {
        length(self.shift_mm)
    }

    fn turn(&self) -> f64 {
        length(self.turn_degrees)
    }

    /// As standard deviations: whether the pose is known as well as a calibrated camera's should be.
    fn is_close(&self) -> bool {
        self.shift() <= 3.0 && self.turn() <= 0.3
    }
}

fn length(values: [f64; 3]) -> f64 {
    values.iter().map(|value| value * value).sum::<f64>().sqrt()
}

impl Told {
    pub(super) fn of(
        clips: &Clips,
        cameras: &[Calibrated],
        args: &Args,
        pictures: Vec<(String, PathBuf)>,
        seconds: f64,
    ) -> Self {
        let told = |camera: &Calibrated| {
            let refined: Option<&Refined> = camera.refined.as_ref().ok();
            Camera {
                camera: camera.name.clone(),
                mount: match camera.given {
                    Mount::Hand { .. } => "hand",
                    Mount::Fixed(_) | Mount::Path(_) => "fixed",
                },
                why: camera.refined.as_ref().err().map(ToString::to_string),
                searched: camera.searched.map(|(overlay, other)| Searched { overlay, other }),
                before: refined.map(|refined| Quality::of(&refined.before)),
                after: refined.map(|refined| Quality::of(&refined.after)),
                correction: refined.map(|refined| Numbers::of(&refined.correction.vector(), args.size)),
                sigma: refined.map(|refined| Numbers::of(&refined.sigma, args.size)),
                frames: refined.map(|refined| refined.frames),
                matches: refined.map(|refined| refined.matches),
                picture: pictures
                    .iter()
                    .find(|(name, _)| *name == camera.name)
                    .map(|(_, path)| path.clone()),
            }
        };
        Self {
            calibration: args.out.clone(),
            episodes: clips.episodes.clone(),
            start: clips.start.clone(),
            image_size: args.size,
            cameras: cameras.iter().map(told).collect(),
            seconds,
        }
    }

    /// The table, and where things are.
    pub(super) fn text(&self) -> String {
        let head = [
            "camera",
            "edges px",
            "overlay",
            "epipolar px",
            "shift mm",
            "turn deg",
            "focal %",
            "lag frames",
            "images",
        ];
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        for camera in &self.cameras {
            let (Some(before), Some(after), Some(correction), Some(sigma)) =
                (&camera.before, &camera.after, &camera.correction, &camera.sigma)
            else {
                rows.push(vec![camera.camera.clone(), "not calibrated".to_owned()]);
                continue;
            };
            let change = |before: f64, after: f64| format!("{before:.2} -> {after:.2}");
            let off = |value: f64, sigma: f64, digits: usize| {
                if sigma > 0.0 {
                    format!("{value:.digits$} +- {sigma:.digits$}")
                } else {
                    "-".to_owned()
                }
            };
            let epipolar = before.epipolar_px.zip(after.epipolar_px);
            rows.push(vec![
                camera.camera.clone(),
                change(before.edge_px, after.edge_px),
                change(before.overlay, after.overlay),
                epipolar.map_or_else(|| "-".to_owned(), |(before, after)| change(before, after)),
                off(correction.shift(), sigma.shift(), 1),
                off(correction.turn(), sigma.turn(), 2),
                off(correction.focal_percent, sigma.focal_percent, 2),
                off(correction.lag_frames, sigma.lag_frames, 2),
                camera.frames.unwrap_or_default().to_string(),
            ]);
        }
        let mut lines = columns(&rows);
        for camera in &self.cameras {
            if let Some(Searched { overlay, other }) = &camera.searched {
                let other = other.map_or_else(
                    || "no other one fits".to_owned(),
                    |other| format!("the next {other:.2}"),
                );
                lines.push(format!(
                    "{}: pose searched, overlay {overlay:.2}, {other}",
                    camera.camera
                ));
            }
            if let Some(sigma) = camera.sigma.as_ref().filter(|sigma| !sigma.is_close()) {
                lines.push(format!(
                    "{}: these images fix it to {:.1} mm and {:.2} degrees only; name more episodes (--episode), in which \
                     the robot goes further",
                    camera.camera,
                    sigma.shift(),
                    sigma.turn()
                ));
            }
            if let Some(path) = &camera.picture {
                lines.push(format!("{}: pictures in `{}`", camera.camera, path.display()));
            }
        }
        lines.push(format!(
            "calibration written to `{}` ({:.1} s)",
            self.calibration.display(),
            self.seconds
        ));
        lines.join("\n")
    }
}
