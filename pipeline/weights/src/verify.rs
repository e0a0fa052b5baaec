//! Comparing the tensors of a file with those a configuration has.

use std::collections::BTreeMap;
use std::path::Path;

use crate::{Error, ParameterSource, Result};

/// How the tensors of a file differ from those of a configuration.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Verification {
    /// Tensors that are as they should be.
    pub matching: usize,
    /// Needed, but not in the file.
    pub missing: Vec<String>,
    /// In the file, but not known to the configuration.
    pub unexpected: Vec<String>,
    /// Name, shape in the file, shape needed.
    pub misshapen: Vec<(String, Vec<usize>, Vec<usize>)>,
}

impl Verification {
    /// True when nothing is missing, unexpected or misshapen.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        self.missing.is_empty() && self.unexpected.is_empty() && self.misshapen.is_empty()
    }

    /// The differences in words, one line each, at most `limit` of a sort.
    #[must_use]
    pub fn lines(&self, limit: usize) -> Vec<String> {
        let mut lines = Vec::new();
        let mut list = |what: &str, names: Vec<String>| {
            lines.extend(names.iter().take(limit).map(|name| format!("{what}: {name}")));
            if names.len() > limit {
                lines.push(format!("{what}: and {} more", names.len() - limit));
            }
        };
        list("missing", self.missing.clone());
        list("unexpected", self.unexpected.clone());
        let wrong = |(name, found, expected): &(String, Vec<usize>, Vec<usize>)| {
            format!("{name} is {found:?}, expected {expected:?}")
        };
        list("wrong shape", self.misshapen.iter().map(wrong).collect());
        lines
    }

    /// An error that lists the differences, if there are any.
    ///
    /// # Errors
    /// When the verification is not clean.
    pub fn into_result(self, path: &Path) -> Result<()> {
        if self.is_clean() {
            return Ok(());
        }
        let reason = format!(
            "its tensors are not those of the configuration\n  {}",
            self.lines(8).join("\n  ")
        );
        Err(Error::BadFile {
            path: path.to_owned(),
            reason,
        })
    }
}

/// Compares the tensors of a source with expected names and shapes.
#[must_use]
pub fn verify(source: &dyn ParameterSource, expected: &BTreeMap<String, Vec<usize>>) -> Verification {
    let mut result = Verification::default();
    for (name, shape) in expected {
        match source.shape(name) {
            None => result.missing.push(name.clone()),
            Some(found) if found == shape.as_slice() => result.matching += 1,
            Some(found) => result.misshapen.push((name.clone(), found.to_vec(), shape.clone())),
        }
    }
    result.unexpected = source
        .names()
        .into_iter()
        .filter(|name| !expected.contains_key(*name))
        .map(str::to_owned)
        .collect();
    result
}
