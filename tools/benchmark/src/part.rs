//! The parts of the benchmark: where their data, manifests and runs lie.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, bail};

use crate::table::Table;
use crate::{cell, procedural, rooms};

/// Folder of the manifests, below the checkout.
pub(crate) const MANIFESTS: &str = "manifests/benchmark";
/// Data of the rooms, from the checkout.
const ROOMS: &str = "../shared/data/hololens_rooms";
/// Data of the cells, from the checkout.
const CELLS: [&str; 3] = [
    "../shared/data/droid_ctrlworld",
    "../shared/data/droid_ctrlworld/new_setup",
    "../shared/data/droid_ctrlworld_more/new_setup",
];

/// A part of the benchmark.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Part {
    /// Real rooms with sensor depth: three views of one moment each.
    Rooms,
    /// Real robot cells: the robot, the table, and times that the network did not see.
    Cell,
    /// 64 procedural clips at 154x84.
    #[value(name = "procedural-154x84")]
    Procedural154,
    /// The same clips at 280x154.
    #[value(name = "procedural-280x154")]
    Procedural280,
}

impl Part {
    pub(crate) const ALL: [Self; 4] = [Self::Rooms, Self::Cell, Self::Procedural154, Self::Procedural280];

    pub(crate) fn title(self) -> &'static str {
        match self {
            Self::Rooms => "Real rooms",
            Self::Cell => "Real robot cells",
            Self::Procedural154 => "Procedural clips at 154x84",
            Self::Procedural280 => "Procedural clips at 280x154",
        }
    }

    /// Name of its manifest and of its run.
    fn name(self) -> &'static str {
        match self {
            Self::Rooms => "rooms",
            Self::Cell => "cell",
            Self::Procedural154 => "procedural-154x84",
            Self::Procedural280 => "procedural-280x154",
        }
    }

    /// What of others it needs and is not there.
    pub(crate) fn missing(self, checkout: &Path) -> Option<PathBuf> {
        let data: &[&str] = match self {
            Self::Rooms => &[ROOMS],
            Self::Cell => &CELLS,
            Self::Procedural154 | Self::Procedural280 => &[],
        };
        let mut folders = data.iter().map(|data| checkout.join(data));
        folders.find(|folder| !folder.is_dir())
    }

    /// Makes its episodes and runs its manifest; what is up to date is left.
    pub(crate) fn make(self, checkout: &Path, program: &Path) -> anyhow::Result<()> {
        let runs = checkout.join("runs/benchmark");
        match self {
            Self::Rooms => rooms::write(&checkout.join(ROOMS), &runs.join("rooms-data"))?,
            Self::Cell => {}
            Self::Procedural154 | Self::Procedural280 => {
                let size = if self == Self::Procedural154 {
                    "154x84"
                } else {
                    "280x154"
                };
                let data = runs.join(format!("{}-data", self.name()));
                if !data.is_dir() {
                    let seed = procedural::FIRST_SEED.to_string();
                    let clips = procedural::CLIPS.to_string();
                    let mut synth = Command::new(program);
                    synth.arg("synth").arg("--out").arg(&data);
                    synth.args(["--episodes", &clips, "--seed", &seed, "--size", size]);
                    run(synth)?;
                }
            }
        }
        let mut command = Command::new(program);
        let manifest = checkout.join(MANIFESTS).join(self.name()).with_extension("toml");
        command.arg("run").arg(manifest);
        run(command)?;
        // Scores of variants with other weights or parameters would be measured too.
        let mut collect = Command::new(program);
        collect.args(["gc", "--quiet"]).arg(runs.join(self.name()));
        run(collect)
    }

    /// What its run scores.
    pub(crate) fn measure(self, checkout: &Path) -> anyhow::Result<Vec<Table>> {
        let run = checkout.join("runs/benchmark").join(self.name());
        let clips = crate::run::read(&run)?;
        Ok(match self {
            Self::Rooms => vec![rooms::table(&clips, &rooms::free(&checkout.join(ROOMS))?)],
            Self::Cell => cell::tables(&clips)?,
            Self::Procedural154 | Self::Procedural280 => vec![procedural::table(&clips)],
        })
    }
}

fn run(mut command: Command) -> anyhow::Result<()> {
    let shown = format!("{command:?}");
    let status = command.status().with_context(|| format!("starting {shown}"))?;
    // 3: some clips failed, and the page counts the others (docs/exit-codes.md).
    match status.code() {
        Some(0 | 3) => Ok(()),
        _ => bail!("{shown} ended with {status}"),
    }
}
