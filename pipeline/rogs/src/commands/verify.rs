//! `rogs verify`: every byte of the outputs of a run.

use std::fmt::Write as _;
use std::process::ExitCode;

use rogs_orchestrator::verify::verify;

use super::status::Args;
use crate::output;

/// Reads every output completely and checks it against the plan.
pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let found = verify(&args.run)?;
    if args.json {
        output::json(&found)?;
    } else {
        let mut text = format!(
            "{} outputs are good, {} missing, {} bad\n",
            found.good,
            found.missing,
            found.bad.len()
        );
        for bad in &found.bad {
            let _ = writeln!(text, "bad: {}: {}", bad.output.display(), bad.what);
        }
        output::text(&text)?;
    }
    Ok(ExitCode::from(found.exit().code()))
}
