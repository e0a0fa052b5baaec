//! One training clip from a procedural episode: what the network sees, and exact references for every loss.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use rogs_geometry::{Base, Link, Pose, Recon};
use rogs_lift::LiftParams;
use rogs_schemas::records::clip::time_of_frame;
use rogs_schemas::records::conditioning::{GripperPrior, KAPPA_CHANNELS, plane};
use rogs_schemas::units::{LengthUnit, UNITS_PER_METRE, iu_from_m};
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_splat::RasterCamera;
use rogs_stage1::NetworkCamera;
use rogs_stage1::held::{HeldMotion, HeldPath, REACH_M};
use rogs_synth::{CAMERAS, FIRST_OBJECT_ID, FIRST_SCENERY_ID, View};

use crate::builder::{ClipBuilder, DEPTH_RANGE_M, RobotSeen};
use crate::config::DataSettings;
use crate::error::Result;
use crate::plan::ClipPlan;

/// A cap that caps nothing, internal units.
pub(crate) const NO_CAP_IU: f32 = 1e3;

/// A clip in the reconstruction frame, internal units. `S` source views in token order (camera-major, times ascending),
/// `A = H W` pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Where the clip comes from, for messages.
    pub origin: String,
    /// Image height and width.
    pub size: [usize; 2],
    /// RGB in 0..1. `[S, 3, H, W]`
    pub images: Vec<f32>,
    /// Camera of each view, as the network sees it.
    pub cameras: Vec<NetworkCamera>,
    /// Where the base of the robot stands, internal units.
    pub recon_from_base_iu: Pose<Recon, Base>,
    /// Camera of each view, as it renders.
    pub raster_cameras: Vec<RasterCamera>,
    /// Index of the camera of each view, and its normalised time. `[S]`
    pub views: Vec<(CameraIndex, f32)>,
    /// Reference depth, internal units; 0 where there is none. `[S, A]`
    pub depth_iu: Vec<f32>,
    /// 1 where the reference depth counts. `[S, A]`
    pub valid: Vec<f32>,
    /// Mesh depth where it anchors, at valid robot support, internal units; 0 elsewhere. `[S, A]`
    pub mesh_depth_iu: Vec<f32>,
    /// Whether robot pixels are anchored; if not, their FK displacement is taken at the depth that the network finds.
    pub anchored: bool,
    /// 1 at valid robot support: what is conditioned. `[S, A]`
    pub support: Vec<f32>,
    /// Largest scale of the Gaussians at valid support, internal units; large elsewhere. `[S, A]`
    pub scale_cap_iu: Vec<f32>,
    /// 1 on the robot. `[S, A]`
    pub robot: Vec<f32>,
    /// 1 on the robot and on objects: what tracks can start on. In recorded clips 1 where the motion is known. `[S, A]`
    pub trackable: Vec<f32>,
    /// Whether all else is known to stand still.
    pub still: bool,
    /// 1 where a reference depth shows a surface within reach of the gripper, the robot's own among them. `[S, A]`
    pub near_tool: Vec<f32>,
    /// What is asked of the field.
    pub queries: Vec<Query>,
}

impl Sample {
    /// The clip without mesh anchoring: positions of robot pixels are then the network's own.
    #[must_use]
    pub fn without_anchors(&self) -> Self {
        let mut free = self.clone();
        free.anchored = false;
        free.mesh_depth_iu.fill(0.0);
        free.scale_cap_iu.fill(NO_CAP_IU);
        free
    }
}

/// One query time of a clip.
#[derive(Debug, Clone, PartialEq)]
pub struct Query {
    /// Normalised time.
    pub time: f32,
    /// Conditioning maps. `[S, 7, H, W]`
    pub kappa: Vec<f32>,
    /// By how much the FK displacement of a conditioned pixel changes with its depth, 0 elsewhere. `[S, 3, H, W]`
    pub fk_slope: Vec<f32>,
    /// How each view's gripper moves what it holds; `None` where there is no robot. `[S]`
    pub held: Vec<Option<HeldMotion>>,
    /// Displacement of every source pixel from its own time to this one, internal units. `[S, 3, H, W]`
    pub displacement_iu: Vec<f32>,
    /// Views of all cameras at this time, source cameras first.
    pub targets: Vec<Target>,
}

impl Query {
    /// How far a pixel (row-major into `[S, A]`) moves, internal units; `area` pixels a view.
    pub(crate) fn moved_iu(&self, pixel: usize, area: usize) -> f32 {
        let first = 3 * (pixel / area) * area + pixel % area;
        let square = |axis: usize| self.displacement_iu[first + axis * area].powi(2);
        (square(0) + square(1) + square(2)).sqrt()
    }
}

/// What a camera saw at a query time.
#[derive(Debug, Clone, PartialEq)]
pub struct Target {
    /// Whether it is held out: the right eye of a source camera, or a camera that is no source of the clip.
    pub right: bool,
    /// The camera.
    pub camera: RasterCamera,
    /// RGB in 0..1. `[A, 3]`
    pub rgb: Vec<f32>,
    /// Depth in internal units, 0 where there is none. `[A]`
    pub depth_iu: Vec<f32>,
    /// 1 where the depth counts. `[A]`
    pub valid: Vec<f32>,
    /// 1 at valid robot support. `[A]`
    pub support: Vec<f32>,
}

/// A picture of a source camera, and the robot's mesh in it.
struct Source {
    view: View,
    robot: RobotSeen,
}

/// What a [`Query`] says of one view.
struct Motion {
    kappa: Vec<f32>,
    fk_slope: Vec<f32>,
    displacement_iu: Vec<f32>,
}

impl ClipPlan {
    /// Makes the clip.
    ///
    /// # Errors
    /// When no motion can be found for the seed.
    pub fn sample(&self, data: &DataSettings, with_targets: bool) -> Result<Sample> {
        let episode = self.episode(data)?;
        Ok(ClipBuilder::new(self, data, &episode).sample(with_targets))
    }
}

impl ClipBuilder<'_> {
    pub(crate) fn sample(&self, with_targets: bool) -> Sample {
        let [height, width] = self.plan.size.map(|side| side as usize);
        let area = height * width;
        let sources: Vec<Vec<Source>> = (self.plan.sources.iter())
            .map(|&frame| {
                let frame = self.frame(frame);
                let views = self.episode.render_cameras(frame, &self.plan.cameras);
                let with_robot = |(view, &camera): (View, &usize)| Source {
                    robot: self.robot_seen(&view, camera, frame),
                    view,
                };
                views.into_iter().zip(&self.plan.cameras).map(with_robot).collect()
            })
            .collect();
        let order: Vec<(usize, usize)> = (0..self.plan.cameras.len())
            .flat_map(|camera| (0..sources.len()).map(move |time| (camera, time)))
            .collect();
        let mut sample = Sample {
            origin: format!("the clip of seed {}", self.plan.seed),
            size: [height, width],
            images: Vec::with_capacity(order.len() * 3 * area),
            cameras: Vec::new(),
            recon_from_base_iu: self.recon_from_base.in_unit(LengthUnit::Internal),
            raster_cameras: Vec::new(),
            views: Vec::new(),
            depth_iu: Vec::with_capacity(order.len() * area),
            valid: Vec::with_capacity(order.len() * area),
            mesh_depth_iu: Vec::with_capacity(order.len() * area),
            anchored: true,
            support: Vec::with_capacity(order.len() * area),
            scale_cap_iu: Vec::with_capacity(order.len() * area),
            robot: Vec::with_capacity(order.len() * area),
            trackable: Vec::with_capacity(order.len() * area),
            still: true,
            near_tool: Vec::with_capacity(order.len() * area),
            queries: Vec::new(),
        };
        let held = self.held_path();
        let mark = |on: bool| f32::from(u8::from(on));
        let footprint_px = LiftParams::default().footprint_px;
        for &(place, time) in &order {
            let (Source { view, robot }, clip_frame) = (&sources[time][place], self.plan.sources[time]);
            let (camera, frame) = (self.plan.cameras[place], self.frame(clip_frame));
            for channel in 0..3 {
                let values = view.rgb[channel..].iter().step_by(3);
                sample.images.extend(values.map(|&value| f32::from(value) / 255.0));
            }
            let (depth, valid) = reference_depth(view);
            sample.depth_iu.extend(depth);
            sample.valid.extend(valid);
            let k = &self.episode.cameras[camera].recorded_lens.intrinsics;
            let footprint = footprint_px.map(|pixels| pixels / k.fx.min(k.fy) as f32);
            for (&depth_m, &supported) in robot.depth_m.iter().zip(&robot.support) {
                let supported = supported != 0;
                let depth = if supported { iu_from_m(depth_m) } else { 0.0 };
                sample.mesh_depth_iu.push(depth);
                sample.support.push(mark(supported));
                let cap = footprint.filter(|_| supported).map_or(NO_CAP_IU, |cap| cap * depth);
                sample.scale_cap_iu.push(cap);
            }
            sample
                .robot
                .extend(view.id.iter().map(|&id| mark(id < FIRST_OBJECT_ID)));
            sample
                .trackable
                .extend(view.id.iter().map(|&id| mark(id < FIRST_SCENERY_ID)));
            let posed = self.posed(camera, frame);
            let network_camera = NetworkCamera::new(&posed);
            let depth = &sample.depth_iu[sample.near_tool.len()..];
            let near = near_tool(&network_camera, depth, sample.size, held.tool(clip_frame));
            sample.near_tool.extend(near);
            sample.cameras.push(network_camera);
            sample
                .raster_cameras
                .push(RasterCamera::new(&posed, LengthUnit::Internal));
            let time = time_of_frame(clip_frame, self.data.clip_frames as usize) as f32;
            sample.views.push((CameraIndex(camera as u32), time));
        }
        sample.queries = (self.plan.queries.iter())
            .map(|&query| self.query(query, (&order, &held), &sources, with_targets))
            .collect();
        sample
    }

    /// The path of what the gripper holds, as the lift stage has it of the clip's records.
    fn held_path(&self) -> HeldPath {
        let frames = FrameIndex::first(self.data.clip_frames as usize).map(|frame| self.frame(frame));
        let hand = |frame| self.recon_from_base * self.episode.base_from_flange(frame).relabelled::<Base, Link>();
        let hands: Vec<Pose<Recon, Link>> = frames.clone().map(hand).collect();
        let gripper: Vec<f64> = frames.clone().map(|frame| self.episode.states[frame].gripper).collect();
        let tool = frames.map(|frame| self.recon_from_base.point(self.episode.tool(frame)));
        HeldPath::new(&hands, &gripper, tool.collect())
    }

    fn query(
        &self,
        query: FrameIndex,
        (order, held): (&[(usize, usize)], &HeldPath),
        sources: &[Vec<Source>],
        with_targets: bool,
    ) -> Query {
        let to = self.frame(query);
        let maps: Vec<Motion> = (order.par_iter())
            .map(|&(place, time)| {
                let from = self.frame(self.plan.sources[time]);
                self.motion(&sources[time][place], self.plan.cameras[place], from, to)
            })
            .collect();
        let held_out = (0..CAMERAS).filter(|camera| !self.plan.cameras.contains(camera));
        let cameras: Vec<usize> = self.plan.cameras.iter().copied().chain(held_out).collect();
        let views = if with_targets {
            self.episode.render_cameras(to, &cameras)
        } else {
            Vec::new()
        };
        let targets = views.iter().zip(cameras).map(|(view, camera)| {
            let (depth_iu, valid) = reference_depth(view);
            Target {
                right: !self.plan.cameras.contains(&camera),
                camera: RasterCamera::new(&self.posed(camera, to), LengthUnit::Internal),
                rgb: view.rgb.iter().map(|&value| f32::from(value) / 255.0).collect(),
                depth_iu,
                valid,
                support: (self.robot_seen(view, camera, to).support.into_iter())
                    .map(f32::from)
                    .collect(),
            }
        });
        Query {
            time: time_of_frame(query, self.data.clip_frames as usize) as f32,
            targets: targets.collect(),
            held: (order.iter())
                .map(|&(_, time)| {
                    HeldMotion::new(held, self.plan.sources[time], query.at() as f64, &self.recon_from_base)
                })
                .collect(),
            kappa: maps.iter().flat_map(|motion| &motion.kappa).copied().collect(),
            fk_slope: maps.iter().flat_map(|motion| &motion.fk_slope).copied().collect(),
            displacement_iu: maps
                .iter()
                .flat_map(|motion| &motion.displacement_iu)
                .copied()
                .collect(),
        }
    }

    /// How one view's pixels move from frame to frame.
    fn motion(&self, source: &Source, camera: usize, from: usize, to: usize) -> Motion {
        let Source { view, robot } = source;
        let eye = &self.episode.cameras[camera];
        let (width, area) = (eye.lens.width as usize, view.id.len());
        let recon_from_camera = self.recon_from_base * self.episode.base_from_camera(camera, from);
        // The mesh lies where the recorded camera has it, and moves as kinematics say.
        let recon_from_recorded = self.recon_from_base * self.recorded(camera, from);
        let base_from_recon = self.recon_from_base.inverse();
        // How each body moves, in the reconstruction frame; `None` where it stays.
        let moves: Vec<Option<Pose<Recon, Recon>>> = (0..FIRST_SCENERY_ID)
            .map(|id| {
                let (before, after) = (self.episode.body_pose(id, from)?, self.episode.body_pose(id, to)?);
                (before != after).then(|| self.recon_from_base * after * before.inverse() * base_from_recon)
            })
            .collect();
        let prior = self.prior(camera, from);
        let mut kappa = vec![0.0f32; KAPPA_CHANNELS * area];
        let (mut fk_slope, mut displacement_iu) = (vec![0.0f32; 3 * area], vec![0.0f32; 3 * area]);
        for pixel in 0..area {
            let (row, column) = (pixel / width, pixel % width);
            kappa[plane::AVAILABLE * area + pixel] = 1.0;
            kappa[plane::PRIOR * area + pixel] = prior.at(column as u32, row as u32);
            let supported = robot.support[pixel] != 0;
            let anchored = supported && robot.displaced;
            let (id, depth_m, lens, recon_from_camera) = if anchored {
                (
                    robot.link[pixel],
                    robot.depth_m[pixel],
                    &eye.recorded_lens,
                    &recon_from_recorded,
                )
            } else {
                (view.id[pixel], view.depth_m[pixel], &eye.lens, &recon_from_camera)
            };
            if supported {
                kappa[plane::SUPPORT * area + pixel] = 1.0;
                kappa[plane::DEPTH * area + pixel] = depth_m;
            }
            let Some(Some(motion)) = moves.get(usize::from(id)) else {
                continue;
            };
            let ray = lens.ray(column as u32, row as u32);
            let point = recon_from_camera.point(ray * f64::from(depth_m));
            let moved = (motion.point(point) - point) * UNITS_PER_METRE;
            let ray = recon_from_camera.direction(ray);
            let slope = motion.direction(ray) - ray;
            for axis in 0..3 {
                displacement_iu[axis * area + pixel] = moved[axis] as f32;
                if supported {
                    kappa[(plane::DISPLACEMENT + axis) * area + pixel] = moved[axis] as f32;
                    fk_slope[axis * area + pixel] = slope[axis] as f32;
                }
            }
        }
        Motion {
            kappa,
            fk_slope,
            displacement_iu,
        }
    }

    fn prior(&self, camera: usize, frame: usize) -> GripperPrior {
        let k = self.episode.cameras[camera].recorded_lens.intrinsics;
        let tool = self.recorded(camera, frame).inverse().point(self.episode.tool(frame));
        let centre_px = if tool.z > 0.0 {
            [tool.x / tool.z * k.fx + k.cx, tool.y / tool.z * k.fy + k.cy]
        } else {
            [0.0, 0.0]
        };
        GripperPrior {
            centre_px,
            depth_m: tool.z,
            focal_px: [k.fx, k.fy],
            sigma_m: rogs_conditioning::Params::default().prior_sigma_m,
        }
    }
}

/// 1 where a depth (0: none) shows a surface within reach of the tool centre (metres) of a view. `[A]`
pub(crate) fn near_tool(
    camera: &NetworkCamera,
    depth_iu: &[f32],
    [height, width]: [usize; 2],
    tool_m: Option<DVec3>,
) -> Vec<f32> {
    let Some(tool_m) = tool_m else {
        return vec![0.0; depth_iu.len()];
    };
    let (tool, reach) = ((tool_m * UNITS_PER_METRE).as_vec3(), (REACH_M * UNITS_PER_METRE) as f32);
    let points = camera.unproject(depth_iu, height, width);
    let near = |(point, &depth): (&[f32], &f32)| {
        let within = depth > 0.0 && Vec3::from_slice(point).distance(tool) < reach;
        f32::from(u8::from(within))
    };
    points.chunks_exact(3).zip(depth_iu).map(near).collect()
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
