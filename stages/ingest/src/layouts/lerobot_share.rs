//! Where an episode of a LeRobot data set lies in a video that it shares with others.

use std::path::Path;

use rogs_worker::StageResult;

use super::lerobot_meta::{Dataset, EpisodeMeta, Version, fill};
use super::parquet_table::{Table, Work};

/// The frames of a shared video that belong to one episode, by the lengths of those in it.
pub(crate) struct Share {
    /// Frames of the episodes before it.
    pub(crate) before: u64,
    /// Frames of all episodes.
    pub(crate) all: u64,
}

impl Dataset {
    /// What the lengths and the order of the episodes in the same video say about where one begins; `None` in v2.1, where
    /// every episode has a video of its own, and where the episodes of the video do not follow each other. Reads the rows of
    /// that video alone.
    pub(crate) fn share(&self, episode: &EpisodeMeta, key: &str) -> StageResult<Option<Share>> {
        let (Version::V30, Some((file, from))) = (self.version, episode.videos.get(key)) else {
            return Ok(None);
        };
        let column = |what: &str| format!("videos/{key}/{what}");
        let (chunks, files, times) = (column("chunk_index"), column("file_index"), column("from_timestamp"));
        let wanted = |name: &str| ["episode_index", "length", &chunks, &files, &times].contains(&name);
        let template = self.info.video_path.as_deref().unwrap_or_default();
        let mut rows: Vec<(u64, u64, f64)> = Vec::new();
        for path in self.tables()? {
            let Some(number) = self.file_number(&path, episode, &files)? else {
                continue;
            };
            let table = Table::read_where(&path, &wanted, Some((files.as_str(), number)), &mut Work::default())?;
            let whole = |column: &str, row: usize| table.integer(column, row).ok();
            let in_file = |row: usize| {
                let numbers = [
                    ("chunk_index", whole(&chunks, row)?),
                    ("file_index", whole(&files, row)?),
                ];
                fill(template, &numbers, key).ok().filter(|own| own == file)
            };
            // A row that is damaged is missing in the sums, which then say nothing.
            rows.extend((0..table.rows).filter_map(|row| {
                in_file(row)?;
                let begin = table.number(&times, row).ok()?;
                Some((whole("episode_index", row)?, whole("length", row)?, begin))
            }));
        }
        rows.sort_by_key(|(index, ..)| *index);
        let follow = rows.windows(2).all(|pair| pair[0].2 < pair[1].2);
        let known = rows
            .iter()
            .any(|(index, _, own)| *index == episode.index && own == from);
        let before = rows.iter().filter(|(index, ..)| *index < episode.index);
        Ok((follow && known).then(|| Share {
            before: before.map(|(_, length, _)| length).sum(),
            all: rows.iter().map(|(_, length, _)| length).sum(),
        }))
    }

    /// The number of the video file of an episode; `None` in a table without that episode.
    fn file_number(&self, path: &Path, episode: &EpisodeMeta, files: &str) -> StageResult<Option<u64>> {
        let wanted = |name: &str| ["episode_index", files].contains(&name);
        let only = Some(("episode_index", episode.index));
        let table = Table::read_where(path, &wanted, only, &mut Work::default())?;
        if table.rows == 0 {
            return Ok(None);
        }
        table.integer(files, 0).map(Some)
    }
}
