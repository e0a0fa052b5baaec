//! The training loop of Stage 1: forward and backward over the clips of an update, and what lies on disk.

use std::collections::BTreeMap;

use burn::tensor::Device;
use rayon::prelude::*;
use rogs_networks::parameters::to_host;
use rogs_networks::stage1::Stage1;
use rogs_random::Pcg64;

use crate::config::Stage1Training;
use crate::error::{Error, Result};
use crate::forward::lift;
use crate::objective::objective;
use crate::optimiser::{Gradients, Moments, update};
use crate::sample::Sample;
use crate::start;
use crate::stream::Batch;

/// A run between two updates.
pub struct Trainer {
    /// Its settings.
    pub settings: Stage1Training,
    /// The network as it is now.
    pub network: Stage1,
    /// Moments of the optimiser.
    pub moments: Moments,
    /// Updates done.
    pub step: u64,
}

/// What an update did.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct UpdateReport {
    /// The update, counted from 0.
    pub step: u64,
    /// The weighted sum of all losses.
    pub loss: f64,
    /// Each loss before its weight, mean over the clips.
    pub terms: BTreeMap<String, f64>,
    /// Norm of the gradient before clipping.
    pub gradient_norm: f64,
    /// Source images of the update.
    pub images: usize,
}

impl Trainer {
    /// A run before its first update, on a device of its own kind with gradients.
    ///
    /// # Errors
    /// When settings are wrong or the checkpoint to start from cannot be opened.
    pub fn new(settings: Stage1Training, device: &Device) -> Result<Self> {
        settings.check()?;
        let network = start::network(&settings, &device.clone().autodiff())?;
        Ok(Self {
            settings,
            network,
            moments: Moments::default(),
            step: 0,
        })
    }

    /// One update. Clips are differentiated side by side on as many threads as there are; their gradients are added up in
    /// their order.
    ///
    /// # Errors
    /// When a loss or gradient is not finite, or the device fails; the network is unchanged then.
    pub fn update(&mut self, batch: &Batch) -> Result<UpdateReport> {
        let results: Vec<Result<ClipResult>> = (0..batch.clips.len())
            .into_par_iter()
            .with_max_len(1)
            .map(|index| self.differentiate(&batch.clips[index], index as u64))
            .collect();
        let mut sum = Gradients::new();
        let mut terms: BTreeMap<String, f64> = BTreeMap::new();
        let (mut loss, share) = (0.0, 1.0 / batch.clips.len().max(1) as f64);
        for result in results {
            let ClipResult {
                value,
                terms: of_clip,
                gradients,
            } = result?;
            loss += share * value;
            for (key, value) in of_clip {
                *terms.entry(key.to_owned()).or_insert(0.0) += share * value;
            }
            for (name, gradient) in gradients {
                let total = sum.entry(name).or_insert_with(|| vec![0.0; gradient.len()]);
                for (total, value) in total.iter_mut().zip(gradient) {
                    *total += share as f32 * value;
                }
            }
        }
        let settings = &self.settings;
        let gradient_norm = update(
            &mut self.network.parameters,
            &mut self.moments,
            &sum,
            &settings.optimiser,
            self.step,
            settings.steps,
        )?;
        let report = UpdateReport {
            step: self.step,
            loss,
            terms,
            gradient_norm,
            images: batch.clips.iter().map(|clip| clip.views.len()).sum(),
        };
        self.step += 1;
        Ok(report)
    }

    /// Loss and gradients of a clip.
    fn differentiate(&self, clip: &Sample, index: u64) -> Result<ClipResult> {
        let settings = &self.settings;
        let network = start::tracked(&self.network, &settings.optimiser)?;
        let mut random = Pcg64::from_seeds(&[settings.seed, 3, self.step, index]);
        let conditioned = random.next_double() >= settings.data.conditioning_dropout;
        let lifted = lift(&network, clip, conditioned)?;
        let objective = objective(clip, &lifted, &settings.losses, &mut random)?;
        if !objective.value.is_finite() {
            let bad = objective.terms.iter().find(|(_, value)| !value.is_finite());
            let bad = bad.map_or("total", |(key, _)| key);
            return Err(Error::Diverged {
                step: self.step,
                what: format!("the loss `{bad}` of the clip of seed {}", clip.seed),
            });
        }
        drop(lifted);
        let mut gradients = objective.surrogate.backward();
        let mut by_name = Gradients::new();
        for (name, parameter) in network.parameters.memory() {
            if let Some(gradient) = parameter.values.grad_remove(&mut gradients) {
                by_name.insert(name.clone(), to_host(gradient)?);
            }
        }
        Ok(ClipResult {
            value: objective.value,
            terms: objective.terms,
            gradients: by_name,
        })
    }
}

/// What a clip adds to an update.
struct ClipResult {
    value: f64,
    terms: BTreeMap<&'static str, f64>,
    gradients: Gradients,
}
