//! How references that the pipeline made lie in their container.

use rogs_schemas::records::check::{area, count, product};
use rogs_schemas::records::references::{MadeDepth, References};
use rogs_schemas::{CameraIndex, ClipId, FrameIndex, SchemaId};
use serde::{Deserialize, Serialize};

use super::clip::{DEPTH, TracksHead, origin, read_tracks, write_tracks};
use crate::error::Result;
use crate::reader::Reader;
use crate::record::Record;
use crate::writer::Writer;

#[derive(Serialize, Deserialize)]
struct Head {
    clip_id: ClipId,
    frame_count: u32,
    height: u32,
    width: u32,
    frames: Vec<FrameIndex>,
    depth: Vec<DepthHead>,
    tracks: Option<TracksHead>,
    /// Name of the origin of the tracks.
    tracks_origin: Option<String>,
    notes: Vec<String>,
}

#[derive(Serialize, Deserialize)]
struct DepthHead {
    camera: CameraIndex,
    range_m: [f32; 2],
    /// Name of an origin.
    origin: String,
}

impl Record for References {
    const SCHEMA: SchemaId = SchemaId {
        name: "rogs.references",
        major: 1,
        minor: 0,
    };

    fn encode(&self, writer: &mut Writer) -> Result<()> {
        self.check().map_err(|what| writer.inconsistent(what))?;
        let depth_head = |made: &MadeDepth| DepthHead {
            camera: made.camera,
            range_m: made.range_m,
            origin: made.origin.to_string(),
        };
        let head = Head {
            clip_id: self.clip_id.clone(),
            frame_count: self.frame_count,
            height: self.height,
            width: self.width,
            frames: self.frames.clone(),
            depth: self.depth.iter().map(depth_head).collect(),
            tracks: self.tracks.as_ref().map(TracksHead::of),
            tracks_origin: self.tracks.as_ref().map(|tracks| tracks.origin.to_string()),
            notes: self.notes.clone(),
        };
        writer.value("references", &head)?;
        let area = self.height as usize * self.width as usize;
        let mut maps = Vec::new();
        for made in &self.depth {
            let of_camera = self.frames.iter().zip(made.depth_m.chunks_exact(area));
            maps.extend(of_camera.map(|(&frame, map)| ([made.camera.0, frame.0, 0, 0], map)));
        }
        writer.stream(&DEPTH, &[self.height, self.width], &maps)?;
        match &self.tracks {
            None => Ok(()),
            Some(tracks) => write_tracks(writer, tracks, self.frame_count),
        }
    }

    fn decode(reader: &Reader) -> Result<Self> {
        let head: Head = reader.value("references")?;
        let wrong = |what: String| reader.inconsistent(what);
        let area = area(head.height, head.width).map_err(wrong)?;
        let maps = reader.stream::<f32>(&DEPTH, &[head.height, head.width])?;
        let of_camera = product("depth", &[head.frames.len(), area]).map_err(wrong)?;
        let total = product("depth", &[head.depth.len(), of_camera]).map_err(wrong)?;
        count("depth", maps.len(), total).map_err(wrong)?;
        let mut depth = Vec::with_capacity(head.depth.len());
        for (number, made) in head.depth.into_iter().enumerate() {
            depth.push(MadeDepth {
                camera: made.camera,
                depth_m: maps[number * of_camera..(number + 1) * of_camera].to_vec(),
                range_m: made.range_m,
                origin: made.origin.parse().map_err(wrong)?,
            });
        }
        let tracks = match head.tracks {
            None => None,
            Some(tracks) => {
                let origin = origin(head.tracks_origin).map_err(wrong)?;
                Some(read_tracks(reader, &tracks, head.frame_count, origin)?)
            }
        };
        let references = Self {
            clip_id: head.clip_id,
            frame_count: head.frame_count,
            height: head.height,
            width: head.width,
            frames: head.frames,
            depth,
            tracks,
            notes: head.notes,
        };
        references.check().map_err(wrong)?;
        Ok(references)
    }
}
