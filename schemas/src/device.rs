//! Where networks and the rasteriser run.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::ids::did_you_mean;

/// A kind of device, as parameters and command lines name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(into = "&'static str", try_from = "String")]
pub enum Device {
    /// The CPU: `cpu`.
    #[default]
    Cpu,
    /// The system's preferred graphics adapter: `gpu`, in programs that were built with the feature `gpu`.
    Gpu,
}

impl Device {
    /// Every device.
    pub const ALL: [Self; 2] = [Self::Cpu, Self::Gpu];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Gpu => "gpu",
        }
    }
}

/// A name that no device has.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("invalid device `{name}`: expected `cpu` or `gpu`{}", .meant.map(|meant| format!("; did you mean `{meant}`?")).unwrap_or_default())]
pub struct UnknownDevice {
    /// The name.
    pub name: String,
    /// The device that was probably meant.
    pub meant: Option<&'static str>,
}

impl FromStr for Device {
    type Err = UnknownDevice;

    fn from_str(name: &str) -> Result<Self, UnknownDevice> {
        let known = Self::ALL.into_iter().find(|device| device.name() == name);
        known.ok_or_else(|| UnknownDevice {
            name: name.to_owned(),
            meant: did_you_mean(name, Self::ALL.map(Self::name)),
        })
    }
}

impl TryFrom<String> for Device {
    type Error = UnknownDevice;

    fn try_from(name: String) -> Result<Self, UnknownDevice> {
        name.parse()
    }
}

impl From<Device> for &'static str {
    fn from(device: Device) -> Self {
        device.name()
    }
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A string, one of the names.
impl schemars::JsonSchema for Device {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Device".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({"type": "string", "enum": Self::ALL.map(Self::name)})
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_are_the_strings_that_people_write() {
        for device in Device::ALL {
            let text = serde_json::to_string(&device).unwrap();
            assert_eq!(text, format!("\"{device}\""));
            assert_eq!(serde_json::from_str::<Device>(&text).unwrap(), device);
        }
        let error = |name: &str| name.parse::<Device>().unwrap_err().to_string();
        assert_eq!(error("tpu"), "invalid device `tpu`: expected `cpu` or `gpu`");
        assert_eq!(
            error("GPU"),
            "invalid device `GPU`: expected `cpu` or `gpu`; did you mean `gpu`?"
        );
        assert_eq!(error("cuda:0"), "invalid device `cuda:0`: expected `cpu` or `gpu`");
        let error = serde_json::from_str::<Device>("\"gup\"").unwrap_err().to_string();
        assert!(error.contains("did you mean `gpu`?"), "{error}");
    }
}
