//! Selection of the evaluation cohort (`docs/spec/scoring.md` section 1): which episodes are scored, fixed before any model runs.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read as _;
use std::path::{Path, PathBuf};

use rogs_random::Pcg64;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// Largest manifest that is read, bytes. The real one has 2.6 MB.
const MAX_MANIFEST_BYTES: u64 = 256 << 20;
/// Fewest cached frames of an eligible clip.
const MIN_FRAMES: u32 = 24;
/// How far a gripper value may leave [0, 1].
const GRIPPER_TOLERANCE: f64 = 1e-6;

/// One episode as the preparation step knows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeRecord {
    /// DROID uuid, `LAB+hash+timestamp`.
    pub episode_id: String,
    /// Laboratory; the part of the episode id before the first `+` when it is not given.
    #[serde(default)]
    pub lab: Option<String>,
    /// Scene id, where it is known.
    #[serde(default)]
    pub scene: Option<String>,
    /// Name of the prepared clip; none when there is none.
    #[serde(default)]
    pub clip_name: Option<String>,
    /// The preparation step put it into its training or validation list.
    #[serde(default)]
    pub train_or_val: bool,
    /// Stereo references exist.
    #[serde(default)]
    pub stereo: bool,
    /// Cached frames of the clip.
    #[serde(default)]
    pub frames: u32,
    /// Calibration metadata exist.
    #[serde(default)]
    pub calibration: bool,
    /// Smallest and largest gripper value; none when a value is not finite.
    #[serde(default)]
    pub gripper_range: Option<[f64; 2]>,
}

impl EpisodeRecord {
    fn lab(&self) -> &str {
        self.lab
            .as_deref()
            .unwrap_or_else(|| self.episode_id.split('+').next().unwrap_or_default())
    }
}

/// The test split of PointWorld as its manifest lists it.
#[derive(Debug, Clone, PartialEq)]
pub struct PointWorldManifest {
    /// File name.
    pub path_name: String,
    /// SHA-256 of the file, hex.
    pub sha256: String,
    /// Data domain, `droid`.
    pub domain: String,
    /// Seed of the split.
    pub seed: u64,
    /// Fraction of clips in the test set.
    pub test_fraction: f64,
    /// Test clips.
    pub clips: usize,
    /// Episodes that have a test clip.
    pub episodes: BTreeSet<String>,
}

#[derive(Deserialize)]
struct RawManifest {
    domain: String,
    seed: u64,
    #[serde(alias = "test_fraction")]
    test_percentage: f64,
    test_clip_keys: Vec<String>,
}

/// Why a cohort cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CohortError {
    /// A file cannot be read.
    #[error("reading `{}`", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file is larger than anything reasonable.
    #[error("`{}` has more than {limit} bytes", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Largest size read.
        limit: u64,
    },
    /// A file is not what it should be.
    #[error("`{}` is not {expected}: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What was expected.
        expected: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// Two records have the same id or clip name.
    #[error("the episode list has `{name}` twice")]
    Duplicate {
        /// Episode id or clip name.
        name: String,
    },
}

impl PointWorldManifest {
    /// Reads `droid_paper_split_manifest.json`.
    ///
    /// # Errors
    /// When it cannot be read or is something else.
    pub fn read(path: &Path) -> Result<Self, CohortError> {
        let bytes = read_bounded(path)?;
        let malformed = |reason: String| CohortError::Malformed {
            path: path.to_owned(),
            expected: "a PointWorld split manifest",
            reason,
        };
        let raw: RawManifest = serde_json::from_slice(&bytes).map_err(|error| malformed(error.to_string()))?;
        let mut episodes = BTreeSet::new();
        for key in &raw.test_clip_keys {
            let id =
                episode_of_key(key).ok_or_else(|| malformed(format!("clip key `{key}` does not end in -START:END")))?;
            episodes.insert(id.to_owned());
        }
        let sha256 = Sha256::digest(&bytes)
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        Ok(Self {
            path_name: path
                .file_name()
                .map(|name| name.to_string_lossy().into_owned())
                .unwrap_or_default(),
            sha256,
            domain: raw.domain,
            seed: raw.seed,
            test_fraction: raw.test_percentage,
            clips: raw.test_clip_keys.len(),
            episodes,
        })
    }

    /// Episodes by laboratory.
    #[must_use]
    pub fn episodes_by_lab(&self) -> BTreeMap<&str, usize> {
        let mut counts = BTreeMap::new();
        for id in &self.episodes {
            *counts.entry(id.split('+').next().unwrap_or_default()).or_default() += 1;
        }
        counts
    }
}

/// The episode id of a clip key: the key without its last `-START:END`.
#[must_use]
pub fn episode_of_key(key: &str) -> Option<&str> {
    let (id, range) = key.rsplit_once('-')?;
    let (start, end) = range.split_once(':')?;
    let number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    (number(start) && number(end) && !id.is_empty()).then_some(id)
}

/// Reads an episode list: a JSON array of [`EpisodeRecord`], or one record a line.
///
/// # Errors
/// When it cannot be read or a record is malformed.
pub fn read_episodes(path: &Path) -> Result<Vec<EpisodeRecord>, CohortError> {
    let bytes = read_bounded(path)?;
    let malformed = |reason: String| CohortError::Malformed {
        path: path.to_owned(),
        expected: "an episode list",
        reason,
    };
    if bytes.iter().find(|byte| !byte.is_ascii_whitespace()) == Some(&b'[') {
        return serde_json::from_slice(&bytes).map_err(|error| malformed(error.to_string()));
    }
    let text = std::str::from_utf8(&bytes).map_err(|error| malformed(error.to_string()))?;
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    lines
        .map(|(index, line)| {
            serde_json::from_str(line).map_err(|error| malformed(format!("line {}: {error}", index + 1)))
        })
        .collect()
}

fn read_bounded(path: &Path) -> Result<Vec<u8>, CohortError> {
    let read = |source| CohortError::Read {
        path: path.to_owned(),
        source,
    };
    let file = std::fs::File::open(path).map_err(read)?;
    let mut bytes = Vec::new();
    file.take(MAX_MANIFEST_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(read)?;
    if bytes.len() as u64 > MAX_MANIFEST_BYTES {
        return Err(CohortError::TooLarge {
            path: path.to_owned(),
            limit: MAX_MANIFEST_BYTES,
        });
    }
    Ok(bytes)
}

/// What is asked of a cohort.
#[derive(Debug, Clone, PartialEq)]
pub struct CohortOptions {
    /// Laboratories held out.
    pub labs: Vec<String>,
    /// Seed of the permutation.
    pub seed: u64,
    /// Episodes to select.
    pub take: usize,
}

impl Default for CohortOptions {
    /// The paper's cohort.
    fn default() -> Self {
        Self {
            labs: vec!["ILIAD".into(), "PennPAL".into()],
            seed: 42,
            take: 256,
        }
    }
}

/// Episodes left after every step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CohortCounts {
    /// Of the held-out laboratories.
    pub reserved: usize,
    /// With prepared clip and stereo references, outside of training and validation.
    pub cached: usize,
    /// In the PointWorld test set.
    pub candidates: usize,
    /// With enough frames, calibration and valid gripper values.
    pub eligible: usize,
    /// Selected.
    pub selected: usize,
}

/// Contents of `selection.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Selection {
    /// Version of this layout.
    pub schema_version: u32,
    /// Seed of the permutation.
    pub seed: u64,
    /// The manifest that was used.
    pub source_manifest: SourceManifest,
    /// Episodes left after every step.
    pub counts: CohortCounts,
    /// Excluded episodes by reason, ascending.
    pub exclusions: BTreeMap<ExclusionReason, Vec<String>>,
    /// Number of excluded episodes by reason.
    pub exclusion_counts: BTreeMap<ExclusionReason, usize>,
    /// Eligible clip names, byte-wise ascending.
    pub eligible_sorted: Vec<String>,
    /// Indices into `eligible_sorted`, ascending.
    pub selected_indices: Vec<u32>,
    /// The selected episodes.
    pub selected: Vec<SelectedEpisode>,
    /// The generator.
    pub rng: RngNote,
}

/// The manifest behind a selection.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SourceManifest {
    /// File name.
    pub path_name: String,
    /// SHA-256, hex.
    pub sha256: String,
    /// Domain.
    pub domain: String,
    /// Seed of the split.
    pub manifest_seed: u64,
    /// Fraction of clips in the test set.
    pub test_fraction: f64,
}

/// One selected episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SelectedEpisode {
    /// Index into `eligible_sorted`.
    pub index: u32,
    /// Clip name.
    pub clip_name: String,
    /// Episode id.
    pub episode_id: String,
    /// Laboratory.
    pub lab: String,
    /// Scene, where it is known.
    pub scene: Option<String>,
}

/// How the random numbers were made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RngNote {
    /// Algorithm.
    pub algorithm: String,
    /// Version.
    pub version: u32,
}

/// Why an episode is not in the cohort. The first reason that applies counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ExclusionReason {
    /// In the training or validation list.
    TrainOrVal,
    /// No prepared clip.
    NoClip,
    /// No stereo references.
    NoStereo,
    /// Not in the PointWorld test set.
    NotInTestManifest,
    /// Fewer than 24 cached frames.
    TooFewFrames,
    /// No calibration metadata.
    NoCalibration,
    /// A gripper value is not finite or leaves [0, 1].
    GripperRange,
}

/// Selects the cohort.
///
/// # Errors
/// When two records have the same episode id or clip name.
pub fn select(
    episodes: &[EpisodeRecord],
    manifest: &PointWorldManifest,
    options: &CohortOptions,
) -> Result<Selection, CohortError> {
    let reserved: Vec<&EpisodeRecord> = episodes
        .iter()
        .filter(|episode| options.labs.iter().any(|lab| lab == episode.lab()))
        .collect();
    no_duplicates(&reserved)?;
    let mut counts = CohortCounts {
        reserved: reserved.len(),
        ..CohortCounts::default()
    };
    let mut exclusions: BTreeMap<ExclusionReason, Vec<String>> = BTreeMap::new();
    let mut eligible: Vec<(&str, &EpisodeRecord)> = Vec::new();
    for episode in reserved {
        match exclusion(episode, manifest) {
            Ok(clip_name) => eligible.push((clip_name, episode)),
            Err(reason) => exclusions.entry(reason).or_default().push(episode.episode_id.clone()),
        }
    }
    exclusions.values_mut().for_each(|ids| ids.sort_unstable());
    let exclusion_counts: BTreeMap<_, _> = exclusions.iter().map(|(reason, ids)| (*reason, ids.len())).collect();
    let excluded = |reasons: std::ops::RangeInclusive<ExclusionReason>| -> usize {
        exclusion_counts.range(reasons).map(|(_, count)| count).sum()
    };
    counts.cached = counts.reserved - excluded(ExclusionReason::TrainOrVal..=ExclusionReason::NoStereo);
    counts.candidates =
        counts.cached - excluded(ExclusionReason::NotInTestManifest..=ExclusionReason::NotInTestManifest);
    counts.eligible = eligible.len();
    eligible.sort_unstable_by_key(|(clip_name, _)| *clip_name);

    let order = Pcg64::from_seed(options.seed).permutation(u32::try_from(eligible.len()).unwrap_or(u32::MAX));
    let mut selected_indices: Vec<u32> = order.into_iter().take(options.take).collect();
    selected_indices.sort_unstable();
    counts.selected = selected_indices.len();
    let selected = |&index: &u32| {
        let (clip_name, episode) = eligible[index as usize];
        SelectedEpisode {
            index,
            clip_name: clip_name.to_owned(),
            episode_id: episode.episode_id.clone(),
            lab: episode.lab().to_owned(),
            scene: episode.scene.clone(),
        }
    };
    Ok(Selection {
        schema_version: 1,
        seed: options.seed,
        source_manifest: SourceManifest {
            path_name: manifest.path_name.clone(),
            sha256: manifest.sha256.clone(),
            domain: manifest.domain.clone(),
            manifest_seed: manifest.seed,
            test_fraction: manifest.test_fraction,
        },
        counts,
        exclusions,
        exclusion_counts,
        eligible_sorted: eligible.iter().map(|(clip_name, _)| (*clip_name).to_owned()).collect(),
        selected: selected_indices.iter().map(selected).collect(),
        selected_indices,
        rng: RngNote {
            algorithm: "numpy-pcg64-permutation".into(),
            version: 1,
        },
    })
}

/// The clip name of an eligible episode, or why it is not eligible.
fn exclusion<'a>(episode: &'a EpisodeRecord, manifest: &PointWorldManifest) -> Result<&'a str, ExclusionReason> {
    if episode.train_or_val {
        return Err(ExclusionReason::TrainOrVal);
    }
    let clip_name = episode.clip_name.as_deref().ok_or(ExclusionReason::NoClip)?;
    if !episode.stereo {
        return Err(ExclusionReason::NoStereo);
    }
    if !manifest.episodes.contains(&episode.episode_id) {
        return Err(ExclusionReason::NotInTestManifest);
    }
    if episode.frames < MIN_FRAMES {
        return Err(ExclusionReason::TooFewFrames);
    }
    if !episode.calibration {
        return Err(ExclusionReason::NoCalibration);
    }
    let allowed = -GRIPPER_TOLERANCE..=1.0 + GRIPPER_TOLERANCE;
    match episode.gripper_range {
        Some([low, high]) if allowed.contains(&low) && allowed.contains(&high) => Ok(clip_name),
        _ => Err(ExclusionReason::GripperRange),
    }
}

fn no_duplicates(episodes: &[&EpisodeRecord]) -> Result<(), CohortError> {
    let (mut ids, mut clips) = (BTreeSet::new(), BTreeSet::new());
    for episode in episodes {
        if !ids.insert(episode.episode_id.as_str()) {
            return Err(CohortError::Duplicate {
                name: episode.episode_id.clone(),
            });
        }
        if let Some(clip) = episode.clip_name.as_deref().filter(|clip| !clips.insert(*clip)) {
            return Err(CohortError::Duplicate { name: clip.to_owned() });
        }
    }
    Ok(())
}
