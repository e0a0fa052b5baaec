//! Posed RGB-D frames of a room: three that see the same become a clip of three cameras that stand still, without a robot.

use std::path::{Path, PathBuf};

use glam::DVec3;
use image::RgbImage;
use rogs_geometry::{Base, Camera, Pinhole, Pose, PosedCamera, Recon};
use rogs_random::Pcg64;
use rogs_schemas::episode::PixelCentres;
use rogs_schemas::records::conditioning::{KAPPA_CHANNELS, plane};
use rogs_schemas::units::LengthUnit;
use rogs_schemas::{CameraIndex, Intrinsics, WrittenPose};
use rogs_splat::RasterCamera;
use rogs_stage1::NetworkCamera;
use serde::Deserialize;

use super::cut::{Cut, Setup, Standing, World};
use super::picture::planar;
use super::unusable;
use crate::error::{Error, Result};
use crate::plan::SOURCE_CAMERAS;
use crate::sample::{NO_CAP_IU, Query, Sample};
use crate::sources::FramesSettings;

/// What `frames.json` says.
#[derive(Debug, Clone, Deserialize)]
struct Written {
    image_size: [u32; 2],
    intrinsics: Intrinsics,
    pixel_centres: PixelCentres,
    floor_y_m: f64,
    frames: Vec<WrittenFrame>,
}

#[derive(Debug, Clone, Deserialize)]
struct WrittenFrame {
    name: String,
    /// Place in the recording.
    index: u64,
    world_from_camera: WrittenPose,
}

/// A recording.
#[derive(Debug, Clone)]
pub(super) struct PosedFrames {
    settings: FramesSettings,
    written: Written,
    poses: Vec<Pose<World, Camera>>,
    /// Frames before this one are for training.
    training: usize,
}

/// Distance of the other frames of a clip from its first, metres of the room.
const BASELINE_M: [f64; 2] = [0.1, 0.7];
/// Cosine of the largest angle between optical axes.
const LEAST_COSINE: f64 = 0.85;
/// Frames beside the source views that renders are compared with.
const NOVEL: usize = 2;
/// Largest file that is read, bytes.
const MAX_BYTES: u64 = 64 << 20;
/// Least share of a frame that is cut out, along its longer fit.
const LEAST_CUT: f64 = 0.75;
/// Least share of pixels of a frame whose depth is known.
const LEAST_KNOWN: f64 = 0.05;

impl PosedFrames {
    /// Reads the list of frames.
    pub(super) fn open(settings: &FramesSettings) -> Result<Self> {
        let path = settings.folder.join("frames.json");
        let wrong = |what: String| unusable(&path, what);
        let text = rogs_files::read_to_string(&path).map_err(Error::io(&path))?;
        let mut written: Written = serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))?;
        written.frames.sort_by_key(|frame| frame.index);
        let Intrinsics { fx, fy, cx, cy } = written.intrinsics;
        let [width, height] = written.image_size;
        let sizes = (16..=8192).contains(&width) && (16..=8192).contains(&height);
        if !sizes || ![fx, fy, cx, cy, written.floor_y_m].iter().all(|v| v.is_finite()) || fx <= 0.0 || fy <= 0.0 {
            return Err(wrong(
                "the image size, an intrinsic number or the floor is impossible".into(),
            ));
        }
        let poses = written.frames.iter().map(|frame| {
            let named = |error: rogs_geometry::Error| wrong(format!("frame `{}`: {error}", frame.name));
            let plain = !frame.name.is_empty()
                && frame
                    .name
                    .chars()
                    .all(|c| c.is_ascii_alphanumeric() || "-_".contains(c));
            if !plain {
                return Err(wrong(format!(
                    "invalid name of a frame `{}`: expected letters, digits, - and _",
                    frame.name
                )));
            }
            Pose::<World, Camera>::from_written(&frame.world_from_camera).map_err(named)
        });
        let poses: Vec<_> = poses.collect::<Result<_>>()?;
        let training = (poses.len() as f64 * (1.0 - settings.held_out)).floor() as usize;
        let frames = Self {
            settings: settings.clone(),
            written,
            poses,
            training,
        };
        for (what, part) in [
            ("for training", 0..frames.training),
            ("held out", frames.training..frames.poses.len()),
        ] {
            let held_out = part.start > 0;
            let alone = part
                .clone()
                .all(|first| frames.company(first, &part).len() < SOURCE_CAMERAS - 1);
            if alone && !(held_out && part.is_empty()) {
                return Err(wrong(format!(
                    "of the {} frames {what} no three see the same: expected some 0.1 to 0.7 m apart that look the same way",
                    part.len()
                )));
            }
        }
        Ok(frames)
    }

    /// Reads every picture and depth once.
    pub(super) fn check(&self) -> Result<()> {
        for frame in &self.written.frames {
            let (_, depth) = self.read(frame)?;
            let known = depth.iter().filter(|depth| depth.is_finite()).count();
            if (known as f64) < LEAST_KNOWN * depth.len() as f64 {
                let path = self.place("depth", frame, "png");
                return Err(unusable(
                    &path,
                    format!(
                        "frame `{}`: the depth of {known} of {} pixels is known",
                        frame.name,
                        depth.len()
                    ),
                ));
            }
        }
        Ok(())
    }

    fn place(&self, folder: &str, frame: &WrittenFrame, ending: &str) -> PathBuf {
        self.settings
            .folder
            .join(folder)
            .join(&frame.name)
            .with_extension(ending)
    }

    /// Picture and depth of a frame, metres of the room, NaN where unknown.
    fn read(&self, frame: &WrittenFrame) -> Result<(RgbImage, Vec<f32>)> {
        let wrong = |path: &Path, what: String| unusable(path, format!("frame `{}`: {what}", frame.name));
        let bytes = |path: &Path| -> Result<Vec<u8>> {
            let length = std::fs::metadata(path).map_err(Error::io(path))?.len();
            if length > MAX_BYTES {
                return Err(wrong(path, format!("{length} bytes are more than a frame may have")));
            }
            rogs_files::read(path).map_err(Error::io(path))
        };
        let [width, height] = self.written.image_size;
        let path = self.place("images", frame, "jpg");
        let picture = image::load_from_memory_with_format(&bytes(&path)?, image::ImageFormat::Jpeg)
            .map_err(|error| wrong(&path, error.to_string()))?
            .into_rgb8();
        if picture.dimensions() != (width, height) {
            let (w, h) = picture.dimensions();
            return Err(wrong(
                &path,
                format!("the picture is {w}x{h}; frames.json says {width}x{height}"),
            ));
        }
        let path = self.place("depth", frame, "png");
        let steps = rogs_arrays::Png::open(&path).map_err(|error| wrong(&path, error.to_string()))?;
        let steps = steps
            .decode()
            .map_err(|error| wrong(&path, error.to_string()))?
            .into_luma16();
        if steps.dimensions() != (width, height) {
            let (w, h) = steps.dimensions();
            return Err(wrong(
                &path,
                format!("the depth is {w}x{h}; frames.json says {width}x{height}"),
            ));
        }
        let metres = |&step: &u16| if step == 0 { f32::NAN } else { f32::from(step) / 1000.0 };
        Ok((picture, steps.as_raw().iter().map(metres).collect()))
    }

    /// Frames of a part that see about what a frame of it sees, from elsewhere.
    fn company(&self, first: usize, part: &std::ops::Range<usize>) -> Vec<usize> {
        let reference = &self.poses[first];
        let fits = |&other: &usize| {
            let pose = &self.poses[other];
            let apart = pose.translation.distance(reference.translation);
            let same_way = pose.direction(DVec3::Z).dot(reference.direction(DVec3::Z));
            (BASELINE_M[0]..=BASELINE_M[1]).contains(&apart) && same_way > LEAST_COSINE
        };
        part.clone().filter(fits).collect()
    }

    /// A clip of the part for training.
    pub(super) fn draw(&self, size: [u32; 2], with_targets: bool, random: &mut Pcg64) -> Result<Sample> {
        let part = 0..self.training;
        let (first, company) = loop {
            let first = below(random, self.training);
            let company = self.company(first, &part);
            if company.len() >= SOURCE_CAMERAS - 1 {
                break (first, company);
            }
        };
        let setup = Setup {
            scale: within(random, self.settings.scale),
            base_distance_m: within(random, self.settings.base_distance_m),
            base_height_m: if random.next_double() < 0.5 {
                0.0
            } else {
                within(random, self.settings.base_height_m)
            },
            turn: within(random, [-0.5, 0.5]),
            cut: within(random, [LEAST_CUT, 1.0]),
            shift: [random.next_double(), random.next_double()],
            gain: within(random, [0.8, 1.2]) as f32,
        };
        self.sample((first, company), size, &setup, with_targets, random)
    }

    /// Clips of the held-out part, spread over it, all set up alike.
    pub(super) fn held_out(&self, size: [u32; 2], most: u64) -> Result<Vec<Sample>> {
        let part = self.training..self.poses.len();
        let whole: Vec<usize> = part
            .clone()
            .filter(|&first| self.company(first, &part).len() >= SOURCE_CAMERAS - 1)
            .collect();
        let count = (most as usize).min(whole.len());
        let setup = Setup {
            scale: 0.5,
            base_distance_m: 1.0,
            base_height_m: 0.0,
            turn: 0.0,
            cut: 1.0,
            shift: [0.5; 2],
            gain: 1.0,
        };
        (0..count)
            .map(|k| {
                let first = whole[k * whole.len() / count];
                let company = self.company(first, &part);
                self.sample(
                    (first, company),
                    size,
                    &setup,
                    true,
                    &mut Pcg64::from_seeds(&[9, first as u64]),
                )
            })
            .collect()
    }

    /// The clip of a first frame and two of its company.
    fn sample(
        &self,
        (first, mut company): (usize, Vec<usize>),
        size: [u32; 2],
        setup: &Setup,
        with_targets: bool,
        random: &mut Pcg64,
    ) -> Result<Sample> {
        for k in 0..company.len().min(SOURCE_CAMERAS - 1 + NOVEL) {
            let other = k + below(random, company.len() - k);
            company.swap(k, other);
        }
        let (sources, others) = company.split_at(SOURCE_CAMERAS - 1);
        let standing = Standing::behind(&self.poses[first], self.written.floor_y_m, setup)
            .ok_or_else(|| unusable(&self.settings.folder, "a frame looks straight up or down"))?;
        let recon_from_base: Pose<Recon, Base> = standing.place(&self.poses[first]).inverse().relabelled();
        let view = |index: usize| -> Result<Cut> {
            let frame = &self.written.frames[index];
            let (picture, depth_m) = self.read(frame)?;
            let camera = PosedCamera::new(self.lens(), standing.place(&self.poses[index]));
            Ok(Cut::of(
                &picture,
                &depth_m,
                camera.in_frame(&recon_from_base),
                size,
                setup,
            ))
        };
        let mut cuts = vec![view(first)?];
        for &index in sources {
            cuts.push(view(index)?);
        }
        let area = size[0] as usize * size[1] as usize;
        let count = cuts.len();
        let mut sample = Sample {
            origin: format!("frames at `{}`", self.written.frames[first].name),
            size: size.map(|side| side as usize),
            images: cuts.iter().flat_map(|cut| planar(&cut.rgb)).collect(),
            cameras: cuts.iter().map(|cut| NetworkCamera::new(&cut.camera)).collect(),
            recon_from_base_iu: recon_from_base.in_unit(LengthUnit::Internal),
            raster_cameras: cuts
                .iter()
                .map(|cut| RasterCamera::new(&cut.camera, LengthUnit::Internal))
                .collect(),
            views: (0..count).map(|camera| (CameraIndex(camera as u32), 0.0)).collect(),
            depth_iu: cuts.iter().flat_map(|cut| cut.depth_iu.clone()).collect(),
            valid: cuts.iter().flat_map(|cut| cut.valid.clone()).collect(),
            mesh_depth_iu: vec![0.0; count * area],
            anchored: true,
            support: vec![0.0; count * area],
            scale_cap_iu: vec![NO_CAP_IU; count * area],
            robot: vec![0.0; count * area],
            trackable: vec![0.0; count * area],
            still: true,
            near_tool: vec![0.0; count * area],
            queries: Vec::new(),
        };
        // The robot is known, and nowhere in view.
        let mut kappa = vec![0.0; KAPPA_CHANNELS * area];
        kappa[plane::AVAILABLE * area..][..area].fill(1.0);
        let mut targets = Vec::new();
        if with_targets {
            targets.extend(cuts.into_iter().map(|cut| cut.target(false)));
            for &index in others.iter().take(NOVEL) {
                targets.push(view(index)?.target(true));
            }
        }
        sample.queries.push(Query {
            time: 0.0,
            kappa: kappa.repeat(count),
            held: vec![None; count],
            fk_slope: vec![0.0; 3 * count * area],
            displacement_iu: vec![0.0; 3 * count * area],
            targets,
        });
        Ok(sample)
    }

    fn lens(&self) -> Pinhole {
        let [width, height] = self.written.image_size;
        match self.written.pixel_centres {
            PixelCentres::Integer => Pinhole::from_integer_centres(self.written.intrinsics, width, height),
            PixelCentres::Half => Pinhole {
                intrinsics: self.written.intrinsics,
                width,
                height,
            },
        }
    }
}

fn below(random: &mut Pcg64, count: usize) -> usize {
    ((random.next_double() * count as f64) as usize).min(count.saturating_sub(1))
}

fn within(random: &mut Pcg64, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * random.next_double()
}
