//! Reference depth: `.npy` or OpenEXR in metres, 16-bit PNG in millimetres, or what the episode says of their unit.

use std::path::Path;

use rogs_arrays::{Dtype, FlatExr, NpyFile};
use rogs_worker::StageResult;

use crate::fault::{unreadable, wrong};
use crate::images::{numbered, read_grey16, said};
use crate::pointworld::read_cached;
use crate::source::SourceDepth;

/// The channel of depth in OpenEXR files, as the format's own description names it.
const DEPTH_CHANNEL: &str = "Z";

/// Beyond this begins no range of depths of a robot's table, metres.
const NEAREST_M: f32 = 20.0;

impl SourceDepth {
    /// Hands the depth maps of these episode frames to `take` in order: metres, NaN where unknown. `[h, w]`, of the
    /// images' size (width, height), or of [`CachedDepth::size`](crate::source::CachedDepth::size). Returns what the first
    /// image that says something of its pixels says.
    pub(crate) fn read(
        &self,
        (first, step, count): (u32, u32, u32),
        frame_count: u32,
        (width, height): (u32, u32),
        mut take: impl FnMut(&[f32]),
    ) -> StageResult<Option<String>> {
        if self.range_m[0] >= NEAREST_M {
            let what = format!("its `range_m` begins at {} m", self.range_m[0]);
            return Err(wrong(&self.path, what).with_hint("`range_m` is metres; were these millimetres?"));
        }
        if let Some(cached) = &self.cached {
            read_cached(&self.path, cached, (first, step, count), take)?;
            return Ok(None);
        }
        let (rows, columns) = (height as usize, width as usize);
        let frames = (0..count).map(|index| first + index * step);
        if self.path.is_file() {
            let mut array = self.open(&self.path, &[frame_count as usize, rows, columns])?;
            for frame in frames {
                take(&metres(array.entry(frame as usize).map_err(unreadable)?, self.unit_m));
            }
            return Ok(None);
        }
        if !self.path.is_dir() {
            return Err(wrong(&self.path, "the depth file or folder is missing"));
        }
        let mut told = None;
        for frame in frames {
            let array = self.path.join(numbered(frame, "npy"));
            let exr = self.path.join(numbered(frame, "exr"));
            if exr.exists() {
                let (values, notes) = read_exr(&exr, (width, height))?;
                take(&metres(values, self.unit_m));
                told = told.or_else(|| said(&exr, &notes));
            } else if array.exists() {
                let mut array = self.open(&array, &[rows, columns])?;
                take(&metres(array.all().map_err(unreadable)?, self.unit_m));
            } else {
                let png = self.path.join(numbered(frame, "png"));
                let (steps, notes) = read_grey16(&png, (width, height))?;
                told = told.or_else(|| said(&png, &notes));
                // Division by 1000 rounds correctly, multiplication by 0.001 twice.
                let metre = |&step: &u16| match self.unit_m {
                    Some(unit) => f64::from(step) * unit,
                    None => f64::from(step) / 1000.0,
                };
                take(&metres(steps.iter().map(metre).collect(), None));
            }
        }
        Ok(told)
    }

    /// Whether some depth of a camera can be scored: in words, for a warning, where all of it lies outside of `near` to
    /// `far` metres.
    ///
    /// # Errors
    /// When another unit explains it.
    pub(crate) fn check_range(
        &self,
        depth_m: &[f32],
        [near, far]: [f32; 2],
        camera: &str,
    ) -> StageResult<Option<String>> {
        /// How much too large the numbers are, and what they are then, and what to do.
        const UNITS: [(f32, &str, &str); 2] = [
            (
                1000.0,
                "millimetres",
                "save metres, or say `unit_m` = 0.001 beside the `path` of the depth",
            ),
            (
                0.001,
                "metres",
                "save 16-bit PNG in millimetres, or say `unit_m` = 1.0 beside the `path` of the depth",
            ),
        ];
        let inside = |factor: f32| {
            let scored = |&&value: &&f32| value / factor > near && value / factor < far;
            depth_m.iter().filter(scored).count()
        };
        let known = depth_m.iter().filter(|value| value.is_finite()).count();
        if known == 0 || inside(1.0) > 0 {
            return Ok(None);
        }
        let text = format!("no depth of camera `{camera}` lies within {near} to {far} m");
        match UNITS.iter().find(|(factor, ..)| 2 * inside(*factor) > known) {
            Some((_, unit, hint)) => {
                Err(wrong(&self.path, format!("{text}; taken as {unit}, it does")).with_hint(*hint))
            }
            None => Ok(Some(format!("{text}: none of it is scored"))),
        }
    }

    /// A `.npy` file of depths: of this shape, perhaps with further axes of 1; floats, or integers whose unit is said.
    fn open(&self, path: &Path, shape: &[usize]) -> StageResult<NpyFile> {
        let array = NpyFile::open(path).map_err(unreadable)?;
        let long = |shape: &[usize]| shape.iter().copied().filter(|&length| length != 1).collect::<Vec<_>>();
        let (own, expected) = (long(array.shape()), long(shape));
        // The first axis stays that of the frames.
        if own != expected || (shape.len() == 3 && array.shape().first() != shape.first()) {
            let sorted = |mut lengths: Vec<usize>| {
                lengths.sort_unstable();
                lengths
            };
            let turned = sorted(own) == sorted(expected);
            return Err(match array.expect_shape(shape).map_err(unreadable) {
                Err(error) if turned => {
                    error.with_hint("its axes stand in another order; `numpy.transpose` turns them")
                }
                Err(error) => error,
                Ok(()) => wrong(path, "its axes are not those of depth"),
            });
        }
        let is_float = matches!(array.dtype(), Dtype::F16 | Dtype::F32 | Dtype::F64);
        if !is_float && self.unit_m.is_none() {
            let what = format!("the values are {:?}, and their unit is not known", array.dtype());
            return Err(wrong(path, what).with_hint(
                "save floats in metres, or say `unit_m` beside the `path` of the depth (0.001 for millimetres)",
            ));
        }
        Ok(array)
    }
}

/// The depth of an OpenEXR file of the expected size (width, height), metres, and what it says of its pixels. `[h, w]`
fn read_exr(path: &Path, (width, height): (u32, u32)) -> StageResult<(Vec<f64>, Vec<String>)> {
    let mut image = FlatExr::open(path).map_err(unreadable)?;
    if (image.width, image.height) != (width as usize, height as usize) {
        let what = format!(
            "the image is {}x{}, the episode says {width}x{height}",
            image.width, image.height
        );
        return Err(wrong(path, what));
    }
    let channel = depth_channel(&image).map_err(|what| wrong(path, what))?;
    let notes = std::mem::take(&mut image.notes);
    let planes = image.planes(&[channel]).map_err(unreadable)?;
    Ok((planes.into_iter().flatten().map(f64::from).collect(), notes))
}

/// The position of the depth channel.
fn depth_channel(image: &FlatExr) -> Result<usize, String> {
    let only = (image.channels.len() == 1).then_some(0);
    only.or_else(|| image.position(DEPTH_CHANNEL)).ok_or_else(|| {
        format!(
            "none of its channels ({}) is `{DEPTH_CHANNEL}`; name the depth so or save it alone",
            image.channels.join(", ")
        )
    })
}

/// Steps of a unit (`None`: metres) become metres; unknown depth (NaN, infinite, 0 or less) becomes NaN.
fn metres(values: Vec<f64>, unit_m: Option<f64>) -> Vec<f32> {
    let one = |value: f64| {
        let value = value * unit_m.unwrap_or(1.0);
        if value.is_finite() && value > 0.0 {
            value as f32
        } else {
            f32::NAN
        }
    };
    values.into_iter().map(one).collect()
}
