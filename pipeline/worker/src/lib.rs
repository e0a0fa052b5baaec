//! The faces of a stage program: `one`, `worker`, `batch`, `describe`.
//!
//! A stage implements [`Stage`]; its binary's `main` is one call of [`stage_main`].
//!
//! | face | for | what it does |
//! |---|---|---|
//! | `one` | a person | runs one clip from named inputs, progress on stderr |
//! | `worker` | the orchestrator | one [`Job`](rogs_schemas::protocol::Job) a line on stdin, one [`Event`](rogs_schemas::protocol::Event) a line on stdout |
//! | `batch` | Slurm arrays, Kubernetes indexed jobs, xargs | one shard of a plan file, skipping what is up to date |
//! | `describe` | the orchestrator, editors | name, version, inputs, parameters with defaults and JSON schema |
//!
//! What a worker promises: a clip that fails or panics does not stop the next one; the stage is loaded once and again
//! only when its parameters or a source input (weights, robot) change; nothing is left beside the output; an output is
//! only accepted when the key asked for equals the hash of its material.

mod batch;
mod cli;
pub mod console;
mod context;
mod describe;
mod error;
mod exit;
mod job;
mod observer;
mod one;
mod params;
mod serve;
mod stage;
mod sys;

pub use cli::{stage_main, stage_main_from};
pub use context::Context;
pub use describe::describe;
pub use error::{StageError, StageResult};
pub use exit::{EXIT_FAILED, EXIT_OK, EXIT_TEMPORARY, EXIT_USAGE};
pub use job::quietly;
pub use observer::{Observer, Part, Unobserved};
pub use params::parse_params;
pub use stage::Stage;
pub use sys::{keep_memory, peak_rss_bytes};
