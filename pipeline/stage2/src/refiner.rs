//! The refiner as inference runs it: host arrays in, host arrays out, one source time at a time.

use super::host_updater::HostUpdater;
use super::knn::nearest_neighbours;
use super::observation::gather_features;
use super::resnet::FeatureMaps;
use super::updater::Neighbours;
use super::{ErrorEncoder, RefinerConfig, TokenGrid, Updater};
use crate::{Error, Result};
use rogs_tensors::parameters::{Parameters, from_host, to_host};

/// Frozen and trained parts together.
pub struct Refiner {
    config: RefinerConfig,
    encoder: ErrorEncoder,
    updater: Updater,
    /// The updater on slices, where the parameters are plain numbers on the CPU.
    host: Option<HostUpdater>,
    gates: [f32; 5],
    device: burn::tensor::Device,
}

/// The tokens that take part in one update of one source time. `n` tokens.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TokenSet {
    /// Token indices in the grid, ascending. `[n]`
    pub tokens: Vec<u32>,
    /// Attribute channels, 59 per Gaussian of a token. `[n, 59 * block^2]`
    pub attributes: Vec<f32>,
    /// Where neighbours are searched: one position per token, internal units. `[n]`
    pub positions: Vec<[f32; 3]>,
    /// Pooled error features. `[n, F]`
    pub feedback: Vec<f32>,
}

impl Refiner {
    /// Reads all parameters of a configuration.
    ///
    /// # Errors
    /// When one is missing or has another shape.
    pub fn load(parameters: &Parameters, config: &RefinerConfig) -> Result<Self> {
        config.validate()?;
        let updater = Updater::load(parameters, config)?;
        let plain = *parameters.device() == burn::tensor::Device::flex();
        let host = plain.then(|| HostUpdater::load(parameters, config)).transpose()?;
        Ok(Self {
            config: config.clone(),
            host,
            encoder: ErrorEncoder::load(parameters, config)?,
            gates: updater.gates_on_host()?,
            updater,
            device: parameters.device().clone(),
        })
    }

    /// The configuration.
    #[must_use]
    pub fn config(&self) -> &RefinerConfig {
        &self.config
    }

    /// The error encoder.
    #[must_use]
    pub fn encoder(&self) -> &ErrorEncoder {
        &self.encoder
    }

    /// The trained part. Its tensors are those of the parameters, so that gradients reach these.
    #[must_use]
    pub fn updater(&self) -> &Updater {
        &self.updater
    }

    /// The device of the trained part.
    #[must_use]
    pub fn device(&self) -> &burn::tensor::Device {
        &self.device
    }

    /// The residual gates in the order position, scale, rotation, opacity, harmonics.
    #[must_use]
    pub fn gates(&self) -> [f32; 5] {
        self.gates
    }

    /// Hidden state of all tokens of a source time, from the feature maps of its observed images in camera order. A
    /// token of several pixels starts from their mean features. `[tokens, S]`
    ///
    /// # Errors
    /// When the device fails.
    pub fn initial_state(&self, maps: &[FeatureMaps], height: usize, width: usize) -> Result<Vec<f32>> {
        let block = self.config.token_block;
        let tokens = (height / block) * (width / block);
        let mut state = Vec::with_capacity(maps.len() * tokens * self.config.state);
        for maps in maps {
            let features = gather_features(maps, height, width, block);
            let features = from_host(features, [tokens, self.config.features()], &self.device);
            state.extend(to_host(self.updater.initial_state(features))?);
        }
        Ok(state)
    }

    /// One update of one source time: advances the state of the set's tokens in place and returns their ungated
    /// residuals. `state` is `[grid tokens, S]`, the result `[n, 59 * block^2]`.
    ///
    /// # Errors
    /// When the arrays do not fit each other, or the device fails.
    pub fn update(&self, grid: &TokenGrid, set: TokenSet, state: &mut [f32]) -> Result<Vec<f32>> {
        let TokenSet {
            tokens,
            attributes,
            positions,
            feedback,
        } = set;
        let (n, s, f) = (tokens.len(), self.config.state, self.config.features());
        let residuals = self.config.residuals();
        let fits = attributes.len() == n * residuals && positions.len() == n && feedback.len() == n * f;
        if !fits || state.len() != grid.len() * s || tokens.iter().any(|&token| token as usize >= grid.len()) {
            return Err(Error::BadInput(format!(
                "the arrays of {n} tokens do not fit the refiner `{}`",
                self.config.name
            )));
        }
        if n == 0 {
            return Ok(Vec::new());
        }
        let count = self.config.neighbours.min(n);
        let neighbours = nearest_neighbours(&positions, count);
        let mut rows: Vec<f32> = tokens
            .iter()
            .flat_map(|&token| &state[token as usize * s..][..s])
            .copied()
            .collect();
        let (advanced, residual) = match &self.host {
            Some(host) => {
                let residual = host.run(&attributes, &mut rows, &feedback, (&neighbours, count))?;
                (rows, residual)
            }
            None => {
                let output = self.updater.forward(
                    from_host(attributes, [n, residuals], &self.device),
                    from_host(rows, [n, s], &self.device),
                    from_host(feedback, [n, f], &self.device),
                    &Neighbours::new(&neighbours, count, &self.device),
                );
                (to_host(output.state)?, to_host(output.residual)?)
            }
        };
        for (&token, row) in tokens.iter().zip(advanced.chunks_exact(s)) {
            state[token as usize * s..][..s].copy_from_slice(row);
        }
        Ok(residual)
    }
}
