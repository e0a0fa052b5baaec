//! Where networks run: on the CPU, or (feature `gpu`) on a GPU through burn's wgpu backend.
//!
//! The kernels of this crate are for the CPU. On a GPU every part that takes tensors runs through
//! the operations of the framework, in f32, with gradients or without: Stage 1, and the updater of Stage 2. What is made of
//! host arrays stays on the CPU: the similarities of a plane sweep that records no gradients, the error encoder of Stage 2,
//! the neighbour search, the pooling of contributions.

use burn::tensor::Device;

use crate::{Error, Result};

/// Opens a device; on a GPU, networks share the adapter with the rasteriser.
///
/// # Errors
/// When this program was built without the feature `gpu`, or when there is no adapter.
pub fn open(device: rogs_schemas::Device) -> Result<Device> {
    match device {
        rogs_schemas::Device::Cpu => Ok(Device::flex()),
        rogs_schemas::Device::Gpu => graphics(),
    }
}

/// What [`open`] made a device of.
#[must_use]
pub fn kind(device: &Device) -> rogs_schemas::Device {
    if is_cpu(device) {
        rogs_schemas::Device::Cpu
    } else {
        rogs_schemas::Device::Gpu
    }
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
    fn devices_are_opened_and_told() {
        assert!(is_cpu(&open(rogs_schemas::Device::Cpu).unwrap()));
        assert!(is_cpu(&Device::flex().autodiff()));
        assert_eq!(kind(&Device::flex().autodiff()), rogs_schemas::Device::Cpu);
        if cfg!(not(feature = "gpu")) {
            let error = open(rogs_schemas::Device::Gpu).unwrap_err().to_string();
            assert!(error.contains("feature `gpu`"), "{error}");
        }
    }
}
