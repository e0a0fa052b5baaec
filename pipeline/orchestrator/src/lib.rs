//! Manifest, plan, cache keys, executors and ledger.
//!
//! The program `rogs` is a thin command line over this crate. The way through it:
//!
//! ```no_run
//! use rogs_orchestrator::{Interrupts, Prepared, programs::StagePrograms};
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let programs = StagePrograms::this_program()?;               // `rogs stage NAME ...`, or StagePrograms::Directory
//! let mut prepared = Prepared::load("demo.toml".as_ref(), programs)?; // manifest -> plan; writes nothing
//! prepared.options.interrupts = Interrupts::install()?;        // Ctrl-C once drains, twice kills
//! let summary = prepared.run()?;                               // lock, freeze plan, run what is not up to date
//! println!("{}", serde_json::to_string(&summary)?);
//! std::process::exit(summary.exit.code().into());
//! # }
//! ```
//!
//! | command | entry point | value for `--json` |
//! |---|---|---|
//! | `plan` | [`Prepared::load`], [`estimate::estimate`]; `--explain`: [`plan::Plan::explain_clip`] | [`estimate::Estimate`], [`explain::Explanation`] |
//! | `run` (= `resume`) | [`Prepared::run`] | [`executor::RunSummary`] |
//! | `status` | [`status::status`] | [`status::Status`] |
//! | `verify` | [`verify::verify`] | [`verify::Verification`] |
//! | `plan --emit jsonl` | [`export::export`] | [`export::Export`] |
//! | `submit` (Slurm) | [`slurm::submit`] | [`slurm::Submission`] |
//! | `gc`, `diff`, `logs` | [`gc::collect`], [`diff::diff`], [`logs::logs`] | [`gc::Collected`], [`diff::Difference`], `[Attempt]` |
//! | `config show` | [`effective::effective`] | `[EffectiveValue]` |
//! | `schema` | [`editor::manifest_schema`] | the JSON schema itself |
//!
//! Every failure of the orchestrator is an [`Error`] with [`Error::hint`] and [`Error::exit`]; failures of clips are values.
//! Errors print as `error: {error}`, then `hint: {hint}`.

pub mod colour;
mod columns;
mod costs;
pub mod diagnose;
pub mod diff;
pub mod editor;
pub mod effective;
pub mod error;
pub mod estimate;
pub mod executor;
pub mod exit;
pub mod explain;
pub mod export;
pub mod gc;
pub mod glob;
pub mod ledger;
pub mod lock;
pub mod logs;
pub mod manifest;
pub mod plan;
pub mod prepare;
pub mod programs;
pub mod quote;
pub mod slurm;
pub mod sources;
pub mod stage;
pub mod state;
pub mod status;
mod sys;
pub mod verify;

pub use columns::columns;
pub use error::{Error, Result};
pub use exit::Exit;
pub use prepare::Prepared;
pub use sys::Interrupts;
