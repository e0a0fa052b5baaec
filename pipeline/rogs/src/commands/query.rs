//! `rogs query`: a field at any time, rendered, without running the backbone again.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context as _, bail, ensure};
use rogs_geometry::LinkPoses;
use rogs_lift::{BUILTIN, FieldQuery, LiftParams, MotionOptions, RobotAtTime, load_model};
use rogs_r4c::read_record;
use rogs_schemas::records::clip::SourceView;
use rogs_schemas::records::conditioning::Conditioning;
use rogs_schemas::records::field::Field;
use rogs_schemas::records::robot::RobotMaps;

use super::render::{ViewArgs, render_field};

/// Renders a field at any time in 0..1: the motion heads answer from what the field keeps, at the robot's pose of that time.
///
/// Link poses between frames are interpolated (translation linearly, rotation on the sphere). At a stored time the answer
/// is the stored one.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The field (`field-1.r4c`); `robot.r4c` and `conditioning.r4c` of the clip are taken from beside it.
    field: PathBuf,
    /// Normalised time in 0..1.
    #[arg(long)]
    time: f64,
    /// Weights that the field was lifted with; not needed for the built-in ones and for seeded ones.
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
    /// Correction of Stage 2 to apply (`field-2.r4c`).
    #[arg(long, value_name = "FILE")]
    refinement: Option<PathBuf>,
    /// Robot maps of the clip.
    #[arg(long, value_name = "FILE")]
    robot: Option<PathBuf>,
    /// Conditioning of the clip.
    #[arg(long, value_name = "FILE")]
    conditioning: Option<PathBuf>,
    #[command(flatten)]
    view: ViewArgs,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    ensure!(
        (0.0..=1.0).contains(&args.time),
        "time {} is outside the clip, which spans 0 to 1",
        args.time
    );
    let (mut field, info) = read_record::<Field>(&args.field)?;
    if field.slice_at(args.time).is_none() {
        let params: LiftParams = serde_json::from_str(&info.provenance.material.params)
            .context("the field was written by another version of `lift`; lift it again")?;
        let builtin = field.weights.hash == BUILTIN.hash();
        if field.weights.trained && args.weights.is_none() && !builtin {
            bail!(
                "the field was lifted with `{}`; give that file with `--weights`",
                field.weights.description
            );
        }
        let model = load_model(&params, args.weights.as_deref())?;
        ensure!(
            model.info.hash == field.weights.hash,
            "these are not the weights that the field was lifted with (`{}`)",
            field.weights.description
        );
        let robot = if params.fk_conditioning {
            let beside = |name: &str| args.field.with_file_name(name);
            let maps = args.robot.clone().unwrap_or_else(|| beside("robot.r4c"));
            let conditioning = args.conditioning.clone().unwrap_or_else(|| beside("conditioning.r4c"));
            robot_at(&field, &maps, &conditioning, args.time)?
        } else {
            Vec::new()
        };
        let options = MotionOptions {
            gates: params.gates(),
            robot_motion: params.robot_motion,
        };
        let slice = FieldQuery::new(&field, &model.network, options)?.at(args.time, &robot)?;
        let place = field.slices.partition_point(|stored| stored.time < args.time);
        field.slices.insert(place, slice);
    }
    render_field(&field, args.refinement.as_deref(), args.time, &args.view)
}

/// How the robot moves from each source view to a time between frames.
fn robot_at(field: &Field, maps: &Path, conditioning: &Path, time: f64) -> anyhow::Result<Vec<Option<RobotAtTime>>> {
    let (maps, _) = read_record::<RobotMaps>(maps)?;
    let (conditioning, _) = read_record::<Conditioning>(conditioning)?;
    for id in [&maps.clip_id, &conditioning.clip_id] {
        ensure!(
            *id == field.clip_id,
            "robot maps or conditioning belong to clip `{id}`, the field to `{}`",
            field.clip_id
        );
    }
    let position = time * f64::from(field.frame_count.saturating_sub(1));
    let query = LinkPoses::between_frames(&maps, position)?;
    let points = 3 * (field.height * field.width) as usize;
    let view = |(view, position_m): (&SourceView, &[f32])| {
        let stored = conditioning.views.iter().position(|other| other == view);
        let stored = stored.context("the conditioning lacks a source view of the field")?;
        let motions = query.motion_from(&LinkPoses::at_frame(&maps, view.frame)?);
        Ok(Some(RobotAtTime::new(
            &conditioning,
            stored,
            0,
            &motions,
            Some(position_m),
        )))
    };
    field
        .views
        .iter()
        .zip(field.position_m.chunks_exact(points))
        .map(view)
        .collect()
}
