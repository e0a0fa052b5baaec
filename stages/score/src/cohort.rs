//! Selection of the evaluation cohort (`docs/spec/scoring.md` section 1): which episodes are scored, fixed before any model runs.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read as _;
use std::path::{Path, PathBuf};

use rogs_random::Pcg64;
pub use rogs_schemas::selection::{
    Candidates, CohortCounts, ExclusionReason, RngNote, SelectedEpisode, Selection, SourceManifest,
};
use rogs_schemas::selection::{SELECTION_ALGORITHM, SELECTION_VERSION};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// Largest manifest that is read, bytes. The real one has 2.6 MB.
const MAX_MANIFEST_BYTES: u64 = 256 << 20;
/// Layout of the manifest.
const MANIFEST_VERSION: &str = "wds_manifest.v1";
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
    /// Why ingest cannot read it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unreadable: Option<String>,
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
    #[serde(default)]
    schema_version: Option<String>,
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
        if let Some(other) = raw
            .schema_version
            .as_deref()
            .filter(|version| *version != MANIFEST_VERSION)
        {
            return Err(malformed(format!(
                "its version is `{other}`, expected `{MANIFEST_VERSION}`"
            )));
        }
        let mut episodes = BTreeSet::new();
        for key in &raw.test_clip_keys {
            let id =
                episode_of_key(key).ok_or_else(|| malformed(format!("clip key `{key}` does not end in -START:END")))?;
            episodes.insert(id.to_owned());
        }
        let sha256 = hex(&Sha256::digest(&bytes));
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

    /// What a selection says about it.
    fn note(&self) -> SourceManifest {
        SourceManifest {
            path_name: self.path_name.clone(),
            sha256: self.sha256.clone(),
            domain: self.domain.clone(),
            manifest_seed: self.seed,
            test_fraction: self.test_fraction,
        }
    }

    /// A list of its episodes. It says nothing about them but their ids, so the conditions of
    /// [`PointWorldManifest::says_nothing_of`] cannot be checked.
    #[must_use]
    pub fn as_list(&self) -> Vec<EpisodeRecord> {
        let record = |id: &String| EpisodeRecord {
            episode_id: id.clone(),
            lab: None,
            scene: None,
            clip_name: None,
            train_or_val: false,
            stereo: false,
            frames: 0,
            calibration: false,
            gripper_range: None,
            unreadable: None,
        };
        self.episodes.iter().map(record).collect()
    }

    /// Conditions about which [`PointWorldManifest::as_list`] says nothing: all but membership.
    #[must_use]
    pub fn says_nothing_of() -> Vec<ExclusionReason> {
        let mut all = ExclusionReason::ALL.to_vec();
        all.retain(|reason| *reason != ExclusionReason::NotInTestManifest);
        all
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

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn read_bounded(path: &Path) -> Result<Vec<u8>, CohortError> {
    let read = |source| CohortError::Read {
        path: path.to_owned(),
        source,
    };
    let file = rogs_files::open(path).map_err(read)?;
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
    /// Laboratories held out; empty for all.
    pub labs: Vec<String>,
    /// Seed of the permutation.
    pub seed: u64,
    /// Episodes to select.
    pub take: usize,
    /// What the list was read from: `list`, `folder` or `manifest`.
    pub source: String,
    /// Conditions that the list says nothing about.
    pub not_checked: Vec<ExclusionReason>,
}

impl Default for CohortOptions {
    /// The paper's cohort.
    fn default() -> Self {
        Self {
            labs: vec!["ILIAD".into(), "PennPAL".into()],
            seed: 42,
            take: 256,
            source: "list".into(),
            not_checked: Vec::new(),
        }
    }
}

/// Selects the cohort. Without a manifest no episode is asked to be in the test set.
///
/// # Errors
/// When two records have the same episode id or clip name.
pub fn select(
    episodes: &[EpisodeRecord],
    manifest: Option<&PointWorldManifest>,
    options: &CohortOptions,
) -> Result<Selection, CohortError> {
    let reserved: Vec<&EpisodeRecord> = episodes
        .iter()
        .filter(|episode| options.labs.is_empty() || options.labs.iter().any(|lab| lab == episode.lab()))
        .collect();
    no_duplicates(&reserved)?;
    let mut candidates = candidates(&reserved, options);
    if manifest.is_none() {
        candidates.not_checked.push(ExclusionReason::NotInTestManifest);
        candidates.not_checked.sort_unstable();
        candidates.not_checked.dedup();
    }
    let mut counts = CohortCounts {
        reserved: reserved.len(),
        ..CohortCounts::default()
    };
    let mut exclusions: BTreeMap<ExclusionReason, Vec<String>> = BTreeMap::new();
    let mut eligible: Vec<(&str, &EpisodeRecord)> = Vec::new();
    for episode in reserved {
        match exclusion(episode, manifest, &candidates.not_checked) {
            Some(reason) => exclusions.entry(reason).or_default().push(episode.episode_id.clone()),
            None => eligible.push((episode.clip_name.as_deref().unwrap_or(&episode.episode_id), episode)),
        }
    }
    exclusions.values_mut().for_each(|ids| ids.sort_unstable());
    let exclusion_counts: BTreeMap<_, _> = exclusions.iter().map(|(reason, ids)| (*reason, ids.len())).collect();
    let excluded = |reasons: &[ExclusionReason]| -> usize {
        let count = |reason| exclusion_counts.get(reason).copied().unwrap_or(0);
        reasons.iter().map(count).sum()
    };
    use ExclusionReason::{NoClip, NoStereo, NotInTestManifest, TrainOrVal, Unreadable};
    counts.cached = counts.reserved - excluded(&[TrainOrVal, NoClip, NoStereo, Unreadable]);
    counts.candidates = counts.cached - excluded(&[NotInTestManifest]);
    counts.eligible = eligible.len();
    eligible.sort_unstable_by_key(|(clip_name, _)| *clip_name);

    let many = u32::try_from(eligible.len()).unwrap_or(u32::MAX);
    let selected_indices = Pcg64::from_seed(options.seed).sorted_sample(many, options.take);
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
        schema_version: SELECTION_VERSION,
        seed: options.seed,
        source_manifest: manifest.map(PointWorldManifest::note),
        candidates: Some(candidates),
        counts,
        exclusions,
        exclusion_counts,
        eligible_sorted: eligible.iter().map(|(clip_name, _)| (*clip_name).to_owned()).collect(),
        selected: selected_indices.iter().map(selected).collect(),
        selected_indices,
        rng: RngNote {
            algorithm: SELECTION_ALGORITHM.into(),
            version: 1,
        },
    })
}

/// What two selections differ in, as sentences: which was made of another list, by another seed, of another size.
#[must_use]
pub fn differences(old: &Selection, new: &Selection) -> Vec<String> {
    let mut found = Vec::new();
    let mut say = |what: &str, old: String, new: String| {
        if old != new {
            found.push(format!("{what}: {old}, now {new}"));
        }
    };
    say("seed", old.seed.to_string(), new.seed.to_string());
    let manifest = |one: &Selection| {
        one.source_manifest
            .as_ref()
            .map_or("none".to_owned(), |own| own.sha256.clone())
    };
    say("test set (SHA-256)", manifest(old), manifest(new));
    let list = |one: &Selection| {
        one.candidates
            .as_ref()
            .map_or("unknown".to_owned(), |own| own.sha256.clone())
    };
    say("episode list (SHA-256)", list(old), list(new));
    say(
        "eligible episodes",
        old.counts.eligible.to_string(),
        new.counts.eligible.to_string(),
    );
    say(
        "selected episodes",
        old.counts.selected.to_string(),
        new.counts.selected.to_string(),
    );
    let ids = |one: &Selection| {
        one.selected
            .iter()
            .map(|own| own.episode_id.clone())
            .collect::<BTreeSet<_>>()
    };
    let common = ids(old).intersection(&ids(new)).count();
    if common != old.selected.len() || common != new.selected.len() {
        found.push(format!("{common} episodes are in both"));
    }
    found
}

/// Where the records came from and what they say, in short.
fn candidates(records: &[&EpisodeRecord], options: &CohortOptions) -> Candidates {
    let mut sorted: Vec<&&EpisodeRecord> = records.iter().collect();
    sorted.sort_unstable_by(|a, b| a.episode_id.cmp(&b.episode_id));
    let mut hasher = Sha256::new();
    for record in &sorted {
        // A record of plain values always has a text.
        hasher.update(serde_json::to_string(record).unwrap_or_default());
        hasher.update(b"\n");
    }
    let problem = |record: &&&EpisodeRecord| Some((record.episode_id.clone(), record.unreadable.clone()?));
    Candidates {
        source: options.source.clone(),
        sha256: hex(&hasher.finalize()),
        labs: options.labs.clone(),
        not_checked: options.not_checked.clone(),
        unreadable: sorted.iter().filter_map(problem).collect(),
    }
}

/// Why an episode is not eligible, if it is not.
fn exclusion(
    episode: &EpisodeRecord,
    manifest: Option<&PointWorldManifest>,
    not_checked: &[ExclusionReason],
) -> Option<ExclusionReason> {
    let allowed = -GRIPPER_TOLERANCE..=1.0 + GRIPPER_TOLERANCE;
    let gripper = |[low, high]: [f64; 2]| allowed.contains(&low) && allowed.contains(&high);
    let holds = |reason: ExclusionReason| match reason {
        ExclusionReason::Unreadable => episode.unreadable.is_some(),
        ExclusionReason::TrainOrVal => episode.train_or_val,
        ExclusionReason::NoClip => episode.clip_name.is_none(),
        ExclusionReason::NoStereo => !episode.stereo,
        ExclusionReason::NotInTestManifest => {
            manifest.is_some_and(|manifest| !manifest.episodes.contains(&episode.episode_id))
        }
        ExclusionReason::TooFewFrames => episode.frames < MIN_FRAMES,
        ExclusionReason::NoCalibration => !episode.calibration,
        ExclusionReason::GripperRange => !episode.gripper_range.is_some_and(gripper),
    };
    // What cannot be read says nothing about itself, so that comes before all that would be asked of its content.
    let first = [ExclusionReason::TrainOrVal, ExclusionReason::Unreadable];
    let others = ExclusionReason::ALL
        .into_iter()
        .filter(|reason| !first.contains(reason));
    first
        .into_iter()
        .chain(others)
        .find(|reason| !not_checked.contains(reason) && holds(*reason))
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
