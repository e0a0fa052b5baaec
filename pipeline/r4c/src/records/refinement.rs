//! How a refinement lies in its container: blocks of Gaussians.

use std::path::Path;

use rogs_schemas::records::check::{count, nonzero, product};
use rogs_schemas::records::field::WeightsInfo;
use rogs_schemas::records::refinement::{RESIDUAL_CHANNELS, Refinement, RefinementStep, ScaleResidual};
use rogs_schemas::{CacheKey, ClipId, SchemaId};
use serde::{Deserialize, Serialize};

use super::arrays::{self, ArrayHead};
use crate::error::{Error, Result};
use crate::reader::Reader;
use crate::record::{Record, read_record};
use crate::stream::{Codec, Dtype, Frame, StreamSpec, Unit};
use crate::writer::Writer;

/// Which Gaussians have a correction, one chunk per (step, block).
const TOUCHED: StreamSpec = StreamSpec {
    name: "touched",
    dtype: Dtype::U8,
    unit: Unit::One,
    frame: Frame::None,
    codec: Codec::Zstd,
    fill: "",
};
/// Corrections of the touched Gaussians, one chunk per (step, block).
const VALUES: StreamSpec = StreamSpec {
    name: "residual",
    dtype: Dtype::F32,
    unit: Unit::One,
    frame: Frame::Recon,
    codec: Codec::PlanesZstd,
    fill: "channels 0 to 2 are metres",
};

/// The hidden state, one chunk per (array, part).
const RESUME_STATE: StreamSpec = StreamSpec {
    name: "resume_state",
    dtype: Dtype::F32,
    unit: Unit::One,
    frame: Frame::None,
    codec: Codec::PlanesZstd,
    fill: "",
};

/// Gaussians of one block.
const BLOCK: usize = 16_384;

#[derive(Serialize, Deserialize)]
struct Head {
    clip_id: ClipId,
    field_key: [u8; 16],
    gaussian_count: u64,
    updates: u32,
    preset: String,
    weights: WeightsInfo,
    scale_residual: ScaleResidual,
    steps: Vec<u32>,
    resume_state: Vec<ArrayHead>,
}

impl Record for Refinement {
    const SCHEMA: SchemaId = SchemaId {
        name: "rogs.refinement",
        major: 1,
        minor: 0,
    };

    fn encode(&self, writer: &mut Writer) -> Result<()> {
        self.check().map_err(|what| writer.inconsistent(what))?;
        let head = Head {
            clip_id: self.clip_id.clone(),
            field_key: self.field_key.0,
            gaussian_count: self.gaussian_count,
            updates: self.updates,
            preset: self.preset.clone(),
            weights: self.weights.clone(),
            scale_residual: self.scale_residual,
            steps: self.steps.iter().map(|step| step.update).collect(),
            resume_state: arrays::heads(&self.resume_state),
        };
        writer.value("refinement", &head)?;
        let mut touched = Vec::new();
        let mut values = Vec::new();
        for (step, number) in self.steps.iter().zip(0u32..) {
            let mut rest = step.values.as_slice();
            for (block, index) in step.touched.chunks(BLOCK).zip(0u32..) {
                touched.push(([number, index, 0, 0], block));
                let (part, after) = rest.split_at(RESIDUAL_CHANNELS * nonzero(block));
                values.push(([number, index, 0, 0], part));
                rest = after;
            }
        }
        writer.stream(&TOUCHED, &[], &touched)?;
        writer.stream(&VALUES, &[RESIDUAL_CHANNELS as u32], &values)?;
        arrays::write(writer, &RESUME_STATE, &self.resume_state)
    }

    fn decode(reader: &Reader) -> Result<Self> {
        let head: Head = reader.value("refinement")?;
        let wrong = |what: String| reader.inconsistent(what);
        let touched = reader.stream::<u8>(&TOUCHED, &[])?;
        let values = reader.stream::<f32>(&VALUES, &[RESIDUAL_CHANNELS as u32])?;
        let gaussians = usize::try_from(head.gaussian_count).map_err(|_| wrong("too many Gaussians".into()))?;
        count(
            "touched",
            touched.len(),
            product("steps", &[gaussians, head.steps.len()]).map_err(wrong)?,
        )
        .map_err(wrong)?;
        count("corrections", values.len(), RESIDUAL_CHANNELS * nonzero(&touched)).map_err(wrong)?;
        let mut rest = values.as_slice();
        let mut steps = Vec::with_capacity(head.steps.len());
        for (index, &update) in head.steps.iter().enumerate() {
            let touched = touched[index * gaussians..(index + 1) * gaussians].to_vec();
            let (values, after) = rest.split_at(RESIDUAL_CHANNELS * nonzero(&touched));
            rest = after;
            steps.push(RefinementStep {
                update,
                touched,
                values: values.to_vec(),
            });
        }
        let refinement = Self {
            clip_id: head.clip_id,
            field_key: CacheKey(head.field_key),
            gaussian_count: head.gaussian_count,
            updates: head.updates,
            preset: head.preset,
            weights: head.weights,
            scale_residual: head.scale_residual,
            steps,
            resume_state: arrays::read(reader, &RESUME_STATE, head.resume_state)?,
        };
        refinement.check().map_err(wrong)?;
        Ok(refinement)
    }
}

/// Reads the corrections of the field whose file has this key.
///
/// # Errors
/// When the file is missing or damaged, or corrects another field: one of as many Gaussians would look right and be wrong.
pub fn read_refinement_of(path: &Path, field: CacheKey) -> Result<Refinement> {
    let (refinement, _) = read_record::<Refinement>(path)?;
    match refinement.check_corrects(field) {
        Ok(()) => Ok(refinement),
        Err(_) => Err(Error::WrongKind {
            path: path.to_owned(),
            found: format!("corrections of field {}", refinement.field_key),
            expected: format!("those of field {field}"),
        }),
    }
}
