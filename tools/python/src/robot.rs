//! Kinematics of a robot described by a URDF.

use std::path::PathBuf;

use numpy::{PyArray1, PyArray4, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::error::said;

/// A robot.
#[pyclass(frozen, module = "rogs._rogs")]
pub(crate) struct RobotModel {
    model: rogs_robot::RobotModel,
}

#[pymethods]
impl RobotModel {
    #[new]
    #[pyo3(signature = (path, base_link=None))]
    fn new(path: PathBuf, base_link: Option<String>) -> PyResult<Self> {
        let model = rogs_robot::RobotModel::load(&path).map_err(said)?;
        let model = match base_link {
            Some(link) => model.with_base_link(&link).map_err(said)?,
            None => model,
        };
        Ok(Self { model })
    }

    #[getter]
    fn name(&self) -> String {
        self.model.name.clone()
    }

    #[getter]
    fn notes(&self) -> Vec<String> {
        self.model.notes.clone()
    }

    #[getter]
    fn link_names(&self) -> Vec<String> {
        self.model.link_names()
    }

    /// Joints that move by themselves: mimic joints follow theirs.
    #[getter]
    fn joint_names(&self) -> Vec<String> {
        let driven = self.model.driven_joints();
        driven.map(|joint| self.model.joints[joint].name.clone()).collect()
    }

    /// Poses of all links in the base link's frame, metres, for rows of joint values (radians, metres). `[T, L, 4, 4]`
    fn fk<'py>(
        &self,
        py: Python<'py>,
        joints: Vec<String>,
        values: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray4<f64>>> {
        let table = values.to_owned_array();
        let (rows, links) = (table.nrows(), self.model.links.len());
        if table.ncols() != joints.len() {
            return Err(pyo3::exceptions::PyValueError::new_err(format!(
                "{} values a row for {} joints",
                table.ncols(),
                joints.len()
            )));
        }
        let flat: Vec<f64> = table.into_iter().collect();
        let of = |row: usize| -> rogs_robot::Result<Vec<f64>> {
            let own = &flat[row * joints.len()..(row + 1) * joints.len()];
            let named = joints.iter().map(String::as_str).zip(own.iter().copied());
            let state = self.model.joint_state(named)?;
            Ok(self
                .model
                .fk(&state)
                .iter()
                .flat_map(|pose| pose.to_matrix4())
                .collect())
        };
        let poses = py.detach(|| {
            (0..rows)
                .into_par_iter()
                .map(of)
                .collect::<rogs_robot::Result<Vec<_>>>()
        });
        PyArray1::from_vec(py, poses.map_err(said)?.concat()).reshape([rows, links, 4, 4])
    }
}
