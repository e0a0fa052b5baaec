//! Binary glTF 2.0: Gaussians by the Khronos extension `KHR_gaussian_splatting`, links and cameras as animated nodes
//! (`docs/exports.md`).
//!
//! Nodes: `world` turns the frame of the data so that y is up; below it `gaussians` and `base`; below `base` a node for every
//! link and every camera, animated over the frames of the clip. More than one time of the Gaussians are morph targets of
//! their centres with animated weights: centres move on straight lines between the times, everything else is that of the
//! first time.

mod buffer;

use std::collections::BTreeMap;

use glam::{DQuat, DVec3};
use rogs_field::Axes;
use rogs_geometry::{Base, Camera, Frame, Link, Pose, PosedCamera};
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::units::LengthUnit;
use rogs_schemas::{CameraIndex, FrameIndex, Intrinsics};
use rogs_splat::{Gaussians, sh};
use serde_json::{Value, json};

use crate::error::{Error, Result};
use crate::nerfstudio::other_axes;
use crate::splats::{Splats, World, y_up_from_world};
use buffer::{Buffer, Kind};

const EXTENSION: &str = "KHR_gaussian_splatting";
/// Nearest surface that cameras show, metres.
const NEAR_M: f64 = 0.01;

/// The surface of a link, in its frame, metres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LinkMesh {
    /// Name of the link.
    pub link: String,
    /// Corners.
    pub positions: Vec<[f32; 3]>,
    /// Which corners make triangles.
    pub triangles: Vec<[u32; 3]>,
}

/// A file in the making.
pub struct Gltf {
    buffer: Buffer,
    nodes: Vec<Value>,
    meshes: Vec<Value>,
    cameras: Vec<Value>,
    /// Samplers and channels of the one animation.
    samplers: Vec<Value>,
    channels: Vec<Value>,
    unit: LengthUnit,
    /// Centres at the first time, metres.
    centres: Vec<f32>,
    targets: Vec<Value>,
    /// Times of the Gaussians, seconds.
    seconds: Vec<f32>,
}

/// Numbers of nodes that are always there.
const WORLD: usize = 0;
const GAUSSIANS: usize = 1;
const BASE: usize = 2;

impl Gltf {
    /// Begins a file whose Gaussians lie in a frame and have lengths of a unit; `world_from_base` is where the robot's base
    /// stands in it, metres.
    #[must_use]
    pub fn new(axes: Axes, unit: LengthUnit, world_from_base: &Pose<World, Base>) -> Self {
        let turn = y_up_from_world(axes).quaternion();
        let nodes = vec![
            json!({"name": "world", "rotation": turn.to_array(), "children": [GAUSSIANS, BASE]}),
            json!({"name": "gaussians", "mesh": 0}),
            node("base", world_from_base),
        ];
        Self {
            buffer: Buffer::default(),
            nodes,
            meshes: vec![Value::Null],
            cameras: Vec::new(),
            samplers: Vec::new(),
            channels: Vec::new(),
            unit,
            centres: Vec::new(),
            targets: Vec::new(),
            seconds: Vec::new(),
        }
    }

    /// Adds the Gaussians at a time, seconds. Row `n` is the same Gaussian every time.
    ///
    /// # Errors
    /// When a number is not finite, times do not ascend, or there are other than so many Gaussians as before.
    pub fn push(&mut self, seconds: f64, gaussians: &Gaussians) -> Result<()> {
        let splats = Splats::new(gaussians, self.unit)?;
        let seconds = seconds as f32;
        let unfit = |what: &str| Err(Error::Unfit { what: what.to_owned() });
        let centres: Vec<f32> = (0..splats.len()).flat_map(|n| splats.centre_m(n)).collect();
        let Some(last) = self.seconds.last() else {
            if splats.len() == 0 {
                return unfit("there are no Gaussians");
            }
            self.meshes[0] = self.first(&splats, &centres);
            self.centres = centres;
            self.seconds.push(seconds);
            return Ok(());
        };
        if !(seconds.is_finite() && seconds > *last) || centres.len() != self.centres.len() {
            return unfit("times must ascend, with the same Gaussians");
        }
        let moved: Vec<f32> = centres
            .iter()
            .zip(&self.centres)
            .map(|(now, then)| now - then)
            .collect();
        let target = self.buffer.attribute(&moved, Kind::Vec3, true);
        self.targets.push(json!({"POSITION": target}));
        self.seconds.push(seconds);
        Ok(())
    }

    fn first(&mut self, splats: &Splats<'_>, centres: &[f32]) -> Value {
        let n = splats.len();
        let mut attributes = BTreeMap::new();
        attributes.insert("POSITION".to_owned(), self.buffer.attribute(centres, Kind::Vec3, true));
        let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
        let rgba: Vec<u8> = (0..n)
            .flat_map(|index| {
                let [r, g, b] = splats.colour(index);
                [r, g, b, splats.opacity(index)].map(byte)
            })
            .collect();
        attributes.insert("COLOR_0".to_owned(), self.buffer.colours(&rgba));
        let mut add = |name: &str, kind: Kind, values: Vec<f32>| {
            attributes.insert(
                format!("{EXTENSION}:{name}"),
                self.buffer.attribute(&values, kind, false),
            );
        };
        let rotations = (0..n).flat_map(|index| splats.rotation(index).map(|value| value as f32));
        add("ROTATION", Kind::Vec4, rotations.collect());
        let scales = (0..n).flat_map(|index| splats.scale_m(index).map(libm::logf));
        add("SCALE", Kind::Vec3, scales.collect());
        add(
            "OPACITY",
            Kind::Scalar,
            (0..n).map(|index| splats.opacity(index)).collect(),
        );
        add(
            "SH_DEGREE_0_COEF_0",
            Kind::Vec3,
            (0..n).flat_map(|index| splats.constant(index)).collect(),
        );
        for degree in 1..=splats.degree() {
            let first = sh::coefficient_count(degree - 1) - 1;
            for own in 0..=2 * degree {
                let at = 3 * (first + own);
                let values = (0..n).flat_map(|index| splats.rest(index)[at..at + 3].iter().copied());
                add(&format!("SH_DEGREE_{degree}_COEF_{own}"), Kind::Vec3, values.collect());
            }
        }
        json!({"name": "gaussians", "primitives": [{
            "mode": 0, "attributes": attributes,
            "extensions": {EXTENSION: {
                "kernel": "ellipse", "colorSpace": "srgb_rec709_display", "projection": "perspective",
                "sortingMethod": "cameraDistance",
            }},
        }]})
    }

    /// Adds links and cameras of a clip, with meshes of the links that have one.
    ///
    /// # Errors
    /// When clip and robot maps do not belong together, or a pose is not rigid.
    pub fn rig(&mut self, clip: &Clip, robot: &RobotMaps, meshes: &[LinkMesh]) -> Result<()> {
        let frames = clip.frame_count();
        let links = robot.link_names.len();
        if clip.clip_id != robot.clip_id || robot.base_from_link.len() != frames * links {
            return Err(Error::Unfit {
                what: format!("the robot maps are not those of clip `{}`", clip.clip_id),
            });
        }
        let seconds: Vec<f32> = (0..frames).map(|frame| (frame as f64 / clip.fps) as f32).collect();
        let times = self.buffer.animated(&seconds, Kind::Scalar, true);
        let mut children = Vec::new();
        for (link, name) in robot.link_names.iter().enumerate() {
            let of = |frame: usize| Pose::<Base, Link>::from_rigid(&robot.base_from_link[frame * links + link]);
            let poses = (0..frames).map(of).collect::<rogs_geometry::Result<Vec<_>>>()?;
            let mut own = node(name, &poses[0]);
            if let Some(mesh) = meshes
                .iter()
                .find(|mesh| mesh.link == *name && !mesh.triangles.is_empty())
            {
                own["mesh"] = self.mesh(mesh).into();
            }
            children.push(self.animate(own, &poses, times));
        }
        for (index, camera) in CameraIndex::first(clip.cameras.len()).zip(&clip.cameras) {
            let of = |frame: FrameIndex| PosedCamera::of_clip(clip, robot, index, frame);
            let posed = FrameIndex::first(frames)
                .map(of)
                .collect::<rogs_geometry::Result<Vec<_>>>()?;
            // The other axes of a camera: x right, y up, z backward.
            let turned = |camera: &PosedCamera<Base>| -> Pose<Base, Camera> {
                let pose = camera.world_from_camera;
                Pose::new(other_axes(&pose.rotation), pose.translation)
            };
            let poses: Vec<Pose<Base, Camera>> = posed.iter().map(turned).collect();
            let mut own = node(&camera.id, &poses[0]);
            own["camera"] = self.cameras.len().into();
            self.cameras.push(lens(&camera.id, &posed[0]));
            children.push(self.animate(own, &poses, times));
        }
        self.nodes[BASE]["children"] = children.into();
        Ok(())
    }

    fn mesh(&mut self, mesh: &LinkMesh) -> usize {
        let positions: Vec<f32> = mesh.positions.iter().flatten().copied().collect();
        let position = self.buffer.attribute(&positions, Kind::Vec3, true);
        let indices = self.buffer.triangles(&mesh.triangles);
        self.meshes.push(json!({"name": mesh.link, "primitives": [
            {"mode": 4, "attributes": {"POSITION": position}, "indices": indices, "material": 0},
        ]}));
        self.meshes.len() - 1
    }

    /// Adds a node that takes these poses, and gives its number.
    fn animate<A: Frame, B: Frame>(&mut self, node: Value, poses: &[Pose<A, B>], times: usize) -> usize {
        let number = self.nodes.len();
        self.nodes.push(node);
        if poses.len() > 1 && poses.iter().any(|pose| pose != &poses[0]) {
            let mut last = poses[0].quaternion();
            let rotations: Vec<f32> = (poses.iter())
                .flat_map(|pose| {
                    // Of the two quaternions of a rotation the one that is nearer, so that readers turn the short way.
                    let own = pose.quaternion();
                    last = if own.dot(last) < 0.0 { -own } else { own };
                    last.to_array().map(|value| value as f32)
                })
                .collect();
            let shifts: Vec<f32> = (poses.iter())
                .flat_map(|pose| pose.translation.to_array().map(|value| value as f32))
                .collect();
            let rotation = self.buffer.animated(&rotations, Kind::Vec4, false);
            let translation = self.buffer.animated(&shifts, Kind::Vec3, false);
            self.channel(number, "rotation", times, rotation);
            self.channel(number, "translation", times, translation);
        }
        number
    }

    fn channel(&mut self, node: usize, path: &str, times: usize, values: usize) {
        let sampler = self.samplers.len();
        self.samplers
            .push(json!({"input": times, "output": values, "interpolation": "LINEAR"}));
        self.channels
            .push(json!({"sampler": sampler, "target": {"node": node, "path": path}}));
    }

    /// The bytes of the file; `note` is said in `extras` of its asset.
    ///
    /// # Errors
    /// When there are no Gaussians, or more bytes than a file holds.
    pub fn finish(mut self, note: &str) -> Result<Vec<u8>> {
        if self.seconds.is_empty() {
            return Err(Error::Unfit {
                what: "no time was given".to_owned(),
            });
        }
        let targets = self.targets.len();
        if targets > 0 {
            self.meshes[0]["primitives"][0]["targets"] = std::mem::take(&mut self.targets).into();
            self.meshes[0]["weights"] = vec![0; targets].into();
            // One target at a time: all weights are 0 at the first time, and one is 1 at each other one.
            let weights: Vec<f32> = (0..=targets)
                .flat_map(|moment| (1..=targets).map(move |target| f32::from(u8::from(target == moment))))
                .collect();
            let seconds = std::mem::take(&mut self.seconds);
            let times = self.buffer.animated(&seconds, Kind::Scalar, true);
            let values = self.buffer.animated(&weights, Kind::Scalar, false);
            self.channel(GAUSSIANS, "weights", times, values);
        }
        let mut document = json!({
            "asset": {"version": "2.0", "generator": "rogs", "extras": {"note": note}},
            "extensionsUsed": [EXTENSION],
            "scene": 0, "scenes": [{"nodes": [WORLD]}],
            "nodes": self.nodes, "meshes": self.meshes,
        });
        if self.meshes.len() > 1 {
            document["materials"] = json!([{
                "name": "robot", "doubleSided": true,
                "pbrMetallicRoughness": {"baseColorFactor": [0.7, 0.7, 0.7, 1.0], "metallicFactor": 0.1, "roughnessFactor": 0.6},
            }]);
        }
        if !self.cameras.is_empty() {
            document["cameras"] = self.cameras.into();
        }
        if !self.channels.is_empty() {
            document["animations"] = json!([{"name": "clip", "samplers": self.samplers, "channels": self.channels}]);
        }
        self.buffer.into_glb(document)
    }
}

/// A node at a pose.
fn node<A: Frame, B: Frame>(name: &str, pose: &Pose<A, B>) -> Value {
    let (turn, shift): (DQuat, DVec3) = (pose.quaternion(), pose.translation);
    json!({"name": name, "rotation": turn.to_array(), "translation": shift.to_array()})
}

/// A camera; glTF has no principal point, so the whole lens stands in `extras`.
fn lens(name: &str, camera: &PosedCamera<Base>) -> Value {
    let (width, height) = (f64::from(camera.lens.width), f64::from(camera.lens.height));
    let Intrinsics { fx, fy, cx, cy } = camera.lens.intrinsics;
    json!({"name": name, "type": "perspective",
        "perspective": {"yfov": 2.0 * libm::atan(height / 2.0 / fy), "aspectRatio": (width / fx) / (height / fy), "znear": NEAR_M},
        "extras": {"width": camera.lens.width, "height": camera.lens.height, "fx": fx, "fy": fy, "cx": cx, "cy": cy}})
}

#[cfg(test)]
mod tests;
