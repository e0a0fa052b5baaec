//! `rogs render`: a field at a time, or a 3DGS PLY, seen from any camera.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context as _, bail, ensure};
use rogs_arrays::{NamedArray, write_exr, write_npz, write_png};
use rogs_field::{Axes, TimedField, export_field};
use rogs_geometry::{Base, Camera, Pinhole, Pose, PosedCamera, Recon};
use rogs_r4c::read_record;
use rogs_schemas::ids::check_name;
use rogs_schemas::records::field::Field;
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::units::LengthUnit;
use rogs_schemas::{Device, Intrinsics, WrittenPose};
use rogs_splat::{Gaussians, RasterCamera, RasterConfig, RasterDevice, Render};
use serde::{Deserialize, Serialize};

use crate::output;

/// Renders a field at a stored time, or any 3DGS PLY, to PNG, EXR and npz; writes a field as PLY.
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

Pixel centres at + 0.5; camera axes OpenCV; metres. Use `recon_from_camera` for a pose in the reconstruction frame; for a \
PLY both mean its world.";

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
    /// Also write NAME.npz with all numbers for Python: rgb, alpha, depth, of a field displacement, intrinsics,
    /// recon_from_camera; metres.
    #[arg(long)]
    npz: bool,
    /// Stored time that the displacement in NAME.npz counts from. Default: the first stored time.
    #[arg(long, value_name = "TIME", requires = "npz")]
    since: Option<f64>,
    /// Also write the Gaussians of the field at this time as `field.ply`, which every 3DGS viewer reads; metres.
    #[arg(long)]
    ply: bool,
    /// Frame of `field.ply`: the robot's base, or the reconstruction frame (axes of the first source camera).
    #[arg(long, value_enum, default_value_t, requires = "ply")]
    axes: AxesArg,
    /// Where to render: `cpu`, or `gpu` where the program was built with the feature `gpu`.
    #[arg(long, value_name = "cpu|gpu", default_value_t)]
    device: Device,
    /// Print one JSON value: the files and what became of the Gaussians.
    #[arg(long)]
    json: bool,
}

/// Frames of a PLY file.
#[derive(Debug, Clone, Copy, Default, clap::ValueEnum)]
enum AxesArg {
    #[default]
    Recon,
    Base,
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
    base_from_camera: Option<WrittenPose>,
    recon_from_camera: Option<WrittenPose>,
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
    /// A field's have their displacement in metres as extra channels where it is asked for.
    gaussians: Gaussians,
    time: Option<f64>,
    /// Of the Gaussians' lengths.
    unit: LengthUnit,
    recon_from_base: Pose<Recon, Base>,
}

/// Writes a scene to a file.
type WritePly<'a> = dyn Fn(&Path) -> anyhow::Result<()> + 'a;

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    if args
        .scene
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("ply"))
    {
        ensure!(args.refinement.is_none(), "a PLY file takes no refinement");
        ensure!(args.time.is_none(), "a PLY file holds one time; leave `--time` out");
        ensure!(
            args.view.since.is_none(),
            "a PLY file holds no displacement; leave `--since` out"
        );
        ensure!(
            !args.view.ply,
            "`{}` is a PLY file already; leave `--ply` out",
            args.scene.display()
        );
        let scene = rogs_field::ply::read_ply_file(&args.scene)?;
        let scene = Scene {
            gaussians: scene.gaussians,
            time: None,
            unit: LengthUnit::Metre,
            recon_from_base: Pose::IDENTITY,
        };
        return render_scene(&scene, &args.view, None);
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
    // A field takes long to read: a camera file with a mistake is reported first.
    read_cameras(&view.camera)?;
    RasterDevice::open(view.device)?;
    let refinement = match refinement {
        Some(path) => Some(read_record::<Refinement>(path)?.0),
        None => None,
    };
    let mut timed = TimedField::new(field)?;
    if let Some(refinement) = &refinement {
        timed = timed.with_refinement(refinement)?;
    }
    let first = field.slices.first().map_or(time, |slice| slice.time);
    let since = view.since.unwrap_or(first);
    let scene = Scene {
        gaussians: if view.npz {
            timed.gaussians_with_displacement(time, since, time)?
        } else {
            timed.gaussians(time)?
        },
        time: Some(time),
        unit: LengthUnit::Internal,
        recon_from_base: Pose::from_rigid(&field.recon_from_base)?,
    };
    let ply = |path: &Path| -> anyhow::Result<()> {
        let axes = match view.axes {
            AxesArg::Recon => Axes::Recon,
            AxesArg::Base => Axes::Base,
        };
        Ok(export_field(&timed, time, axes, path)?)
    };
    render_scene(&scene, view, view.ply.then_some(&ply))
}

fn make_folder(path: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(path).with_context(|| format!("making `{}`", path.display()))
}

/// Renders a scene from all cameras; `ply` writes the scene as a whole. Nothing is written before all that was asked for
/// has been understood.
fn render_scene(scene: &Scene, args: &ViewArgs, ply: Option<&WritePly<'_>>) -> anyhow::Result<ExitCode> {
    let cameras = read_cameras(&args.camera)?;
    let device = RasterDevice::open(args.device)?;
    let views: Vec<(PosedCamera<Recon>, RasterCamera)> = cameras
        .iter()
        .map(|spec| camera(spec, scene))
        .collect::<anyhow::Result<_>>()?;
    make_folder(&args.out)?;
    let whole = match ply {
        Some(write) => {
            let path = args.out.join("field.ply");
            write(&path)?;
            Some(path)
        }
        None => None,
    };
    let mut rendered = Vec::new();
    // A view at a time: images of many large views would not fit in memory together.
    for (spec, (posed, camera)) in cameras.iter().zip(views) {
        let views = device.render_views(&scene.gaussians, &[camera], &RasterConfig::default())?;
        let view = views
            .into_iter()
            .next()
            .context("one view was asked for, none was rendered")?;
        let mut files = write(args, spec, &view, scene.unit)?;
        if args.npz {
            let path = args.out.join(format!("{}.npz", spec.name));
            write_numbers(&path, &posed, &view, scene)?;
            files.push(path);
        }
        rendered.push(Rendered {
            camera: spec.name.clone(),
            files,
            time: scene.time,
            gaussians: scene.gaussians.len(),
            visible: view.counts.visible,
            invalid: view.counts.invalid,
        });
    }
    if args.json {
        // One value per camera; the files of the scene as a whole stand with the first.
        if let Some(first) = rendered.first_mut() {
            first.files.splice(0..0, whole);
        }
        output::json(&rendered)?;
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(file) = &whole {
        output::text(&file.display().to_string())?;
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
    let text = rogs_files::read_to_string(path).with_context(|| format!("reading `{}`", path.display()))?;
    let file = serde_json::from_str(&text).with_context(|| format!("not a camera file: `{}`", path.display()))?;
    let cameras = match file {
        CameraFile::Many(cameras) => cameras,
        CameraFile::One(camera) => vec![*camera],
    };
    ensure!(!cameras.is_empty(), "`{}` holds no camera", path.display());
    for camera in &cameras {
        check_name(&camera.name).context("the name of a camera becomes that of its files")?;
    }
    Ok(cameras)
}

/// The camera of a view, in metres and as it is rendered from.
fn camera(spec: &CameraSpec, scene: &Scene) -> anyhow::Result<(PosedCamera<Recon>, RasterCamera)> {
    let of_camera = || format!("the pose of camera `{}`", spec.name);
    let recon_from_camera: Pose<Recon, Camera> = match (&spec.recon_from_camera, &spec.base_from_camera) {
        (Some(written), None) => Pose::from_written(written).with_context(of_camera)?,
        (None, Some(written)) => {
            let base_from_camera: Pose<Base, Camera> = Pose::from_written(written).with_context(of_camera)?;
            scene.recon_from_base * base_from_camera
        }
        _ => bail!(
            "camera `{}` needs either `base_from_camera` or `recon_from_camera`",
            spec.name
        ),
    };
    let lens = Pinhole {
        intrinsics: spec.intrinsics,
        width: spec.width,
        height: spec.height,
    };
    let posed = PosedCamera::new(lens, recon_from_camera);
    let camera = RasterCamera::new(&posed, scene.unit);
    camera
        .validate()
        .with_context(|| format!("camera `{}` cannot be rendered", spec.name))?;
    Ok((posed, camera))
}

/// All numbers of a view: images of f32, `[H, W]` or `[H, W, 3]`, and the camera in f64.
fn write_numbers(path: &Path, camera: &PosedCamera<Recon>, view: &Render, scene: &Scene) -> rogs_files::Result<()> {
    let (height, width) = (view.height, view.width);
    let depth: Vec<f32> = metres(&view.depth_expected, scene.unit);
    let Intrinsics { fx, fy, cx, cy } = camera.lens.intrinsics;
    let mut arrays = vec![
        NamedArray::new("rgb", &[height, width, 3], &view.rgb),
        NamedArray::new("alpha", &[height, width], &view.alpha),
        NamedArray::new("depth", &[height, width], &depth),
    ];
    if view.extra_channels == 3 {
        arrays.push(NamedArray::new("displacement", &[height, width, 3], &view.extra));
    }
    let matrix = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0];
    arrays.push(NamedArray::new("intrinsics", &[3, 3], &matrix));
    arrays.push(NamedArray::new(
        "recon_from_camera",
        &[4, 4],
        &camera.world_from_camera.to_matrix4(),
    ));
    if let Some(time) = scene.time {
        arrays.push(NamedArray::new("time", &[], &[time]));
    }
    write_npz(path, &arrays)
}

fn metres(depth: &[f32], unit: LengthUnit) -> Vec<f32> {
    depth.iter().map(|&depth| unit.to_m(depth)).collect()
}

fn write(args: &ViewArgs, spec: &CameraSpec, view: &Render, unit: LengthUnit) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    let png = args.out.join(format!("{}.png", spec.name));
    let bytes: Vec<u8> = view
        .rgb
        .iter()
        .map(|value| (value.clamp(0.0, 1.0) * 255.0).round() as u8)
        .collect();
    write_png(&png, (spec.width, spec.height), &bytes)?;
    files.push(png);
    let mut plane = |kind: &str, channel: &str, values: Vec<f32>| -> anyhow::Result<()> {
        let path = args.out.join(format!("{}.{kind}.exr", spec.name));
        write_exr(&path, (spec.width as usize, spec.height as usize), channel, values)?;
        files.push(path);
        Ok(())
    };
    if args.depth {
        plane("depth", "Z", metres(&view.depth_expected, unit))?;
    }
    if args.alpha {
        plane("alpha", "A", view.alpha.clone())?;
    }
    Ok(files)
}
