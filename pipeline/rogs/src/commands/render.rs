//! `rogs render`: a field at a time or over time, or a 3DGS PLY, seen from any camera.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context as _, bail, ensure};
use rogs_arrays::{NamedArray, write_exr, write_npz, write_png};
use rogs_field::export_field;
use rogs_geometry::{PosedCamera, Recon};
use rogs_schemas::units::LengthUnit;
use rogs_schemas::{Device, Intrinsics};
use rogs_splat::{Gaussians, RasterCamera, RasterConfig, RasterDevice, Render};
use schemars::JsonSchema;
use serde::Serialize;

use super::export_field::AxesArg;
use super::film::{self, FilmArgs, Shooting};
use super::network::BesideArgs;
use super::scene::{FieldFile, Scene, read_ply};
use super::viewpoint::{CAMERA_HELP, Place, Scenery, Shot, Viewpoint};
use crate::output::{self, Items};

/// Renders a field at any time, or any 3DGS PLY, to PNG, EXR, npz and films; writes a field as PLY.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A field (`field-1.r4c`) or a PLY file.
    scene: PathBuf,
    /// Normalised time in 0..1; stored times within 1e-6 are taken as they are, others are answered by the network that the
    /// field was lifted with. Default: the first stored time.
    #[arg(long)]
    time: Option<f64>,
    /// Correction of Stage 2 to apply (`field-2.r4c`).
    #[arg(long, value_name = "FILE")]
    refinement: Option<PathBuf>,
    #[command(flatten)]
    film: FilmArgs,
    #[command(flatten)]
    beside: BesideArgs,
    #[command(flatten)]
    view: ViewArgs,
}

/// From where, and what is written.
#[derive(Debug, clap::Args)]
pub(crate) struct ViewArgs {
    /// A camera of the clip (`ext1`), `orbit`, `lookat:X,Y,Z,X,Y,Z`, or a JSON file of cameras or a camera path.
    #[arg(long, value_name = "CAMERA", long_help = CAMERA_HELP)]
    camera: Viewpoint,
    /// Folder for the pictures; made when missing.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Size of the pictures, e.g. 640x352. Default: that of the camera.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    size: Option<(u32, u32)>,
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

/// What was rendered.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Rendered {
    /// Name of the camera.
    camera: String,
    /// What was written; the files of the scene as a whole stand with the first camera.
    files: Vec<PathBuf>,
    /// Time in 0..1; null of a PLY file.
    time: Option<f64>,
    /// Gaussians of the scene.
    gaussians: usize,
    /// Gaussians that this camera sees.
    visible: usize,
    /// Gaussians that were left out because their values are invalid.
    invalid: usize,
}

/// A size of pictures.
pub(super) fn size(text: &str) -> Result<(u32, u32), String> {
    let sides = text
        .split_once('x')
        .and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    sides
        .filter(|&(width, height): &(u32, u32)| (1..=16_384).contains(&width) && (1..=16_384).contains(&height))
        .ok_or_else(|| format!("invalid size `{text}`: expected e.g. 640x352"))
}

/// A scene at a time, ready to render.
struct Moment {
    /// A field's have their displacement in metres as extra channels where it is asked for.
    gaussians: Gaussians,
    time: Option<f64>,
    /// Of the Gaussians' lengths.
    unit: LengthUnit,
}

/// Writes a scene to a file.
type WritePly<'a> = dyn FnMut(&Path) -> anyhow::Result<()> + 'a;

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    refuse_other_splats(&args.scene)?;
    if !is_ply(&args.scene) {
        let wanted = Wanted {
            refinement: args.refinement.as_deref(),
            time: args.time,
            film: Some(&args.film),
        };
        return render_field(&args.scene, &wanted, &args.beside, &args.view);
    }
    ensure!(args.refinement.is_none(), "a PLY file takes no refinement");
    ensure!(
        args.time.is_none() && args.film.times.is_none(),
        "a PLY file holds one time; leave `--time` and `--times` out"
    );
    ensure!(
        args.view.since.is_none(),
        "a PLY file holds no displacement; leave `--since` out"
    );
    ensure!(
        !args.view.ply,
        "`{}` is a PLY file already; leave `--ply` out",
        args.scene.display()
    );
    args.view.check(Some(&args.film))?;
    let mut scene = read_ply(&args.scene)?;
    let shot = args.view.find(&scene, None, USUAL_SIZE, args.film.video.is_some())?;
    if let Some(video) = &args.film.video {
        return args.view.shoot(&mut scene, None, video, shot, vec![0.0], &args.film);
    }
    let moment = Moment {
        gaussians: scene.gaussians(0.0)?,
        time: None,
        unit: scene.unit(),
    };
    render_scene(&moment, &args.view, &stills(&scene, shot, 0.0, &args.view)?, None)
}

/// Size of images where neither a camera nor a field has one.
const USUAL_SIZE: (u32, u32) = (640, 352);

/// Whether a file is a PLY by its name.
fn is_ply(path: &Path) -> bool {
    let ending = path.extension();
    ending.is_some_and(|ending| ending.eq_ignore_ascii_case("ply"))
}

/// Refuses scenes of Gaussians in forms of other programs by name.
fn refuse_other_splats(path: &Path) -> anyhow::Result<()> {
    const OTHERS: [&str; 6] = ["splat", "ksplat", "spz", "sog", "sogs", "ckpt"];
    let ending = path.extension().map(|ending| ending.to_ascii_lowercase());
    let other = OTHERS
        .iter()
        .find(|other| ending.as_ref().is_some_and(|own| *own == **other));
    match other {
        None => Ok(()),
        Some(other) => bail!(
            "`{}`: files `.{other}` are not read; export the scene as PLY of Gaussians (SuperSplat and splat-transform do)",
            path.display()
        ),
    }
}

/// What is asked of a field.
pub(crate) struct Wanted<'a> {
    pub(crate) refinement: Option<&'a Path>,
    /// The first stored one where none is named.
    pub(crate) time: Option<f64>,
    pub(crate) film: Option<&'a FilmArgs>,
}

/// Renders a field, with the correction of a refinement file where one is given.
pub(crate) fn render_field(
    path: &Path,
    wanted: &Wanted<'_>,
    beside: &BesideArgs,
    view: &ViewArgs,
) -> anyhow::Result<ExitCode> {
    // A field takes long to read: mistakes of the request are reported first.
    view.check(wanted.film)?;
    let video = wanted.film.and_then(|film| film.video.as_deref());
    let times = |field: &rogs_schemas::records::field::Field| {
        let stored: Vec<f64> = field.slices.iter().map(|slice| slice.time).collect();
        let asked = match (wanted.time, video) {
            (Some(time), _) => time.to_string(),
            (None, Some(_)) => (wanted.film.and_then(|film| film.times.clone())).unwrap_or_else(|| "all".to_owned()),
            (None, None) => stored.first().context("the field stores no time")?.to_string(),
        };
        film::times(&asked, &stored, field.frame_count)
    };
    let (file, times) = FieldFile::read(path, wanted.refinement, times, beside)?;
    let needed = view.camera.needs_scenery();
    let clip_id = file.field.clip_id.as_str();
    let read = || Scenery::read(&beside.clip(path), &beside.robot(path), clip_id);
    let scenery = needed.then(read).transpose()?;
    let mut scene = Scene::of(&file, scenery.as_ref())?;
    let usual = (file.field.width, file.field.height);
    let shot = view.find(&scene, scenery.as_ref(), usual, video.is_some())?;
    if let (Some(video), Some(film)) = (video, wanted.film) {
        return view.shoot(&mut scene, scenery.as_ref(), video, shot, times, film);
    }
    let time = times.first().copied().context("the field stores no time")?;
    let since = view.since.or(file.field.slices.first().map(|slice| slice.time));
    let views = stills(&scene, shot, time, view)?;
    let gaussians = scene.timed(time, |timed| {
        Ok(if view.npz {
            timed.gaussians_with_displacement(time, since.unwrap_or(time), time)?
        } else {
            timed.gaussians(time)?
        })
    })?;
    let moment = Moment {
        gaussians,
        time: Some(time),
        unit: scene.unit(),
    };
    let axes = view.axes.into();
    let mut ply = |path: &Path| scene.timed(time, |timed| Ok(export_field(timed, time, axes, path)?));
    render_scene(&moment, view, &views, if view.ply { Some(&mut ply) } else { None })
}

impl ViewArgs {
    /// What can be seen to be wrong before anything is read.
    fn check(&self, film: Option<&FilmArgs>) -> anyhow::Result<()> {
        let video = film.is_some_and(|film| film.video.is_some());
        ensure!(
            self.out.is_some() || video,
            "nothing is asked for: name a folder for pictures with `--out DIR`{}",
            if film.is_some() {
                ", or a film with `--video FILE`"
            } else {
                ""
            }
        );
        let pictures = self.out.is_some() || self.depth || self.alpha || self.npz || self.ply;
        ensure!(
            !(video && pictures),
            "`--video` makes a film alone: leave `--out`, `--depth`, `--alpha`, `--npz` and `--ply` out (`--beside depth` \
             shows depth in the film)"
        );
        if let Some(path) = film.and_then(|film| film.video.as_ref()) {
            rogs_video::FilmForm::of(path)?;
        }
        if let Viewpoint::File(path) = &self.camera {
            rogs_export::nerfstudio::read_json(path)?;
        }
        RasterDevice::open(self.device)?;
        Ok(())
    }

    fn place<'a>(&self, scene: &Scene<'_>, scenery: Option<&'a Scenery>, usual: (u32, u32), moving: bool) -> Place<'a> {
        Place {
            recon_from_base: scene.recon_from_base(),
            scenery,
            size: self.size,
            usual,
            moving,
        }
    }

    fn find(
        &self,
        scene: &Scene<'_>,
        scenery: Option<&Scenery>,
        usual: (u32, u32),
        moving: bool,
    ) -> anyhow::Result<Shot> {
        self.camera.find(&self.place(scene, scenery, usual, moving))
    }

    fn shoot(
        &self,
        scene: &mut Scene<'_>,
        scenery: Option<&Scenery>,
        video: &Path,
        shot: Shot,
        times: Vec<f64>,
        film: &FilmArgs,
    ) -> anyhow::Result<ExitCode> {
        let place = self.place(scene, scenery, USUAL_SIZE, true);
        let shooting = Shooting {
            shot,
            times,
            device: &RasterDevice::open(self.device)?,
            args: film,
            json: self.json,
            fit: &|camera| place.fit(camera),
        };
        film::shoot(scene, video, &shooting)
    }
}

/// The cameras of pictures at a time, by name.
fn stills(
    scene: &Scene<'_>,
    shot: Shot,
    time: f64,
    view: &ViewArgs,
) -> anyhow::Result<Vec<(String, PosedCamera<Recon>)>> {
    match shot {
        Shot::Still(cameras) => Ok(cameras),
        Shot::OfClip(camera) => {
            let name = scene.clip().and_then(|clip| clip.cameras.get(camera.at()));
            let name = name.map_or_else(|| camera.to_string(), |camera| camera.id.clone());
            let place = view.place(scene, None, USUAL_SIZE, false);
            Ok(vec![(name, place.fit(scene.camera_at(camera, time)?))])
        }
        Shot::Path { .. } | Shot::Orbit { .. } => bail!("a path needs `--video FILE`"),
    }
}

fn make_folder(path: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(path).with_context(|| format!("making `{}`", path.display()))
}

/// Renders a scene from all cameras; `ply` writes the scene as a whole. Nothing is written before all that was asked for
/// has been understood.
fn render_scene(
    scene: &Moment,
    args: &ViewArgs,
    cameras: &[(String, PosedCamera<Recon>)],
    ply: Option<&mut WritePly<'_>>,
) -> anyhow::Result<ExitCode> {
    let device = RasterDevice::open(args.device)?;
    let out = args.out.as_deref().context("no folder was named")?;
    let raster = |(name, camera): &(String, PosedCamera<Recon>)| {
        let raster = RasterCamera::new(camera, scene.unit);
        let checked = raster.validate();
        checked.with_context(|| format!("camera `{name}` cannot be rendered"))?;
        Ok(raster)
    };
    let views: Vec<RasterCamera> = cameras.iter().map(raster).collect::<anyhow::Result<_>>()?;
    make_folder(out)?;
    let whole = match ply {
        Some(write) => {
            let path = out.join("field.ply");
            write(&path)?;
            Some(path)
        }
        None => None,
    };
    let mut rendered = Vec::new();
    // A view at a time: images of many large views would not fit in memory together.
    for ((name, posed), camera) in cameras.iter().zip(views) {
        let views = device.render_views(&scene.gaussians, &[camera], &RasterConfig::default())?;
        let view = views
            .into_iter()
            .next()
            .context("one view was asked for, none was rendered")?;
        let mut files = write(args, &out.join(name), &view, scene.unit)?;
        if args.npz {
            let path = out.join(format!("{name}.npz"));
            write_numbers(&path, posed, &view, scene)?;
            files.push(path);
        }
        rendered.push(Rendered {
            camera: name.clone(),
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
        output::json(&Items { items: rendered })?;
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

/// All numbers of a view: images of f32, `[H, W]` or `[H, W, 3]`, and the camera in f64.
fn write_numbers(path: &Path, camera: &PosedCamera<Recon>, view: &Render, scene: &Moment) -> rogs_files::Result<()> {
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

/// Writes a picture and what is asked for beside it; `stem` is the path without an ending.
fn write(args: &ViewArgs, stem: &Path, view: &Render, unit: LengthUnit) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    let named = |ending: &str| {
        let mut path = stem.as_os_str().to_owned();
        path.push(ending);
        PathBuf::from(path)
    };
    let png = named(".png");
    write_png(&png, (view.width as u32, view.height as u32), &view.rgb_bytes())?;
    files.push(png);
    let mut plane = |ending: &str, channel: &str, values: Vec<f32>| -> anyhow::Result<()> {
        let path = named(ending);
        write_exr(&path, (view.width, view.height), channel, values)?;
        files.push(path);
        Ok(())
    };
    if args.depth {
        plane(".depth.exr", "Z", metres(&view.depth_expected, unit))?;
    }
    if args.alpha {
        plane(".alpha.exr", "A", view.alpha.clone())?;
    }
    Ok(files)
}
