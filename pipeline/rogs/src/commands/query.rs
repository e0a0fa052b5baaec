//! `rogs query`: a field at any time, rendered, without running the backbone again.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context as _, bail, ensure};
use rogs_geometry::{Base, Link, Pose, Recon, wxyz_f32};
use rogs_lift::{FieldQuery, LiftParams, MotionOptions, RobotAtTime, load_model};
use rogs_schemas::records::conditioning::Conditioning;
use rogs_schemas::records::field::Field;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::units::UNITS_PER_METRE;
use rogs_schemas::{RigidPose, read_record};

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
    /// Weights that the field was lifted with; not needed for seeded weights.
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
        if field.weights.trained && args.weights.is_none() {
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
    let links = maps.link_names.len();
    let recon_from_base: Pose<Recon, Base> = Pose::from_rigid(&maps.recon_from_base)?;
    let position = time * f64::from(field.frame_count.saturating_sub(1));
    let (before, after) = (position.floor() as usize, position.ceil() as usize);
    let at = |frame: usize, link: usize| -> anyhow::Result<&RigidPose> {
        maps.base_from_link
            .get(frame * links + link)
            .with_context(|| format!("the robot maps have no frame {frame}"))
    };
    let query: Vec<Pose<Recon, Link>> = (0..links)
        .map(|link| {
            let between = interpolate(at(before, link)?, at(after, link)?, position - before as f64)?;
            Ok(recon_from_base * between)
        })
        .collect::<anyhow::Result<_>>()?;
    let area = (field.height * field.width) as usize;
    let mut robot = Vec::with_capacity(field.views.len());
    for (index, view) in field.views.iter().enumerate() {
        let stored = conditioning.views.iter().position(|other| other == view);
        let stored = stored.context("the conditioning lacks a source view of the field")?;
        let motions: Vec<Pose<Recon, Recon>> = (0..links)
            .map(|link| {
                let source: Pose<Base, Link> = Pose::from_rigid(at(view.frame as usize, link)?)?;
                Ok(query[link] * (recon_from_base * source).inverse())
            })
            .collect::<anyhow::Result<_>>()?;
        // Support, depth and prior do not depend on the query time; the displacements are laid over them.
        let mut kappa = conditioning.dense(stored, 0);
        let view_maps = &conditioning.view_maps[stored];
        for (&pixel, &link) in view_maps.pixels.iter().zip(&view_maps.link) {
            let pixel = pixel as usize;
            let Some(motion) = motions.get(usize::from(link)) else {
                continue;
            };
            let from = &field.position_m[(index * area + pixel) * 3..][..3];
            let point = glam::DVec3::new(f64::from(from[0]), f64::from(from[1]), f64::from(from[2]));
            let moved = motion.point(point) - point;
            for axis in 0..3 {
                kappa[(2 + axis) * area + pixel] = (moved[axis] * UNITS_PER_METRE) as f32;
            }
        }
        let link_rotation = motions.iter().map(|motion| wxyz_f32(motion.quaternion())).collect();
        robot.push(Some(RobotAtTime { kappa, link_rotation }));
    }
    Ok(robot)
}

/// The pose at `share` of the way from one pose to another.
fn interpolate(a: &RigidPose, b: &RigidPose, share: f64) -> anyhow::Result<Pose<Base, Link>> {
    let (a, b): (Pose<Base, Link>, Pose<Base, Link>) = (Pose::from_rigid(a)?, Pose::from_rigid(b)?);
    let rotation = glam::DMat3::from_quat(a.quaternion().slerp(b.quaternion(), share));
    let translation = a.translation.lerp(b.translation, share);
    Ok(Pose::new(rotation, translation))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halfway_between_two_poses_is_halfway() {
        let a: Pose<Base, Link> = Pose::from_xyz_euler([0.0, 0.0, 0.0], [0.0, 0.0, 0.2]);
        let b: Pose<Base, Link> = Pose::from_xyz_euler([1.0, 2.0, -4.0], [0.0, 0.0, 1.0]);
        let half = interpolate(&a.to_rigid(), &b.to_rigid(), 0.5).unwrap();
        let expected: Pose<Base, Link> = Pose::from_xyz_euler([0.5, 1.0, -2.0], [0.0, 0.0, 0.6]);
        for (found, expected) in half.to_matrix4().iter().zip(expected.to_matrix4()) {
            assert!((found - expected).abs() < 1e-12, "{found} is not {expected}");
        }
    }
}
