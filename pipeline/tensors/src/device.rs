//! Where networks run: on the CPU, or (feature `gpu`) on a GPU through burn's wgpu backend.
//!
//! The kernels of this crate are for the CPU. On a GPU every part that takes tensors runs through
//! the operations of the framework, in f32, with gradients or without: Stage 1, and the updater of Stage 2. What is made of
//! host arrays stays on the CPU: the similarities of a plane sweep that records no gradients, the error encoder of Stage 2,
//! the neighbour search, the pooling of contributions.

use burn::tensor::Device;

use crate::{Error, Result};

/// Checks that a device has this name, whether or not this machine has it.
///
/// # Errors
/// When the name is neither `cpu` nor `gpu`.
pub fn check(name: &str) -> Result<()> {
    match name {
        "cpu" | "gpu" => Ok(()),
        _ => Err(Error::Device(format!("`device` must be `cpu` or `gpu`, not `{name}`"))),
    }
}

/// The device of a name: `cpu`, or `gpu` for the system's preferred graphics adapter, which networks share with the
/// rasteriser.
///
/// # Errors
/// When the name is another, when this program was built without the feature `gpu`, or when there is no adapter.
pub fn open(name: &str) -> Result<Device> {
    check(name)?;
    if name == "gpu" { graphics() } else { Ok(Device::flex()) }
}

/// The name of a device, as [`open`] takes it.
#[must_use]
pub fn name(device: &Device) -> &'static str {
    if is_cpu(device) { "cpu" } else { "gpu" }
}

/// Whether tensors of a device are those of the CPU, recording gradients or not.
#[must_use]
pub fn is_cpu(device: &Device) -> bool {
    *device == Device::flex()
}

#[cfg(feature = "gpu")]
fn graphics() -> Result<Device> {
    // The rasteriser opens the adapter and says what is wrong; the framework takes the same one lazily, and panics.
    rogs_splat::GpuDevice::open().map_err(|error| Error::Device(error.to_string()))?;
    Ok(Device::wgpu(burn::tensor::DeviceKind::DefaultDevice))
}

#[cfg(not(feature = "gpu"))]
fn graphics() -> Result<Device> {
    Err(Error::Device(
        "this program was built without GPU support; build it with the feature `gpu`, or choose the device `cpu`"
            .into(),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_told() {
        assert!(is_cpu(&open("cpu").unwrap()));
        assert!(is_cpu(&Device::flex().autodiff()));
        assert_eq!(name(&Device::flex().autodiff()), "cpu");
        let error = open("tpu").unwrap_err().to_string();
        assert!(error.contains("`cpu` or `gpu`, not `tpu`"), "{error}");
        if cfg!(not(feature = "gpu")) {
            let error = open("gpu").unwrap_err().to_string();
            assert!(error.contains("feature `gpu`"), "{error}");
        }
    }
}
