//! One training clip from a procedural episode: what the network sees, and exact references for every loss.

use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;
use rogs_networks::stage1::Camera;
use rogs_random::Pcg64;
use rogs_schemas::RigidPose;
use rogs_schemas::records::clip::time_of_frame;
use rogs_schemas::records::conditioning::{GripperPrior, KAPPA_CHANNELS};
use rogs_schemas::units::{UNITS_PER_METRE, iu_from_m};
use rogs_splat::Camera as RasterCamera;
use rogs_synth::{Episode, FIRST_OBJECT_ID, FIRST_SCENERY_ID, Resolution, SynthConfig, View, generate_episode};

use crate::config::DataSettings;
use crate::error::{Error, Result};
use crate::records::Records;

/// Cameras whose images the network sees; their right eyes follow them in the episode.
pub const SOURCE_CAMERAS: usize = 3;
/// Frames of a procedural episode.
const EPISODE_FRAMES: u32 = 33;
/// References outside this interval take no part in depth losses, metres (as in scoring).
pub(crate) const DEPTH_RANGE_M: [f32; 2] = [0.1, 5.0];
/// Largest footprint of an anchored Gaussian, source pixels (`lift`'s default).
const FOOTPRINT_PX: f32 = 1.5;
/// A cap that caps nothing, internal units.
const NO_CAP_IU: f32 = 1e3;
/// Links farther apart than this are different surfaces, metres (`robot-maps`' default).
const LINK_STEP_M: f32 = 0.03;
/// Standard deviation of the gripper-neighbourhood prior, metres (`conditioning`'s default).
const PRIOR_SIGMA_M: f64 = 0.10;

/// A clip in the reconstruction frame, internal units. `S` source views in token order (camera-major, times ascending),
/// `A = H W` pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Seed of the episode.
    pub seed: u64,
    /// Image height and width.
    pub size: [usize; 2],
    /// RGB in 0..1. `[S, 3, H, W]`
    pub images: Vec<f32>,
    /// Camera of each view.
    pub cameras: Vec<Camera>,
    /// The same for the rasteriser.
    pub raster_cameras: Vec<RasterCamera>,
    /// Index of the camera of each view, and its normalised time. `[S]`
    pub views: Vec<(u32, f32)>,
    /// Reference depth, internal units; 0 where there is none. `[S, A]`
    pub depth_iu: Vec<f32>,
    /// 1 where the reference depth counts. `[S, A]`
    pub valid: Vec<f32>,
    /// Mesh depth at valid robot support, internal units; 0 elsewhere. `[S, A]`
    pub mesh_depth_iu: Vec<f32>,
    /// 1 at valid robot support: what is anchored and conditioned. `[S, A]`
    pub support: Vec<f32>,
    /// Largest scale of the Gaussians at valid support, internal units; large elsewhere. `[S, A]`
    pub scale_cap_iu: Vec<f32>,
    /// 1 on the robot. `[S, A]`
    pub robot: Vec<f32>,
    /// 1 on the robot and on objects: what tracks can start on. `[S, A]`
    pub trackable: Vec<f32>,
    /// What is asked of the field.
    pub queries: Vec<Query>,
}

/// One query time of a clip.
#[derive(Debug, Clone, PartialEq)]
pub struct Query {
    /// Normalised time.
    pub time: f32,
    /// Conditioning maps. `[S, 7, H, W]`
    pub kappa: Vec<f32>,
    /// Displacement of every source pixel from its own time to this one, internal units. `[S, 3, H, W]`
    pub displacement_iu: Vec<f32>,
    /// Views of all cameras at this time.
    pub targets: Vec<Target>,
}

/// What a camera saw at a query time.
#[derive(Debug, Clone, PartialEq)]
pub struct Target {
    /// Whether it is the right eye of a source camera.
    pub right: bool,
    /// The camera.
    pub camera: RasterCamera,
    /// RGB in 0..1. `[A, 3]`
    pub rgb: Vec<f32>,
    /// Depth in internal units, 0 where there is none. `[A]`
    pub depth_iu: Vec<f32>,
    /// 1 where the depth counts. `[A]`
    pub valid: Vec<f32>,
}

/// Which frames of which episode.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClipPlan {
    /// Seed of the episode.
    pub seed: u64,
    /// First episode frame of the clip.
    pub first: u32,
    /// Clip frames whose images the network sees, ascending.
    pub sources: Vec<u32>,
    /// Clip frames that are asked for, ascending.
    pub queries: Vec<u32>,
}

impl ClipPlan {
    /// A plan with the given number of source times, drawn from `random`: half of the plans spread them evenly, as
    /// evaluation does.
    #[must_use]
    pub fn draw(seed: u64, sources: u32, data: &DataSettings, random: &mut Pcg64) -> Self {
        let frames = data.clip_frames;
        let latest = EPISODE_FRAMES.saturating_sub(frames);
        let first = (random.next_double() * f64::from(latest + 1)) as u32;
        let even = random.next_double() < 0.5;
        Self {
            seed,
            first: first.min(latest),
            sources: if even {
                spread(frames, sources)
            } else {
                choose(frames, sources, random)
            },
            queries: choose(frames, data.queries, random),
        }
    }

    /// The clip that evaluation cuts: the paper's interval, evenly spread sources, queries between them.
    #[must_use]
    pub fn evaluation(seed: u64, data: &DataSettings) -> Self {
        let frames = data.clip_frames;
        Self {
            seed,
            first: 7.min(EPISODE_FRAMES.saturating_sub(frames)),
            sources: spread(frames, data.source_times[1]),
            queries: spread(frames, 3.min(frames))
                .into_iter()
                .map(|frame| frame.saturating_sub(2))
                .collect(),
        }
    }

    /// Makes the clip.
    ///
    /// # Errors
    /// When no motion can be found for the seed.
    pub fn sample(&self, data: &DataSettings, with_targets: bool) -> Result<Sample> {
        let episode = self.episode(data)?;
        Ok(Maker::new(self, data, &episode).sample(with_targets))
    }

    /// The records that the pipeline would make of the clip.
    ///
    /// # Errors
    /// As [`Self::sample`].
    pub fn records(&self, data: &DataSettings) -> Result<Records> {
        let episode = self.episode(data)?;
        Ok(Maker::new(self, data, &episode).records())
    }

    /// Makes something of the plan; a seed for which no motion is found gives way to another one far from all others.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn or_another<T>(&self, make: impl Fn(&Self) -> Result<T>) -> Result<T> {
        const FAR: u64 = 1 << 40;
        match make(self) {
            Err(Error::Synth(_)) => make(&Self {
                seed: self.seed + FAR,
                ..self.clone()
            }),
            result => result,
        }
    }

    fn episode(&self, data: &DataSettings) -> Result<Episode> {
        let config = SynthConfig {
            frames: EPISODE_FRAMES.max(data.clip_frames),
            resolution: Resolution {
                wrist: data.size,
                external: data.size,
            },
            calibration_noise: data.calibration_noise,
            anchor_frame: Some(self.first + self.sources[0]),
            ..SynthConfig::default()
        };
        Ok(generate_episode(&config, self.seed)?)
    }
}

/// Frames spread evenly from the first to the last.
fn spread(frames: u32, count: u32) -> Vec<u32> {
    if count < 2 {
        return vec![0];
    }
    let last = f64::from(frames - 1);
    (0..count)
        .map(|k| (f64::from(k) * last / f64::from(count - 1)).round() as u32)
        .collect()
}

/// Different frames, ascending.
fn choose(frames: u32, count: u32, random: &mut Pcg64) -> Vec<u32> {
    let mut all: Vec<u32> = (0..frames).collect();
    for k in 0..count as usize {
        let other = k + (random.next_double() * (all.len() - k) as f64) as usize;
        all.swap(k, other.min(frames as usize - 1));
    }
    all.truncate(count as usize);
    all.sort_unstable();
    all
}

/// Makes what training needs of a clip.
pub(crate) struct Maker<'a> {
    pub(crate) plan: &'a ClipPlan,
    pub(crate) data: &'a DataSettings,
    pub(crate) episode: &'a Episode,
    /// Reconstruction frame from base, metres.
    pub(crate) recon_from_base: DAffine3,
}

impl<'a> Maker<'a> {
    fn new(plan: &'a ClipPlan, data: &'a DataSettings, episode: &'a Episode) -> Self {
        let mut maker = Self {
            plan,
            data,
            episode,
            recon_from_base: DAffine3::IDENTITY,
        };
        maker.recon_from_base = inverse(&maker.recorded(0, maker.frame(plan.sources[0])));
        maker
    }

    /// Episode frame of a clip frame.
    pub(crate) fn frame(&self, clip_frame: u32) -> usize {
        (self.plan.first + clip_frame) as usize
    }

    /// Camera-to-base pose as it is recorded.
    pub(crate) fn recorded(&self, camera: usize, frame: usize) -> DAffine3 {
        let lens = &self.episode.cameras[camera];
        let recorded = rogs_synth::Camera {
            mount: lens.recorded_mount,
            ..*lens
        };
        recorded.base_from_camera(&self.episode.base_from_flange(frame))
    }

    fn sample(&self, with_targets: bool) -> Sample {
        let [height, width] = self.data.size.map(|side| side as usize);
        let area = height * width;
        let sources: Vec<Vec<View>> = (self.plan.sources.iter())
            .map(|&frame| self.episode.render_cameras(self.frame(frame), &[0, 1, 2]))
            .collect();
        let order: Vec<(usize, usize)> = (0..SOURCE_CAMERAS)
            .flat_map(|camera| (0..sources.len()).map(move |time| (camera, time)))
            .collect();
        let mut sample = Sample {
            seed: self.plan.seed,
            size: [height, width],
            images: Vec::with_capacity(order.len() * 3 * area),
            cameras: Vec::new(),
            raster_cameras: Vec::new(),
            views: Vec::new(),
            depth_iu: Vec::with_capacity(order.len() * area),
            valid: Vec::with_capacity(order.len() * area),
            mesh_depth_iu: Vec::with_capacity(order.len() * area),
            support: Vec::with_capacity(order.len() * area),
            scale_cap_iu: Vec::with_capacity(order.len() * area),
            robot: Vec::with_capacity(order.len() * area),
            trackable: Vec::with_capacity(order.len() * area),
            queries: Vec::new(),
        };
        let mark = |on: bool| f32::from(u8::from(on));
        for &(camera, time) in &order {
            let (view, clip_frame) = (&sources[time][camera], self.plan.sources[time]);
            let frame = self.frame(clip_frame);
            for channel in 0..3 {
                let values = view.rgb[channel..].iter().step_by(3);
                sample.images.extend(values.map(|&value| f32::from(value) / 255.0));
            }
            let (depth, valid) = reference_depth(view);
            sample.depth_iu.extend(depth);
            sample.valid.extend(valid);
            let k = &self.episode.cameras[camera].intrinsics;
            let footprint = FOOTPRINT_PX / k.fx.min(k.fy) as f32;
            for (&depth_m, supported) in view.depth_m.iter().zip(support(view, width)) {
                let depth = if supported { iu_from_m(depth_m) } else { 0.0 };
                sample.mesh_depth_iu.push(depth);
                sample.support.push(mark(supported));
                let cap = if supported { footprint * depth } else { NO_CAP_IU };
                sample.scale_cap_iu.push(cap);
            }
            sample
                .robot
                .extend(view.id.iter().map(|&id| mark(id < FIRST_OBJECT_ID)));
            sample
                .trackable
                .extend(view.id.iter().map(|&id| mark(id < FIRST_SCENERY_ID)));
            sample.cameras.push(self.network_camera(camera, frame));
            sample.raster_cameras.push(self.raster_camera(camera, frame));
            let time = time_of_frame(clip_frame, self.data.clip_frames as usize) as f32;
            sample.views.push((camera as u32, time));
        }
        sample.queries = (self.plan.queries.iter())
            .map(|&query| self.query(query, &order, &sources, with_targets))
            .collect();
        sample
    }

    fn query(&self, query: u32, order: &[(usize, usize)], sources: &[Vec<View>], with_targets: bool) -> Query {
        let to = self.frame(query);
        let maps: Vec<(Vec<f32>, Vec<f32>)> = (order.par_iter())
            .map(|&(camera, time)| {
                let from = self.frame(self.plan.sources[time]);
                self.motion(&sources[time][camera], camera, from, to)
            })
            .collect();
        let views = if with_targets {
            self.episode.render_frame(to).views
        } else {
            Vec::new()
        };
        let targets = views.iter().enumerate().map(|(camera, view)| {
            let (depth_iu, valid) = reference_depth(view);
            Target {
                right: camera >= SOURCE_CAMERAS,
                camera: self.raster_camera(camera, to),
                rgb: view.rgb.iter().map(|&value| f32::from(value) / 255.0).collect(),
                depth_iu,
                valid,
            }
        });
        Query {
            time: time_of_frame(query, self.data.clip_frames as usize) as f32,
            targets: targets.collect(),
            kappa: maps.iter().flat_map(|(kappa, _)| kappa.iter().copied()).collect(),
            displacement_iu: maps.iter().flat_map(|(_, motion)| motion.iter().copied()).collect(),
        }
    }

    /// Conditioning map and displacement of one view's pixels from frame to frame.
    fn motion(&self, view: &View, camera: usize, from: usize, to: usize) -> (Vec<f32>, Vec<f32>) {
        let lens = &self.episode.cameras[camera];
        let (width, area, k) = (lens.width as usize, view.id.len(), lens.intrinsics);
        let recon_from_camera = self.recon_from_base * self.episode.base_from_camera(camera, from);
        let base_from_recon = inverse(&self.recon_from_base);
        // How each body moves, in the reconstruction frame; `None` where it stays.
        let moves: Vec<Option<DAffine3>> = (0..FIRST_SCENERY_ID)
            .map(|id| {
                let (before, after) = (self.episode.body_pose(id, from)?, self.episode.body_pose(id, to)?);
                (before != after).then(|| self.recon_from_base * after * inverse(&before) * base_from_recon)
            })
            .collect();
        let prior = self.prior(camera, from);
        let support = support(view, width);
        let mut kappa = vec![0.0f32; KAPPA_CHANNELS * area];
        let mut displacement = vec![0.0f32; 3 * area];
        for pixel in 0..area {
            let (row, column) = (pixel / width, pixel % width);
            kappa[5 * area + pixel] = 1.0;
            kappa[6 * area + pixel] = prior.at(column as u32, row as u32);
            let (id, depth_m) = (view.id[pixel], view.depth_m[pixel]);
            let supported = support[pixel];
            if supported {
                kappa[pixel] = 1.0;
                kappa[area + pixel] = depth_m;
            }
            let Some(Some(motion)) = moves.get(usize::from(id)) else {
                continue;
            };
            let ray = DVec3::new(
                (column as f64 + 0.5 - k.cx) / k.fx,
                (row as f64 + 0.5 - k.cy) / k.fy,
                1.0,
            );
            let point = recon_from_camera.transform_point3(ray * f64::from(depth_m));
            let moved = (motion.transform_point3(point) - point) * UNITS_PER_METRE;
            for axis in 0..3 {
                displacement[axis * area + pixel] = moved[axis] as f32;
                if supported {
                    kappa[(2 + axis) * area + pixel] = moved[axis] as f32;
                }
            }
        }
        (kappa, displacement)
    }

    pub(crate) fn prior(&self, camera: usize, frame: usize) -> GripperPrior {
        let k = self.episode.cameras[camera].intrinsics;
        let tool = inverse(&self.recorded(camera, frame)).transform_point3(self.episode.tool(frame));
        let centre_px = if tool.z > 0.0 {
            [tool.x / tool.z * k.fx + k.cx, tool.y / tool.z * k.fy + k.cy]
        } else {
            [0.0, 0.0]
        };
        GripperPrior {
            centre_px,
            depth_m: tool.z,
            focal_px: [k.fx, k.fy],
            sigma_m: PRIOR_SIGMA_M,
        }
    }

    fn network_camera(&self, camera: usize, frame: usize) -> Camera {
        let lens = &self.episode.cameras[camera];
        let (width, height, k) = (f64::from(lens.width), f64::from(lens.height), lens.intrinsics);
        let pose = rigid(&(self.recon_from_base * self.recorded(camera, frame)));
        Camera {
            rotation: pose.rotation,
            translation_iu: pose.translation.map(|metres| metres * UNITS_PER_METRE),
            focal_centre: [k.fx / width, k.fy / height, k.cx / width, k.cy / height],
        }
    }

    fn raster_camera(&self, camera: usize, frame: usize) -> RasterCamera {
        let lens = &self.episode.cameras[camera];
        let pose = rigid(&(self.recon_from_base * self.recorded(camera, frame)));
        RasterCamera::from_world_pose(lens.width, lens.height, &lens.intrinsics, &pose, UNITS_PER_METRE)
    }
}

/// Valid robot support by the rule of `robot-maps`: robot with all its neighbours, no two of which are links far apart in
/// depth. `[A]`
pub(crate) fn support(view: &View, width: usize) -> Vec<bool> {
    let height = view.id.len() / width;
    let apart =
        |a: usize, b: usize| view.id[a] != view.id[b] && (view.depth_m[a] - view.depth_m[b]).abs() > LINK_STEP_M;
    let valid = |pixel: usize| {
        let (row, column) = (pixel / width, pixel % width);
        if row == 0 || column == 0 || row + 1 == height || column + 1 == width {
            return false;
        }
        let mut window = [0; 9];
        for (index, other) in window.iter_mut().enumerate() {
            *other = (row + index / 3 - 1) * width + column + index % 3 - 1;
        }
        window.iter().all(|&a| view.id[a] < FIRST_OBJECT_ID)
            && !window.iter().any(|&a| window.iter().any(|&b| apart(a, b)))
    };
    (0..view.id.len()).map(valid).collect()
}

/// Depth in internal units and whether it counts.
fn reference_depth(view: &View) -> (Vec<f32>, Vec<f32>) {
    let [nearest, farthest] = DEPTH_RANGE_M;
    view.depth_m
        .iter()
        .map(|&depth| {
            if depth > nearest && depth < farthest {
                (iu_from_m(depth), 1.0)
            } else {
                (0.0, 0.0)
            }
        })
        .unzip()
}

fn inverse(pose: &DAffine3) -> DAffine3 {
    let rotation = pose.matrix3.transpose();
    DAffine3::from_mat3_translation(rotation, -(rotation * pose.translation))
}

/// The stored form of a rigid transform, rotation row-major.
pub(crate) fn rigid(pose: &DAffine3) -> RigidPose {
    let DMat3 { x_axis, y_axis, z_axis } = pose.matrix3;
    RigidPose {
        rotation: [
            x_axis.x, y_axis.x, z_axis.x, x_axis.y, y_axis.y, z_axis.y, x_axis.z, y_axis.z, z_axis.z,
        ],
        translation: pose.translation.to_array(),
    }
}
