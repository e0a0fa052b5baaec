//! `rogs export field`: the Gaussians of a field for other programs.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context as _, ensure};
use rogs_arrays::{NamedArray, write_npz};
use rogs_field::{Axes, TimedField, gaussians_in, write_packed_ply, write_ply};
use rogs_files::Draft;
use rogs_schemas::units::LengthUnit;
use rogs_splat::{Colour, Gaussians};
use schemars::JsonSchema;
use serde::Serialize;

use super::film::times;
use super::network::BesideArgs;
use super::scene::{FieldFile, Scene};
use crate::output;

/// Writes the Gaussians of a field, at one time or many, for other programs.
///
/// One time gives a file; several give a folder of files `000000.ply`, ... with `times.json`, or one npz. Row `n` is the same
/// Gaussian at every time. Metres, rotations (w, x, y, z).
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
    let folder = times.len() > 1 && args.format != Format::Npz;
    ensure!(
        !(folder && args.out.exists()),
        "`{}` is there already: name another folder, or remove it",
        args.out.display()
    );
    let mut scene = Scene::of(&file, None)?;
    let keep = kept(&mut scene, &times, args.min_opacity, file.field.len())?;
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
    let (gaussians, bytes) = match (args.format, folder) {
        (Format::Npz, _) => arrays(&args.out, &times, &mut at)?,
        (format, false) => {
            let time = times.first().context("no time was asked for")?;
            let (gaussians, comments) = at(*time)?;
            let bytes = encoded(format, &gaussians, &comments, &args.out)?;
            rogs_files::write_bytes(&args.out, &bytes)?;
            (gaussians.len(), bytes.len() as u64)
        }
        (format, true) => sequence(&args.out, format, &times, &mut at)?,
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

/// Which Gaussians are opaque enough at one of the times; none where all are wanted.
fn kept(scene: &mut Scene<'_>, times: &[f64], least: f32, count: usize) -> anyhow::Result<Option<Vec<bool>>> {
    if least <= 0.0 {
        return Ok(None);
    }
    let mut keep = vec![false; count];
    for &time in times {
        let gaussians = scene.gaussians(time)?;
        for (keep, opacity) in keep.iter_mut().zip(&gaussians.opacities) {
            *keep |= *opacity >= least;
        }
    }
    ensure!(
        keep.contains(&true),
        "no Gaussian has an opacity of {least} or more at these times"
    );
    Ok(Some(keep))
}

/// The Gaussians at a time, internal units, and what a file says of them.
type At<'a> = dyn FnMut(f64) -> anyhow::Result<(Gaussians, [String; 2])> + 'a;

fn encoded(format: Format, gaussians: &Gaussians, comments: &[String], path: &Path) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let unit = LengthUnit::Internal;
    match format {
        Format::PlyCompressed => write_packed_ply(gaussians, unit, comments, &mut bytes, path)?,
        Format::Ply | Format::Npz => write_ply(gaussians, unit, comments, &mut bytes, path)?,
    }
    Ok(bytes)
}

/// A folder with a file for every time.
fn sequence(folder: &Path, format: Format, times: &[f64], at: &mut At<'_>) -> anyhow::Result<(usize, u64)> {
    let draft = Draft::begin(folder)?;
    let (mut count, mut total, mut names) = (0, 0, Vec::new());
    for (index, &time) in times.iter().enumerate() {
        let (gaussians, comments) = at(time)?;
        let name = format!("{index:06}.ply");
        let bytes = encoded(format, &gaussians, &comments, folder)?;
        draft.write(&name, &bytes)?;
        count = gaussians.len();
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
