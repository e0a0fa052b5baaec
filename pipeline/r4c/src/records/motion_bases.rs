//! How a field of Shape of Motion lies in its container: one chunk per camera in every stream.

use rogs_schemas::records::check::count;
use rogs_schemas::records::field::WeightsInfo;
use rogs_schemas::records::motion_bases::{BasisGaussians, MotionBasisField};
use rogs_schemas::{CameraIndex, ClipId, SchemaId};
use serde::{Deserialize, Serialize};

use crate::error::Result;
use crate::reader::Reader;
use crate::record::Record;
use crate::stream::{Frame, StreamSpec, Unit};
use crate::writer::Writer;

const ROTATIONS: StreamSpec = StreamSpec::floats("rotations", Unit::One, Frame::RobotBase);
const TRANSLATIONS: StreamSpec = StreamSpec::floats("translations_m", Unit::Metre, Frame::RobotBase);
const COEFFICIENTS: StreamSpec = StreamSpec::floats("coefficients", Unit::One, Frame::None);
const MEANS: StreamSpec = StreamSpec::floats("means_m", Unit::Metre, Frame::RobotBase);
const QUATS: StreamSpec = StreamSpec::floats("quats", Unit::One, Frame::RobotBase);
const SCALES: StreamSpec = StreamSpec::floats("log_scales", Unit::One, Frame::None);
const OPACITIES: StreamSpec = StreamSpec::floats("opacity_logits", Unit::One, Frame::None);
const COLOURS: StreamSpec = StreamSpec::floats("colour_logits", Unit::One, Frame::None);

#[derive(Serialize, Deserialize)]
struct Head {
    clip_id: ClipId,
    frame_count: u32,
    weights: WeightsInfo,
    cameras: Vec<CameraHead>,
}

#[derive(Serialize, Deserialize)]
struct CameraHead {
    camera: CameraIndex,
    bases: u32,
    foreground: u32,
    background: u32,
}

/// The streams in the order of [`BasisGaussians::arrays`]: what each is, and the shape of its elements.
const STREAMS: [(StreamSpec, &[u32]); 8] = [
    (ROTATIONS, &[6]),
    (TRANSLATIONS, &[3]),
    (COEFFICIENTS, &[]),
    (MEANS, &[3]),
    (QUATS, &[4]),
    (SCALES, &[3]),
    (OPACITIES, &[]),
    (COLOURS, &[3]),
];

impl Record for MotionBasisField {
    const SCHEMA: SchemaId = SchemaId {
        name: "rogs.motion-basis-field",
        major: 1,
        minor: 0,
    };

    fn encode(&self, writer: &mut Writer) -> Result<()> {
        self.check().map_err(|what| writer.inconsistent(what))?;
        let head = |(camera, own): &(CameraIndex, BasisGaussians)| CameraHead {
            camera: *camera,
            bases: own.bases as u32,
            foreground: own.foreground() as u32,
            background: (own.len() - own.foreground()) as u32,
        };
        let head = Head {
            clip_id: self.clip_id.clone(),
            frame_count: self.frame_count,
            weights: self.weights.clone(),
            cameras: self.cameras.iter().map(head).collect(),
        };
        writer.value("field", &head)?;
        for (index, (spec, shape)) in STREAMS.iter().enumerate() {
            let chunks = self.cameras.iter();
            let chunks = chunks.map(|(camera, own)| ([camera.0, 0, 0, 0], own.arrays()[index]));
            writer.stream(spec, shape, &chunks.collect::<Vec<_>>())?;
        }
        Ok(())
    }

    fn decode(reader: &Reader) -> Result<Self> {
        let head: Head = reader.value("field")?;
        let wrong = |what: String| reader.inconsistent(what);
        let frames = head.frame_count as usize;
        let mut cameras = Vec::new();
        for own in &head.cameras {
            let array = |index: usize| -> Result<Vec<f32>> {
                let (spec, shape) = &STREAMS[index];
                reader.read_chunk(spec, shape, [own.camera.0, 0, 0, 0])
            };
            let gaussians = BasisGaussians {
                bases: own.bases as usize,
                frames,
                rotations: array(0)?,
                translations: array(1)?,
                coefficients: array(2)?,
                means: array(3)?,
                quats: array(4)?,
                scales: array(5)?,
                opacities: array(6)?,
                colours: array(7)?,
            };
            let (foreground, background) = (own.foreground as usize, own.background as usize);
            count("foreground", gaussians.foreground(), foreground).map_err(wrong)?;
            count("opacities", gaussians.len(), foreground.saturating_add(background)).map_err(wrong)?;
            cameras.push((own.camera, gaussians));
        }
        let field = Self {
            clip_id: head.clip_id,
            frame_count: head.frame_count,
            weights: head.weights,
            cameras,
        };
        field.check().map_err(wrong)?;
        Ok(field)
    }
}
