//! The fields that the refiner is trained on.

use std::path::Path;

use burn::tensor::Device;
use rogs_lift::{LiftParams, lift_clip, load_model};
use rogs_refine::ClipInputs;
use rogs_schemas::FrameIndex;
use rogs_schemas::key::CacheKey;
use rogs_schemas::records::field::Field;
use rogs_tensors::device;
use rogs_worker::Unobserved;

use crate::config::DataSettings;
use crate::error::Result;
use crate::plan::ClipPlan;
use crate::records::Records;

/// A clip and the field that Stage 1 makes of it.
pub struct LiftedClip {
    /// The clip as the pipeline would store it.
    pub(super) records: Records,
    /// The field of Stage 1.
    pub(super) field: Field,
    /// Query frames.
    pub(super) frames: Vec<FrameIndex>,
}

/// Lifts clips with one loaded network.
pub(super) struct Lifter {
    model: rogs_lift::Model,
    params: LiftParams,
}

impl Lifter {
    pub(super) fn load(weights: &Path, device: &Device) -> Result<Self> {
        let params = LiftParams {
            device: device::kind(device),
            ..LiftParams::default()
        };
        let model = load_model(&params, Some(weights))?;
        Ok(Self { model, params })
    }

    pub(super) fn lift(&self, plan: &ClipPlan, data: &DataSettings) -> Result<LiftedClip> {
        let records = plan.or_another(|plan| plan.records(data))?;
        let (clip, robot, conditioning) = (&records.clip, &records.robot, &records.conditioning);
        let inputs = rogs_lift::ClipInputs::new(clip, robot, conditioning);
        Ok(LiftedClip {
            frames: plan.queries.clone(),
            field: lift_clip(&self.model, &self.params, inputs, &mut Unobserved)?,
            records,
        })
    }
}

impl LiftedClip {
    pub(super) fn inputs(&self) -> ClipInputs<'_> {
        ClipInputs {
            clip: &self.records.clip,
            robot: &self.records.robot,
            field: &self.field,
            field_key: CacheKey([0; 16]),
            resume: None,
        }
    }
}
