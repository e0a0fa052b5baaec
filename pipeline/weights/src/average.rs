//! Averaging checkpoints of one network: parts of a training that went different ways from the same start.

use std::path::{Path, PathBuf};

use super::header::ElementType;
use super::write::{TensorSource, write};
use super::{PROVENANCE, TensorFile};
use crate::ParameterSource;
use crate::{Error, Result};

/// Writes the weighted mean of checkpoints of one network: every tensor is the sum of `share * tensor` over the inputs, added
/// up in f64 in the order given. Shares are divided by their sum. Metadata other than the provenance must be the same in all
/// inputs, and is kept in the output; the provenance is the given one, or says what was averaged.
///
/// # Errors
/// When there are no inputs, a share is not a positive number, an input cannot be read or is of another network than the
/// first, or writing fails; nothing is written then.
pub fn average(inputs: &[(PathBuf, f64)], output: &Path, element: ElementType, provenance: Option<&str>) -> Result<()> {
    for (path, share) in inputs {
        if !(share.is_finite() && *share > 0.0) {
            return Err(Error::BadInput(format!(
                "the share of `{}` is {share}; give a positive number",
                path.display()
            )));
        }
    }
    let total: f64 = inputs.iter().map(|(_, share)| share).sum();
    let read = |(path, share): &(PathBuf, f64)| Ok((TensorFile::open(path)?, share / total));
    let files: Vec<(TensorFile, f64)> = inputs.iter().map(read).collect::<Result<_>>()?;
    let Some(((first, _), others)) = files.split_first() else {
        return Err(Error::BadInput("there is nothing to average".into()));
    };
    for (other, _) in others {
        same_network(first, other)?;
    }
    let said = |(file, share): &(TensorFile, f64)| {
        let of = file
            .metadata()
            .get(PROVENANCE)
            .map_or("unknown weights", String::as_str);
        format!("{share:.3} of ({of})")
    };
    let mut metadata = first.metadata().clone();
    let parts: Vec<String> = files.iter().map(said).collect();
    let provenance = provenance.map_or_else(|| format!("average: {}", parts.join(" + ")), str::to_owned);
    metadata.insert(PROVENANCE.to_owned(), provenance);
    let files = &files;
    let tensor = |name: &str| {
        let (shape, own) = (first.shape(name).unwrap_or_default().to_vec(), name.to_owned());
        TensorSource {
            name: name.to_owned(),
            shape,
            values: Box::new(move || mean(files, &own)),
        }
    };
    write(
        output,
        &metadata,
        element,
        first.names().into_iter().map(tensor).collect(),
    )
}

/// One tensor's mean.
fn mean(files: &[(TensorFile, f64)], name: &str) -> Result<Vec<f32>> {
    let mut sum: Vec<f64> = Vec::new();
    for (file, share) in files {
        let values = file.values(name)?;
        sum.resize(values.len(), 0.0);
        for (sum, value) in sum.iter_mut().zip(values) {
            *sum += share * f64::from(value);
        }
    }
    Ok(sum.into_iter().map(|value| value as f32).collect())
}

/// Refuses a file whose tensors (names, shapes) or whose metadata, other than the provenance, differ from those of the first.
fn same_network(first: &TensorFile, other: &TensorFile) -> Result<()> {
    let bad = |reason: String| Error::BadFile {
        path: other.path().to_owned(),
        reason: format!(
            "{reason} in `{}`; only weights of one network can be averaged",
            first.path().display()
        ),
    };
    if let Some(name) = first.names().into_iter().find(|name| other.shape(name).is_none()) {
        return Err(bad(format!("it lacks the tensor `{name}` that is")));
    }
    for name in other.names() {
        let (found, expected) = (other.shape(name), first.shape(name));
        if found != expected {
            return Err(match expected {
                Some(expected) => bad(format!(
                    "its tensor `{name}` has shape {:?}, not {expected:?} as",
                    found.unwrap_or_default()
                )),
                None => bad(format!("its tensor `{name}` is not")),
            });
        }
    }
    let keys = first.metadata().keys().chain(other.metadata().keys());
    for key in keys.filter(|key| *key != PROVENANCE) {
        if first.metadata().get(key) != other.metadata().get(key) {
            return Err(bad(format!("its metadata `{key}` is not what it is")));
        }
    }
    Ok(())
}
