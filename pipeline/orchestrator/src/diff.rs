//! Comparing two runs, or two files, by content.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use rogs_r4c::{FileHeader, read_header};
use schemars::JsonSchema;
use serde::Serialize;

use crate::error::{Error, Result, io};
use crate::exit::Exit;
use crate::plan::PLAN_FILE;

/// How two runs differ.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Difference {
    /// Outputs with the same content on both sides.
    pub same: usize,
    /// Outputs of the first only.
    pub only_a: Vec<PathBuf>,
    /// Outputs of the second only.
    pub only_b: Vec<PathBuf>,
    /// Outputs whose content differs.
    pub different: Vec<DifferentOutput>,
}

/// One output that differs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub struct DifferentOutput {
    /// The file, relative to both run folders.
    pub output: PathBuf,
    /// What differs: schema, parameters, inputs, content.
    pub what: Vec<String>,
}

/// Compares two run folders, or two container files, by what is in them and not by how it is stored.
///
/// # Errors
/// When one of them cannot be read.
pub fn diff(a: &Path, b: &Path) -> Result<Difference> {
    let (in_a, in_b) = (outputs(a)?, outputs(b)?);
    let only = |x: &BTreeMap<PathBuf, PathBuf>, y: &BTreeMap<PathBuf, PathBuf>| {
        x.keys()
            .filter(|name| !y.contains_key(*name))
            .cloned()
            .collect::<Vec<_>>()
    };
    let both: Vec<_> = in_a
        .iter()
        .filter_map(|(name, path)| Some((name, path, in_b.get(name)?)))
        .collect();
    let compared: Vec<DifferentOutput> = both
        .par_iter()
        .map(|(name, a, b)| DifferentOutput {
            output: (*name).clone(),
            what: compare(a, b),
        })
        .collect();
    let (different, same): (Vec<_>, Vec<_>) = compared.into_iter().partition(|output| !output.what.is_empty());
    Ok(Difference {
        same: same.len(),
        only_a: only(&in_a, &in_b),
        only_b: only(&in_b, &in_a),
        different,
    })
}

/// Container files by their names below `clips`; a single file under an empty name.
fn outputs(path: &Path) -> Result<BTreeMap<PathBuf, PathBuf>> {
    if path.is_file() {
        return Ok(BTreeMap::from([(PathBuf::new(), path.to_owned())]));
    }
    let clips = path.join("clips");
    if !clips.is_dir() {
        if path.join(PLAN_FILE).is_file() {
            // Planned, and nothing made yet.
            return Ok(BTreeMap::new());
        }
        return Err(Error::usage(format!(
            "`{}` is neither a run folder nor a file",
            path.display()
        )));
    }
    let mut found = BTreeMap::new();
    let mut folders = vec![clips];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder)
            .map_err(io("cannot list", &folder))?
            .flatten()
        {
            let file = entry.path();
            if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                folders.push(file);
            } else if file.extension().is_some_and(|extension| extension == "r4c") {
                found.insert(file.strip_prefix(path).unwrap_or(&file).to_owned(), file);
            }
        }
    }
    Ok(found)
}

fn compare(a: &Path, b: &Path) -> Vec<String> {
    let (a, b) = match (read_header(a), read_header(b)) {
        (Ok(a), Ok(b)) => (a, b),
        (Err(error), _) | (_, Err(error)) => return vec![Error::from(error).to_string()],
    };
    let mut what = Vec::new();
    let mut note = |name: &str, differs: bool| {
        if differs {
            what.push(name.to_owned());
        }
    };
    let material = |header: &FileHeader| header.info.provenance.material.clone();
    let (made_a, made_b) = (material(&a), material(&b));
    note("schema", a.schema != b.schema || a.version != b.version);
    note("stage version", made_a.stage_version != made_b.stage_version);
    note("parameters", made_a.params != made_b.params);
    note("inputs", made_a.inputs != made_b.inputs);
    note("content", a.info.content != b.info.content);
    what
}

impl Difference {
    /// Done when nothing differs.
    #[must_use]
    pub fn exit(&self) -> Exit {
        let equal = self.only_a.is_empty() && self.only_b.is_empty() && self.different.is_empty();
        if equal { Exit::Done } else { Exit::Failed }
    }
}
