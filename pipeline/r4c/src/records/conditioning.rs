//! How conditioning maps lie in their container.

use rogs_schemas::records::check::{count, product};
use rogs_schemas::records::clip::SourceView;
use rogs_schemas::records::conditioning::{Conditioning, GripperPrior, ViewConditioning};
use rogs_schemas::{ClipId, FrameIndex, SchemaId};
use serde::{Deserialize, Serialize};

use crate::error::Result;
use crate::reader::Reader;
use crate::record::Record;
use crate::stream::{Codec, Dtype, Frame, StreamSpec, Unit};
use crate::writer::Writer;

/// Supported pixels, one chunk per view.
const PIXELS: StreamSpec = StreamSpec {
    name: "pixels",
    dtype: Dtype::U32,
    unit: Unit::One,
    frame: Frame::None,
    codec: Codec::DeltaShuffleZstd,
    fill: "",
};
/// Link ids, one chunk per view.
const LINK: StreamSpec = StreamSpec {
    name: "link",
    dtype: Dtype::U8,
    unit: Unit::One,
    frame: Frame::None,
    codec: Codec::Zstd,
    fill: "",
};
/// Mesh depth, one chunk per view.
const DEPTH: StreamSpec = StreamSpec {
    name: "mesh_depth_m",
    dtype: Dtype::F32,
    unit: Unit::Metre,
    frame: Frame::Camera,
    codec: Codec::PlanesZstd,
    fill: "",
};
/// FK displacements, one chunk per (view, query).
const DISPLACEMENT: StreamSpec = StreamSpec {
    name: "displacement_iu",
    dtype: Dtype::F32,
    unit: Unit::InternalUnit,
    frame: Frame::Recon,
    codec: Codec::PlanesZstd,
    fill: "",
};

#[derive(Serialize, Deserialize)]
struct Head {
    clip_id: ClipId,
    height: u32,
    width: u32,
    views: Vec<SourceView>,
    query_frames: Vec<FrameIndex>,
    view_maps: Vec<ViewHead>,
}

#[derive(Serialize, Deserialize)]
struct ViewHead {
    count: u32,
    available: Vec<u8>,
    prior: GripperPrior,
}

impl Record for Conditioning {
    const SCHEMA: SchemaId = SchemaId {
        name: "rogs.conditioning",
        major: 1,
        minor: 0,
    };

    fn encode(&self, writer: &mut Writer) -> Result<()> {
        self.check().map_err(|what| writer.inconsistent(what))?;
        let view_head = |view: &ViewConditioning| ViewHead {
            count: view.pixels.len() as u32,
            available: view.available.clone(),
            prior: view.prior,
        };
        let head = Head {
            clip_id: self.clip_id.clone(),
            height: self.height,
            width: self.width,
            views: self.views.clone(),
            query_frames: self.query_frames.clone(),
            view_maps: self.view_maps.iter().map(view_head).collect(),
        };
        writer.value("conditioning", &head)?;
        let maps = || self.view_maps.iter().zip(0u32..);
        let pixels: Vec<_> = maps().map(|(view, v)| ([v, 0, 0, 0], view.pixels.as_slice())).collect();
        let link: Vec<_> = maps().map(|(view, v)| ([v, 0, 0, 0], view.link.as_slice())).collect();
        let depth: Vec<_> = maps()
            .map(|(view, v)| ([v, 0, 0, 0], view.depth_m.as_slice()))
            .collect();
        let mut displacement = Vec::new();
        for (view, v) in maps() {
            let values = 3 * view.pixels.len();
            displacement.extend(
                (0..self.query_frames.len())
                    .map(|q| ([v, q as u32, 0, 0], &view.displacement_iu[q * values..(q + 1) * values])),
            );
        }
        writer.stream(&PIXELS, &[], &pixels)?;
        writer.stream(&LINK, &[], &link)?;
        writer.stream(&DEPTH, &[], &depth)?;
        writer.stream(&DISPLACEMENT, &[3], &displacement)
    }

    fn decode(reader: &Reader) -> Result<Self> {
        let head: Head = reader.value("conditioning")?;
        let wrong = |what: String| reader.inconsistent(what);
        let pixels = reader.stream::<u32>(&PIXELS, &[])?;
        let link = reader.stream::<u8>(&LINK, &[])?;
        let depth = reader.stream::<f32>(&DEPTH, &[])?;
        let displacement = reader.stream::<f32>(&DISPLACEMENT, &[3])?;
        let total = head.view_maps.iter().map(|view| view.count as usize).sum::<usize>();
        count("pixels", pixels.len(), total).map_err(wrong)?;
        count("link ids", link.len(), total).map_err(wrong)?;
        count("mesh depth", depth.len(), total).map_err(wrong)?;
        let displacements = product("displacements", &[total, 3, head.query_frames.len()]).map_err(wrong)?;
        count("displacements", displacement.len(), displacements).map_err(wrong)?;
        let mut view_maps = Vec::with_capacity(head.view_maps.len());
        let mut start = 0;
        for view in head.view_maps {
            let end = start + view.count as usize;
            let scale = 3 * head.query_frames.len();
            view_maps.push(ViewConditioning {
                pixels: pixels[start..end].to_vec(),
                link: link[start..end].to_vec(),
                depth_m: depth[start..end].to_vec(),
                displacement_iu: displacement[start * scale..end * scale].to_vec(),
                available: view.available,
                prior: view.prior,
            });
            start = end;
        }
        let conditioning = Self {
            clip_id: head.clip_id,
            height: head.height,
            width: head.width,
            views: head.views,
            query_frames: head.query_frames,
            view_maps,
        };
        conditioning.check().map_err(wrong)?;
        Ok(conditioning)
    }
}
