//! Fields: their Gaussians at stored times, read time by time.

use std::path::PathBuf;
use std::sync::Mutex;

use numpy::{PyArray2, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use rogs_field::TimedField;
use rogs_geometry::Pose;
use rogs_r4c::read_refinement_of;
use rogs_schemas::records::field::Field;
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::units::LengthUnit;

use crate::error::{DamagedError, read, said};
use crate::gaussians::Gaussians;

/// A field, and the correction of Stage 2 where one is given.
#[pyclass(frozen, module = "rogs._rogs")]
pub(crate) struct FieldFile {
    file: rogs_r4c::FieldFile,
    path: PathBuf,
    refinement: Option<Refinement>,
    /// What was read so far: nothing, or the base with the slices that were asked for.
    read: Mutex<Option<Field>>,
}

#[pymethods]
impl FieldFile {
    #[new]
    #[pyo3(signature = (path, refinement=None))]
    fn new(path: PathBuf, refinement: Option<PathBuf>) -> PyResult<Self> {
        let file = rogs_r4c::FieldFile::open(&path).map_err(read)?;
        let refinement = match refinement {
            Some(path) => Some(read_refinement_of(&path, file.key()).map_err(read)?),
            None => None,
        };
        Ok(Self {
            file,
            path,
            refinement,
            read: Mutex::new(None),
        })
    }

    #[getter]
    fn times(&self) -> Vec<f64> {
        self.file.times().to_vec()
    }

    /// The Gaussians at a stored time.
    fn at(&self, py: Python<'_>, time: f64) -> PyResult<Gaussians> {
        py.detach(|| {
            self.with(&[time], |field| {
                let recon_from_base = Pose::from_rigid(&field.recon_from_base).map_err(said)?;
                let timed = self.timed(field)?;
                let gaussians = timed.gaussians(time).map_err(said)?;
                Ok(Gaussians::new(gaussians, LengthUnit::Internal, recon_from_base))
            })
        })
    }

    /// Displacements from a stored time to another, metres, reconstruction frame. `[N, 3]`
    fn displacement_m<'py>(&self, py: Python<'py>, since: f64, time: f64) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let values = py.detach(|| {
            self.with(&[since, time], |field| {
                let timed = TimedField::new(field).map_err(said)?;
                timed.displacement_m(since, time).map_err(said)
            })
        })?;
        let count = values.len() / 3;
        numpy::PyArray1::from_vec(py, values).reshape([count, 3])
    }
}

impl FieldFile {
    fn timed<'a>(&'a self, field: &'a Field) -> PyResult<TimedField<'a>> {
        let timed = TimedField::new(field).map_err(said)?;
        match &self.refinement {
            Some(refinement) => timed.with_refinement(refinement).map_err(said),
            None => Ok(timed),
        }
    }

    /// Sees that the slices of these times are there, and asks.
    fn with<T>(&self, times: &[f64], ask: impl FnOnce(&Field) -> PyResult<T>) -> PyResult<T> {
        let mut place = self.read.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let field = match &mut *place {
            Some(field) => field,
            empty => empty.insert(self.file.base().map_err(read)?),
        };
        for time in times {
            if field.slice_at(*time).is_some() {
                continue;
            }
            let stored = self.file.times();
            let Some(index) = stored.iter().position(|stored| stored == time) else {
                let stored: Vec<String> = stored.iter().map(ToString::to_string).collect();
                return Err(PyValueError::new_err(format!(
                    "`{}` stores no time {time} (stored: {})",
                    self.path.display(),
                    stored.join(", ")
                )));
            };
            let slice = self.file.slice(index).map_err(read)?;
            let at = field.slices.partition_point(|other| other.time < *time);
            field.slices.insert(at, slice);
            if let Err(what) = field.check() {
                field.slices.remove(at);
                return Err(DamagedError::new_err(format!("`{}`: {what}", self.path.display())));
            }
        }
        ask(field)
    }
}
