//! Tensors of others under our names.

use std::collections::BTreeMap;

use crate::{Error, ParameterSource, Result};

/// Tensors of a source under other names.
pub struct Renamed {
    source: Box<dyn ParameterSource>,
    /// Name in the source by our name.
    names: BTreeMap<String, String>,
}

impl Renamed {
    /// Gives every tensor of a source the name that `rename` makes of its own.
    #[must_use]
    pub fn new(source: Box<dyn ParameterSource>, rename: impl Fn(&str) -> String) -> Self {
        Self::chosen(source, |name| Some(rename(name)))
    }

    /// The tensors of a source that `rename` gives a name; the others are left aside.
    #[must_use]
    pub fn chosen(source: Box<dyn ParameterSource>, rename: impl Fn(&str) -> Option<String>) -> Self {
        let names = source.names().into_iter();
        let names = names.filter_map(|name| Some((rename(name)?, name.to_owned())));
        Self {
            names: names.collect(),
            source,
        }
    }

    /// Takes the tensors of a source out of the folders in which training programs keep them.
    #[must_use]
    pub fn without_folders(source: Box<dyn ParameterSource>) -> Self {
        Self::new(source, |name| strip_folders(name).to_owned())
    }
}

impl ParameterSource for Renamed {
    fn shape(&self, name: &str) -> Option<&[usize]> {
        self.source.shape(self.names.get(name)?)
    }

    fn values(&self, name: &str) -> Result<Vec<f32>> {
        let original = self
            .names
            .get(name)
            .ok_or_else(|| Error::MissingTensor { name: name.to_owned() })?;
        self.source.values(original)
    }

    fn names(&self) -> Vec<&str> {
        self.names.keys().map(String::as_str).collect()
    }
}

/// Removes the folders in which training programs keep their tensors.
fn strip_folders(name: &str) -> &str {
    const FOLDERS: [&str; 5] = ["state_dict.", "model.", "module.", "ema.", "_orig_mod."];
    let mut rest = name;
    while let Some(shorter) = FOLDERS.iter().find_map(|folder| rest.strip_prefix(folder)) {
        rest = shorter;
    }
    rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_of_training_programs_are_stripped() {
        assert_eq!(strip_folders("state_dict.module.backbone.norm"), "backbone.norm");
    }
}
