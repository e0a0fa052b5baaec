//! The compiled part of the Python package `rogs`; `tools/python/rogs` has the rest and what people see of it.

mod container;
mod error;
mod field;
mod gaussians;
mod metrics;
mod robot;

use pyo3::prelude::*;

/// Containers, fields, rendering, metrics and kinematics.
#[pymodule]
fn _rogs(module: &Bound<'_, PyModule>) -> PyResult<()> {
    error::register(module)?;
    module.add_class::<container::Container>()?;
    module.add_class::<field::FieldFile>()?;
    module.add_class::<gaussians::Gaussians>()?;
    module.add_class::<robot::RobotModel>()?;
    module.add_function(wrap_pyfunction!(metrics::psnr, module)?)?;
    module.add_function(wrap_pyfunction!(metrics::ssim, module)?)?;
    module.add_function(wrap_pyfunction!(metrics::depth_scores, module)?)?;
    module.add_function(wrap_pyfunction!(metrics::score_paths, module)?)?;
    Ok(())
}
