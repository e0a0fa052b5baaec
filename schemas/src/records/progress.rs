//! How far an optimisation has come: what a stage leaves beside its output, to resume from after a kill.

use super::check::{Check, count};
use super::field::{NamedArray, array_length};
use crate::ids::ClipId;

/// All that the next step of a computation depends on beside its inputs. It passes to no other stage: the one that wrote it
/// reads it again, for the same key, and takes it away with its output.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// The clip this belongs to.
    pub clip_id: ClipId,
    /// Counters by name.
    pub counters: Vec<(String, u64)>,
    /// Arrays by name.
    pub arrays: Vec<NamedArray>,
}

impl Progress {
    /// The value of a counter.
    #[must_use]
    pub fn counter(&self, name: &str) -> Option<u64> {
        self.counters
            .iter()
            .find(|(own, _)| own == name)
            .map(|(_, value)| *value)
    }

    /// The values of an array.
    #[must_use]
    pub fn array(&self, name: &str) -> Option<&[f32]> {
        self.arrays
            .iter()
            .find(|own| own.name == name)
            .map(|own| own.data.as_slice())
    }

    /// The arrays have the sizes of their shapes.
    ///
    /// # Errors
    /// Names the first that has not.
    pub fn check(&self) -> Check {
        self.arrays.iter().try_for_each(|array| {
            let length = array_length(&array.name, &array.shape)?;
            count(&format!("array `{}`", array.name), array.data.len(), length)
        })
    }
}
