//! How stage programs are found and asked.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use rogs_schemas::protocol::Description;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::error::{Error, Result, io};
use crate::stage::StageId;

/// Where the stage programs are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum StagePrograms {
    /// All stages are inside one program, as `PROGRAM PREFIX... NAME ...`; `rogs` itself is one with prefix `stage`.
    Embedded {
        /// The program.
        program: PathBuf,
        /// Arguments before the stage's name.
        prefix: Vec<String>,
    },
    /// A folder with programs `rogs-NAME`.
    Directory(PathBuf),
}

/// An episode as `rogs-ingest list ROOT --json` tells it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ListedEpisode {
    /// Id of the episode in its dataset.
    pub episode_id: String,
    /// Which importer reads it.
    pub layout: String,
    /// The dataset's folder below the root; ingest gets this folder.
    #[serde(default)]
    pub folder: PathBuf,
    /// Name for people, where the id is none; may be empty.
    #[serde(default)]
    pub name: String,
    /// What ingest needs to pick it out of the folder; empty when the folder is the episode.
    #[serde(default)]
    pub selector: String,
    /// Its frames, where they are known without opening it.
    #[serde(default)]
    pub frames: Option<u64>,
    /// The files it is made of, below the folder.
    #[serde(default)]
    pub files: Vec<PathBuf>,
}

impl ListedEpisode {
    /// What a person may call this episode: its id, its name, or its selector, alone or after its folder.
    pub fn names(&self) -> impl Iterator<Item = String> + '_ {
        let within = self.folder.join(&self.selector).to_string_lossy().into_owned();
        let names = [
            self.episode_id.clone(),
            self.name.clone(),
            self.selector.clone(),
            within,
        ];
        names.into_iter().filter(|name| !name.is_empty())
    }
}

impl StagePrograms {
    /// The program that is running now, with its stages behind `stage NAME`.
    ///
    /// # Errors
    /// When the system does not tell which program this is.
    pub fn this_program() -> Result<Self> {
        let program = std::env::current_exe().map_err(io("cannot find the program", Path::new("rogs")))?;
        Ok(Self::Embedded {
            program,
            prefix: vec!["stage".to_owned()],
        })
    }

    /// The program, or the folder with the programs.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            Self::Embedded { program, .. } => program,
            Self::Directory(folder) => folder,
        }
    }

    /// A command that starts a stage program, without arguments.
    #[must_use]
    pub fn command(&self, stage: StageId) -> Command {
        match self {
            Self::Embedded { program, prefix } => {
                let mut command = Command::new(program);
                command.args(prefix).arg(stage.name());
                command
            }
            Self::Directory(folder) => Command::new(folder.join(format!("rogs-{stage}"))),
        }
    }

    /// The command line of a stage program, word by word.
    #[must_use]
    pub fn words(&self, stage: StageId) -> Vec<String> {
        let command = self.command(stage);
        let words = std::iter::once(command.get_program()).chain(command.get_args());
        words.map(|word| word.to_string_lossy().into_owned()).collect()
    }

    /// What a stage is, with the given parameters normalised: defaults filled in, numbers as the stage holds them.
    ///
    /// # Errors
    /// When the program cannot be started, or refuses the parameters.
    pub fn describe(&self, stage: StageId, params: &Value) -> Result<Description> {
        let output = self.answer(
            stage,
            &["describe".to_owned(), "--params".to_owned(), params.to_string()],
        )?;
        let description: Description = serde_json::from_slice(&output)
            .map_err(|error| self.error(stage, format!("`describe` did not answer with a description: {error}")))?;
        if description.stage != stage.name() {
            return Err(self.error(
                stage,
                format!("`describe` says that it is stage `{}`", description.stage),
            ));
        }
        Ok(description)
    }

    /// The episodes in a folder, by their ids; `counted` with the frames of all, which may mean to open each.
    ///
    /// # Errors
    /// When ingest cannot be started or does not know what the folder holds.
    pub fn list_episodes(&self, root: &Path, counted: bool) -> Result<Vec<ListedEpisode>> {
        let words = ["list".to_owned(), root.display().to_string(), "--json".to_owned()];
        let frames = counted.then(|| "--frames".to_owned());
        let words: Vec<String> = words.into_iter().chain(frames).collect();
        let output = self.answer(StageId::Ingest, &words)?;
        let mut episodes: Vec<ListedEpisode> = serde_json::from_slice(&output)
            .map_err(|error| self.error(StageId::Ingest, format!("`list` did not answer with episodes: {error}")))?;
        episodes.sort_by(|a, b| (&a.episode_id, &a.folder, &a.selector).cmp(&(&b.episode_id, &b.folder, &b.selector)));
        Ok(episodes)
    }

    /// The files with references in a folder, by episode and by role; relative to the folder.
    ///
    /// # Errors
    /// When ingest cannot be started or the folder cannot be read.
    pub fn list_references(&self, root: &Path) -> Result<HashMap<String, BTreeMap<String, PathBuf>>> {
        let output = self.answer(
            StageId::Ingest,
            &["caches".to_owned(), root.display().to_string(), "--json".to_owned()],
        )?;
        serde_json::from_slice(&output)
            .map_err(|error| self.error(StageId::Ingest, format!("`caches` did not answer with files: {error}")))
    }

    fn answer(&self, stage: StageId, arguments: &[String]) -> Result<Vec<u8>> {
        let output = self.command(stage).args(arguments).stdin(Stdio::null()).output();
        let output = output.map_err(|error| {
            let error = self.error(stage, format!("cannot be started: {error}"));
            match self {
                Self::Directory(folder) => error.with_hint(format!("is `rogs-{stage}` in `{}`?", folder.display())),
                Self::Embedded { .. } => error,
            }
        })?;
        if output.status.success() {
            return Ok(output.stdout);
        }
        // The program says what is wrong in the form `error: ...` and `hint: ...`.
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        let line = |start: &str| stderr.lines().find_map(|line| line.strip_prefix(start)).map(str::trim);
        // Only a program that ended by itself and says why has looked at what it was asked; others were killed, or are none
        // of ours.
        let Some(message) = line("error:").filter(|_| output.status.code().is_some()) else {
            let error = self.error(stage, format!("ended with {}: {}", output.status, stderr.trim()));
            return Err(match output.status.code() {
                None => error.with_hint("something killed it; is there enough memory? Run again"),
                Some(_) => error,
            });
        };
        let error = Error::Usage {
            message: format!("{stage}: {message}"),
            hint: None,
        };
        Err(match line("hint:") {
            Some(hint) => error.with_hint(hint),
            None => error,
        })
    }

    fn error(&self, stage: StageId, message: String) -> Error {
        Error::Program {
            program: self.words(stage).join(" "),
            message,
            hint: None,
        }
    }
}
