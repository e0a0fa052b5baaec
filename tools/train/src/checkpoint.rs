//! What a run leaves in its folder, and how it resumes there.
//!
//! | file | content |
//! |---|---|
//! | `settings.toml` | the settings; a folder belongs to one run |
//! | `state.safetensors` | parameters, moments and number of updates: everything the next update depends on |
//! | `metrics.jsonl` | one line an update or evaluation; the same bytes whether or not the run was interrupted |
//! | `time.jsonl` | seconds of training at each evaluation |
//! | `model.safetensors` | the network as `rogs` reads it |
//! | `samples/` | renders of a held-out clip |
//! | `report.html` | curves and samples |

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use rogs_tensors::optimiser::Moments;
use rogs_tensors::parameters::Parameters;
use rogs_weights::ParameterSource;
use rogs_weights::{ElementType, TensorFile, TensorSource, write};
use serde::Serialize;

use crate::error::{Error, Result};

/// Metadata key of a state: updates done.
const STEP: &str = "rogs.train.step";
/// Metadata key of a state: settings it belongs to.
const SETTINGS: &str = "rogs.train.settings";

/// The folder of a run.
#[derive(Debug, Clone)]
pub struct RunFolder {
    root: PathBuf,
    /// Fingerprint of the settings.
    settings: String,
}

/// What the next update of a run depends on, besides its settings.
pub struct State<'a> {
    /// Parameters of the network.
    pub parameters: &'a mut Parameters,
    /// Moments of the optimiser.
    pub moments: &'a mut Moments,
    /// Updates done.
    pub step: &'a mut u64,
}

impl RunFolder {
    /// Opens or makes the folder of a run and checks that it belongs to these settings.
    ///
    /// # Errors
    /// When it cannot be written or belongs to other settings.
    pub fn open(root: &Path, settings: &impl Serialize) -> Result<Self> {
        let folder = Self {
            root: root.to_owned(),
            settings: fingerprint(settings),
        };
        let samples = folder.path("samples");
        fs::create_dir_all(&samples).map_err(Error::io(&samples))?;
        let path = folder.path("settings.toml");
        let text = toml::to_string(settings).map_err(|error| Error::Configuration {
            path: path.clone(),
            reason: error.to_string(),
        })?;
        if path.exists() {
            let known = fs::read_to_string(&path).map_err(Error::io(&path))?;
            if known != text {
                return Err(Error::Folder {
                    path,
                    reason: "the folder belongs to a run with other settings; give another folder with `--out`, \
                             or give this file as the settings to resume"
                        .into(),
                });
            }
        } else {
            rogs_files::write_bytes(&path, text.as_bytes())?;
        }
        Ok(folder)
    }

    /// A file of the folder.
    #[must_use]
    pub fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// Brings a run to where the folder's state is; leaves it alone when there is none. Returns the number of parameters
    /// that the state held.
    ///
    /// # Errors
    /// When the state cannot be read or is not one of this run.
    pub fn resume(&self, run: State<'_>) -> Result<usize> {
        let path = self.path("state.safetensors");
        let mut restored = 0;
        if !path.exists() {
            self.keep_metrics_before(0)?;
            return Ok(restored);
        }
        let file = TensorFile::open(&path)?;
        let bad = |reason: &str| Error::Folder {
            path: path.clone(),
            reason: format!("{reason}; delete the file to start again"),
        };
        let metadata = file.metadata();
        let step = metadata.get(STEP).and_then(|step| step.parse().ok());
        let step: u64 = step.ok_or_else(|| bad("the state does not say after which update it was written"))?;
        if metadata.get(SETTINGS) != Some(&self.settings) {
            return Err(bad("the state belongs to other settings"));
        }
        let names: Vec<String> = file.names().into_iter().map(str::to_owned).collect();
        for name in names {
            let (kind, parameter) = name.split_once('/').ok_or_else(|| bad("a tensor has no kind"))?;
            let shape = file.shape(&name).map(<[usize]>::to_vec).unwrap_or_default();
            let values = file.values(&name)?;
            if run.parameters.shape(parameter) != Some(&shape) {
                return Err(bad("a tensor is not one of this network"));
            }
            let moment = match kind {
                "value" => {
                    run.parameters.insert(parameter, &shape, values)?;
                    restored += 1;
                    continue;
                }
                "first" => 0,
                "second" => 1,
                _ => return Err(bad("a tensor is of an unknown kind")),
            };
            run.moments.by_name.entry(parameter.to_owned()).or_default()[moment] = values;
        }
        *run.step = step;
        self.keep_metrics_before(step)?;
        Ok(restored)
    }

    /// Writes the state of a run; the old one stays whole until the new one is. Parameters that are read from the
    /// checkpoint that the run started from are not in it.
    ///
    /// # Errors
    /// When writing fails.
    pub fn save(&self, parameters: &Parameters, moments: &Moments, step: u64) -> Result<()> {
        let mut tensors = Vec::new();
        for (name, parameter) in parameters.memory() {
            let shape = parameter.shape.clone();
            let mut add = |kind: &str, values: Vec<f32>| {
                tensors.push(TensorSource {
                    name: format!("{kind}/{name}"),
                    shape: shape.clone(),
                    values: Box::new(move || Ok(values)),
                });
            };
            add("value", parameters.host(name)?);
            if let Some([first, second]) = moments.by_name.get(name) {
                add("first", first.clone());
                add("second", second.clone());
            }
        }
        let metadata = BTreeMap::from([
            (STEP.to_owned(), step.to_string()),
            (SETTINGS.to_owned(), self.settings.clone()),
        ]);
        write(&self.path("state.safetensors"), &metadata, ElementType::F32, tensors)?;
        Ok(())
    }

    /// Appends a line to a file of the folder.
    ///
    /// # Errors
    /// When writing fails.
    pub fn append(&self, name: &str, line: &serde_json::Value) -> Result<()> {
        let path = self.path(name);
        let mut file = fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            .map_err(Error::io(&path))?;
        file.write_all(format!("{line}\n").as_bytes()).map_err(Error::io(&path))
    }

    /// The lines of a file of the folder, none when it is not there.
    ///
    /// # Errors
    /// When reading fails.
    pub fn lines(&self, name: &str) -> Result<Vec<serde_json::Value>> {
        let path = self.path(name);
        if !path.exists() {
            return Ok(Vec::new());
        }
        let text = fs::read_to_string(&path).map_err(Error::io(&path))?;
        Ok(text
            .lines()
            .filter_map(|line| serde_json::from_str(line).ok())
            .collect())
    }

    /// Drops lines about updates that will be made again.
    fn keep_metrics_before(&self, step: u64) -> Result<()> {
        for name in ["metrics.jsonl", "time.jsonl"] {
            let path = self.path(name);
            if !path.exists() {
                continue;
            }
            let text = fs::read_to_string(&path).map_err(Error::io(&path))?;
            let keep = |line: &&str| {
                let value: Option<serde_json::Value> = serde_json::from_str(line).ok();
                let of = value.as_ref().and_then(|value| value["step"].as_u64());
                // An evaluation is made after so many updates, an update is counted from 0.
                let evaluation = value.as_ref().is_some_and(|value| value.get("evaluation").is_some());
                of.is_some_and(|of| if evaluation { of <= step } else { of < step })
            };
            let kept: String = text.lines().filter(keep).flat_map(|line| [line, "\n"]).collect();
            rogs_files::write_bytes(&path, kept.as_bytes())?;
        }
        Ok(())
    }
}

/// Writes parameters as a weights file.
///
/// # Errors
/// When writing fails.
pub fn export(
    parameters: &Parameters,
    metadata: &BTreeMap<String, String>,
    path: &Path,
    element: ElementType,
) -> Result<()> {
    let tensors = parameters.names().into_iter().map(|name| TensorSource {
        shape: parameters.shape(&name).map(<[usize]>::to_vec).unwrap_or_default(),
        values: {
            let name = name.clone();
            Box::new(move || {
                let unreadable = |error: rogs_tensors::Error| rogs_weights::Error::BadInput(error.to_string());
                parameters.host(&name).map_err(unreadable)
            })
        },
        name,
    });
    write(path, metadata, element, tensors.collect())?;
    Ok(())
}

/// Fingerprint of settings.
fn fingerprint(settings: &impl Serialize) -> String {
    let text = serde_json::to_string(settings).unwrap_or_default();
    blake3::hash(text.as_bytes()).to_hex().to_string()
}
