//! `rogs fk`: forward kinematics of a table of joint values.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context as _;
use rogs_robot::RobotModel;
use rogs_robot::fk_json::fk_rows;

use crate::output;

/// Computes link poses of a robot for every row of a table of joint values.
///
/// Prints a JSON array with one object a row; its `links` maps each link's name to its row-major 4x4 pose in the base
/// link's frame (metres).
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// URDF of the robot.
    robot: PathBuf,
    /// CSV file: a header with joint names, then one row of values (radians, metres) a state. Mimic joints follow.
    #[arg(long, value_name = "CSV")]
    joints: PathBuf,
    /// Frame in which poses are given; by default the root link of the robot.
    #[arg(long, value_name = "LINK")]
    base_link: Option<String>,
    /// Print JSON (the only form there is; accepted so that every command takes it).
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let _ = args.json;
    let mut model = RobotModel::load(&args.robot)?;
    if let Some(base_link) = &args.base_link {
        model = model.with_base_link(base_link)?;
    }
    for note in &model.notes {
        output::note(&format!("warning: robot `{}`: {note}", args.robot.display()));
    }
    let mut reader = csv::ReaderBuilder::new()
        .flexible(true)
        .from_path(&args.joints)
        .with_context(|| format!("reading `{}`", args.joints.display()))?;
    let header: Vec<String> = reader.headers()?.iter().map(str::to_owned).collect();
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.with_context(|| format!("reading `{}`", args.joints.display()))?;
        rows.push(record.iter().map(str::to_owned).collect::<Vec<_>>());
    }
    let rows = fk_rows(&model, &header, rows).with_context(|| format!("in `{}`", args.joints.display()))?;
    output::json(&rows)?;
    Ok(ExitCode::SUCCESS)
}
