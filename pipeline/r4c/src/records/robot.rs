//! How robot maps lie in their container.

use rogs_schemas::records::check::{area, count, product};
use rogs_schemas::records::robot::{RobotMap, RobotMaps};
use rogs_schemas::{CameraIndex, ClipId, FrameIndex, RigidPose, SchemaId};
use serde::{Deserialize, Serialize};

use crate::error::Result;
use crate::reader::Reader;
use crate::record::Record;
use crate::stream::{Codec, Dtype, Frame, StreamSpec, Unit};
use crate::writer::Writer;

/// Mesh depth, one chunk per map.
const DEPTH: StreamSpec = StreamSpec {
    name: "mesh_depth_m",
    dtype: Dtype::F32,
    unit: Unit::Metre,
    frame: Frame::Camera,
    codec: Codec::PlanesZstd,
    fill: "0: nothing hit",
};
/// Link ids, one chunk per map.
const LINK: StreamSpec = StreamSpec {
    name: "link",
    dtype: Dtype::U8,
    unit: Unit::One,
    frame: Frame::None,
    codec: Codec::Zstd,
    fill: "255: nothing hit",
};
/// Support, one chunk per map.
const SUPPORT: StreamSpec = StreamSpec {
    name: "support",
    dtype: Dtype::U8,
    unit: Unit::One,
    frame: Frame::None,
    codec: Codec::Zstd,
    fill: "",
};

#[derive(Serialize, Deserialize)]
struct Head {
    clip_id: ClipId,
    link_names: Vec<String>,
    base_from_link: Vec<RigidPose>,
    base_from_camera: Vec<RigidPose>,
    recon_from_base: RigidPose,
    tool_m: Vec<f64>,
    height: u32,
    width: u32,
    /// Camera and frame of every map.
    maps: Vec<(CameraIndex, FrameIndex)>,
}

impl Record for RobotMaps {
    const SCHEMA: SchemaId = SchemaId {
        name: "rogs.robot",
        major: 1,
        minor: 0,
    };

    fn encode(&self, writer: &mut Writer) -> Result<()> {
        self.check().map_err(|what| writer.inconsistent(what))?;
        let head = Head {
            clip_id: self.clip_id.clone(),
            link_names: self.link_names.clone(),
            base_from_link: self.base_from_link.clone(),
            base_from_camera: self.base_from_camera.clone(),
            recon_from_base: self.recon_from_base,
            tool_m: self.tool_m.clone(),
            height: self.height,
            width: self.width,
            maps: self.maps.iter().map(|map| (map.camera, map.frame)).collect(),
        };
        writer.value("robot", &head)?;
        let shape = [self.height, self.width];
        let at = |map: &RobotMap| [map.camera.0, map.frame.0, 0, 0];
        let depth: Vec<_> = self.maps.iter().map(|map| (at(map), map.depth_m.as_slice())).collect();
        let link: Vec<_> = self.maps.iter().map(|map| (at(map), map.link.as_slice())).collect();
        let support: Vec<_> = self.maps.iter().map(|map| (at(map), map.support.as_slice())).collect();
        writer.stream(&DEPTH, &shape, &depth)?;
        writer.stream(&LINK, &shape, &link)?;
        writer.stream(&SUPPORT, &shape, &support)
    }

    fn decode(reader: &Reader) -> Result<Self> {
        let head: Head = reader.value("robot")?;
        let wrong = |what: String| reader.inconsistent(what);
        let area = area(head.height, head.width).map_err(wrong)?;
        let shape = [head.height, head.width];
        let depth = reader.stream::<f32>(&DEPTH, &shape)?;
        let link = reader.stream::<u8>(&LINK, &shape)?;
        let support = reader.stream::<u8>(&SUPPORT, &shape)?;
        let total = product("maps", &[head.maps.len(), area]).map_err(wrong)?;
        for (what, length) in [
            ("mesh depth", depth.len()),
            ("link ids", link.len()),
            ("support", support.len()),
        ] {
            count(what, length, total).map_err(wrong)?;
        }
        let mut maps = Vec::with_capacity(head.maps.len());
        for (number, &(camera, frame)) in head.maps.iter().enumerate() {
            let pixels = number * area..(number + 1) * area;
            maps.push(RobotMap {
                camera,
                frame,
                depth_m: depth[pixels.clone()].to_vec(),
                link: link[pixels.clone()].to_vec(),
                support: support[pixels].to_vec(),
            });
        }
        let robot = Self {
            clip_id: head.clip_id,
            link_names: head.link_names,
            base_from_link: head.base_from_link,
            base_from_camera: head.base_from_camera,
            recon_from_base: head.recon_from_base,
            tool_m: head.tool_m,
            height: head.height,
            width: head.width,
            maps,
        };
        robot.check().map_err(wrong)?;
        Ok(robot)
    }
}
