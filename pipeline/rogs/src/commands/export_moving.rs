//! Forms of `rogs export field` that hold a scene over time in one file: `.4dgs`, glTF.

use std::path::Path;

use anyhow::{Context as _, bail};
use rogs_export::{FourDgs, Gltf, LinkMesh};
use rogs_field::Axes;
use rogs_geometry::{Base, Pose, Recon};
use rogs_robot::{Mesh, RobotModel};
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::robot::RobotSpec;
use rogs_schemas::units::LengthUnit;
use rogs_splat::Gaussians;

use super::network::BesideArgs;
use super::scene::FieldFile;
use super::viewpoint::Scenery;
use crate::output;

/// The Gaussians at a time, internal units, and what a file says of them.
pub(super) type At<'a> = dyn FnMut(f64) -> anyhow::Result<(Gaussians, [String; 2])> + 'a;

/// What is written where.
pub(super) struct Moving<'a> {
    pub(super) field: &'a Path,
    pub(super) out: &'a Path,
    pub(super) axes: Axes,
    pub(super) urdf: Option<&'a Path>,
    pub(super) beside: &'a BesideArgs,
}

/// Seconds from the beginning of a clip to its end.
fn length(clip: &Clip) -> f64 {
    clip.frame_count().saturating_sub(1) as f64 / clip.fps
}

/// Writes `.4dgs`: the first time is second 0, and the last one lasts as long as a frame.
pub(super) fn four_dgs(
    args: &Moving<'_>,
    file: &FieldFile,
    times: &[f64],
    at: &mut At<'_>,
) -> anyhow::Result<(usize, u64)> {
    ascending(times)?;
    let scenery = scenery(args, file)?;
    let (&first, &last) = times.first().zip(times.last()).context("no time was asked for")?;
    let seconds = |time: f64| (time - first) * length(&scenery.clip);
    let duration = seconds(last) + 1.0 / scenery.clip.fps;
    let mut scene = FourDgs::new(args.axes, LengthUnit::Internal, duration)?;
    let mut count = 0;
    for &time in times {
        let (gaussians, _) = at(time)?;
        count = gaussians.len();
        scene.push(seconds(time), gaussians)?;
    }
    let bytes = scene.finish()?;
    rogs_files::write_bytes(args.out, &bytes)?;
    Ok((count, bytes.len() as u64))
}

/// Writes a binary glTF file; second 0 is the beginning of the clip.
pub(super) fn gltf(
    args: &Moving<'_>,
    file: &FieldFile,
    times: &[f64],
    at: &mut At<'_>,
) -> anyhow::Result<(usize, u64)> {
    ascending(times)?;
    let scenery = scenery(args, file)?;
    let meshes = args.urdf.map_or_else(|| Ok(Vec::new()), link_meshes)?;
    let recon_from_base: Pose<Recon, Base> = Pose::from_rigid(&file.field.recon_from_base)?;
    let world_from_base = match args.axes {
        Axes::Base => Pose::IDENTITY,
        Axes::Recon => recon_from_base.relabelled(),
    };
    let mut scene = Gltf::new(args.axes, LengthUnit::Internal, &world_from_base);
    let mut count = 0;
    for &time in times {
        let (gaussians, _) = at(time)?;
        count = gaussians.len();
        scene.push(time * length(&scenery.clip), &gaussians)?;
    }
    scene.rig(&scenery.clip, &scenery.robot, &meshes)?;
    let bytes = scene.finish(&format!("clip {}", file.field.clip_id))?;
    rogs_files::write_bytes(args.out, &bytes)?;
    Ok((count, bytes.len() as u64))
}

/// A file that plays needs its times in order.
fn ascending(times: &[f64]) -> anyhow::Result<()> {
    let wrong = times.windows(2).find(|pair| pair[0] >= pair[1]);
    wrong.map_or(Ok(()), |pair| {
        bail!("times must ascend: {} follows {}", pair[1], pair[0])
    })
}

fn scenery(args: &Moving<'_>, file: &FieldFile) -> anyhow::Result<Scenery> {
    let (clip, robot) = (args.beside.clip(args.field), args.beside.robot(args.field));
    Scenery::read(&clip, &robot, file.field.clip_id.as_str())
}

/// What the links of a robot look like.
fn link_meshes(urdf: &Path) -> anyhow::Result<Vec<LinkMesh>> {
    let model = RobotModel::load(urdf)?;
    for note in &model.notes {
        output::note(&format!("warning: robot `{}`: {note}", urdf.display()));
    }
    let axes = RobotSpec::default().mesh_axes;
    let mut meshes = Vec::new();
    for link in &model.links {
        let mut whole = Mesh::default();
        for shape in &link.visual {
            whole.append(&Mesh::of_shape(shape, &model.folder, axes)?.mesh);
        }
        meshes.push(LinkMesh {
            link: link.name.clone(),
            positions: whole.positions,
            triangles: whole.triangles,
        });
    }
    Ok(meshes)
}
