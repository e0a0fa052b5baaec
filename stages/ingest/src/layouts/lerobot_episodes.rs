//! The episodes of a LeRobot data set: all of them for the listing, or the one that a clip is cut from. Metadata lie in
//! `meta/episodes.jsonl` (v2.1) or `meta/episodes/chunk-*/file-*.parquet` (v3.0), one line or row an episode.
//!
//! A data set may have a hundred thousand episodes. The listing reads every line or row once; finding one episode reads
//! some lines around it (they are sorted by index) or the row groups whose statistics admit it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufRead, BufReader, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use rogs_worker::{StageError, StageResult};
use serde::Deserialize;

use super::lerobot_meta::{Dataset, EpisodeMeta, Version, fill, selector};
use super::parquet_table::{Table, Work};
use crate::fault::{io_error, wrong};

/// Episodes of v2.1.
const LINES: &str = "meta/episodes.jsonl";
/// Folder with the episodes of v3.0.
const TABLES: &str = "meta/episodes";
/// Longest line of `meta/episodes.jsonl`, bytes.
const MAX_LINE: u64 = 1 << 20;
/// Lines this near to each other are read one by one, bytes.
const NEAR: u64 = 4096;

/// An entry of the listing.
pub(crate) struct Listed {
    /// What selects it.
    pub(crate) selector: String,
    /// The episode; `None` where its line or row is damaged, which ingesting it tells.
    pub(crate) episode: Option<EpisodeMeta>,
    /// File of the metadata that describes it, relative.
    pub(crate) described_by: String,
}

#[derive(Deserialize)]
struct Line {
    episode_index: u64,
    #[serde(default)]
    tasks: Vec<String>,
    length: u64,
}

impl Dataset {
    /// Every episode, in the order of the metadata. A damaged line or row is an entry too, under the index that its place
    /// gives it.
    pub(crate) fn episodes(&self) -> StageResult<Vec<Listed>> {
        let mut work = Work::default();
        self.episodes_counted(&mut work)
    }

    fn episodes_counted(&self, work: &mut Work) -> StageResult<Vec<Listed>> {
        match self.version {
            Version::V21 => self.all_lines(work),
            Version::V30 => self.all_rows(work),
        }
    }

    /// The episode of a selector: `episode_000010` or `10`, or empty for the only one.
    pub(crate) fn select(&self, selector: &str) -> StageResult<EpisodeMeta> {
        let mut work = Work::default();
        self.select_counted(selector, &mut work)
    }

    fn select_counted(&self, wanted: &str, work: &mut Work) -> StageResult<EpisodeMeta> {
        let which = if wanted.is_empty() {
            let all = self.episodes_counted(work)?;
            match &all[..] {
                [only] => only.selector.clone(),
                all => {
                    let text = format!("`{}` holds {} episodes: say which", self.root.display(), all.len());
                    return Err(StageError::bad_params(text)
                        .with_hint("set `episode` to a selector that `rogs list FOLDER` prints"));
                }
            }
        } else {
            wanted.to_owned()
        };
        let missing = || {
            StageError::bad_input(format!("`{}` has no episode `{which}`", self.root.display()))
                .with_hint("`rogs list FOLDER` prints those that it has")
        };
        let index = which.strip_prefix("episode_").unwrap_or(&which).parse::<u64>();
        let index = index.map_err(|_| missing())?;
        let found = match self.version {
            Version::V21 => self.find_line(index, work)?,
            Version::V30 => self.find_row(index, work)?,
        };
        found.ok_or_else(missing)
    }

    /// Where the data and the videos of an episode of v2.1 lie.
    fn of_line(&self, line: Line) -> StageResult<EpisodeMeta> {
        let index = line.episode_index;
        let numbers = [
            ("episode_chunk", index / self.info.chunks_size),
            ("episode_index", index),
        ];
        let place = |template: &str, key: &str| {
            fill(template, &numbers, key).map_err(|what| wrong(&self.root.join("meta/info.json"), what))
        };
        let mut videos = BTreeMap::new();
        for key in self.videos() {
            let template = self.info.video_path.as_deref().unwrap_or_default();
            videos.insert(key.to_owned(), (place(template, key)?, 0.0));
        }
        Ok(EpisodeMeta {
            index,
            task: line.tasks.into_iter().next().unwrap_or_default(),
            length: line.length,
            described_by: LINES.to_owned(),
            data: place(&self.info.data_path, "")?,
            videos,
        })
    }

    fn all_lines(&self, work: &mut Work) -> StageResult<Vec<Listed>> {
        let mut lines = Lines::open(&self.root.join(LINES))?;
        let (mut found, mut given) = (Vec::new(), BTreeSet::new());
        let mut damaged = Vec::new();
        let mut number = 0;
        while let Some((_, line)) = lines.next(work)? {
            match rogs_schemas::json::read::<Line>(&line) {
                Ok(line) => {
                    given.insert(line.episode_index);
                    found.push(self.of_line(line)?);
                }
                Err(_) => damaged.push(number),
            }
            number += 1;
        }
        Ok(listed(
            found,
            given,
            damaged.into_iter().map(|place| (place, LINES.to_owned())),
        ))
    }

    /// The episode of an index: by halving the file, which is sorted in every data set seen, else by reading all of it.
    fn find_line(&self, index: u64, work: &mut Work) -> StageResult<Option<EpisodeMeta>> {
        let path = self.root.join(LINES);
        let mut lines = Lines::open(&path)?;
        let line = match lines.halve(index, work)? {
            Some(line) => Some(line),
            None => lines.scan(index, work)?,
        };
        line.map(|line| self.of_line(line)).transpose()
    }

    /// Files with the episodes of v3.0, sorted.
    pub(super) fn tables(&self) -> StageResult<Vec<PathBuf>> {
        let mut files = Vec::new();
        for chunk in sorted(&self.root.join(TABLES))? {
            if chunk.is_dir() {
                let is_table = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "parquet");
                files.extend(sorted(&chunk)?.into_iter().filter(is_table));
            }
        }
        Ok(files)
    }

    fn relative(&self, path: &Path) -> String {
        path.strip_prefix(&self.root)
            .unwrap_or(path)
            .to_string_lossy()
            .into_owned()
    }

    fn all_rows(&self, work: &mut Work) -> StageResult<Vec<Listed>> {
        let (mut found, mut given, mut damaged) = (Vec::new(), BTreeSet::new(), Vec::new());
        let mut before = 0;
        for path in self.tables()? {
            let columns = Columns::read(self, &path, None, work)?;
            for row in 0..columns.rows() {
                match columns.episode(self, row) {
                    Ok(episode) => {
                        given.insert(episode.index);
                        found.push(episode);
                    }
                    Err(_) => damaged.push((before + row as u64, columns.described_by.clone())),
                }
            }
            before += columns.rows() as u64;
        }
        Ok(listed(found, given, damaged.into_iter()))
    }

    fn find_row(&self, index: u64, work: &mut Work) -> StageResult<Option<EpisodeMeta>> {
        let (mut before, mut placed) = (0, None);
        for path in self.tables()? {
            let columns = Columns::read(self, &path, Some(index), work)?;
            match columns.rows() {
                0 => {}
                1 => return columns.episode(self, 0).map(Some),
                several => return Err(wrong(&path, format!("{several} rows describe episode {index}"))),
            }
            if (before..before + columns.of).contains(&index) {
                placed = Some((path, (index - before) as usize));
            }
            before += columns.of;
        }
        // A row without a readable index is known by its place.
        let Some((path, row)) = placed else { return Ok(None) };
        let columns = Columns::read(self, &path, None, work)?;
        columns.index(row).map(|_| None)
    }
}

/// The entries of a listing: the episodes, and damaged ones under the index of their place where nothing else has it.
fn listed(found: Vec<EpisodeMeta>, given: BTreeSet<u64>, damaged: impl Iterator<Item = (u64, String)>) -> Vec<Listed> {
    let whole = found.into_iter().map(|episode| Listed {
        selector: episode.selector(),
        described_by: episode.described_by.clone(),
        episode: Some(episode),
    });
    let broken = damaged
        .filter(|(place, _)| !given.contains(place))
        .map(|(place, described_by)| Listed {
            selector: selector(place),
            episode: None,
            described_by,
        });
    whole.chain(broken).collect()
}

/// The columns of one file of v3.0 that say where episodes lie, each converted once.
struct Columns {
    path: PathBuf,
    described_by: String,
    /// Rows of the whole file.
    of: u64,
    table: Table,
    videos: Vec<String>,
}

impl Columns {
    /// All rows, or those of one episode.
    fn read(dataset: &Dataset, path: &Path, only: Option<u64>, work: &mut Work) -> StageResult<Self> {
        // Everything but the statistics.
        let wanted = |name: &str| !name.starts_with("stats/");
        let table = Table::read_where(path, &wanted, only.map(|index| ("episode_index", index)), work)?;
        Ok(Self {
            path: path.to_owned(),
            described_by: dataset.relative(path),
            of: table.of,
            table,
            videos: dataset.videos().into_iter().map(str::to_owned).collect(),
        })
    }

    fn rows(&self) -> usize {
        self.table.rows
    }

    fn index(&self, row: usize) -> StageResult<u64> {
        self.table.integer("episode_index", row)
    }

    fn episode(&self, dataset: &Dataset, row: usize) -> StageResult<EpisodeMeta> {
        let table = &self.table;
        let index = self.index(row)?;
        let place = |template: &str, numbers: (u64, u64), key: &str| {
            let numbers = [("chunk_index", numbers.0), ("file_index", numbers.1)];
            fill(template, &numbers, key).map_err(|what| wrong(&dataset.root.join("meta/info.json"), what))
        };
        let mut videos = BTreeMap::new();
        for key in &self.videos {
            let chunk = table.integer(&format!("videos/{key}/chunk_index"), row)?;
            let file = table.integer(&format!("videos/{key}/file_index"), row)?;
            let column = format!("videos/{key}/from_timestamp");
            let from = table.number(&column, row)?;
            if !from.is_finite() {
                return Err(wrong(
                    &self.path,
                    format!("column `{column}`: {from} for episode {index}"),
                ));
            }
            let template = dataset.info.video_path.as_deref().unwrap_or_default();
            videos.insert(key.clone(), (place(template, (chunk, file), key)?, from));
        }
        // Text for people: that it is missing or strange is no reason to stop.
        let task = table.texts("tasks").ok().and_then(|tasks| tasks.get(row).cloned());
        let task = task.unwrap_or_default();
        let numbers = (
            table.integer("data/chunk_index", row)?,
            table.integer("data/file_index", row)?,
        );
        Ok(EpisodeMeta {
            index,
            task,
            length: table.integer("length", row)?,
            described_by: self.described_by.clone(),
            data: place(&dataset.info.data_path, numbers, "")?,
            videos,
        })
    }
}

/// `meta/episodes.jsonl`, read line by line.
pub(super) struct Lines {
    path: PathBuf,
    file: BufReader<File>,
    length: u64,
    /// Where the next line begins.
    at: u64,
}

impl Lines {
    pub(super) fn open(path: &Path) -> StageResult<Self> {
        let file = rogs_files::open(path).map_err(|error| io_error(path, &error))?;
        let length = file.metadata().map_err(|error| io_error(path, &error))?.len();
        Ok(Self {
            path: path.to_owned(),
            file: BufReader::with_capacity(NEAR as usize, file),
            length,
            at: 0,
        })
    }

    fn go_to(&mut self, at: u64) -> StageResult<()> {
        self.file
            .seek(SeekFrom::Start(at))
            .map_err(|error| io_error(&self.path, &error))?;
        self.at = at;
        Ok(())
    }

    /// Where the next line that is not empty begins, and what it says.
    pub(super) fn next(&mut self, work: &mut Work) -> StageResult<Option<(u64, String)>> {
        loop {
            let begin = self.at;
            let mut line = Vec::new();
            let mut bounded = (&mut self.file).take(MAX_LINE);
            let read = bounded
                .read_until(b'\n', &mut line)
                .map_err(|error| io_error(&self.path, &error))? as u64;
            work.bytes += read;
            self.at += read;
            if read == 0 {
                return Ok(None);
            }
            if read == MAX_LINE && !line.ends_with(b"\n") {
                return Err(wrong(
                    &self.path,
                    format!("the line at byte {begin} is longer than {MAX_LINE} bytes"),
                ));
            }
            let line = String::from_utf8_lossy(&line);
            if !line.trim().is_empty() {
                return Ok(Some((begin, line.trim().to_owned())));
            }
        }
    }

    /// Looks for an episode in lines that ascend; `None` when it is not where it should be.
    fn halve(&mut self, index: u64, work: &mut Work) -> StageResult<Option<Line>> {
        // The line, if it is there, begins in `low..high`; a line begins at `low`.
        let (mut low, mut high) = (0, self.length);
        while high - low > NEAR {
            let middle = low + (high - low) / 2;
            // The line in which `middle` lies has begun before; the one after it is looked at.
            self.go_to(middle)?;
            let mut rest = Vec::new();
            let skipped = (&mut self.file).take(MAX_LINE).read_until(b'\n', &mut rest);
            let skipped = skipped.map_err(|error| io_error(&self.path, &error))? as u64;
            work.bytes += skipped;
            self.at += skipped;
            let Some((begin, text)) = self.next(work)?.filter(|(begin, _)| *begin < high) else {
                high = middle + 1;
                continue;
            };
            let Ok(line) = rogs_schemas::json::read::<Line>(&text) else {
                return Ok(None);
            };
            match line.episode_index.cmp(&index) {
                std::cmp::Ordering::Equal => return Ok(Some(line)),
                std::cmp::Ordering::Less => low = begin,
                std::cmp::Ordering::Greater => high = middle + 1,
            }
        }
        self.go_to(low)?;
        while let Some((_, text)) = self.next(work)?.filter(|(begin, _)| *begin < high) {
            match rogs_schemas::json::read::<Line>(&text) {
                Ok(line) if line.episode_index == index => return Ok(Some(line)),
                Ok(_) => {}
                Err(_) => return Ok(None),
            }
        }
        Ok(None)
    }

    /// Looks for an episode in all lines. A line that is damaged is its own when no other has its index.
    fn scan(&mut self, index: u64, work: &mut Work) -> StageResult<Option<Line>> {
        self.go_to(0)?;
        let mut damaged = None;
        let mut number = 0;
        while let Some((_, text)) = self.next(work)? {
            match rogs_schemas::json::read::<Line>(&text) {
                Ok(line) if line.episode_index == index => return Ok(Some(line)),
                Err(error) if number == index => {
                    damaged = Some(wrong(&self.path, format!("line {} is no episode: {error}", number + 1)));
                }
                _ => {}
            }
            number += 1;
        }
        damaged.map_or(Ok(None), Err)
    }
}

fn sorted(folder: &Path) -> StageResult<Vec<PathBuf>> {
    let entries = rogs_files::entries(folder).map_err(|error| io_error(folder, &error))?;
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.sort();
    Ok(paths)
}

#[cfg(test)]
#[path = "../../tests/common/tables.rs"]
mod tables;

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
mod tests {
    use super::tables::{self, Values};
    use super::*;

    const INFO: &str = r#"{"codebase_version":"VERSION","fps":15,"data_path":"data/{episode_index}.parquet",
        "video_path":"videos/{video_key}/{episode_index}.mp4","features":{"cam":{"dtype":"video"}}}"#;

    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str, version: &str) -> Self {
            let path = std::env::temp_dir().join(format!("rogs-lerobot-{name}-{}", std::process::id()));
            let _ = std::fs::remove_dir_all(&path);
            std::fs::create_dir_all(path.join("meta/episodes/chunk-000")).unwrap();
            let info = INFO.replace("VERSION", version);
            let info = match version {
                "v3.0" => info.replace("{episode_index}", "{chunk_index}-{file_index}"),
                _ => info,
            };
            std::fs::write(path.join("meta/info.json"), info).unwrap();
            Self(path)
        }

        fn dataset(&self) -> Dataset {
            Dataset::open(&self.0).unwrap()
        }

        fn lines(&self, lines: impl Iterator<Item = String>) {
            let text: Vec<String> = lines.collect();
            std::fs::write(self.0.join(LINES), text.join("\n")).unwrap();
        }

        /// One file of v3.0 with these episodes, `group` rows a row group; `None` is a missing index.
        fn rows(&self, file: u32, index: &[Option<i64>], group: usize) {
            let n = index.len();
            let of = |value: i64| Values::Integers(vec![Some(value); n]);
            let columns = [
                ("episode_index", Values::Integers(index.to_vec())),
                ("length", of(100)),
                ("data/chunk_index", of(0)),
                ("data/file_index", of(0)),
                ("videos/cam/chunk_index", of(0)),
                ("videos/cam/file_index", of(i64::from(file))),
                ("videos/cam/from_timestamp", Values::Numbers(vec![0.5; n])),
            ];
            let path = self.0.join(format!("{TABLES}/chunk-000/file-{file:03}.parquet"));
            tables::write(&path, &columns, group);
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    fn line(index: u64) -> String {
        format!(
            r#"{{"episode_index":{index},"tasks":["task {index}"],"length":{}}}"#,
            50 + index % 7
        )
    }

    /// What the listing and one episode cost for a data set of `n` episodes.
    fn work(name: &str, n: u64, version: &str) -> (Work, Work) {
        let folder = Folder::new(&format!("{name}-{n}"), version);
        if version == "v3.0" {
            for (file, part) in (0..n as i64)
                .map(Some)
                .collect::<Vec<_>>()
                .chunks(n as usize / 4)
                .enumerate()
            {
                folder.rows(file as u32, part, 10);
            }
        } else {
            folder.lines((0..n).map(line));
        }
        let (dataset, mut all, mut one) = (folder.dataset(), Work::default(), Work::default());
        assert_eq!(dataset.episodes_counted(&mut all).unwrap().len() as u64, n);
        let index = n * 2 / 3;
        let found = dataset
            .select_counted(&format!("episode_{index:06}"), &mut one)
            .unwrap();
        assert_eq!(found.index, index);
        (all, one)
    }

    #[test]
    fn the_listing_reads_twice_as_much_of_twice_the_episodes_and_one_episode_no_more() {
        let ((all, one), (twice, same)) = (work("rows", 2000, "v3.0"), work("rows", 4000, "v3.0"));
        assert_eq!((all.rows, twice.rows), (2000, 4000));
        assert_eq!((one.rows, same.rows), (10, 10));
        let ((all, one), (twice, same)) = (work("lines", 20_000, "v2.1"), work("lines", 40_000, "v2.1"));
        assert!(twice.bytes < 2 * all.bytes + 40_000, "{all:?} {twice:?}");
        // Halving needs one more step, of a line and a part of one.
        assert!(
            one.bytes < 3 * NEAR && same.bytes < one.bytes + 200 + NEAR,
            "{one:?} {same:?}"
        );
    }

    #[test]
    fn every_line_is_found_also_where_they_do_not_ascend() {
        let folder = Folder::new("all", "v2.1");
        folder.lines((0..300).map(line));
        let dataset = folder.dataset();
        for index in 0..300 {
            let episode = dataset.select(&index.to_string()).unwrap();
            assert_eq!(
                (episode.index, episode.task.as_str()),
                (index, format!("task {index}").as_str())
            );
        }
        assert!(
            dataset
                .select("300")
                .unwrap_err()
                .to_string()
                .contains("no episode `300`")
        );
        folder.lines((0..300).rev().map(line));
        for index in [0, 17, 150, 299] {
            assert_eq!(folder.dataset().select(&index.to_string()).unwrap().index, index);
        }
    }

    #[test]
    fn a_damaged_line_or_row_fails_its_episode_alone() {
        let folder = Folder::new("line", "v2.1");
        folder.lines((0..5).map(|index| {
            if index == 2 {
                r#"{"episode_ind"#.to_owned()
            } else {
                line(index)
            }
        }));
        let listed = folder.dataset().episodes().unwrap();
        let broken: Vec<_> = listed
            .iter()
            .filter(|one| one.episode.is_none())
            .map(|one| one.selector.as_str())
            .collect();
        assert_eq!((listed.len(), broken), (5, vec!["episode_000002"]));
        let error = folder.dataset().select("episode_000002").unwrap_err().to_string();
        assert!(error.contains("episodes.jsonl`: line 3 is no episode"), "{error}");
        assert_eq!(folder.dataset().select("3").unwrap().index, 3);

        let folder = Folder::new("row", "v3.0");
        folder.rows(0, &[Some(0), Some(1), None, Some(3), Some(-4)], 2);
        let listed = folder.dataset().episodes().unwrap();
        let broken: Vec<_> = listed
            .iter()
            .filter(|one| one.episode.is_none())
            .map(|one| one.selector.as_str())
            .collect();
        assert_eq!((listed.len(), broken), (5, vec!["episode_000002", "episode_000004"]));
        let error = folder.dataset().select("2").unwrap_err().to_string();
        assert!(error.contains("column `episode_index` holds NaN in row 2"), "{error}");
        assert_eq!(folder.dataset().select("3").unwrap().index, 3);
    }
}
