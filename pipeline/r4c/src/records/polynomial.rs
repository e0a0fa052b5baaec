//! How a field of 4DGT lies in its container: arrays of Gaussians in one chunk per view.

use rogs_schemas::records::check::area;
use rogs_schemas::records::clip::SourceView;
use rogs_schemas::records::field::WeightsInfo;
use rogs_schemas::records::polynomial::{ANGULAR, PolynomialField, Polynomials, VELOCITIES};
use rogs_schemas::{ClipId, SchemaId};
use serde::{Deserialize, Serialize};

use crate::error::Result;
use crate::reader::Reader;
use crate::record::Record;
use crate::stream::{Frame, StreamSpec, Unit};
use crate::writer::Writer;

const CENTRE: StreamSpec = StreamSpec::floats("centre_m", Unit::Metre, Frame::RobotBase);
const TIME: StreamSpec = StreamSpec::floats("time_s", Unit::Second, Frame::None);
const VARIANCE: StreamSpec = StreamSpec::floats("variance_s2", Unit::One, Frame::None);
const VELOCITY: StreamSpec = StreamSpec::floats("velocity", Unit::One, Frame::RobotBase);
const ANGULAR_VELOCITY: StreamSpec = StreamSpec::floats("angular", Unit::One, Frame::None);
const ROTATION: StreamSpec = StreamSpec::floats("rotation", Unit::One, Frame::RobotBase);
const SCALE: StreamSpec = StreamSpec::floats("scale_m", Unit::Metre, Frame::None);
const OPACITY: StreamSpec = StreamSpec::floats("opacity", Unit::One, Frame::None);
const RGB: StreamSpec = StreamSpec::floats("rgb", Unit::One, Frame::None);

#[derive(Serialize, Deserialize)]
struct Head {
    clip_id: ClipId,
    height: u32,
    width: u32,
    views: Vec<SourceView>,
    weights: Vec<WeightsInfo>,
}

impl Record for PolynomialField {
    const SCHEMA: SchemaId = SchemaId {
        name: "rogs.polynomial-field",
        major: 1,
        minor: 0,
    };

    fn encode(&self, writer: &mut Writer) -> Result<()> {
        self.check().map_err(|what| writer.inconsistent(what))?;
        let head = Head {
            clip_id: self.clip_id.clone(),
            height: self.height,
            width: self.width,
            views: self.views.clone(),
            weights: self.weights.clone(),
        };
        writer.value("field", &head)?;
        let area = self.height as usize * self.width as usize;
        let mut stream = |spec: &StreamSpec, shape: &[u32], values: &[f32]| {
            let each = area * shape.iter().product::<u32>() as usize;
            let parts = values.chunks_exact(each).zip(0..);
            let parts: Vec<([u32; 4], &[f32])> = parts.map(|(part, view)| ([view, 0, 0, 0], part)).collect();
            writer.stream(spec, shape, &parts)
        };
        let own = &self.gaussians;
        stream(&CENTRE, &[3], &own.centre_m)?;
        stream(&TIME, &[], &own.time_s)?;
        stream(&VARIANCE, &[], &own.variance_s2)?;
        stream(&VELOCITY, &[VELOCITIES as u32], &own.velocity)?;
        stream(&ANGULAR_VELOCITY, &[ANGULAR as u32], &own.angular)?;
        stream(&ROTATION, &[4], &own.rotation)?;
        stream(&SCALE, &[3], &own.scale_m)?;
        stream(&OPACITY, &[], &own.opacity)?;
        stream(&RGB, &[3], &own.rgb)
    }

    fn decode(reader: &Reader) -> Result<Self> {
        let head: Head = reader.value("field")?;
        let wrong = |what: String| reader.inconsistent(what);
        area(head.height, head.width).map_err(wrong)?;
        let field = Self {
            clip_id: head.clip_id,
            height: head.height,
            width: head.width,
            views: head.views,
            weights: head.weights,
            gaussians: Polynomials {
                centre_m: reader.stream(&CENTRE, &[3])?,
                time_s: reader.stream(&TIME, &[])?,
                variance_s2: reader.stream(&VARIANCE, &[])?,
                velocity: reader.stream(&VELOCITY, &[VELOCITIES as u32])?,
                angular: reader.stream(&ANGULAR_VELOCITY, &[ANGULAR as u32])?,
                rotation: reader.stream(&ROTATION, &[4])?,
                scale_m: reader.stream(&SCALE, &[3])?,
                opacity: reader.stream(&OPACITY, &[])?,
                rgb: reader.stream(&RGB, &[3])?,
            },
        };
        field.check().map_err(wrong)?;
        Ok(field)
    }
}
