//! What others estimated from the images of a clip: metric depth, relative disparity and 2D tracks (`docs/sidecars.md`).
//!
//! A clip's folder has a folder for every source camera, named by its id, with `unidepth.npy` (metres, `[T, H, W]`),
//! `depth-anything.npy` (0 to 65535, `[T, H, W]`) and `tracks.npz`: an array for every query frame, named by its number,
//! `[N, T, 4]` of x and y (pixels, centres at integers), the logit of being hidden and the logit of a large error.

use std::path::Path;

use rogs_arrays::{ArrayFile, NpyFile};
use rogs_worker::{StageError, StageResult};

/// Metric depth as UniDepth gives it.
pub const METRIC: &str = "unidepth.npy";
/// Relative disparity as Depth Anything gives it, scaled per image to 0 to 65535.
pub const RELATIVE: &str = "depth-anything.npy";
/// Tracks as BootsTAPIR gives them.
pub const TRACKS: &str = "tracks.npz";
/// Grid of the points that are tracked, pixels.
pub const STRIDE: u32 = 4;
/// The largest relative disparity.
const LARGEST: f32 = 65_535.0;

/// The sidecars of one camera.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sidecars {
    /// Metric depth before any factor, metres. `[T]` of `[H, W]`
    pub metric_m: Vec<Vec<f32>>,
    /// Relative disparity, 0 to 1. `[T]` of `[H, W]`
    pub relative: Vec<Vec<f32>>,
    /// Tracks of the points of every query frame. `[T]` of `[N, T, 4]`
    pub tracks: Vec<Vec<f32>>,
}

/// Reads and checks the sidecars of a camera: `folder` is that of its clip, the images have `frames` frames of `size`
/// (height, width).
///
/// # Errors
/// When a file is missing, cannot be read, has another grid or number of frames, or holds what no estimator gives; with the
/// file and the clip.
pub fn read(folder: &Path, clip: &str, camera: &str, frames: usize, size: [usize; 2]) -> StageResult<Sidecars> {
    let place = folder.join(camera);
    let at = |name: &str| Place {
        path: place.join(name),
        clip,
    };
    let metric = at(METRIC);
    let metric_m = metric.maps(frames, size)?;
    for (frame, map) in metric_m.iter().enumerate() {
        if let Some(pixel) = map.iter().position(|depth| *depth <= 0.0) {
            return Err(metric.pixel(frame, pixel, size[1], map[pixel], "depths above 0, metres"));
        }
    }
    let relative_file = at(RELATIVE);
    let mut relative = relative_file.maps(frames, size)?;
    for (frame, map) in relative.iter_mut().enumerate() {
        if let Some(pixel) = map.iter().position(|value| !(0.0..=LARGEST).contains(value)) {
            return Err(relative_file.pixel(frame, pixel, size[1], map[pixel], "disparities from 0 to 65535"));
        }
        map.iter_mut().for_each(|value| *value /= LARGEST);
    }
    let tracks = at(TRACKS).tracks(frames, size)?;
    Ok(Sidecars {
        metric_m,
        relative,
        tracks,
    })
}

/// A file of a clip.
struct Place<'a> {
    path: std::path::PathBuf,
    clip: &'a str,
}

impl Place<'_> {
    /// An error that names file and clip.
    fn bad(&self, what: impl std::fmt::Display) -> StageError {
        StageError::bad_input(format!("clip `{}`: `{}`: {what}", self.clip, self.path.display()))
            .with_hint("docs/sidecars.md says what lies in it and how it is made")
    }

    fn pixel(&self, frame: usize, pixel: usize, width: usize, value: f32, expected: &str) -> StageError {
        let (row, column) = (pixel / width, pixel % width);
        self.bad(format!(
            "frame {frame}, row {row}, column {column} is {value}: expected {expected}"
        ))
    }

    /// The error of a file that is not there.
    fn present(&self) -> StageResult<()> {
        if self.path.is_file() {
            return Ok(());
        }
        Err(self.bad("it is not there"))
    }

    fn arrays(&self, error: rogs_arrays::Error) -> StageError {
        match error.problem {
            rogs_arrays::Problem::Io(error) => {
                StageError::io(format!("clip `{}`: `{}`: {error}", self.clip, self.path.display()))
            }
            problem => self.bad(problem),
        }
    }

    /// Maps of every frame, all of them finite. `[T]` of `[H, W]`
    fn maps(&self, frames: usize, [height, width]: [usize; 2]) -> StageResult<Vec<Vec<f32>>> {
        self.present()?;
        let mut file = NpyFile::open(&self.path).map_err(|error| self.arrays(error))?;
        if file.shape() != [frames, height, width] {
            return Err(self.bad(format!(
                "its shape is {:?}: expected [{frames}, {height}, {width}], the frames, rows and columns of the clip",
                file.shape()
            )));
        }
        (0..frames)
            .map(|frame| {
                let map = file.entry(frame).map_err(|error| self.arrays(error))?;
                let map: Vec<f32> = map.into_iter().map(|value| value as f32).collect();
                match map.iter().position(|value| !value.is_finite()) {
                    Some(pixel) => Err(self.pixel(frame, pixel, width, map[pixel], "finite numbers")),
                    None => Ok(map),
                }
            })
            .collect()
    }

    /// Tracks of every query frame.
    fn tracks(&self, frames: usize, [height, width]: [usize; 2]) -> StageResult<Vec<Vec<f32>>> {
        self.present()?;
        let file = ArrayFile::open(&self.path).map_err(|error| self.arrays(error))?;
        let grid = height.div_ceil(STRIDE as usize) * width.div_ceil(STRIDE as usize);
        let query = |query: usize| {
            let name = query.to_string();
            let array = file.need(&[&name]).map_err(|error| self.arrays(error))?;
            let [points, times, 4] = array.shape[..] else {
                return Err(self.bad(format!(
                    "array `{name}`: its shape is {:?}: expected [N, {frames}, 4]",
                    array.shape
                )));
            };
            if times != frames || points > grid {
                return Err(self.bad(format!(
                    "array `{name}`: its shape is {:?}: expected {frames} frames, and at most {grid} points of a grid of \
                     {STRIDE} pixels on {width}x{height}",
                    array.shape
                )));
            }
            let values = array.into_floats();
            for (number, point) in values.chunks_exact(4 * frames.max(1)).enumerate() {
                if let Some(at) = point.iter().position(|value| !value.is_finite()) {
                    let (frame, column) = (at / 4, at % 4);
                    return Err(self.bad(format!(
                        "array `{name}`: point {number}, frame {frame}, column {column} is {}",
                        point[at]
                    )));
                }
                let on = |place: f32, length: usize| {
                    place >= 0.0
                        && place < length as f32
                        && place.fract() == 0.0
                        && (place as u32).is_multiple_of(STRIDE)
                };
                let [x, y] = [point[4 * query], point[4 * query + 1]];
                if !(on(x, width) && on(y, height)) {
                    return Err(self.bad(format!(
                        "array `{name}`: point {number} begins at ({x}, {y}): expected a place on the grid of {STRIDE} pixels \
                         of an image of {width}x{height}"
                    )));
                }
            }
            Ok(values)
        };
        (0..frames).map(query).collect()
    }
}
