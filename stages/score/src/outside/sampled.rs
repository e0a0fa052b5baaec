//! Gaussians given at a list of clip frames: the plainest form of a moving field.

use rogs_arrays::{ANY, ArrayFile};
use rogs_schemas::FrameIndex;
use rogs_splat::{Colour, Gaussians};

use crate::outside::OutsideError;

/// Most Gaussians of one field.
const MAX_GAUSSIANS: usize = 1 << 27;

/// A field sampled at clip frames; row `n` is the same Gaussian at every time.
#[derive(Debug, Clone, PartialEq)]
pub struct SampledField {
    frames: Vec<FrameIndex>,
    count: usize,
    means: Vec<f32>,
    quats: Vec<f32>,
    scales: Vec<f32>,
    opacities: Vec<f32>,
    colours: Vec<f32>,
    /// Coefficients of spherical harmonics per Gaussian and channel; 0 for plain colours.
    harmonics: usize,
}

impl SampledField {
    /// Reads `frames [T]`, `means [T, N, 3]` and, constant (`[N, ...]`) or per time (`[T, N, ...]`), `quats` (w, x, y, z),
    /// `scales` (standard deviations), `opacities` in 0 to 1, and `rgb` in 0 to 1 or `sh [N, K, 3]` with K = 1, 4, 9, 16.
    ///
    /// # Errors
    /// When an array is missing or has another shape.
    pub fn read(file: &ArrayFile) -> Result<Self, OutsideError> {
        let path = file.path();
        let frames = frames(file)?;
        let means = file.need(&["means"])?;
        let count = means.shape.get(1).copied().unwrap_or(0);
        let times = frames.len();
        means.expect_shape(path, &[&[times, count, 3]])?;
        if count == 0 || count > MAX_GAUSSIANS {
            return Err(OutsideError::file(path, format!("it has {count} Gaussians")));
        }
        let each = |name: &str, width: usize| -> Result<Vec<f32>, OutsideError> {
            let array = file.need(&[name])?;
            match width {
                1 => array.expect_shape(path, &[&[count], &[times, count]])?,
                _ => array.expect_shape(path, &[&[count, width], &[times, count, width]])?,
            }
            Ok(array.into_floats())
        };
        let (colours, harmonics) = match file.find(&["rgb"])? {
            Some(rgb) => {
                rgb.expect_shape(path, &[&[count, 3], &[times, count, 3]])?;
                (rgb.into_colours(), 0)
            }
            None => {
                let sh = file.need(&["sh", "rgb"])?;
                let bands = sh.shape.iter().rev().nth(1).copied().unwrap_or(0);
                if ![1, 4, 9, 16].contains(&bands) {
                    let what = format!("`sh` has {bands} coefficients a channel, expected 1, 4, 9 or 16");
                    return Err(OutsideError::file(path, what));
                }
                sh.expect_shape(path, &[&[count, bands, 3], &[times, count, bands, 3]])?;
                (sh.into_floats(), bands)
            }
        };
        Ok(Self {
            means: means.into_floats(),
            quats: each("quats", 4)?,
            scales: each("scales", 3)?,
            opacities: each("opacities", 1)?,
            colours,
            harmonics,
            frames,
            count,
        })
    }

    /// All Gaussians at a clip frame.
    ///
    /// # Errors
    /// When the field does not have the frame.
    pub fn at(&self, frame: FrameIndex) -> Result<Gaussians, OutsideError> {
        let time = self.index(frame)?;
        let colours = self.slice(&self.colours, 3 * self.harmonics.max(1), time).to_vec();
        Ok(Gaussians {
            means: self.slice(&self.means, 3, time).to_vec(),
            quats: self.slice(&self.quats, 4, time).to_vec(),
            scales: self.slice(&self.scales, 3, time).to_vec(),
            opacities: self.slice(&self.opacities, 1, time).to_vec(),
            colour: match self.harmonics {
                0 => Colour::Rgb(colours),
                bands => Colour::Sh {
                    degree: bands.isqrt() - 1,
                    coefficients: colours,
                },
            },
            extra: Vec::new(),
            extra_channels: 0,
        })
    }

    /// Displacement of every Gaussian between two clip frames, in the field's lengths. `[N, 3]`
    ///
    /// # Errors
    /// When the field does not have a frame.
    pub fn displacement(&self, from: FrameIndex, to: FrameIndex) -> Result<Vec<f32>, OutsideError> {
        let from = self.slice(&self.means, 3, self.index(from)?);
        let to = self.slice(&self.means, 3, self.index(to)?);
        Ok(to.iter().zip(from).map(|(to, from)| to - from).collect())
    }

    fn index(&self, frame: FrameIndex) -> Result<usize, OutsideError> {
        let found = self.frames.iter().position(|&own| own == frame);
        found.ok_or_else(|| OutsideError::MissingFrame {
            frame,
            frames: self.frames.clone(),
        })
    }

    /// The part of a time of an array that is constant or has all times.
    fn slice<'a>(&self, values: &'a [f32], width: usize, time: usize) -> &'a [f32] {
        let one = self.count * width;
        if values.len() == one {
            values
        } else {
            &values[time * one..(time + 1) * one]
        }
    }
}

/// The array `frames`: clip frames, each once.
pub(crate) fn frames(file: &ArrayFile) -> Result<Vec<FrameIndex>, OutsideError> {
    let array = file.need(&["frames"])?;
    array.expect_shape(file.path(), &[&[ANY]])?;
    let frames: Vec<FrameIndex> = array
        .into_floats()
        .into_iter()
        .map(|frame| FrameIndex(frame as u32))
        .collect();
    let mut sorted = frames.clone();
    sorted.sort_unstable();
    sorted.dedup();
    if frames.is_empty() || sorted.len() != frames.len() {
        return Err(OutsideError::file(
            file.path(),
            "`frames` is empty or names a frame twice".to_owned(),
        ));
    }
    Ok(frames)
}
