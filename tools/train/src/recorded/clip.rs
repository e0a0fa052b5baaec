//! Samples of ingested clips: any of the source times and cameras that robot maps hold, any query times.

use std::path::{Path, PathBuf};

use rogs_geometry::{Base, Link, Pose, PosedCamera, Recon};
use rogs_lift::LiftParams;
use rogs_r4c::{Record, read_record};
use rogs_random::Pcg64;
use rogs_schemas::records::clip::{CameraRole, Clip, SourceView, time_of_frame};
use rogs_schemas::records::conditioning::{Conditioning, KAPPA_CHANNELS, plane};
use rogs_schemas::records::robot::{RobotMap, RobotMaps};
use rogs_schemas::units::{LengthUnit, iu_from_m};
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_splat::RasterCamera;
use rogs_stage1::NetworkCamera;
use rogs_stage1::held::{HeldMotion, HeldPath};

use super::picture::{mesh_reference, planar, reference_depth};
use super::tracks::Tracked;
use super::unusable;
use crate::config::DataSettings;
use crate::error::{Error, Result};
use crate::sample::{NO_CAP_IU, Query, Sample, Target, near_tool};
use crate::sources::RecordedSettings;

/// Factors on all levels of a training clip, and on those of a colour.
const EXPOSURE: [f64; 2] = [0.7, 1.25];
const BALANCE: [f64; 2] = [0.9, 1.1];

/// The clips of a run.
#[derive(Debug, Clone)]
pub(super) struct RecordedClips {
    training: Vec<PathBuf>,
    held_out: Vec<PathBuf>,
    mesh_depth: bool,
}

/// A clip that was read.
struct Read {
    folder: PathBuf,
    clip: Clip,
    robot: RobotMaps,
    /// Uses the robot's mesh as reference depth where a camera has none.
    mesh_depth: bool,
}

impl RecordedClips {
    /// Finds the clips of a run that have both records.
    pub(super) fn find(settings: &RecordedSettings) -> Result<Self> {
        let folder = settings.run.join("clips");
        let mut found = Vec::new();
        for entry in std::fs::read_dir(&folder).map_err(Error::io(&folder))? {
            let place = entry.map_err(Error::io(&folder))?.path();
            if ["clip.r4c", "robot.r4c"].iter().all(|name| place.join(name).is_file()) {
                found.push(place);
            }
        }
        found.sort();
        let held_out = (found.len() as f64 * settings.held_out).ceil() as usize;
        if found.len() <= held_out {
            return Err(unusable(
                &folder,
                format!(
                    "{} clips have clip.r4c and robot.r4c, {held_out} of them are held out; none is left",
                    found.len()
                ),
            ));
        }
        let held_out = found.split_off(found.len() - held_out);
        Ok(Self {
            training: found,
            held_out,
            mesh_depth: settings.mesh_depth,
        })
    }

    /// Reads every clip and says what cannot be trained on.
    pub(super) fn check(&self, patch: usize) -> Result<()> {
        for folder in self.training.iter().chain(&self.held_out) {
            self.open(folder)?.check(patch)?;
        }
        Ok(())
    }

    fn open(&self, folder: &Path) -> Result<Read> {
        Ok(Read {
            folder: folder.to_owned(),
            clip: record(&folder.join("clip.r4c"))?,
            robot: record(&folder.join("robot.r4c"))?,
            mesh_depth: self.mesh_depth,
        })
    }

    /// A clip with this many source times, or as many as it has.
    pub(super) fn draw(
        &self,
        data: &DataSettings,
        times: u32,
        with_targets: bool,
        random: &mut Pcg64,
    ) -> Result<Sample> {
        let folder = &self.training[below(random, self.training.len())];
        let read = self.open(folder)?;
        let count = (times as usize).min(read.clip.source_frames.len());
        let sources = choose(&read.clip.source_frames, count, random);
        let frames: Vec<FrameIndex> = FrameIndex::first(read.clip.frame_count()).collect();
        let queries = choose(&frames, (data.queries as usize).min(frames.len()), random);
        let mut sample = read.sample(sources, queries, with_targets)?;
        relight(&mut sample, random);
        Ok(sample)
    }

    /// The held-out clips as they were cut.
    pub(super) fn held_out(&self, data: &DataSettings, most: u64) -> Result<Vec<Sample>> {
        let sample = |folder: &PathBuf| {
            let read = self.open(folder)?;
            let (sources, queries) = (read.clip.source_frames.clone(), read.clip.query_frames.clone());
            let kept = (data.queries as usize).clamp(1, 3).min(queries.len());
            read.sample(sources, queries[..kept].to_vec(), true)
        };
        self.held_out.iter().take(most as usize).map(sample).collect()
    }
}

/// Other exposure and white balance for a clip, the same in all its images and targets: recordings are few, and their light
/// must not be what is learned.
fn relight(sample: &mut Sample, random: &mut Pcg64) {
    let mut between = |[low, high]: [f64; 2]| low + (high - low) * random.next_double();
    let exposure = between(EXPOSURE);
    let gains: [f32; 3] = std::array::from_fn(|_| (exposure * between(BALANCE)) as f32);
    let area = sample.size[0] * sample.size[1];
    let lit = |value: &mut f32, channel: usize| *value = (*value * gains[channel]).min(1.0);
    for (index, plane) in sample.images.chunks_exact_mut(area).enumerate() {
        plane.iter_mut().for_each(|value| lit(value, index % 3));
    }
    for target in sample.queries.iter_mut().flat_map(|query| &mut query.targets) {
        let values = target.rgb.iter_mut().enumerate();
        values.for_each(|(index, value)| lit(value, index % 3));
    }
}

fn below(random: &mut Pcg64, count: usize) -> usize {
    ((random.next_double() * count as f64) as usize).min(count.saturating_sub(1))
}

/// Different ones of these, ascending.
fn choose(from: &[FrameIndex], count: usize, random: &mut Pcg64) -> Vec<FrameIndex> {
    let mut all = from.to_vec();
    for k in 0..count.min(all.len()) {
        let other = k + below(random, all.len() - k);
        all.swap(k, other);
    }
    all.truncate(count);
    all.sort_unstable();
    all
}

fn record<T: Record>(path: &Path) -> Result<T> {
    let read = read_record(path).map_err(|error| unusable(path, error.to_string()))?;
    Ok(read.0)
}

impl Read {
    /// A message about the clip.
    fn wrong(&self, what: impl Into<String>) -> Error {
        let path = self.folder.join("clip.r4c");
        unusable(&path, format!("clip `{}`: {}", self.clip.clip_id, what.into()))
    }

    /// Whether a network of this patch side can be trained on the clip, by a reference at least.
    fn check(&self, patch: usize) -> Result<()> {
        let clip = &self.clip;
        let [height, width] = [clip.height, clip.width].map(|side| side as usize);
        if !height.is_multiple_of(patch) || !width.is_multiple_of(patch) {
            return Err(self.wrong(format!(
                "its images are {width}x{height}; expected multiples of {patch}, as `[ingest] size` of the run's manifest \
                 has them"
            )));
        }
        if [self.robot.height, self.robot.width] != [clip.height, clip.width] || self.robot.clip_id != clip.clip_id {
            return Err(self.wrong("robot.r4c is of another clip or size; run `rogs run` again"));
        }
        if clip.source_frames.is_empty() || clip.source_cameras().is_empty() {
            return Err(self.wrong("it has no source view"));
        }
        for view in clip.source_views() {
            if clip.observation(view).is_none() {
                let camera = &clip.cameras[view.camera.at()].id;
                return Err(self.wrong(format!("camera `{camera}` has no image at frame {}", view.frame)));
            }
        }
        let mut references = 0;
        for camera in &clip.cameras {
            let Some(depth) = &camera.depth else { continue };
            let [nearest, farthest] = depth.range_m;
            let counts = |depth: &&f32| **depth > nearest && **depth < farthest;
            if !depth.depth_m.iter().any(|depth| counts(&depth)) {
                return Err(self.wrong(format!(
                    "the reference depth of camera `{}` has no valid value: expected numbers between {nearest} and {farthest} m",
                    camera.id
                )));
            }
            references += 1;
        }
        if let Some(tracks) = &clip.tracks {
            let frames = clip.frame_count();
            let whole = |track: &[f32]| {
                track
                    .chunks_exact(3)
                    .filter(|p| p.iter().all(|v| v.is_finite()))
                    .count()
                    > 1
            };
            if tracks.camera.is_empty() || !tracks.position_m.chunks_exact(3 * frames).any(whole) {
                return Err(self.wrong("its tracks are empty: none has two known positions"));
            }
            references += 1;
        }
        if self.mesh_depth && rogs_lift::sees_robot(&self.robot) {
            references += 1;
        }
        if references == 0 {
            return Err(self.wrong(if self.mesh_depth {
                "it has neither reference depth nor tracks, and its robot is not in view: nothing to learn geometry from"
            } else {
                "it has neither reference depth nor tracks: nothing to learn geometry from; `mesh_depth = true` takes the \
                 robot's mesh where cameras are calibrated"
            }));
        }
        Ok(())
    }

    /// The sample of these source and query times.
    fn sample(mut self, sources: Vec<FrameIndex>, queries: Vec<FrameIndex>, with_targets: bool) -> Result<Sample> {
        let wrong = |read: &Self, error: &dyn std::fmt::Display| read.wrong(error.to_string());
        self.clip.source_frames = sources;
        self.clip.query_frames = queries;
        let views = self.clip.source_views();
        let first = PosedCamera::of_clip(&self.clip, &self.robot, views[0].camera, views[0].frame)
            .map_err(|error| wrong(&self, &error))?;
        let recon_from_base: Pose<Recon, Base> = first.world_from_camera.inverse().relabelled();
        self.robot.recon_from_base = recon_from_base.to_rigid();
        let conditioning = rogs_conditioning::build(&self.clip, &self.robot, &rogs_conditioning::Params::default())
            .map_err(|error| wrong(&self, &error))?;
        let area = self.clip.height as usize * self.clip.width as usize;
        let count = views.len();
        let mut sample = Sample {
            origin: format!("clip `{}`", self.clip.clip_id),
            size: [self.clip.height as usize, self.clip.width as usize],
            images: Vec::with_capacity(3 * count * area),
            cameras: Vec::new(),
            recon_from_base_iu: recon_from_base.in_unit(LengthUnit::Internal),
            raster_cameras: Vec::new(),
            views: Vec::new(),
            depth_iu: Vec::with_capacity(count * area),
            valid: Vec::with_capacity(count * area),
            mesh_depth_iu: vec![0.0; count * area],
            anchored: true,
            support: vec![0.0; count * area],
            scale_cap_iu: vec![NO_CAP_IU; count * area],
            robot: vec![0.0; count * area],
            trackable: vec![0.0; count * area],
            still: false,
            near_tool: Vec::with_capacity(count * area),
            queries: Vec::new(),
        };
        let held = HeldPath::of_clip(&self.robot, &self.clip.robot.gripper).map_err(|error| wrong(&self, &error))?;
        let posed = |camera, frame| -> Result<PosedCamera<Recon>> {
            let camera = PosedCamera::of_clip(&self.clip, &self.robot, camera, frame);
            Ok(camera.map_err(|error| wrong(&self, &error))?.in_frame(&recon_from_base))
        };
        for (index, view) in views.iter().enumerate() {
            let camera = posed(view.camera, view.frame)?;
            let image = (self.clip.observation(*view)).ok_or_else(|| self.wrong("an image is missing"))?;
            sample.images.extend(planar(image.rgb()));
            let (depth, valid) = self.depth((view.camera, view.frame), area);
            let tool_m = held.as_ref().and_then(|path| path.tool(view.frame));
            let near = near_tool(&NetworkCamera::new(&camera), &depth, sample.size, tool_m);
            sample.near_tool.extend(near);
            sample.depth_iu.extend(depth);
            sample.valid.extend(valid);
            self.add_mesh(&mut sample, index, *view, &camera)?;
            sample.cameras.push(NetworkCamera::new(&camera));
            sample
                .raster_cameras
                .push(RasterCamera::new(&camera, LengthUnit::Internal));
            let time = time_of_frame(view.frame, self.clip.frame_count()) as f32;
            sample.views.push((view.camera, time));
        }
        let tracks = self.clip.tracks.as_ref();
        let tracked = tracks.map(|tracks| Tracked::of(&self.clip, tracks, &views, &recon_from_base, &posed));
        let tracked = tracked.transpose()?;
        for &frame in &self.clip.query_frames {
            let query = self.query(
                frame,
                (&views, &conditioning, held.as_ref()),
                &recon_from_base,
                &mut sample,
                tracked.as_ref(),
            )?;
            let targets = if with_targets {
                self.targets(frame, &posed)?
            } else {
                Vec::new()
            };
            sample.queries.push(Query { targets, ..query });
        }
        Ok(sample)
    }

    /// Reference depth of a camera at a frame, and whether it counts; nothing where there is none.
    fn depth(&self, (camera, frame): (CameraIndex, FrameIndex), area: usize) -> (Vec<f32>, Vec<f32>) {
        let depth = self.clip.cameras[camera.at()].depth.as_ref();
        let of_frame =
            depth.and_then(|depth| Some((depth.depth_m.get(frame.at() * area..)?.get(..area)?, depth.range_m)));
        match of_frame {
            Some((depth_m, range_m)) => reference_depth(depth_m, range_m),
            None => match self.map_at(camera, frame).filter(|_| self.mesh_depth) {
                Some(map) => mesh_reference(map),
                None => (vec![0.0; area], vec![0.0; area]),
            },
        }
    }

    fn map_at(&self, camera: CameraIndex, frame: FrameIndex) -> Option<&RobotMap> {
        (self.robot.maps.iter()).find(|map| map.camera == camera && map.frame == frame)
    }

    /// The map of a source view.
    fn map(&self, view: SourceView) -> Result<&RobotMap> {
        self.map_at(view.camera, view.frame).ok_or_else(|| {
            self.wrong(format!(
                "robot.r4c has no map of camera {} at frame {}",
                view.camera, view.frame
            ))
        })
    }

    /// Where the mesh anchors in a view, and where the robot is.
    fn add_mesh(&self, sample: &mut Sample, index: usize, view: SourceView, camera: &PosedCamera<Recon>) -> Result<()> {
        let area = sample.size[0] * sample.size[1];
        let map = self.map(view)?;
        let k = &camera.lens.intrinsics;
        let footprint = LiftParams::default()
            .footprint_px
            .map(|pixels| pixels / k.fx.min(k.fy) as f32);
        for (pixel, (&depth_m, &supported)) in map.depth_m.iter().zip(&map.support).enumerate() {
            let at = index * area + pixel;
            if supported != 0 {
                let depth = iu_from_m(depth_m);
                sample.mesh_depth_iu[at] = depth;
                sample.support[at] = 1.0;
                sample.robot[at] = 1.0;
                sample.trackable[at] = 1.0;
                sample.scale_cap_iu[at] = footprint.map_or(NO_CAP_IU, |cap| cap * depth);
            }
        }
        Ok(())
    }

    /// Conditioning and known motion of a query time, without targets.
    fn query(
        &self,
        frame: FrameIndex,
        (views, conditioning, held): (&[SourceView], &Conditioning, Option<&HeldPath>),
        recon_from_base: &Pose<Recon, Base>,
        sample: &mut Sample,
        tracked: Option<&Tracked>,
    ) -> Result<Query> {
        let area = sample.size[0] * sample.size[1];
        let stored = conditioning.query_frames.iter().position(|&own| own == frame);
        let stored = stored.ok_or_else(|| self.wrong(format!("there is no conditioning for frame {frame}")))?;
        let mut query = Query {
            time: time_of_frame(frame, self.clip.frame_count()) as f32,
            kappa: Vec::with_capacity(KAPPA_CHANNELS * views.len() * area),
            held: (views.iter())
                .map(|view| HeldMotion::new(held?, view.frame, frame.at() as f64, recon_from_base))
                .collect(),
            fk_slope: vec![0.0; 3 * views.len() * area],
            displacement_iu: vec![0.0; 3 * views.len() * area],
            targets: Vec::new(),
        };
        for (index, view) in views.iter().enumerate() {
            let kappa = conditioning.dense(index, stored);
            let maps = &conditioning.view_maps[index];
            let camera = &sample.cameras[index];
            let [height, width] = sample.size;
            for (&pixel, &link) in maps.pixels.iter().zip(&maps.link) {
                let pixel = pixel as usize;
                let (u, v) = (
                    ((pixel % width) as f64 + 0.5) / width as f64,
                    ((pixel / width) as f64 + 0.5) / height as f64,
                );
                let ray = glam::DVec3::from_array(camera.point(u, v, 1.0)) - camera.world_from_camera_iu.translation;
                let motion = self.link_motion(usize::from(link), (view.frame, frame), recon_from_base)?;
                let slope = motion.direction(ray) - ray;
                for axis in 0..3 {
                    let at = (3 * index + axis) * area + pixel;
                    query.fk_slope[at] = slope[axis] as f32;
                    query.displacement_iu[at] = kappa[(plane::DISPLACEMENT + axis) * area + pixel];
                }
            }
            query.kappa.extend(kappa);
        }
        for known in tracked.iter().flat_map(|tracked| &tracked.pixels) {
            let at = known.view * area + known.pixel;
            let Some(moved) = known.moved(frame).filter(|_| sample.support[at] == 0.0) else {
                continue;
            };
            sample.trackable[at] = 1.0;
            for axis in 0..3 {
                query.displacement_iu[(3 * known.view + axis) * area + known.pixel] = moved[axis];
            }
        }
        Ok(query)
    }

    /// How a link moves from one frame to another, in the reconstruction frame.
    fn link_motion(
        &self,
        link: usize,
        (from, to): (FrameIndex, FrameIndex),
        recon_from_base: &Pose<Recon, Base>,
    ) -> Result<Pose<Recon, Recon>> {
        let links = self.robot.link_names.len();
        let at = |frame: FrameIndex| {
            let stored = &self.robot.base_from_link[frame.at() * links + link];
            Pose::<Base, Link>::from_rigid(stored).map_err(|error| self.wrong(error.to_string()))
        };
        Ok(*recon_from_base * (at(to)? * at(from)?.inverse()) * recon_from_base.inverse())
    }

    /// What cameras with images saw at a frame, source cameras first.
    fn targets(
        &self,
        frame: FrameIndex,
        posed: &dyn Fn(CameraIndex, FrameIndex) -> Result<PosedCamera<Recon>>,
    ) -> Result<Vec<Target>> {
        let area = self.clip.height as usize * self.clip.width as usize;
        let mut targets = Vec::new();
        for (camera, own) in CameraIndex::first(self.clip.cameras.len()).zip(&self.clip.cameras) {
            let Some(image) = self.clip.target(camera, frame) else {
                continue;
            };
            let (depth_iu, valid) = self.depth((camera, frame), area);
            let map = self.map_at(camera, frame);
            targets.push(Target {
                right: own.role == CameraRole::Evaluation,
                camera: RasterCamera::new(&posed(camera, frame)?, LengthUnit::Internal),
                rgb: image.rgb().iter().map(|&value| f32::from(value) / 255.0).collect(),
                depth_iu,
                valid,
                support: map.map_or_else(
                    || vec![0.0; area],
                    |map| map.support.iter().map(|&supported| f32::from(supported)).collect(),
                ),
            });
        }
        if targets.is_empty() {
            return Err(self.wrong(format!("no camera has an image at frame {frame}")));
        }
        Ok(targets)
    }
}
