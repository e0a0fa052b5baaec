//! Which file of a folder of rollouts belongs to which clip.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::model::RolloutFile;
use crate::diagnose::{At, Text};
use crate::error::{Result, io};
use crate::manifest::safe_name;
use crate::sources::SourceCache;

/// Extensions of rollouts that are one file.
const VIDEOS: [&str; 6] = ["mp4", "mkv", "webm", "avi", "mov", "m4v"];

/// The videos and folders in a folder of rollouts.
pub(super) struct RolloutFolder {
    root: PathBuf,
    /// Names of entries by what they are called after: a clip, an episode, or the episode in the name of a Ctrl-World replay.
    by_name: HashMap<String, Vec<String>>,
}

impl RolloutFolder {
    /// Reads the names in a folder.
    ///
    /// # Errors
    /// When it cannot be read.
    pub(super) fn read(root: &Path) -> Result<Self> {
        let mut by_name: HashMap<String, Vec<String>> = HashMap::new();
        for entry in rogs_files::entries(root).map_err(io("cannot read", root))? {
            let path = entry.map_err(io("cannot read", root))?.path();
            let Some(name) = path.file_name().and_then(|name| name.to_str()).map(str::to_owned) else {
                continue;
            };
            let is_video = path
                .extension()
                .and_then(|extension| extension.to_str())
                .is_some_and(|extension| VIDEOS.iter().any(|known| extension.eq_ignore_ascii_case(known)));
            let called = match (path.is_dir(), path.file_stem().and_then(|stem| stem.to_str())) {
                (true, _) => name.clone(),
                (false, Some(stem)) if is_video => replayed(stem).unwrap_or(stem).to_owned(),
                _ => continue,
            };
            by_name.entry(called).or_default().push(name);
        }
        Ok(Self {
            root: root.to_owned(),
            by_name,
        })
    }

    /// The rollout of a clip: what is called by its id, else by its episode's; `None` where nothing is.
    ///
    /// # Errors
    /// When several are, or it cannot be read.
    pub(super) fn of(
        &self,
        clip: &str,
        episode: &str,
        text: &Text,
        sources: &SourceCache,
    ) -> Result<Option<RolloutFile>> {
        let safe = safe_name(episode);
        let called = [clip, episode, &safe]
            .into_iter()
            .find_map(|name| self.by_name.get(name));
        let Some(called) = called else { return Ok(None) };
        let [name] = &called[..] else {
            let mut called = called.clone();
            called.sort();
            let message = format!("clip `{clip}` has several rollouts: {}", called.join(", "));
            let error = text.error(At::key("rollouts").then("root"), message);
            return Err(error.with_hint("keep one of them in the folder, or name it by the clip's id"));
        };
        Ok(Some(RolloutFile {
            name: name.clone(),
            content: sources.source("rollout", &self.root.join(name))?,
        }))
    }
}

/// The episode in the name of a Ctrl-World replay, `time_20260131_120000_traj_899_8_5_TEXT`.
fn replayed(stem: &str) -> Option<&str> {
    let (_, after) = stem.split_once("_traj_")?;
    let mut parts = after.split('_');
    let (episode, start) = (parts.next()?, parts.next()?);
    (!episode.is_empty() && start.parse::<u32>().is_ok()).then_some(episode)
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
mod tests {
    use super::*;

    #[test]
    fn rollouts_are_called_by_clip_episode_or_replay() {
        let root = std::env::temp_dir().join(format!("rogs-rollout-names-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&root);
        for name in ["clip-a", "twice"] {
            std::fs::create_dir_all(root.join(name)).unwrap();
        }
        for name in [
            "ep.1.mp4",
            "time_2026_1_traj_899_8_5_text.mp4",
            "twice.MP4",
            "notes.txt",
            "clip-a.json",
        ] {
            std::fs::write(root.join(name), name).unwrap();
        }
        let folder = RolloutFolder::read(&root).unwrap();
        let text = Text::new(Path::new("manifest.toml"), "[rollouts]\nroot = \"x\"\n");
        let sources = SourceCache::default();
        let of = |clip: &str, episode: &str| folder.of(clip, episode, &text, &sources);
        let name = |clip: &str, episode: &str| of(clip, episode).unwrap().map(|found| found.name);
        assert_eq!(
            name("clip-a", "ep.1").as_deref(),
            Some("clip-a"),
            "the clip's own name comes first"
        );
        assert_eq!(name("clip-b", "ep.1").as_deref(), Some("ep.1.mp4"));
        assert_eq!(
            name("clip-c", "899").as_deref(),
            Some("time_2026_1_traj_899_8_5_text.mp4")
        );
        assert_eq!(name("clip-d", "nobody"), None);
        let error = of("clip-e", "twice").unwrap_err().to_string();
        assert!(error.contains("several rollouts: twice, twice.MP4"), "{error}");
        std::fs::remove_dir_all(&root).unwrap();
    }
}
