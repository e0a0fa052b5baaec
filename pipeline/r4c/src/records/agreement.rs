//! How the agreement of robot and images lies in its container.

use rogs_schemas::records::agreement::{
    Agreements, CameraAgreement, Estimate, Offset, TriedMistake, ViewAgreement, ViewState,
};
use rogs_schemas::records::check::{count, product};
use rogs_schemas::{CameraIndex, ClipId, SchemaId};
use serde::{Deserialize, Serialize};

use crate::error::Result;
use crate::reader::Reader;
use crate::record::Record;
use crate::stream::{Codec, Dtype, Element, Frame, StreamSpec, Unit};
use crate::writer::Writer;

const UNKNOWN: &str = "NaN: cannot be told";

const fn spec(name: &'static str, unit: Unit) -> StreamSpec {
    StreamSpec {
        name,
        dtype: Dtype::F32,
        unit,
        frame: Frame::None,
        codec: Codec::ShuffleZstd,
        fill: UNKNOWN,
    }
}

/// Whether a frame tells, one chunk per camera.
const STATE: StreamSpec = StreamSpec {
    dtype: Dtype::U8,
    codec: Codec::Zstd,
    fill: "",
    ..spec("state", Unit::One)
};
const SHIFT: StreamSpec = spec("shift_px", Unit::Pixel);
const SIGMA_PX: StreamSpec = spec("sigma_px", Unit::Pixel);
const OFFSET: StreamSpec = spec("offset_m", Unit::Metre);
const SIGMA_M: StreamSpec = spec("sigma_m", Unit::Metre);
const OVERLAY: StreamSpec = spec("overlay", Unit::One);
/// Per link, one chunk per camera, frames outer.
const LINK_PX: StreamSpec = spec("link_px", Unit::Pixel);
const LINK_M: StreamSpec = spec("link_m", Unit::Metre);

#[derive(Serialize, Deserialize)]
struct Head {
    clip_id: ClipId,
    setting: String,
    frame_count: u32,
    link_names: Vec<String>,
    cameras: Vec<CameraHead>,
}

#[derive(Serialize, Deserialize)]
struct CameraHead {
    camera: CameraIndex,
    name: String,
    /// Name of a verdict.
    verdict: String,
    mistake: Option<TriedMistake>,
    why: String,
    overlay: f64,
    offset: Option<Offset>,
    tried: Vec<TriedMistake>,
    lag_frames: Option<Estimate>,
    drift_m: Option<Estimate>,
}

impl Record for Agreements {
    const SCHEMA: SchemaId = SchemaId {
        name: "rogs.agreement",
        major: 1,
        minor: 0,
    };

    fn encode(&self, writer: &mut Writer) -> Result<()> {
        self.check().map_err(|what| writer.inconsistent(what))?;
        let camera_head = |own: &CameraAgreement| CameraHead {
            camera: own.camera,
            name: own.name.clone(),
            verdict: own.verdict.name().to_owned(),
            mistake: own.mistake.clone(),
            why: own.why.clone(),
            overlay: own.overlay,
            offset: own.offset,
            tried: own.tried.clone(),
            lag_frames: own.lag_frames,
            drift_m: own.drift_m,
        };
        let head = Head {
            clip_id: self.clip_id.clone(),
            setting: self.setting.clone(),
            frame_count: self.frame_count,
            link_names: self.link_names.clone(),
            cameras: self.cameras.iter().map(camera_head).collect(),
        };
        writer.value("agreement", &head)?;
        let views = |value: fn(&ViewAgreement) -> f32| {
            move |own: &CameraAgreement| -> Vec<f32> { own.views.iter().map(value).collect() }
        };
        let cameras = &self.cameras;
        write(writer, &STATE, &[], cameras, |own| {
            own.views.iter().map(|view| view.state.number()).collect()
        })?;
        write(writer, &SHIFT, &[2], cameras, |own| {
            own.views.iter().flat_map(|view| view.shift_px).collect()
        })?;
        write(writer, &SIGMA_PX, &[], cameras, views(|view| view.sigma_px))?;
        write(writer, &OFFSET, &[], cameras, views(|view| view.offset_m))?;
        write(writer, &SIGMA_M, &[], cameras, views(|view| view.sigma_m))?;
        write(writer, &OVERLAY, &[], cameras, views(|view| view.overlay))?;
        write(writer, &LINK_PX, &[], cameras, |own| own.link_px.clone())?;
        write(writer, &LINK_M, &[], cameras, |own| own.link_m.clone())
    }

    fn decode(reader: &Reader) -> Result<Self> {
        let head: Head = reader.value("agreement")?;
        let wrong = |what: String| reader.inconsistent(what);
        let (cameras, frames) = (head.cameras.len(), head.frame_count as usize);
        let views = product("views", &[cameras, frames]).map_err(wrong)?;
        let of_links = product("links", &[frames, head.link_names.len()]).map_err(wrong)?;
        let links = product("links", &[cameras, of_links]).map_err(wrong)?;
        let states = reader.stream::<u8>(&STATE, &[])?;
        count("states", states.len(), views).map_err(wrong)?;
        let read = |spec: &StreamSpec, shape: &[u32], expected: usize| -> Result<Vec<f32>> {
            let values = reader.stream::<f32>(spec, shape)?;
            count(spec.name, values.len(), expected).map_err(wrong)?;
            Ok(values)
        };
        let shifts = read(&SHIFT, &[2], product("views", &[2, views]).map_err(wrong)?)?;
        let [sigma_px, offset_m, sigma_m, overlay] = [
            read(&SIGMA_PX, &[], views)?,
            read(&OFFSET, &[], views)?,
            read(&SIGMA_M, &[], views)?,
            read(&OVERLAY, &[], views)?,
        ];
        let (link_px, link_m) = (read(&LINK_PX, &[], links)?, read(&LINK_M, &[], links)?);
        let view = |at: usize| -> std::result::Result<ViewAgreement, String> {
            let state = ViewState::from_number(states[at]);
            Ok(ViewAgreement {
                state: state.ok_or_else(|| format!("there is no state {}", states[at]))?,
                shift_px: [shifts[2 * at], shifts[2 * at + 1]],
                sigma_px: sigma_px[at],
                offset_m: offset_m[at],
                sigma_m: sigma_m[at],
                overlay: overlay[at],
            })
        };
        let mut found = Vec::with_capacity(cameras);
        for (number, own) in head.cameras.into_iter().enumerate() {
            let views = (number * frames..(number + 1) * frames)
                .map(view)
                .collect::<std::result::Result<_, _>>();
            let of_links = number * of_links..(number + 1) * of_links;
            found.push(CameraAgreement {
                camera: own.camera,
                name: own.name,
                verdict: own.verdict.parse().map_err(wrong)?,
                mistake: own.mistake,
                why: own.why,
                overlay: own.overlay,
                offset: own.offset,
                tried: own.tried,
                lag_frames: own.lag_frames,
                drift_m: own.drift_m,
                views: views.map_err(wrong)?,
                link_px: link_px[of_links.clone()].to_vec(),
                link_m: link_m[of_links].to_vec(),
            });
        }
        let agreements = Self {
            clip_id: head.clip_id,
            setting: head.setting,
            frame_count: head.frame_count,
            link_names: head.link_names,
            cameras: found,
        };
        agreements.check().map_err(wrong)?;
        Ok(agreements)
    }
}

/// Writes one chunk per camera.
fn write<T: Element>(
    writer: &mut Writer,
    spec: &StreamSpec,
    shape: &[u32],
    cameras: &[CameraAgreement],
    values: impl Fn(&CameraAgreement) -> Vec<T>,
) -> Result<()> {
    let values: Vec<Vec<T>> = cameras.iter().map(values).collect();
    let chunks: Vec<_> = (cameras.iter().zip(&values))
        .map(|(own, values)| ([own.camera.0, 0, 0, 0], values.as_slice()))
        .collect();
    writer.stream(spec, shape, &chunks)
}
