//! The clips with tracks of an episode, wherever they lie: in `UUID_flows.h5`, or in a WebDataset shard, whose samples
//! have the key `UUID-START:END` and the same arrays as members `camera_SERIAL_ext_NAME.npy` and `NAME.npy`.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use rogs_arrays::{ANY, Hdf5File, npy_numbers};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_worker::StageResult;

use super::depth::{stated_origin, whole_dataset};
use super::tar;
use crate::fault::{io_error, unreadable, wrong};

/// Recorded frames of a canonical frame, where the file has no clock.
pub(super) const CANONICAL_STEP: usize = 2;
/// Largest member of a sample that is read, bytes.
const MAX_MEMBER: u64 = 1 << 28;

/// The clips of one file.
pub(super) struct Clips {
    pub(super) path: PathBuf,
    store: Store,
    /// In the order of their numbers: as texts, 105:116 comes before 15:26.
    pub(super) clips: Vec<Clip>,
    /// Times of the canonical frames, milliseconds; shards have none.
    pub(super) clock: Option<Vec<f64>>,
    /// Whose they are, where the file says so.
    pub(super) uuid: Option<String>,
    /// What made the tracks: PointWorld's tracker, unless the file says otherwise.
    pub(super) origin: ReferenceOrigin,
}

/// One clip: canonical frames `start..end`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Clip {
    /// Its group or key.
    pub(super) name: String,
    pub(super) start: usize,
    pub(super) end: usize,
}

/// Members of a sample: offset and length by name.
type Members = BTreeMap<String, (u64, u64)>;
/// Samples of a shard by key.
type Samples = BTreeMap<String, Members>;

enum Store {
    Hdf5(Hdf5File),
    Shard(Samples),
}

/// Numbers with their shape.
pub(super) struct Numbers {
    pub(super) shape: Vec<usize>,
    /// Row-major; truth values are 0 and 1.
    pub(super) values: Vec<f32>,
}

/// True for the name of a shard.
pub(super) fn is_shard(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("tar"))
}

/// The samples of a shard: members by key. A file belongs to the key before the first dot of its name.
fn samples(path: &Path) -> StageResult<Samples> {
    let mut samples = Samples::new();
    for file in tar::index(path)? {
        let base = file.name.rsplit('/').next().unwrap_or(&file.name);
        if let Some((key, member)) = base.split_once('.')
            && !key.is_empty()
        {
            let members = samples.entry(key.to_owned()).or_default();
            members.insert(member.to_owned(), (file.offset, file.length));
        }
    }
    Ok(samples)
}

/// Uuid and canonical frames of a key.
fn parse_key(key: &str) -> Option<(&str, &str)> {
    let (uuid, range) = key.rsplit_once('-')?;
    let uuid = uuid.strip_suffix("_flows").unwrap_or(uuid);
    (!uuid.is_empty() && range.contains(':')).then_some((uuid, range))
}

/// How many clips a shard has of which episode.
pub(super) fn episodes_of_shard(path: &Path) -> StageResult<BTreeMap<String, usize>> {
    let mut counts = BTreeMap::new();
    for key in samples(path)?.keys() {
        if let Some((uuid, _)) = parse_key(key) {
            *counts.entry(uuid.to_owned()).or_default() += 1;
        }
    }
    Ok(counts)
}

impl Clips {
    /// Opens the clips that a file has of an episode.
    pub(super) fn open(path: &Path, episode: &str) -> StageResult<Self> {
        let mut origin = ReferenceOrigin::PointTracker;
        let (store, names, clock, uuid) = if is_shard(path) {
            let mut samples = samples(path)?;
            samples.retain(|key, _| parse_key(key).is_some_and(|(uuid, _)| uuid == episode));
            let names: Vec<String> = samples.keys().cloned().collect();
            (Store::Shard(samples), names, None, None)
        } else {
            let file = Hdf5File::open(path).map_err(unreadable)?;
            let attributes = file.attributes("").map_err(unreadable)?;
            let text = |name: &str| attributes.get(name).and_then(|value| value.text()).map(str::to_owned);
            let clock: Option<Vec<f64>> =
                text("canonical_timestamps").and_then(|list| serde_json::from_str(&list).ok());
            let clock =
                clock.ok_or_else(|| wrong(path, "invalid `canonical_timestamps`: expected a list of milliseconds"))?;
            if !clock.is_sorted_by(|a, b| a < b) {
                return Err(wrong(path, "`canonical_timestamps` do not ascend"));
            }
            origin = stated_origin(attributes.get("origin"), path)?.unwrap_or(origin);
            let (names, uuid) = (file.groups("").map_err(unreadable)?, text("uuid"));
            (Store::Hdf5(file), names, Some(clock), uuid)
        };
        let mut clips = Vec::new();
        for name in names {
            clips.push(clip(name, clock.as_ref().map_or(usize::MAX, Vec::len), path)?);
        }
        if clips.is_empty() {
            return Err(wrong(path, format!("it has no clips of `{episode}`")));
        }
        clips.sort_by_key(|clip| (clip.start, clip.end));
        Ok(Self {
            path: path.to_owned(),
            store,
            clips,
            clock,
            uuid,
            origin,
        })
    }

    /// What the groups of a clip's cameras are called: `camera_SERIAL_ext`.
    pub(super) fn cameras(&self, clip: &Clip) -> StageResult<Vec<String>> {
        let names: Vec<String> = match &self.store {
            Store::Hdf5(file) => file.groups(&clip.name).map_err(unreadable)?,
            Store::Shard(samples) => {
                let members = samples.get(&clip.name).into_iter().flat_map(BTreeMap::keys);
                let flows = members.filter_map(|member| member.strip_suffix("_scene_flows.npy"));
                flows.map(str::to_owned).collect::<BTreeSet<_>>().into_iter().collect()
            }
        };
        Ok(names.into_iter().filter(|name| name.starts_with("camera_")).collect())
    }

    /// An array of a clip, or of one of its cameras; [`ANY`] stands for any length.
    pub(super) fn numbers(
        &self,
        clip: &Clip,
        camera: Option<&str>,
        name: &str,
        expected: &[usize],
    ) -> StageResult<Numbers> {
        match &self.store {
            Store::Hdf5(file) => {
                let parts = [Some(clip.name.as_str()), camera, Some(name)];
                let at = parts.into_iter().flatten().collect::<Vec<_>>().join("/");
                let dataset = whole_dataset(file, &at)?;
                dataset.expect_shape(expected).map_err(unreadable)?;
                Ok(Numbers {
                    shape: dataset.shape().to_vec(),
                    values: dataset.read().map_err(unreadable)?,
                })
            }
            Store::Shard(samples) => {
                let member = match camera {
                    Some(camera) => format!("{camera}_{name}.npy"),
                    None => format!("{name}.npy"),
                };
                let place = samples.get(&clip.name).and_then(|members| members.get(&member));
                let bad = |what: String| wrong(&self.path, format!("`{}.{member}`: {what}", clip.name));
                let &place = place.ok_or_else(|| bad("it is missing".to_owned()))?;
                let (shape, values) = npy_numbers(&self.bytes(place, &bad)?).map_err(bad)?;
                let fits = |(&found, &wanted): (&usize, &usize)| wanted == ANY || found == wanted;
                if shape.len() != expected.len() || !shape.iter().zip(expected).all(fits) {
                    return Err(bad(format!(
                        "its shape is {shape:?}, which a clip {}:{} has not",
                        clip.start, clip.end
                    )));
                }
                Ok(Numbers {
                    shape,
                    values: values.into_iter().map(|value| value as f32).collect(),
                })
            }
        }
    }

    fn bytes(
        &self,
        (offset, length): (u64, u64),
        bad: &dyn Fn(String) -> rogs_worker::StageError,
    ) -> StageResult<Vec<u8>> {
        if length > MAX_MEMBER {
            return Err(bad(format!("{length} bytes are too many")));
        }
        let io = |error: std::io::Error| io_error(&self.path, &error);
        let mut file = rogs_files::open(&self.path).map_err(io)?;
        file.seek(SeekFrom::Start(offset)).map_err(io)?;
        let mut bytes = Vec::new();
        file.take(length).read_to_end(&mut bytes).map_err(io)?;
        Ok(bytes)
    }
}

/// A clip by its name, `START:END` at the end.
fn clip(name: String, canonical: usize, path: &Path) -> StageResult<Clip> {
    let range = parse_key(&name).map_or(name.as_str(), |(_, range)| range);
    let parse = || {
        let (start, end) = range.split_once(':')?;
        Some((start.parse::<usize>().ok()?, end.parse::<usize>().ok()?))
    };
    let (start, end) = parse().ok_or_else(|| wrong(path, format!("invalid clip `{name}`: expected START:END")))?;
    if start >= end || end > canonical {
        let frames = if canonical == usize::MAX {
            String::new()
        } else {
            format!(" of the {canonical} canonical frames")
        };
        return Err(wrong(path, format!("the clip `{name}` lies outside{frames}")));
    }
    Ok(Clip { name, start, end })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_lose_only_their_range() {
        assert_eq!(
            parse_key("ILIAD+5e9+2023-06-12-14h-47m-26s-15:26"),
            Some(("ILIAD+5e9+2023-06-12-14h-47m-26s", "15:26"))
        );
        assert_eq!(parse_key("a_flows-0:11"), Some(("a", "0:11")));
        for other in ["a-0", "-0:11", "0:11", ""] {
            assert_eq!(parse_key(other), None, "{other}");
        }
    }

    #[test]
    fn clips_out_of_range_are_refused() {
        let told =
            |name: &str, canonical| clip(name.to_owned(), canonical, Path::new("f")).map_err(|error| error.to_string());
        assert_eq!(told("105:116", 200).unwrap().start, 105);
        assert!(
            told("7:18", 17)
                .unwrap_err()
                .contains("outside of the 17 canonical frames")
        );
        assert!(
            told("a-11:0", usize::MAX)
                .unwrap_err()
                .contains("the clip `a-11:0` lies outside")
        );
        assert!(told("first", 17).unwrap_err().contains("expected START:END"));
    }
}
