//! Gaussians at a time: as arrays, rendered, as PLY.

use std::path::PathBuf;

use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rogs_geometry::{Base, Camera, Pinhole, Pose, PosedCamera, Recon};
use rogs_schemas::Intrinsics;
use rogs_schemas::units::LengthUnit;
use rogs_splat::{Colour, RasterCamera, RasterConfig, render, sh};

use crate::error::said;

/// Gaussians, in the unit in which they are rendered.
#[pyclass(frozen, module = "rogs._rogs")]
pub(crate) struct Gaussians {
    inner: rogs_splat::Gaussians,
    unit: LengthUnit,
    recon_from_base: Pose<Recon, Base>,
    in_base: bool,
}

impl Gaussians {
    pub(crate) fn new(inner: rogs_splat::Gaussians, unit: LengthUnit, recon_from_base: Pose<Recon, Base>) -> Self {
        Self {
            inner,
            unit,
            recon_from_base,
            in_base: false,
        }
    }

    fn metres(&self, values: &[f32]) -> Vec<f32> {
        values.iter().map(|value| self.unit.to_m(*value)).collect()
    }
}

/// Values as rows.
fn rows<'py>(py: Python<'py>, values: Vec<f32>, width: usize) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let count = values.len() / width;
    PyArray1::from_vec(py, values).reshape([count, width])
}

#[pymethods]
impl Gaussians {
    /// Gaussians of arrays, metres; the world is their own frame.
    #[staticmethod]
    #[pyo3(signature = (means, quats, scales, opacities, rgb=None, sh=None))]
    fn from_arrays(
        means: PyReadonlyArray2<'_, f32>,
        quats: PyReadonlyArray2<'_, f32>,
        scales: PyReadonlyArray2<'_, f32>,
        opacities: PyReadonlyArray1<'_, f32>,
        rgb: Option<PyReadonlyArray2<'_, f32>>,
        sh: Option<PyReadonlyArray3<'_, f32>>,
    ) -> PyResult<Self> {
        let colour = match (rgb, sh) {
            (Some(rgb), None) => Colour::Rgb(rgb.to_owned_array().into_iter().collect()),
            (None, Some(sh)) => {
                let [_, count, _] = [sh.shape()[0], sh.shape()[1], sh.shape()[2]];
                let degree = (0..=sh::MAX_DEGREE).find(|degree| sh::coefficient_count(*degree) == count);
                let degree = degree.ok_or_else(|| {
                    PyValueError::new_err(format!("{count} harmonics: degrees 0 to 3 have 1, 4, 9 or 16"))
                })?;
                Colour::Sh {
                    degree,
                    coefficients: sh.to_owned_array().into_iter().collect(),
                }
            }
            _ => return Err(PyValueError::new_err("give either `rgb` or `sh`")),
        };
        let flat = |values: &PyReadonlyArray2<'_, f32>| values.to_owned_array().into_iter().collect::<Vec<f32>>();
        let inner = rogs_splat::Gaussians {
            means: flat(&means),
            quats: flat(&quats),
            scales: flat(&scales),
            opacities: opacities.to_owned_array().to_vec(),
            colour,
            extra: Vec::new(),
            extra_channels: 0,
        };
        inner.validate().map_err(said)?;
        Ok(Self::new(inner, LengthUnit::Metre, Pose::IDENTITY))
    }

    /// Gaussians of a 3DGS PLY file, plain or compressed; the world is that of the file.
    #[staticmethod]
    fn read_ply(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let scene = py.detach(|| rogs_field::read_ply_file(&path)).map_err(said)?;
        Ok(Self::new(scene.gaussians, LengthUnit::Metre, Pose::IDENTITY))
    }

    /// Writes a 3DGS PLY file, metres.
    fn write_ply(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let frame = if self.in_base { "base" } else { "recon_opencv" };
        let comments = [format!("frame {frame} unit m")];
        py.detach(|| {
            rogs_files::try_write_with(&path, |file| {
                rogs_field::write_ply(&self.inner, self.unit, &comments, file, &path)
            })
        })
        .map_err(said)
    }

    fn __len__(&self) -> usize {
        self.inner.len()
    }

    #[getter]
    fn frame(&self) -> &'static str {
        if self.in_base { "base" } else { "recon" }
    }

    #[getter]
    fn means<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        rows(py, self.metres(&self.inner.means), 3)
    }

    #[getter]
    fn scales<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        rows(py, self.metres(&self.inner.scales), 3)
    }

    #[getter]
    fn quats<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        rows(py, self.inner.quats.clone(), 4)
    }

    #[getter]
    fn opacities<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        PyArray1::from_vec(py, self.inner.opacities.clone())
    }

    /// Plain colours, or those that the harmonics of degree 0 are.
    #[getter]
    fn rgb<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let per = self.inner.colour.values_per_gaussian();
        let values = match &self.inner.colour {
            Colour::Rgb(rgb) => rgb.clone(),
            Colour::Sh { coefficients, .. } => {
                let constant = coefficients.chunks_exact(per).flat_map(|own| &own[..3]);
                constant.map(|value| sh::C0 * value + 0.5).collect()
            }
        };
        rows(py, values, 3)
    }

    /// Harmonics, coefficient by coefficient. `[N, K, 3]`
    #[getter]
    fn sh<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let n = self.inner.len();
        let (values, count) = match &self.inner.colour {
            Colour::Rgb(rgb) => (rgb.iter().map(|value| sh::coefficient_from_colour(*value)).collect(), 1),
            Colour::Sh { degree, coefficients } => (coefficients.clone(), sh::coefficient_count(*degree)),
        };
        PyArray1::from_vec(py, values).reshape([n, count, 3])
    }

    /// The same Gaussians in the frame of the robot's base.
    fn in_base(&self, py: Python<'_>) -> Self {
        if self.in_base {
            return self.clone_as(self.inner.clone());
        }
        let base_from_recon = self.recon_from_base.inverse().in_unit(self.unit);
        let moved = py.detach(|| self.inner.clone().moved(&base_from_recon.into()));
        Self {
            in_base: true,
            ..self.clone_as(moved)
        }
    }

    /// Those whose flag is set.
    fn kept(&self, keep: Vec<bool>) -> PyResult<Self> {
        if keep.len() != self.inner.len() {
            return Err(PyValueError::new_err(format!(
                "{} flags for {} Gaussians",
                keep.len(),
                self.inner.len()
            )));
        }
        Ok(self.clone_as(self.inner.kept(&keep)))
    }

    /// What a camera sees: `rgb` [H, W, 3], `alpha` [H, W], `depth` [H, W] in metres, `image` [H, W, 3] of bytes.
    fn render<'py>(
        &self,
        py: Python<'py>,
        size: (u32, u32),
        intrinsics: [f64; 4],
        pose: [f64; 16],
        frame: &str,
    ) -> PyResult<Bound<'py, PyDict>> {
        let [fx, fy, cx, cy] = intrinsics;
        let lens = Pinhole {
            intrinsics: Intrinsics { fx, fy, cx, cy },
            width: size.0,
            height: size.1,
        };
        let raster = match (frame, self.in_base) {
            ("base", true) => RasterCamera::new(&PosedCamera::<Base>::new(lens, of_matrix(&pose)?), self.unit),
            ("recon", false) => RasterCamera::new(&PosedCamera::<Recon>::new(lens, of_matrix(&pose)?), self.unit),
            ("base", false) => {
                let camera = PosedCamera::<Base>::new(lens, of_matrix(&pose)?);
                RasterCamera::new(&camera.in_frame(&self.recon_from_base), self.unit)
            }
            ("recon", true) => {
                let camera = PosedCamera::<Recon>::new(lens, of_matrix(&pose)?);
                RasterCamera::new(&camera.in_frame(&self.recon_from_base.inverse()), self.unit)
            }
            (other, _) => {
                return Err(PyValueError::new_err(format!(
                    "frame `{other}`: expected `base` or `recon`"
                )));
            }
        };
        raster.validate().map_err(said)?;
        let view = py
            .detach(|| render(&self.inner, &raster, &RasterConfig::default()))
            .map_err(said)?;
        let (height, width) = (view.height, view.width);
        let out = PyDict::new(py);
        let image = view.rgb_bytes();
        out.set_item("image", PyArray1::from_vec(py, image).reshape([height, width, 3])?)?;
        let depth = self.metres(&view.depth_expected);
        out.set_item("rgb", PyArray1::from_vec(py, view.rgb).reshape([height, width, 3])?)?;
        out.set_item("alpha", PyArray1::from_vec(py, view.alpha).reshape([height, width])?)?;
        out.set_item("depth", PyArray1::from_vec(py, depth).reshape([height, width])?)?;
        Ok(out)
    }
}

impl Gaussians {
    fn clone_as(&self, inner: rogs_splat::Gaussians) -> Self {
        Self {
            inner,
            unit: self.unit,
            recon_from_base: self.recon_from_base,
            in_base: self.in_base,
        }
    }
}

fn of_matrix<W: rogs_geometry::Frame>(flat: &[f64; 16]) -> PyResult<Pose<W, Camera>> {
    Pose::from_matrix4(flat).map_err(said)
}
