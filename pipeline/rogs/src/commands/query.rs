//! `rogs query`: a field at any time, rendered, without running the backbone again.

use std::path::PathBuf;
use std::process::ExitCode;

use super::network::BesideArgs;
use super::render::{ViewArgs, Wanted, render_field};

/// Renders a field at any time in 0..1: the motion heads answer from what the field keeps, at the robot's pose of that time.
///
/// Link poses between frames are interpolated (translation linearly, rotation on the sphere). At a stored time the answer
/// is the stored one.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The field (`field-1.r4c`); the other files of the clip are taken from beside it.
    field: PathBuf,
    /// Normalised time in 0..1.
    #[arg(long)]
    time: f64,
    /// Correction of Stage 2 to apply (`field-2.r4c`).
    #[arg(long, value_name = "FILE")]
    refinement: Option<PathBuf>,
    #[command(flatten)]
    beside: BesideArgs,
    #[command(flatten)]
    view: ViewArgs,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let wanted = Wanted {
        refinement: args.refinement.as_deref(),
        time: Some(args.time),
        film: None,
    };
    render_field(&args.field, &wanted, &args.beside, &args.view)
}
