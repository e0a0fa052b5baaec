//! How a field lies in its container: per-Gaussian arrays in one chunk per source view (and time).

use std::path::Path;

use rayon::prelude::*;
use rogs_schemas::records::check::{area, count, nonzero, product};
use rogs_schemas::records::clip::SourceView;
use rogs_schemas::records::field::{Field, RAW_CHANNELS, TimeSlice, WeightsInfo};
use rogs_schemas::{CacheKey, ClipId, RigidPose, SchemaId};
use serde::{Deserialize, Serialize};

use super::arrays::{self, ArrayHead};
use crate::error::Result;
use crate::reader::Reader;
use crate::record::Record;
use crate::stream::{Codec, Dtype, Frame, StreamSpec, Unit};
use crate::writer::Writer;

const POSITION: StreamSpec = floats("position_m", Unit::Metre, Frame::Recon, "");
const BASE_RAW: StreamSpec = floats("base_raw", Unit::One, Frame::None, "");
const SUPPORT: StreamSpec = bytes("support", "");
const LINK: StreamSpec = bytes("link", "255: not anchored");
const SCALE_CAP: StreamSpec = floats("scale_cap_iu", Unit::InternalUnit, Frame::None, "infinite: no cap");
/// One chunk per (view, time).
const DISPLACEMENT: StreamSpec = floats("displacement_m", Unit::Metre, Frame::Recon, "");
/// One chunk per (view, time).
const GATE: StreamSpec = bytes("gate", "");
/// One chunk per (view, time).
const MOVING_RAW: StreamSpec = floats("moving_raw", Unit::One, Frame::None, "");
/// One chunk per (array, part).
const QUERY_STATE: StreamSpec = floats("query_state", Unit::One, Frame::None, "");

const fn floats(name: &'static str, unit: Unit, frame: Frame, fill: &'static str) -> StreamSpec {
    StreamSpec {
        fill,
        ..StreamSpec::floats(name, unit, frame)
    }
}

const fn bytes(name: &'static str, fill: &'static str) -> StreamSpec {
    StreamSpec {
        name,
        dtype: Dtype::U8,
        unit: Unit::One,
        frame: Frame::None,
        codec: Codec::Zstd,
        fill,
    }
}

#[derive(Serialize, Deserialize)]
struct Head {
    clip_id: ClipId,
    frame_count: u32,
    height: u32,
    width: u32,
    views: Vec<SourceView>,
    recon_from_base: RigidPose,
    weights: WeightsInfo,
    times: Vec<f64>,
    query_state: Vec<ArrayHead>,
}

impl Record for Field {
    const SCHEMA: SchemaId = SchemaId {
        name: "rogs.field",
        major: 1,
        minor: 0,
    };

    fn encode(&self, writer: &mut Writer) -> Result<()> {
        self.check().map_err(|what| writer.inconsistent(what))?;
        let head = Head {
            clip_id: self.clip_id.clone(),
            frame_count: self.frame_count,
            height: self.height,
            width: self.width,
            views: self.views.clone(),
            recon_from_base: self.recon_from_base,
            weights: self.weights.clone(),
            times: self.slices.iter().map(|slice| slice.time).collect(),
            query_state: arrays::heads(&self.query_state),
        };
        writer.value("field", &head)?;
        let area = self.height as usize * self.width as usize;
        let channels = RAW_CHANNELS as u32;
        writer.stream(&POSITION, &[3], &by_view(&self.position_m, 3 * area))?;
        writer.stream(&BASE_RAW, &[channels], &by_view(&self.base_raw, RAW_CHANNELS * area))?;
        writer.stream(&SUPPORT, &[], &by_view(&self.support, area))?;
        writer.stream(&LINK, &[], &by_view(&self.link, area))?;
        writer.stream(&SCALE_CAP, &[], &by_view(&self.scale_cap_iu, area))?;
        let mut displacement = Vec::new();
        let mut gate = Vec::new();
        let mut moving = Vec::new();
        for (slice, time) in self.slices.iter().zip(0u32..) {
            let at = |view: u32| [view, time, 0, 0];
            displacement.extend(
                slice
                    .displacement_m
                    .chunks_exact(3 * area)
                    .zip(0..)
                    .map(|(part, view)| (at(view), part)),
            );
            let mut rest = slice.moving_raw.as_slice();
            for (part, view) in slice.gate.chunks_exact(area).zip(0..) {
                gate.push((at(view), part));
                let (values, after) = rest.split_at(RAW_CHANNELS * nonzero(part));
                moving.push((at(view), values));
                rest = after;
            }
        }
        writer.stream(&DISPLACEMENT, &[3], &displacement)?;
        writer.stream(&GATE, &[], &gate)?;
        writer.stream(&MOVING_RAW, &[channels], &moving)?;
        arrays::write(writer, &QUERY_STATE, &self.query_state)
    }

    fn decode(reader: &Reader) -> Result<Self> {
        let head: Head = reader.value("field")?;
        let wrong = |what: String| reader.inconsistent(what);
        let area = area(head.height, head.width).map_err(wrong)?;
        let total = product("Gaussians", &[area, head.views.len()]).map_err(wrong)?;
        let channels = RAW_CHANNELS as u32;
        let displacement = reader.stream::<f32>(&DISPLACEMENT, &[3])?;
        let gate = reader.stream::<u8>(&GATE, &[])?;
        let moving = reader.stream::<f32>(&MOVING_RAW, &[channels])?;
        let times = head.times.len();
        count(
            "displacements",
            displacement.len(),
            product("slices", &[times, total, 3]).map_err(wrong)?,
        )
        .map_err(wrong)?;
        count("gates", gate.len(), product("slices", &[times, total]).map_err(wrong)?).map_err(wrong)?;
        count("query-time attributes", moving.len(), RAW_CHANNELS * nonzero(&gate)).map_err(wrong)?;
        let mut rest = moving.as_slice();
        let mut slices = Vec::with_capacity(times);
        for (index, &time) in head.times.iter().enumerate() {
            let gate = gate[index * total..(index + 1) * total].to_vec();
            let (values, after) = rest.split_at(RAW_CHANNELS * nonzero(&gate));
            rest = after;
            let displacement_m = displacement[3 * index * total..3 * (index + 1) * total].to_vec();
            slices.push(TimeSlice {
                time,
                displacement_m,
                gate,
                moving_raw: values.to_vec(),
            });
        }
        let field = Self {
            clip_id: head.clip_id,
            frame_count: head.frame_count,
            height: head.height,
            width: head.width,
            views: head.views,
            recon_from_base: head.recon_from_base,
            weights: head.weights,
            position_m: reader.stream(&POSITION, &[3])?,
            base_raw: reader.stream(&BASE_RAW, &[channels])?,
            support: reader.stream(&SUPPORT, &[])?,
            link: reader.stream(&LINK, &[])?,
            scale_cap_iu: reader.stream(&SCALE_CAP, &[])?,
            slices,
            query_state: arrays::read(reader, &QUERY_STATE, head.query_state)?,
        };
        field.check().map_err(wrong)?;
        Ok(field)
    }
}

/// A field of which only the times that are asked for are read.
pub struct FieldFile {
    reader: Reader,
    head: Head,
}

impl FieldFile {
    /// Opens a field: its head and nothing else.
    ///
    /// # Errors
    /// When the file is missing, damaged, no field, or its head contradicts itself.
    pub fn open(path: &Path) -> Result<Self> {
        let reader = Reader::open(path)?;
        reader.expect_schema(Field::SCHEMA)?;
        let head: Head = reader.value("field")?;
        let area = area(head.height, head.width).map_err(|what| reader.inconsistent(what))?;
        product("Gaussians", &[area, head.views.len()]).map_err(|what| reader.inconsistent(what))?;
        Ok(Self { reader, head })
    }

    /// The cache key of the file.
    #[must_use]
    pub fn key(&self) -> CacheKey {
        self.reader.provenance().key()
    }

    /// Stored normalised times, ascending.
    #[must_use]
    pub fn times(&self) -> &[f64] {
        &self.head.times
    }

    /// Everything but the slices and the state for other times.
    ///
    /// # Errors
    /// When the file is damaged or its arrays contradict each other.
    pub fn base(&self) -> Result<Field> {
        let (head, reader) = (&self.head, &self.reader);
        let field = Field {
            clip_id: head.clip_id.clone(),
            frame_count: head.frame_count,
            height: head.height,
            width: head.width,
            views: head.views.clone(),
            recon_from_base: head.recon_from_base,
            weights: head.weights.clone(),
            position_m: reader.stream(&POSITION, &[3])?,
            base_raw: reader.stream(&BASE_RAW, &[RAW_CHANNELS as u32])?,
            support: reader.stream(&SUPPORT, &[])?,
            link: reader.stream(&LINK, &[])?,
            scale_cap_iu: reader.stream(&SCALE_CAP, &[])?,
            slices: Vec::new(),
            query_state: Vec::new(),
        };
        field.check().map_err(|what| reader.inconsistent(what))?;
        Ok(field)
    }

    /// The slice of the stored time with this index; [`Field::check`] of a field that has it sees whether it fits.
    ///
    /// # Errors
    /// When there is no such time, or the file is damaged.
    pub fn slice(&self, index: usize) -> Result<TimeSlice> {
        let time = self.head.times.get(index).copied();
        let missing = || self.reader.inconsistent(format!("there is no stored time {index}"));
        let mut slice = TimeSlice {
            time: time.ok_or_else(missing)?,
            displacement_m: Vec::new(),
            gate: Vec::new(),
            moving_raw: Vec::new(),
        };
        let of_view = |view: u32| -> Result<(Vec<f32>, Vec<u8>, Vec<f32>)> {
            let (reader, at) = (&self.reader, [view, index as u32, 0, 0]);
            Ok((
                reader.read_chunk(&DISPLACEMENT, &[3], at)?,
                reader.read_chunk(&GATE, &[], at)?,
                reader.read_chunk(&MOVING_RAW, &[RAW_CHANNELS as u32], at)?,
            ))
        };
        let views = (0..self.head.views.len() as u32).into_par_iter();
        for (displacement, gate, moving) in views.map(of_view).collect::<Result<Vec<_>>>()? {
            slice.displacement_m.extend(displacement);
            slice.gate.extend(gate);
            slice.moving_raw.extend(moving);
        }
        Ok(slice)
    }
}

fn by_view<T>(values: &[T], length: usize) -> Vec<([u32; 4], &[T])> {
    values
        .chunks_exact(length)
        .zip(0..)
        .map(|(part, view)| ([view, 0, 0, 0], part))
        .collect()
}
