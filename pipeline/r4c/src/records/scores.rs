//! How scores lie in their container.

use rogs_schemas::records::check::{area, count};
use rogs_schemas::records::origin::{ReferenceKind, ReferenceUse};
use rogs_schemas::records::scores::{CrossViewScore, RenderedView, ScoreSheet, Scores};
use rogs_schemas::{FrameIndex, SchemaId};
use serde::{Deserialize, Serialize};

use crate::error::Result;
use crate::reader::Reader;
use crate::record::Record;
use crate::stream::{Codec, Dtype, Frame, StreamSpec, Unit};
use crate::writer::Writer;

/// Renders, one chunk per view; views may differ in size.
const RGB: StreamSpec = StreamSpec {
    name: "rgb",
    dtype: Dtype::U8,
    unit: Unit::One,
    frame: Frame::None,
    codec: Codec::Zstd,
    fill: "",
};
/// Rendered depth, one chunk per view.
const DEPTH: StreamSpec = StreamSpec {
    name: "depth_m",
    dtype: Dtype::F32,
    unit: Unit::Metre,
    frame: Frame::Camera,
    codec: Codec::PlanesZstd,
    fill: "0: nothing hit",
};

#[derive(Serialize, Deserialize)]
struct RenderHead {
    camera: String,
    frame: FrameIndex,
    height: u32,
    width: u32,
}

/// What was scored against; absent before version 1.1.
#[derive(Serialize, Deserialize)]
struct ReferenceHead {
    kind: ReferenceKind,
    camera: String,
    /// Name of an origin.
    origin: String,
}

/// Name of the stream of [`ReferenceHead`]s.
const REFERENCES: &str = "references";
/// Name of the stream of [`CrossViewScore`]s; absent before version 1.2.
const CROSS_VIEW: &str = "cross_view";

impl Record for Scores {
    const SCHEMA: SchemaId = SchemaId {
        name: "rogs.scores",
        major: 1,
        minor: 2,
    };

    fn encode(&self, writer: &mut Writer) -> Result<()> {
        self.check().map_err(|what| writer.inconsistent(what))?;
        writer.value("summary", &self.summary)?;
        let reference = |used: &ReferenceUse| ReferenceHead {
            kind: used.kind,
            camera: used.camera.clone(),
            origin: used.origin.to_string(),
        };
        let references: Vec<_> = self.summary.references.iter().map(reference).collect();
        writer.value(REFERENCES, &references)?;
        writer.value(CROSS_VIEW, &self.summary.cross_view)?;
        let head = |view: &RenderedView| RenderHead {
            camera: view.camera.clone(),
            frame: view.frame,
            height: view.height,
            width: view.width,
        };
        writer.value("renders", &self.renders.iter().map(head).collect::<Vec<_>>())?;
        let views = || self.renders.iter().zip(0u32..);
        let rgb: Vec<_> = views().map(|(view, at)| ([at, 0, 0, 0], view.rgb.as_slice())).collect();
        let depth: Vec<_> = views()
            .map(|(view, at)| ([at, 0, 0, 0], view.depth_m.as_slice()))
            .collect();
        writer.stream(&RGB, &[3], &rgb)?;
        writer.stream(&DEPTH, &[], &depth)
    }

    fn decode(reader: &Reader) -> Result<Self> {
        let mut summary: ScoreSheet = reader.value("summary")?;
        let heads: Vec<RenderHead> = reader.value("renders")?;
        let wrong = |what: String| reader.inconsistent(what);
        if reader.has(REFERENCES) {
            for head in reader.value::<Vec<ReferenceHead>>(REFERENCES)? {
                let ReferenceHead { kind, camera, origin } = head;
                let origin = origin.parse().map_err(wrong)?;
                summary.references.push(ReferenceUse { kind, camera, origin });
            }
        }
        if reader.has(CROSS_VIEW) {
            summary.cross_view = reader.value::<Vec<CrossViewScore>>(CROSS_VIEW)?;
        }
        let rgb = reader.stream::<u8>(&RGB, &[3])?;
        let depth = reader.stream::<f32>(&DEPTH, &[])?;
        let (mut rgb_rest, mut depth_rest) = (rgb.as_slice(), depth.as_slice());
        let mut renders = Vec::with_capacity(heads.len());
        for RenderHead {
            camera,
            frame,
            height,
            width,
        } in heads
        {
            let area = area(height, width).map_err(wrong)?;
            let missing = || wrong(format!("the render of `{camera}` at frame {frame} has too few pixels"));
            let (rgb, rgb_after) = rgb_rest.split_at_checked(3 * area).ok_or_else(missing)?;
            let (depth, depth_after) = depth_rest.split_at_checked(area).ok_or_else(missing)?;
            (rgb_rest, depth_rest) = (rgb_after, depth_after);
            renders.push(RenderedView {
                camera,
                frame,
                height,
                width,
                rgb: rgb.to_vec(),
                depth_m: depth.to_vec(),
            });
        }
        count("pixels beyond the renders", rgb_rest.len() + depth_rest.len(), 0).map_err(wrong)?;
        Ok(Self { summary, renders })
    }
}
