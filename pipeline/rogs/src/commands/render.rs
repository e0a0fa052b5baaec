//! `rogs render`: a field at a time, or a 3DGS PLY, seen from any camera.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context as _, bail, ensure};
use rogs_geometry::{Base, Camera as CameraFrame, Pose, Recon};
use rogs_schemas::records::field::Field;
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::{Intrinsics, read_record};
use rogs_splat::{Camera, Gaussians, RasterConfig, Render, TimedField, render};
use serde::{Deserialize, Serialize};

use crate::output;

/// Renders a field of ours at a stored time, or any 3DGS PLY, to PNG and EXR.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A field (`field-1.r4c`) or a PLY file.
    scene: PathBuf,
    /// Normalised time in 0..1; the nearest stored time must be within 1e-6 (`rogs query` answers others). Default: the
    /// first stored time.
    #[arg(long)]
    time: Option<f64>,
    /// Correction of Stage 2 to apply (`field-2.r4c`).
    #[arg(long, value_name = "FILE")]
    refinement: Option<PathBuf>,
    #[command(flatten)]
    view: ViewArgs,
}

const CAMERA_HELP: &str = "Camera file: JSON, one camera or a list of them, for example

{\"name\": \"view\", \"width\": 280, \"height\": 154,
 \"intrinsics\": {\"fx\": 116, \"fy\": 116, \"cx\": 140, \"cy\": 77},
 \"base_from_camera\": [[1,0,0,0.5], [0,1,0,0], [0,0,1,0.4], [0,0,0,1]]}

Pixel centres at + 0.5; camera axes OpenCV; metres. Say `recon_from_camera` for a pose in the reconstruction frame; for a \
PLY its world is meant by either.";

/// From where, and what is written.
#[derive(Debug, clap::Args)]
pub(crate) struct ViewArgs {
    /// Camera file: JSON, one camera or a list of them.
    #[arg(long, value_name = "JSON", long_help = CAMERA_HELP)]
    camera: PathBuf,
    /// Folder for the pictures; made when missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Also write expected depth (camera z, metres; 0 where nothing is) as NAME.depth.exr.
    #[arg(long)]
    depth: bool,
    /// Also write accumulated opacity as NAME.alpha.exr.
    #[arg(long)]
    alpha: bool,
    /// Print one JSON value: the files and what became of the Gaussians.
    #[arg(long)]
    json: bool,
}

/// A camera file.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum CameraFile {
    Many(Vec<CameraSpec>),
    One(Box<CameraSpec>),
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraSpec {
    #[serde(default = "default_name")]
    name: String,
    width: u32,
    height: u32,
    intrinsics: Intrinsics,
    base_from_camera: Option<[[f64; 4]; 4]>,
    recon_from_camera: Option<[[f64; 4]; 4]>,
}

fn default_name() -> String {
    "view".to_owned()
}

/// What was rendered.
#[derive(Debug, Serialize)]
struct Rendered {
    camera: String,
    files: Vec<PathBuf>,
    time: Option<f64>,
    gaussians: usize,
    visible: usize,
    invalid: usize,
}

/// A scene ready to render, with what a base pose means in it.
struct Scene {
    gaussians: Gaussians,
    time: Option<f64>,
    units_per_metre: f64,
    recon_from_base: Pose<Recon, Base>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    if args
        .scene
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("ply"))
    {
        ensure!(args.refinement.is_none(), "a PLY file takes no refinement");
        ensure!(args.time.is_none(), "a PLY file holds one time; leave `--time` out");
        let scene = rogs_splat::ply::read_ply_file(&args.scene)?;
        let recon_from_base = Pose::from_matrix4(&IDENTITY)?;
        let scene = Scene {
            gaussians: scene.gaussians,
            time: None,
            units_per_metre: 1.0,
            recon_from_base,
        };
        return render_scene(&scene, &args.view);
    }
    let (field, _) = read_record::<Field>(&args.scene)?;
    let mut stored = field.slices.iter().map(|slice| slice.time);
    let time = match args.time {
        None => stored.next(),
        Some(asked) => stored.find(|time| (time - asked).abs() < 1e-6),
    };
    let Some(time) = time else {
        let stored: Vec<String> = field.slices.iter().map(|slice| slice.time.to_string()).collect();
        bail!(
            "the field stores no values at this time; `rogs query` answers any; stored times: {}",
            stored.join(", ")
        );
    };
    render_field(&field, args.refinement.as_deref(), time, &args.view)
}

/// Renders a field at a time that it stores, with the correction of a refinement file where one is given.
pub(crate) fn render_field(
    field: &Field,
    refinement: Option<&Path>,
    time: f64,
    view: &ViewArgs,
) -> anyhow::Result<ExitCode> {
    let refinement = match refinement {
        Some(path) => Some(read_record::<Refinement>(path)?.0),
        None => None,
    };
    let mut timed = TimedField::new(field)?;
    if let Some(refinement) = &refinement {
        timed = timed.with_refinement(refinement)?;
    }
    let scene = Scene {
        gaussians: timed.gaussians(time)?,
        time: Some(time),
        units_per_metre: rogs_schemas::units::UNITS_PER_METRE,
        recon_from_base: Pose::from_rigid(&field.recon_from_base)?,
    };
    render_scene(&scene, view)
}

fn render_scene(scene: &Scene, args: &ViewArgs) -> anyhow::Result<ExitCode> {
    let cameras = read_cameras(&args.camera)?;
    std::fs::create_dir_all(&args.out).with_context(|| format!("making `{}`", args.out.display()))?;
    let mut rendered = Vec::new();
    for spec in &cameras {
        let view = render(&scene.gaussians, &camera(spec, scene)?, &RasterConfig::default())?;
        rendered.push(Rendered {
            camera: spec.name.clone(),
            files: write(args, spec, &view, scene.units_per_metre)?,
            time: scene.time,
            gaussians: scene.gaussians.len(),
            visible: view.counts.visible,
            invalid: view.counts.invalid,
        });
    }
    if args.json {
        output::json(&rendered)?;
        return Ok(ExitCode::SUCCESS);
    }
    for view in &rendered {
        for file in &view.files {
            output::text(&file.display().to_string())?;
        }
        if view.invalid > 0 {
            output::note(&format!(
                "{}: {} Gaussians have invalid values and were left out",
                view.camera, view.invalid
            ));
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn read_cameras(path: &Path) -> anyhow::Result<Vec<CameraSpec>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("reading `{}`", path.display()))?;
    let file = serde_json::from_str(&text).with_context(|| format!("`{}` is no camera file", path.display()))?;
    let cameras = match file {
        CameraFile::Many(cameras) => cameras,
        CameraFile::One(camera) => vec![*camera],
    };
    ensure!(!cameras.is_empty(), "`{}` holds no camera", path.display());
    for camera in &cameras {
        let safe = |c: char| c.is_ascii_alphanumeric() || "._+-".contains(c);
        let name = &camera.name;
        ensure!(
            !name.is_empty() && name.chars().all(safe) && !name.starts_with('.'),
            "camera name `{name}` is no file name: letters, digits and . _ + - only"
        );
    }
    Ok(cameras)
}

const IDENTITY: [f64; 16] = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.];

fn camera(spec: &CameraSpec, scene: &Scene) -> anyhow::Result<Camera> {
    let flat = |matrix: &[[f64; 4]; 4]| -> [f64; 16] { std::array::from_fn(|index| matrix[index / 4][index % 4]) };
    let recon_from_camera: Pose<Recon, CameraFrame> = match (&spec.recon_from_camera, &spec.base_from_camera) {
        (Some(matrix), None) => Pose::from_matrix4(&flat(matrix))?,
        (None, Some(matrix)) => {
            let base_from_camera: Pose<Base, CameraFrame> = Pose::from_matrix4(&flat(matrix))?;
            scene.recon_from_base * base_from_camera
        }
        _ => bail!(
            "camera `{}` needs either `base_from_camera` or `recon_from_camera`",
            spec.name
        ),
    };
    let pose = recon_from_camera.to_rigid();
    Ok(Camera::from_world_pose(
        spec.width,
        spec.height,
        &spec.intrinsics,
        &pose,
        scene.units_per_metre,
    ))
}

fn write(args: &ViewArgs, spec: &CameraSpec, view: &Render, units_per_metre: f64) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    let png = args.out.join(format!("{}.png", spec.name));
    let bytes: Vec<u8> = view
        .rgb
        .iter()
        .map(|value| (value.clamp(0.0, 1.0) * 255.0).round() as u8)
        .collect();
    image::save_buffer(&png, &bytes, spec.width, spec.height, image::ExtendedColorType::Rgb8)
        .with_context(|| format!("writing `{}`", png.display()))?;
    files.push(png);
    let mut plane = |kind: &str, channel: &str, values: Vec<f32>| -> anyhow::Result<()> {
        let path = args.out.join(format!("{}.{kind}.exr", spec.name));
        write_exr(&path, spec.width as usize, spec.height as usize, channel, values)
            .with_context(|| format!("writing `{}`", path.display()))?;
        files.push(path);
        Ok(())
    };
    if args.depth {
        plane(
            "depth",
            "Z",
            view.depth_expected
                .iter()
                .map(|depth| depth / units_per_metre as f32)
                .collect(),
        )?;
    }
    if args.alpha {
        plane("alpha", "A", view.alpha.clone())?;
    }
    Ok(files)
}

/// One channel of f32 values, ZIP compressed.
fn write_exr(path: &Path, width: usize, height: usize, channel: &str, values: Vec<f32>) -> exr::error::UnitResult {
    use exr::prelude::*;

    let channel = AnyChannel::new(channel, FlatSamples::F32(values));
    let layer = Layer::new(
        (width, height),
        LayerAttributes::default(),
        Encoding {
            compression: Compression::ZIP16,
            ..Encoding::default()
        },
        AnyChannels::sort(std::iter::once(channel).collect()),
    );
    Image::from_layer(layer).write().to_file(path)
}
