//! `rogs export field`: the Gaussians of a field for other programs.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context as _, ensure};
use rogs_arrays::{NamedArray, write_npz};
use rogs_export::{splats, spz_bytes};
use rogs_field::{Axes, TimedField, gaussians_in, write_packed_ply, write_ply};
use rogs_files::Draft;
use rogs_geometry::Similarity;
use rogs_schemas::units::LengthUnit;
use rogs_splat::{Colour, Gaussians};
use schemars::JsonSchema;
use serde::Serialize;

use super::export_moving::{At, Moving, four_dgs, gltf};
use super::film::times;
use super::network::BesideArgs;
use super::scene::{FieldFile, Scene};
use crate::output;

/// Writes the Gaussians of a field, at one time or many, for other programs.
///
/// One time gives a file; several give a folder of files `000000.ply`, ... with `times.json`; npz, 4dgs and gltf hold all in
/// one file. Row `n` is the same Gaussian at every time. Metres, rotations (w, x, y, z). `docs/exports.md` says what each
/// form can hold, in which axes.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The field (`field-1.r4c`).
    field: PathBuf,
    /// What is written.
    #[arg(long, value_enum)]
    format: Format,
    /// File or folder to write; nothing may have its name where it is a folder.
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
    /// Times: `all` that are stored, `frames` of the clip, FROM..TO/COUNT, or a list with commas.
    #[arg(long, value_name = "TIMES", default_value = "all")]
    times: String,
    /// Correction of Stage 2 to apply (`field-2.r4c`).
    #[arg(long, value_name = "FILE")]
    refinement: Option<PathBuf>,
    /// Frame: the robot's base, or the reconstruction frame (axes of the first source camera).
    #[arg(long, value_enum, default_value_t)]
    axes: AxesArg,
    /// Leave out Gaussians whose opacity is below this at every one of the times.
    #[arg(long, value_name = "OPACITY", default_value_t = 0.0)]
    min_opacity: f32,
    /// Description of the robot, whose meshes a gltf file shows; without it links are nodes without a mesh.
    #[arg(long, value_name = "URDF")]
    urdf: Option<PathBuf>,
    #[command(flatten)]
    beside: BesideArgs,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// Forms of files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// The PLY of 3D Gaussian splatting.
    Ply,
    /// The compressed PLY of SuperSplat: a quarter of the size, or less.
    PlyCompressed,
    /// SPZ: a twentieth of the size of a PLY.
    Spz,
    /// Binary glTF: Gaussians (extension KHR_gaussian_splatting; several times as morph targets of their centres), links and
    /// cameras animated over the clip.
    Gltf,
    /// The open container of moving Gaussians; several times are keyframes and differences.
    #[value(name = "4dgs")]
    FourDgs,
    /// Arrays for numpy: `times [T]`, `means [T, N, 3]`, `quats [T, N, 4]`, `scales [T, N, 3]`, `opacities [T, N]`, `rgb
    /// [T, N, 3]` or `sh [T, N, K, 3]`.
    Npz,
}

/// Frames of what is written.
#[derive(Debug, Clone, Copy, Default, clap::ValueEnum)]
pub(crate) enum AxesArg {
    #[default]
    Recon,
    Base,
}

impl Format {
    /// Whether several times are files of a folder.
    fn is_sequence(self) -> bool {
        matches!(self, Self::Ply | Self::PlyCompressed | Self::Spz)
    }

    /// Whether it holds finite numbers alone.
    fn is_finite(self) -> bool {
        matches!(self, Self::Spz | Self::Gltf | Self::FourDgs)
    }

    /// How names of its files end.
    fn ending(self) -> &'static str {
        match self {
            Self::Ply | Self::PlyCompressed => "ply",
            Self::Spz => "spz",
            Self::Gltf => "glb",
            Self::FourDgs => "4dgs",
            Self::Npz => "npz",
        }
    }
}

impl From<AxesArg> for Axes {
    fn from(axes: AxesArg) -> Self {
        match axes {
            AxesArg::Recon => Self::Recon,
            AxesArg::Base => Self::Base,
        }
    }
}

/// What was written.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Written {
    /// The file or folder.
    path: PathBuf,
    /// Times in it, in 0..1.
    times: Vec<f64>,
    /// Gaussians of each time.
    gaussians: usize,
    /// Gaussians of the field that are not in it.
    left_out: usize,
    /// Length of all files.
    bytes: u64,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    ensure!(
        (0.0..=1.0).contains(&args.min_opacity),
        "invalid opacity {}: expected 0 to 1",
        args.min_opacity
    );
    let asked = |field: &rogs_schemas::records::field::Field| {
        let stored: Vec<f64> = field.slices.iter().map(|slice| slice.time).collect();
        times(&args.times, &stored, field.frame_count)
    };
    let (file, times) = FieldFile::read(&args.field, args.refinement.as_deref(), asked, &args.beside)?;
    let folder = times.len() > 1 && args.format.is_sequence();
    ensure!(
        args.urdf.is_none() || args.format == Format::Gltf,
        "only a gltf file shows meshes of the robot; leave `--urdf` out"
    );
    ensure!(
        !(folder && args.out.exists()),
        "`{}` is there already: name another folder, or remove it",
        args.out.display()
    );
    let mut scene = Scene::of(&file, None)?;
    let keep = kept(&mut scene, &times, args, file.field.len())?;
    let mut at = |time: f64| {
        scene.timed(time, |timed: &TimedField<'_>| {
            let (gaussians, comments) = gaussians_in(timed, time, args.axes.into())?;
            let gaussians = match &keep {
                Some(keep) => gaussians.kept(keep),
                None => gaussians,
            };
            Ok((gaussians, comments))
        })
    };
    let moving = Moving {
        field: &args.field,
        out: &args.out,
        axes: args.axes.into(),
        urdf: args.urdf.as_deref(),
        beside: &args.beside,
    };
    let (gaussians, bytes) = match (args.format, folder) {
        (Format::Npz, _) => arrays(&args.out, &times, &mut at)?,
        (Format::Gltf, _) => gltf(&moving, &file, &times, &mut at)?,
        (Format::FourDgs, _) => four_dgs(&moving, &file, &times, &mut at)?,
        (format, false) => {
            let time = times.first().context("no time was asked for")?;
            let (gaussians, comments) = at(*time)?;
            let bytes = encoded(format, args.axes, gaussians, &comments, &args.out)?;
            rogs_files::write_bytes(&args.out, &bytes)?;
            (kept_count(&keep, &file), bytes.len() as u64)
        }
        (format, true) => sequence(args, format, &times, &mut at)?,
    };
    let written = Written {
        path: args.out.clone(),
        gaussians,
        left_out: file.field.len() - gaussians,
        times,
        bytes,
    };
    if args.json {
        output::json(&written)?;
    } else {
        output::text(&args.out.display().to_string())?;
        output::note(&format!(
            "{} Gaussians at {} times, {} bytes",
            written.gaussians,
            written.times.len(),
            written.bytes
        ));
    }
    Ok(ExitCode::SUCCESS)
}

/// Which Gaussians are opaque enough at one of the times and can be written at all of them; none where all are.
fn kept(scene: &mut Scene<'_>, times: &[f64], args: &Args, count: usize) -> anyhow::Result<Option<Vec<bool>>> {
    let least = args.min_opacity;
    if least <= 0.0 && !args.format.is_finite() {
        return Ok(None);
    }
    let (mut opaque, mut whole) = (vec![least <= 0.0; count], vec![true; count]);
    for &time in times {
        let gaussians = scene.gaussians(time)?;
        for (opaque, opacity) in opaque.iter_mut().zip(&gaussians.opacities) {
            *opaque |= *opacity >= least;
        }
        if args.format.is_finite() {
            for (whole, now) in whole.iter_mut().zip(splats::whole(&gaussians)) {
                *whole &= now;
            }
        }
    }
    ensure!(
        opaque.contains(&true),
        "no Gaussian has an opacity of {least} or more at these times"
    );
    let lost = whole.iter().filter(|whole| !**whole).count();
    if lost > 0 {
        output::note(&format!(
            "{lost} Gaussians have numbers that are not finite and are left out"
        ));
    }
    let keep: Vec<bool> = opaque
        .iter()
        .zip(&whole)
        .map(|(opaque, whole)| *opaque && *whole)
        .collect();
    Ok(if keep.contains(&false) { Some(keep) } else { None })
}

fn kept_count(keep: &Option<Vec<bool>>, file: &FieldFile) -> usize {
    match keep {
        Some(keep) => keep.iter().filter(|keep| **keep).count(),
        None => file.field.len(),
    }
}

fn encoded(
    format: Format,
    axes: AxesArg,
    gaussians: Gaussians,
    comments: &[String],
    path: &Path,
) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let unit = LengthUnit::Internal;
    match format {
        Format::PlyCompressed => write_packed_ply(&gaussians, unit, comments, &mut bytes, path)?,
        Format::Spz => {
            let turned = gaussians.moved(&Similarity::from(splats::y_up_from_world(axes.into())));
            bytes = spz_bytes(&turned, unit)?;
        }
        Format::Ply | Format::Npz | Format::Gltf | Format::FourDgs => {
            write_ply(&gaussians, unit, comments, &mut bytes, path)?;
        }
    }
    Ok(bytes)
}

/// A folder with a file for every time.
fn sequence(args: &Args, format: Format, times: &[f64], at: &mut At<'_>) -> anyhow::Result<(usize, u64)> {
    let draft = Draft::begin(&args.out)?;
    let (mut count, mut total, mut names) = (0, 0, Vec::new());
    for (index, &time) in times.iter().enumerate() {
        let (gaussians, comments) = at(time)?;
        count = gaussians.len();
        let name = format!("{index:06}.{}", format.ending());
        let bytes = encoded(format, args.axes, gaussians, &comments, &args.out)?;
        draft.write(&name, &bytes)?;
        total += bytes.len() as u64;
        names.push(serde_json::json!({ "file": name, "time": time }));
    }
    draft.write("times.json", &serde_json::to_vec_pretty(&names)?)?;
    draft.publish()?;
    Ok((count, total))
}

/// All times in one archive of arrays.
fn arrays(path: &Path, times: &[f64], at: &mut At<'_>) -> anyhow::Result<(usize, u64)> {
    let (mut means, mut quats, mut scales, mut opacities) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut colours, mut per, mut harmonics, mut count) = (Vec::new(), 3, false, 0);
    for &time in times {
        let (gaussians, _) = at(time)?;
        let metres = |value: &f32| LengthUnit::Internal.to_m(*value);
        means.extend(gaussians.means.iter().map(metres));
        scales.extend(gaussians.scales.iter().map(metres));
        quats.extend_from_slice(&gaussians.quats);
        opacities.extend_from_slice(&gaussians.opacities);
        colours.extend_from_slice(gaussians.colour.values());
        per = gaussians.colour.values_per_gaussian();
        harmonics = matches!(gaussians.colour, Colour::Sh { .. });
        count = gaussians.len();
    }
    let t = times.len();
    let colour = if harmonics {
        NamedArray::new("sh", &[t, count, per / 3, 3], &colours)
    } else {
        NamedArray::new("rgb", &[t, count, 3], &colours)
    };
    let all = [
        NamedArray::new("times", &[t], times),
        NamedArray::new("means", &[t, count, 3], &means),
        NamedArray::new("quats", &[t, count, 4], &quats),
        NamedArray::new("scales", &[t, count, 3], &scales),
        NamedArray::new("opacities", &[t, count], &opacities),
        colour,
    ];
    write_npz(path, &all)?;
    Ok((count, std::fs::metadata(path)?.len()))
}
