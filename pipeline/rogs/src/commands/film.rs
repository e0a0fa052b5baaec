//! `rogs render --video`: a scene over time, or along a path, as a film.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context as _, bail, ensure};
use glam::DVec3;
use indicatif::{ProgressBar, ProgressStyle};
use rogs_geometry::{PosedCamera, Recon};
use rogs_orchestrator::executor::ProgressMode;
use rogs_pages::colours;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::units::LengthUnit;
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_splat::{Gaussians, RasterCamera, RasterConfig, RasterDevice, Render};
use rogs_video::{Error as FilmError, Film, FilmForm};
use schemars::JsonSchema;
use serde::Serialize;

use super::scene::Scene;
use super::viewpoint::Shot;
use crate::output;

/// Frames of an orbit, and how many a second of a film whose camera moves.
const ORBIT_FRAMES: usize = 120;
const MOVING_RATE: f64 = 30.0;
/// Frames per second of a film whose camera stands still or is one of the clip.
const CLIP_RATE: f64 = 10.0;
/// Most frames of a film.
const MOST_FRAMES: usize = 100_000;

/// A film.
#[derive(Debug, clap::Args)]
pub(crate) struct FilmArgs {
    /// Write a film: .mp4, .webm and .gif need the program `ffmpeg`; a name without an ending is a folder of PNG images.
    #[arg(long, value_name = "FILE")]
    pub(crate) video: Option<PathBuf>,
    /// Times of the film: `all` that are stored, `frames` of the clip, FROM..TO/COUNT, or a list with commas. Times that are
    /// not stored are answered by the network that the field was lifted with. Default: `all`.
    #[arg(long, value_name = "TIMES", requires = "video", conflicts_with = "time")]
    pub(crate) times: Option<String>,
    /// Frames of the film; its times are spread over them, each held until the next. Default: one a time where the camera
    /// is one of the clip or stands still, as many as a path says, or 120.
    #[arg(long, value_name = "COUNT", requires = "video")]
    frames: Option<usize>,
    /// Frames per second. Default: 10, or 30 where the camera moves of its own.
    #[arg(long, value_name = "RATE", requires = "video")]
    fps: Option<f64>,
    /// What stands beside the render, with commas; reference and error need a camera of the clip and times of frames.
    #[arg(long, value_name = "reference,depth,error", requires = "video", value_delimiter = ',')]
    pub(crate) beside: Vec<Beside>,
}

/// A picture beside the render.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Beside {
    /// What the camera recorded; left of the render.
    Reference,
    /// Expected depth, near dark and far bright.
    Depth,
    /// Mean absolute difference of the channels, black to yellow.
    Error,
}

/// What was made.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Made {
    /// The film, or the folder of its images.
    video: PathBuf,
    /// Number of frames.
    frames: usize,
    /// Their rate.
    frames_per_second: f64,
    /// Of one frame, pixels.
    width: u32,
    /// Of one frame, pixels.
    height: u32,
    /// Times that it shows, in 0..1.
    times: Vec<f64>,
}

/// The times that `--times` asks for, ascending where the words say so. Times within 1e-6 of a stored one are that.
pub(crate) fn times(asked: &str, stored: &[f64], frame_count: u32) -> anyhow::Result<Vec<f64>> {
    let last = f64::from(frame_count.saturating_sub(1)).max(1.0);
    let spread = |from: f64, to: f64, count: usize| -> Vec<f64> {
        let steps = count.saturating_sub(1).max(1) as f64;
        (0..count).map(|k| from + (to - from) * k as f64 / steps).collect()
    };
    let invalid = || {
        anyhow::anyhow!(
            "invalid times `{asked}`: expected `all`, `frames`, FROM..TO/COUNT (e.g. 0..1/120), or a list such as 0,0.5,1"
        )
    };
    let times = if asked == "all" {
        stored.to_vec()
    } else if asked == "frames" {
        (0..frame_count).map(|frame| f64::from(frame) / last).collect()
    } else if let Some((from, rest)) = asked.split_once("..") {
        let (to, count) = rest.split_once('/').ok_or_else(invalid)?;
        let number = |text: &str| text.trim().parse::<f64>().ok();
        let count: usize = count.trim().parse().map_err(|_| invalid())?;
        ensure!(
            (1..=MOST_FRAMES).contains(&count),
            "{count} times: expected 1 to {MOST_FRAMES}"
        );
        let (from, to) = number(from).zip(number(to)).ok_or_else(invalid)?;
        spread(from, to, count)
    } else {
        let list: Option<Vec<f64>> = asked.split(',').map(|time| time.trim().parse().ok()).collect();
        list.ok_or_else(invalid)?
    };
    ensure!(!times.is_empty(), "the field stores no time; give `--times`");
    let snapped = |time: f64| {
        ensure!(
            (0.0..=1.0).contains(&time),
            "time {time} is outside the clip, which spans 0 to 1"
        );
        Ok(stored
            .iter()
            .copied()
            .find(|other| (other - time).abs() < 1e-6)
            .unwrap_or(time))
    };
    times.into_iter().map(snapped).collect()
}

/// What a film is made of.
pub(crate) struct Shooting<'a> {
    pub(crate) shot: Shot,
    /// One or more.
    pub(crate) times: Vec<f64>,
    pub(crate) device: &'a RasterDevice,
    pub(crate) args: &'a FilmArgs,
    pub(crate) json: bool,
    /// Fits a camera of the clip to the size asked for.
    pub(crate) fit: &'a dyn Fn(PosedCamera<Recon>) -> PosedCamera<Recon>,
}

/// Frames, rate and centre of a film, all that is known before the first frame.
struct Plan {
    frames: usize,
    rate: f64,
    references: Option<References>,
}

/// Recorded images of a camera.
struct References {
    camera: CameraIndex,
    frames: Vec<usize>,
}

/// Makes a film. Everything asked for is understood before anything is written.
pub(crate) fn shoot(scene: &mut Scene<'_>, path: &Path, shooting: &Shooting<'_>) -> anyhow::Result<ExitCode> {
    let form = FilmForm::of(path)?;
    let plan = plan(scene, shooting)?;
    let mut held = Held::first(scene, shooting)?;
    let first = shooting.camera(scene, &held, 0, plan.frames)?;
    let unit = scene.unit();
    let raster = |camera: &PosedCamera<Recon>| RasterCamera::new(camera, unit);
    raster(&first).validate().context("the camera cannot be rendered")?;
    let lens = first.lens;
    let panels = Panels::new(scene, shooting, &plan, (lens.width, lens.height))?;
    let size = panels.size();
    let (mut film, path) = begin(path, form, size, plan.rate)?;
    let bar = match output::progress() {
        ProgressMode::Quiet => ProgressBar::hidden(),
        _ => ProgressBar::new(plan.frames as u64),
    };
    bar.set_style(ProgressStyle::with_template("{bar:40} {pos}/{len} frames, {eta} left")?);
    let mut range = None;
    for frame in 0..plan.frames {
        let at = frame * shooting.times.len() / plan.frames;
        held.turn_to(scene, shooting.times[at])?;
        let camera = raster(&shooting.camera(scene, &held, frame, plan.frames)?);
        let views = shooting
            .device
            .render_views(&held.gaussians, &[camera], &RasterConfig::default())?;
        let view = views.first().context("one view was asked for, none was rendered")?;
        let depths = || view.depth_expected.iter().map(|&depth| unit.to_m(depth));
        let range = *range.get_or_insert_with(|| colours::depth_range(depths()).unwrap_or((0.0, 1.0)));
        let reference = plan
            .references
            .as_ref()
            .map(|references| (references.camera, references.frames[at]));
        film.frame(&panels.compose(scene, view, reference, range)?)?;
        bar.inc(1);
    }
    film.finish()?;
    bar.finish_and_clear();
    if let Some((near, far)) = range.filter(|_| shooting.args.beside.contains(&Beside::Depth)) {
        output::note(&format!("depth: {near:.2} m (dark) to {far:.2} m (bright)"));
    }
    if shooting.json {
        output::json(&Made {
            video: path,
            frames: plan.frames,
            frames_per_second: plan.rate,
            width: size[0],
            height: size[1],
            times: shooting.times.clone(),
        })?;
    } else {
        output::text(&path.display().to_string())?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Begins a film; without the program, images in a folder of that name.
fn begin(path: &Path, form: FilmForm, size: [u32; 2], rate: f64) -> anyhow::Result<(Film, PathBuf)> {
    match Film::begin(path, form, size, rate) {
        Err(error @ FilmError::NoProgram(_)) => {
            let name = path.file_stem().unwrap_or_default().to_string_lossy();
            let folder = path.with_file_name(format!("{name}-frames"));
            output::warning(&format!("{error}; PNG images are written instead"));
            output::note(&format!(
                "hint: with it, `ffmpeg -framerate {rate} -i {}/%06d.png -pix_fmt yuv420p {}` makes the film",
                folder.display(),
                path.display()
            ));
            Ok((Film::begin(&folder, FilmForm::Images, size, rate)?, folder))
        }
        other => Ok((other?, path.to_owned())),
    }
}

fn plan(scene: &Scene<'_>, shooting: &Shooting<'_>) -> anyhow::Result<Plan> {
    let args = shooting.args;
    let (frames, rate) = match &shooting.shot {
        Shot::Still(cameras) => {
            ensure!(
                cameras.len() == 1,
                "a film has one camera, or a path through several poses"
            );
            (shooting.times.len(), CLIP_RATE)
        }
        Shot::OfClip(_) => (shooting.times.len(), CLIP_RATE),
        Shot::Path { frames, rate, .. } => (*frames, rate.unwrap_or(MOVING_RATE)),
        Shot::Orbit { .. } => (ORBIT_FRAMES, MOVING_RATE),
    };
    let frames = args.frames.unwrap_or(frames);
    ensure!(
        (1..=MOST_FRAMES).contains(&frames),
        "invalid number of frames {frames}: expected 1 to {MOST_FRAMES}"
    );
    let compared = args.beside.iter().any(|beside| *beside != Beside::Depth);
    let references = compared.then(|| references(scene, shooting)).transpose()?;
    Ok(Plan {
        frames,
        rate: args.fps.unwrap_or(rate),
        references,
    })
}

/// The recorded images that the times of a film are compared with.
fn references(scene: &Scene<'_>, shooting: &Shooting<'_>) -> anyhow::Result<References> {
    let Shot::OfClip(camera) = shooting.shot else {
        bail!("a reference is what a camera of the clip recorded: name one with `--camera`");
    };
    let clip = scene.clip().context("the scene has no clip")?;
    let last = clip.frame_count().saturating_sub(1) as f64;
    let frame = |time: &f64| {
        let position = time * last;
        let frame = position.round();
        ensure!(
            (position - frame).abs() < 1e-6,
            "there is no reference at time {time}, which lies between frames; `--times frames` has none such"
        );
        let image = clip.target(camera, FrameIndex(frame as u32));
        ensure!(
            image.is_some(),
            "camera `{}` has no recorded images to stand beside the render",
            clip.cameras[camera.at()].id
        );
        Ok(frame as usize)
    };
    let frames = shooting.times.iter().map(frame).collect::<anyhow::Result<_>>()?;
    Ok(References { camera, frames })
}

/// The Gaussians of the time in hand, and what an orbit goes about.
struct Held {
    time: f64,
    gaussians: Gaussians,
    /// Metres, reconstruction frame.
    centre: DVec3,
}

impl Held {
    fn first(scene: &mut Scene<'_>, shooting: &Shooting<'_>) -> anyhow::Result<Self> {
        let time = shooting.times.first().copied().unwrap_or(0.0);
        let gaussians = scene.gaussians(time)?;
        let centre = match &shooting.shot {
            Shot::Orbit { start, .. } => looked_at(&gaussians, start, scene.unit(), shooting.device)?,
            _ => DVec3::ZERO,
        };
        Ok(Self {
            time,
            gaussians,
            centre,
        })
    }

    fn turn_to(&mut self, scene: &mut Scene<'_>, time: f64) -> anyhow::Result<()> {
        if self.time.to_bits() != time.to_bits() {
            self.gaussians = scene.gaussians(time)?;
            self.time = time;
        }
        Ok(())
    }
}

/// The point on the axis of a camera at the median depth of the middle of its image, metres.
fn looked_at(
    gaussians: &Gaussians,
    camera: &PosedCamera<Recon>,
    unit: LengthUnit,
    device: &RasterDevice,
) -> anyhow::Result<DVec3> {
    let views = device.render_views(gaussians, &[RasterCamera::new(camera, unit)], &RasterConfig::default())?;
    let view = views.first().context("one view was asked for, none was rendered")?;
    let middle = |side: usize| side / 4..(3 * side).div_ceil(4);
    let rows = middle(view.height).flat_map(|row| middle(view.width).map(move |column| row * view.width + column));
    let mut depths: Vec<f32> = rows
        .map(|pixel| view.depth_expected[pixel])
        .filter(|depth| *depth > 0.0)
        .collect();
    ensure!(!depths.is_empty(), "the camera that the orbit starts from sees nothing");
    depths.sort_unstable_by(f32::total_cmp);
    let depth = f64::from(unit.to_m(depths[depths.len() / 2]));
    Ok(camera.world_from_camera.point(DVec3::Z * depth))
}

impl Shooting<'_> {
    /// The camera of a frame.
    fn camera(
        &self,
        scene: &Scene<'_>,
        held: &Held,
        frame: usize,
        frames: usize,
    ) -> anyhow::Result<PosedCamera<Recon>> {
        match &self.shot {
            Shot::Still(cameras) => Ok(cameras.first().context("a film needs a camera")?.1),
            Shot::Path { path, .. } => Ok(path.at(frame as f64 / frames.saturating_sub(1).max(1) as f64)),
            Shot::OfClip(camera) => Ok((self.fit)(scene.camera_at(*camera, held.time)?)),
            Shot::Orbit { start, degrees } => {
                let turn = std::f64::consts::TAU * frame as f64 / frames as f64;
                let angle = if *degrees < 360.0 {
                    degrees.to_radians() / 2.0 * turn.sin()
                } else {
                    turn
                };
                let up = scene.recon_from_base().direction(DVec3::Z);
                let pose = start.world_from_camera.turned_about(held.centre, up, angle);
                Ok(PosedCamera::new(start.lens, pose))
            }
        }
    }
}

/// How the pictures of a frame stand side by side.
struct Panels {
    beside: Vec<Beside>,
    width: u32,
    height: u32,
}

impl Panels {
    fn new(
        scene: &Scene<'_>,
        shooting: &Shooting<'_>,
        plan: &Plan,
        (width, height): (u32, u32),
    ) -> anyhow::Result<Self> {
        if let Some(clip) = scene.clip().filter(|_| plan.references.is_some()) {
            let whole = f64::from(clip.height) * f64::from(width) / f64::from(clip.width);
            ensure!(
                (whole - f64::from(height)).abs() <= 1.0,
                "a reference of {}x{} cannot stand beside {width}x{height}: name a size of its shape with `--size`",
                clip.width,
                clip.height
            );
        }
        Ok(Self {
            beside: shooting.args.beside.clone(),
            width,
            height,
        })
    }

    fn size(&self) -> [u32; 2] {
        [self.width * (1 + self.beside.len() as u32), self.height]
    }

    /// The bytes of a frame: the reference where it is asked for, the render, then the others in their order.
    fn compose(
        &self,
        scene: &Scene<'_>,
        view: &Render,
        reference: Option<(CameraIndex, usize)>,
        range: (f32, f32),
    ) -> anyhow::Result<Vec<u8>> {
        let render = view.rgb_bytes();
        let reference = match reference.zip(scene.clip()) {
            Some(((camera, frame), clip)) => self.reference(clip, camera, frame)?,
            None => Vec::new(),
        };
        let picture = |beside: &Beside| -> Vec<u8> {
            match beside {
                Beside::Reference => reference.clone(),
                Beside::Depth => {
                    let depths = view.depth_expected.iter();
                    depths
                        .flat_map(|&depth| colours::depth(scene.unit().to_m(depth), range))
                        .collect()
                }
                Beside::Error => {
                    let pairs = reference.chunks_exact(3).zip(render.chunks_exact(3));
                    pairs.flat_map(|(a, b)| colours::error(a, b)).collect()
                }
            }
        };
        let (left, right): (Vec<&Beside>, Vec<&Beside>) =
            self.beside.iter().partition(|beside| **beside == Beside::Reference);
        let mut pictures: Vec<Vec<u8>> = left.into_iter().map(picture).collect();
        let others: Vec<Vec<u8>> = right.into_iter().map(picture).collect();
        pictures.push(render);
        pictures.extend(others);
        let row = 3 * self.width as usize;
        let mut bytes = Vec::with_capacity(pictures.len() * row * self.height as usize);
        for at in 0..self.height as usize {
            for picture in &pictures {
                bytes.extend_from_slice(&picture[at * row..(at + 1) * row]);
            }
        }
        Ok(bytes)
    }

    /// The recorded image at the size of the render.
    fn reference(&self, clip: &Clip, camera: CameraIndex, frame: usize) -> anyhow::Result<Vec<u8>> {
        let image = clip.target(camera, FrameIndex(frame as u32));
        let image = image.context("there is no recorded image")?.rgb();
        let from = (clip.width as usize, clip.height as usize);
        let to = (self.width as usize, self.height as usize);
        Ok(if from == to {
            image.to_vec()
        } else {
            resized(image, from, to)
        })
    }
}

/// An image at another size: bilinear between pixel centres. `[H, W, 3]`
fn resized(rgb: &[u8], (width, height): (usize, usize), (columns, rows): (usize, usize)) -> Vec<u8> {
    let place = |at: usize, to: usize, from: usize| {
        let position = ((at as f32 + 0.5) * from as f32 / to as f32 - 0.5).clamp(0.0, (from - 1) as f32);
        let first = (position as usize).min(from.saturating_sub(2));
        (first, (first + 1).min(from - 1), position - first as f32)
    };
    let mut out = Vec::with_capacity(3 * columns * rows);
    for row in 0..rows {
        let (top, bottom, v) = place(row, rows, height);
        for column in 0..columns {
            let (left, right, u) = place(column, columns, width);
            for channel in 0..3 {
                let at = |row: usize, column: usize| f32::from(rgb[3 * (row * width + column) + channel]);
                let mix = |row: usize| at(row, left) + (at(row, right) - at(row, left)) * u;
                out.push((mix(top) + (mix(bottom) - mix(top)) * v).round() as u8);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_and_lie_in_the_clip() {
        let stored = [0.0, 0.25, 1.0];
        let of = |asked: &str| times(asked, &stored, 17);
        assert_eq!(of("all").unwrap(), stored);
        assert_eq!(of("frames").unwrap().len(), 17);
        assert_eq!(of("0..1/5").unwrap(), [0.0, 0.25, 0.5, 0.75, 1.0]);
        assert_eq!(of("0.2500000001, 0.3").unwrap(), [0.25, 0.3], "what is stored is taken");
        assert!(of("0,1.5").unwrap_err().to_string().contains("1.5 is outside the clip"));
        for wrong in ["", "half", "0..1", "0..x/3", "0..1/0"] {
            assert!(of(wrong).is_err(), "{wrong}");
        }
        assert!(times("all", &[], 17).is_err());
    }

    #[test]
    fn resized_pictures_keep_their_mean_and_their_sides() {
        let rgb: Vec<u8> = (0..4).flat_map(|k| [10 * k, 100, 255 - k]).collect();
        let larger = resized(&rgb, (2, 2), (6, 4));
        assert_eq!(larger.len(), 72);
        assert_eq!(larger[..3], rgb[..3], "corners stay");
        assert_eq!(larger[69..], rgb[9..]);
        let mean = larger.iter().step_by(3).map(|&v| f32::from(v)).sum::<f32>() / 24.0;
        assert!((mean - 15.0).abs() < 0.5, "{mean}");
        assert_eq!(resized(&rgb, (2, 2), (2, 2)), rgb);
    }
}
