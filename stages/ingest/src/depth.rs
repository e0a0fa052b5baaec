//! Reference depth: metres in `.npy` or OpenEXR, or millimetres in 16-bit PNG.

use rogs_worker::StageResult;

use crate::checks::wrong;
use crate::exr_depth::read_exr;
use crate::images::{numbered, read_grey16};
use crate::npy::Npy;
use crate::source::SourceDepth;

impl SourceDepth {
    /// Hands the depth maps of these episode frames to `take` in order: metres, NaN where unknown. `[h, w]`
    pub(crate) fn read(
        &self,
        (first, step, count): (u32, u32, u32),
        frame_count: u32,
        (width, height): (u32, u32),
        mut take: impl FnMut(&[f32]),
    ) -> StageResult<()> {
        let (rows, columns) = (Some(u64::from(height)), Some(u64::from(width)));
        let frames = (0..count).map(|index| first + index * step);
        if self.path.is_file() {
            let mut array = Npy::open(&self.path)?;
            array.expect_shape(&[Some(u64::from(frame_count)), rows, columns])?;
            array.expect_floats()?;
            for frame in frames {
                take(&metres(array.entry(u64::from(frame))?));
            }
            return Ok(());
        }
        if !self.path.is_dir() {
            return Err(wrong(&self.path, "the depth file or folder is missing"));
        }
        for frame in frames {
            let array = self.path.join(numbered(frame, "npy"));
            let exr = self.path.join(numbered(frame, "exr"));
            if exr.exists() {
                take(&metres(read_exr(&exr, (width, height))?));
            } else if array.exists() {
                let mut array = Npy::open(&array)?;
                array.expect_shape(&[rows, columns])?;
                array.expect_floats()?;
                take(&metres(array.all()?));
            } else {
                let millimetres = read_grey16(&self.path.join(numbered(frame, "png")), (width, height))?;
                take(&metres(
                    millimetres.iter().map(|&value| f64::from(value) / 1000.0).collect(),
                ));
            }
        }
        Ok(())
    }
}

/// Unknown depth (NaN, infinite, 0 or less) becomes NaN.
fn metres(values: Vec<f64>) -> Vec<f32> {
    let one = |value: f64| {
        if value.is_finite() && value > 0.0 {
            value as f32
        } else {
            f32::NAN
        }
    };
    values.into_iter().map(one).collect()
}
