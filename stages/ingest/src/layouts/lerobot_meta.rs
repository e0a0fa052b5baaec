//! What a LeRobot data set says about itself in `meta/info.json`; its episodes are found by `lerobot_episodes`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rogs_worker::StageResult;
use serde::Deserialize;

use crate::fault::{read_text, wrong};

/// Longest `info.json`, bytes.
const MAX_JSON: u64 = 16 << 20;

/// Version of the layout.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Version {
    V21,
    V30,
}

impl Version {
    /// Its name as the clip keeps it.
    pub(crate) fn layout(self) -> &'static str {
        match self {
            Self::V21 => "lerobot-v2.1",
            Self::V30 => "lerobot-v3.0",
        }
    }
}

/// `meta/info.json`.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct Info {
    codebase_version: String,
    #[serde(default)]
    pub(crate) robot_type: Option<String>,
    pub(crate) fps: f64,
    #[serde(default = "default_chunk")]
    pub(super) chunks_size: u64,
    pub(super) data_path: String,
    #[serde(default)]
    pub(super) video_path: Option<String>,
    pub(crate) features: BTreeMap<String, Feature>,
}

fn default_chunk() -> u64 {
    1000
}

/// One feature.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct Feature {
    pub(crate) dtype: String,
    #[serde(default)]
    names: serde_json::Value,
    #[serde(default)]
    shape: Vec<u64>,
    /// What older and newer writers say of a video.
    #[serde(default, alias = "video_info")]
    info: serde_json::Value,
}

/// More entries than this are no state.
const MOST_ENTRIES: u64 = 4096;

impl Feature {
    /// Whether a video holds depth instead of colours.
    pub(crate) fn is_depth(&self) -> bool {
        let says = |key: &str| self.info.get(key).and_then(serde_json::Value::as_bool) == Some(true);
        says("video.is_depth_map") || says("is_depth_map")
    }

    /// What to say of a video of another size than is announced.
    pub(crate) fn other_size(&self, (width, height): (u32, u32)) -> Option<String> {
        let announced = [width, height]
            .iter()
            .all(|&side| self.shape.contains(&u64::from(side)));
        (self.shape.len() == 3 && !announced).then(|| {
            format!(
                "`info.json` announces images of the shape {:?}, the video has {width}x{height}: intrinsics must be those \
                 of the video",
                self.shape
            )
        })
    }

    /// Names of its entries, flattened from however they are nested; their numbers where there is not one for each.
    pub(crate) fn entry_names(&self) -> Vec<String> {
        fn flatten(value: &serde_json::Value, out: &mut Vec<String>) {
            match value {
                serde_json::Value::String(name) => out.push(name.clone()),
                serde_json::Value::Array(items) => items.iter().for_each(|item| flatten(item, out)),
                serde_json::Value::Object(items) => items.values().for_each(|item| flatten(item, out)),
                _ => {}
            }
        }
        let mut names = Vec::new();
        flatten(&self.names, &mut names);
        // Some writers name the whole, or nothing: the entries are then known by their numbers.
        match self.shape[..] {
            [count] if count != names.len() as u64 && count <= MOST_ENTRIES => {
                (0..count).map(|entry| entry.to_string()).collect()
            }
            _ => names,
        }
    }
}

/// One episode of a data set.
#[derive(Debug, Clone)]
pub(crate) struct EpisodeMeta {
    pub(crate) index: u64,
    pub(crate) task: String,
    pub(crate) length: u64,
    /// File of the metadata that describes it, relative.
    pub(crate) described_by: String,
    /// Parquet file, relative.
    pub(crate) data: String,
    /// Per video feature: file, relative, and where the episode begins in it, seconds.
    pub(crate) videos: BTreeMap<String, (String, f64)>,
}

impl EpisodeMeta {
    /// What selects it.
    pub(crate) fn selector(&self) -> String {
        selector(self.index)
    }
}

/// What selects the episode of an index.
pub(super) fn selector(index: u64) -> String {
    format!("episode_{index:06}")
}

/// A data set.
pub(crate) struct Dataset {
    pub(crate) root: PathBuf,
    pub(crate) info: Info,
    pub(crate) version: Version,
}

impl Dataset {
    /// Reads what the data set says of all its episodes; none of them is looked at.
    pub(crate) fn open(root: &Path) -> StageResult<Self> {
        let path = root.join("meta/info.json");
        let text = read_text(&path, MAX_JSON)?;
        let info: Info = rogs_schemas::json::read(&text)
            .map_err(|error| wrong(&path, format!("not LeRobot's `info.json`: {error}")))?;
        let version = match info.codebase_version.as_str() {
            "v2.0" | "v2.1" => Version::V21,
            "v3.0" => Version::V30,
            other => {
                let text = format!("version `{other}` is not supported (v2.1 and v3.0 are)");
                return Err(wrong(&path, text).with_hint("LeRobot converts old data sets to v3.0"));
            }
        };
        if !(info.fps.is_finite() && info.fps > 0.0) || info.chunks_size == 0 {
            return Err(wrong(
                &path,
                format!("`fps` {} or `chunks_size` {} is impossible", info.fps, info.chunks_size),
            ));
        }
        Ok(Self {
            root: root.to_owned(),
            info,
            version,
        })
    }

    /// Names of the features that are videos of colours.
    pub(crate) fn videos(&self) -> Vec<&str> {
        self.videos_where(|feature| !feature.is_depth())
    }

    /// Names of the features that are videos of depth.
    pub(crate) fn depth_videos(&self) -> Vec<&str> {
        self.videos_where(Feature::is_depth)
    }

    fn videos_where(&self, is_meant: impl Fn(&Feature) -> bool) -> Vec<&str> {
        let features = self.info.features.iter();
        features
            .filter(|(_, feature)| feature.dtype == "video" && is_meant(feature))
            .map(|(name, _)| name.as_str())
            .collect()
    }
}

/// Fills a Python format string: `{video_key}` and numbers such as `{episode_index:06d}`.
pub(super) fn fill(template: &str, numbers: &[(&str, u64)], key: &str) -> Result<String, String> {
    let wrong = || format!("the path template `{template}` is not understood");
    let mut out = String::new();
    let mut rest = template;
    while let Some((before, after)) = rest.split_once('{') {
        out.push_str(before);
        let (field, after) = after.split_once('}').ok_or_else(wrong)?;
        let (name, format) = field.split_once(':').unwrap_or((field, ""));
        if name == "video_key" {
            out.push_str(key);
        } else {
            let number = numbers.iter().find(|(known, _)| *known == name).ok_or_else(wrong)?.1;
            let width = format.trim_end_matches('d');
            let width: usize = if width.is_empty() {
                0
            } else {
                width.parse().map_err(|_| wrong())?
            };
            out.push_str(&format!("{number:0width$}", width = width.min(20)));
        }
        rest = after;
    }
    out.push_str(rest);
    if out.is_empty() { Err(wrong()) } else { Ok(out) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn templates_are_filled() {
        let numbers = [("episode_chunk", 0), ("episode_index", 10)];
        let template = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4";
        assert_eq!(
            fill(template, &numbers, "cam").unwrap(),
            "videos/chunk-000/cam/episode_000010.mp4"
        );
        assert!(fill("{what}", &numbers, "").is_err());
        assert!(fill("{episode_index", &numbers, "").is_err());
    }

    #[test]
    fn what_is_said_of_a_video_is_honoured_or_told() {
        let feature = |rest: &str| {
            let text = format!(r#"{{"dtype":"video","shape":[48,64,3]{rest}}}"#);
            serde_json::from_str::<Feature>(&text).unwrap()
        };
        for (rest, depth) in [
            ("", false),
            (r#","info":{"video.is_depth_map":false,"video.fps":30}"#, false),
            (r#","info":{"video.is_depth_map":true}"#, true),
            (r#","video_info":{"is_depth_map":true}"#, true),
            (r#","info":null"#, false),
        ] {
            assert_eq!(feature(rest).is_depth(), depth, "{rest}");
        }
        assert_eq!(feature("").other_size((64, 48)), None);
        assert!(feature("").other_size((32, 24)).unwrap().contains("32x24"));
    }

    #[test]
    fn names_are_flattened() {
        let names = |json: &str| serde_json::from_str::<Feature>(json).unwrap().entry_names();
        assert_eq!(names(r#"{"dtype":"float32","names":[["a","b"]]}"#), ["a", "b"]);
        assert_eq!(names(r#"{"dtype":"float32","names":{"motors":["a"]}}"#), ["a"]);
        assert!(names(r#"{"dtype":"float32","names":null}"#).is_empty());
        assert_eq!(names(r#"{"dtype":"float32","names":null,"shape":[2]}"#), ["0", "1"]);
        assert_eq!(
            names(r#"{"dtype":"float32","names":["state"],"shape":[3]}"#),
            ["0", "1", "2"]
        );
        assert_eq!(
            names(r#"{"dtype":"float32","names":["a","b"],"shape":[2]}"#),
            ["a", "b"]
        );
    }
}
