//! What a LeRobot data set says about itself: `meta/` of v2.1 (JSON lines) and v3.0 (parquet).

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rogs_worker::{StageError, StageResult};
use serde::Deserialize;

use super::parquet_table::Table;
use crate::fault::{io_error, read_text, wrong};

/// Longest file of the metadata, bytes.
const MAX_JSON: u64 = 256 << 20;

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
    chunks_size: u64,
    data_path: String,
    #[serde(default)]
    video_path: Option<String>,
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
}

impl Feature {
    /// Names of its entries, flattened from however they are nested.
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
        names
    }
}

/// One episode of a data set.
#[derive(Debug, Clone)]
pub(crate) struct EpisodeMeta {
    pub(crate) index: u64,
    pub(crate) task: String,
    pub(crate) length: u64,
    /// Parquet file, relative.
    pub(crate) data: String,
    /// Per video feature: file, relative, and where the episode begins in it, seconds.
    pub(crate) videos: BTreeMap<String, (String, f64)>,
}

impl EpisodeMeta {
    /// What selects it.
    pub(crate) fn selector(&self) -> String {
        format!("episode_{:06}", self.index)
    }
}

/// A data set.
pub(crate) struct Dataset {
    pub(crate) root: PathBuf,
    pub(crate) info: Info,
    pub(crate) version: Version,
    pub(crate) episodes: Vec<EpisodeMeta>,
    /// Files of the metadata besides `meta/info.json`, relative.
    pub(crate) meta_files: Vec<String>,
}

impl Dataset {
    /// Reads the metadata of a data set.
    pub(crate) fn open(root: &Path) -> StageResult<Self> {
        let path = root.join("meta/info.json");
        let text = read_text(&path, MAX_JSON)?;
        let info: Info =
            serde_json::from_str(&text).map_err(|error| wrong(&path, format!("not LeRobot's `info.json`: {error}")))?;
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
        let mut dataset = Self {
            root: root.to_owned(),
            info,
            version,
            episodes: Vec::new(),
            meta_files: Vec::new(),
        };
        dataset.episodes = match version {
            Version::V21 => dataset.read_v21()?,
            Version::V30 => dataset.read_v30()?,
        };
        Ok(dataset)
    }

    /// Names of the features that are videos.
    pub(crate) fn videos(&self) -> Vec<&str> {
        let is_video = |(_, feature): &(&String, &Feature)| feature.dtype == "video";
        self.info
            .features
            .iter()
            .filter(is_video)
            .map(|(name, _)| name.as_str())
            .collect()
    }

    /// The episode of a selector: `episode_000010` or `10`, or empty for the only one.
    pub(crate) fn select(&self, selector: &str) -> StageResult<&EpisodeMeta> {
        if selector.is_empty() {
            return match &self.episodes[..] {
                [only] => Ok(only),
                all => Err(StageError::bad_params(format!(
                    "`{}` holds {} episodes: say which",
                    self.root.display(),
                    all.len()
                ))
                .with_hint("set `episode` to a selector that `rogs stage ingest list FOLDER` prints")),
            };
        }
        let index = selector.strip_prefix("episode_").unwrap_or(selector).parse::<u64>();
        let found = index
            .ok()
            .and_then(|index| self.episodes.iter().find(|episode| episode.index == index));
        found.ok_or_else(|| {
            StageError::bad_input(format!(
                "`{}` has no episode `{selector}`, it has {}",
                self.root.display(),
                self.episodes.len()
            ))
        })
    }

    fn read_v21(&mut self) -> StageResult<Vec<EpisodeMeta>> {
        #[derive(Deserialize)]
        struct Line {
            episode_index: u64,
            #[serde(default)]
            tasks: Vec<String>,
            length: u64,
        }
        self.meta_files.push("meta/episodes.jsonl".to_owned());
        let path = self.root.join("meta/episodes.jsonl");
        let text = read_text(&path, MAX_JSON)?;
        let one = |(number, line): (usize, &str)| {
            let line: Line =
                serde_json::from_str(line).map_err(|error| wrong(&path, format!("line {}: {error}", number + 1)))?;
            let index = line.episode_index;
            let place = |template: &str, key: &str| {
                let numbers = [
                    ("episode_chunk", index / self.info.chunks_size),
                    ("episode_index", index),
                ];
                fill(template, &numbers, key).map_err(|what| wrong(&self.root.join("meta/info.json"), what))
            };
            let mut videos = BTreeMap::new();
            for key in self.videos() {
                let template = self.info.video_path.as_deref().unwrap_or_default();
                videos.insert(key.to_owned(), (place(template, key)?, 0.0));
            }
            let data = place(&self.info.data_path, "")?;
            let task = line.tasks.into_iter().next().unwrap_or_default();
            Ok(EpisodeMeta {
                index,
                task,
                length: line.length,
                data,
                videos,
            })
        };
        text.lines()
            .enumerate()
            .filter(|(_, line)| !line.trim().is_empty())
            .map(one)
            .collect()
    }

    fn read_v30(&mut self) -> StageResult<Vec<EpisodeMeta>> {
        let folder = self.root.join("meta/episodes");
        let mut files = Vec::new();
        for chunk in sorted(&folder)? {
            if chunk.is_dir() {
                files.extend(
                    sorted(&chunk)?
                        .into_iter()
                        .filter(|path| path.extension().is_some_and(|ext| ext == "parquet")),
                );
            }
        }
        let relative = |path: &PathBuf| Some(path.strip_prefix(&self.root).ok()?.to_str()?.to_owned());
        self.meta_files = files.iter().filter_map(relative).collect();
        let mut episodes = Vec::new();
        for path in files {
            // Everything but the statistics.
            let table = Table::read(&path, &|name| !name.starts_with("stats/"))?;
            let (index, length) = (table.integers("episode_index")?, table.integers("length")?);
            let (data_chunk, data_file) = (table.integers("data/chunk_index")?, table.integers("data/file_index")?);
            let place = |template: &str, numbers: (u64, u64), key: &str| {
                let numbers = [("chunk_index", numbers.0), ("file_index", numbers.1)];
                fill(template, &numbers, key).map_err(|what| wrong(&self.root.join("meta/info.json"), what))
            };
            for row in 0..table.rows {
                let mut videos = BTreeMap::new();
                for key in self.videos() {
                    let chunk = table.integers(&format!("videos/{key}/chunk_index"))?[row];
                    let file = table.integers(&format!("videos/{key}/file_index"))?[row];
                    let from = table.numbers(&format!("videos/{key}/from_timestamp"))?.1[row];
                    let template = self.info.video_path.as_deref().unwrap_or_default();
                    videos.insert(key.to_owned(), (place(template, (chunk, file), key)?, from));
                }
                let task = if table.has("tasks") {
                    table.texts("tasks")?[row].clone()
                } else {
                    String::new()
                };
                let data = place(&self.info.data_path, (data_chunk[row], data_file[row]), "")?;
                episodes.push(EpisodeMeta {
                    index: index[row],
                    task,
                    length: length[row],
                    data,
                    videos,
                });
            }
        }
        Ok(episodes)
    }
}

fn sorted(folder: &Path) -> StageResult<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|error| io_error(folder, &error))?;
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.sort();
    Ok(paths)
}

/// Fills a Python format string: `{video_key}` and numbers such as `{episode_index:06d}`.
fn fill(template: &str, numbers: &[(&str, u64)], key: &str) -> Result<String, String> {
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
    fn names_are_flattened() {
        let names = |json: &str| serde_json::from_str::<Feature>(json).unwrap().entry_names();
        assert_eq!(names(r#"{"dtype":"float32","names":[["a","b"]]}"#), ["a", "b"]);
        assert_eq!(names(r#"{"dtype":"float32","names":{"motors":["a"]}}"#), ["a"]);
        assert!(names(r#"{"dtype":"float32","names":null}"#).is_empty());
    }
}
