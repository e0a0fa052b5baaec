//! Metrics, those of the scores: the same functions.

use std::path::PathBuf;

use numpy::{PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use rogs_score::metrics::{self, Pixels, RgbView, SsimVariant};

use crate::error::said;

/// An image that Python holds, copied into one row after the other.
enum Image {
    Bytes(Vec<u8>, [usize; 2]),
    Unit(Vec<f32>, [usize; 2]),
}

impl Image {
    fn of(value: &Bound<'_, PyAny>) -> PyResult<Self> {
        let side = |shape: &[usize]| {
            let rgb = shape[2] == 3;
            rgb.then_some([shape[0], shape[1]])
                .ok_or_else(|| PyValueError::new_err(format!("an image of {} channels: expected [H, W, 3]", shape[2])))
        };
        if let Ok(bytes) = value.extract::<PyReadonlyArray3<'_, u8>>() {
            let size = side(bytes.shape())?;
            return Ok(Self::Bytes(bytes.as_array().iter().copied().collect(), size));
        }
        if let Ok(floats) = value.extract::<PyReadonlyArray3<'_, f32>>() {
            let size = side(floats.shape())?;
            return Ok(Self::Unit(floats.as_array().iter().copied().collect(), size));
        }
        Err(PyTypeError::new_err(
            "expected an array [H, W, 3] of uint8, or of float32 in 0 to 1",
        ))
    }

    fn view(&self) -> PyResult<RgbView<'_>> {
        let (pixels, [height, width]) = match self {
            Self::Bytes(values, size) => (Pixels::Bytes(values), *size),
            Self::Unit(values, size) => (Pixels::Unit(values), *size),
        };
        RgbView::new(height, width, pixels).map_err(said)
    }
}

fn variant(name: &str) -> PyResult<SsimVariant> {
    let all = [
        SsimVariant::SkimageSampleCov,
        SsimVariant::Skimage,
        SsimVariant::Torchmetrics,
    ];
    let found = all.into_iter().find(|variant| variant.name() == name);
    found.ok_or_else(|| PyValueError::new_err(format!("variants are {}", all.map(SsimVariant::name).join(", "))))
}

#[pyfunction]
pub(crate) fn psnr(py: Python<'_>, prediction: &Bound<'_, PyAny>, reference: &Bound<'_, PyAny>) -> PyResult<f64> {
    let (own, other) = (Image::of(prediction)?, Image::of(reference)?);
    let (own, other) = (own.view()?, other.view()?);
    py.detach(|| metrics::psnr(&own, &other)).map_err(said)
}

#[pyfunction]
pub(crate) fn ssim(
    py: Python<'_>,
    prediction: &Bound<'_, PyAny>,
    reference: &Bound<'_, PyAny>,
    name: &str,
) -> PyResult<f64> {
    let (own, other, variant) = (Image::of(prediction)?, Image::of(reference)?, variant(name)?);
    let (own, other) = (own.view()?, other.view()?);
    py.detach(|| metrics::ssim(&own, &other, variant)).map_err(said)
}

/// AbsRel, RMSE (metres), delta1, pixels; none where no pixel counts.
#[pyfunction]
pub(crate) fn depth_scores(
    prediction: PyReadonlyArray2<'_, f32>,
    reference: PyReadonlyArray2<'_, f32>,
    near: f32,
    far: f32,
) -> PyResult<Option<(f64, f64, f64, u64)>> {
    if prediction.shape() != reference.shape() {
        return Err(PyValueError::new_err(format!(
            "a prediction of {:?} pixels for a reference of {:?}",
            prediction.shape(),
            reference.shape()
        )));
    }
    let prediction: Vec<f32> = prediction.as_array().iter().copied().collect();
    let reference: Vec<f32> = reference.as_array().iter().copied().collect();
    let support = metrics::depth_support(&reference, [near, far]);
    let scores = metrics::depth_scores(&prediction, &reference, &support, 1.0);
    Ok(scores.map(|scores| (scores.absrel, scores.rmse_m, scores.delta1, scores.count)))
}

/// Two files or two folders; JSON, as `rogs metrics --json` prints it. `units_m`: metres of one step of depth in the
/// prediction and in the reference.
#[pyfunction]
pub(crate) fn score_paths(
    py: Python<'_>,
    prediction: PathBuf,
    reference: PathBuf,
    name: &str,
    units_m: [Option<f64>; 2],
) -> PyResult<String> {
    let variant = variant(name)?;
    let scores = py.detach(|| rogs_score::folders::score_paths(&prediction, &reference, variant, None, units_m));
    serde_json::to_string(&scores.map_err(said)?).map_err(said)
}
