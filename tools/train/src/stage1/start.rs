//! The parameters training starts from, and which of them it changes how fast.

use burn::tensor::Device;

use rogs_stage1::{HeadKind, Stage1, Stage1Config, held, layout, seeded};
use rogs_tensors::parameters::Parameters;
use rogs_weights::TrainingDomain;

use crate::config::{OptimiserSettings, Stage1Training};
use crate::error::Result;

/// Residual scale of aggregator blocks in a network that starts from nothing; the released value (0.01) leaves blocks
/// silent for thousands of updates.
const START_LAYER_SCALE: f32 = 0.3;

/// The network of a run before its first update.
pub struct Start {
    /// Its weights are those of the checkpoint, or drawn from the seed.
    pub network: Stage1,
    /// The narrow kind of clips that its weights have seen, if any.
    pub domain: Option<TrainingDomain>,
}

/// Makes the network that a run starts from.
///
/// # Errors
/// When the checkpoint to start from cannot be opened or is of another configuration.
pub fn start(settings: &Stage1Training, device: &Device) -> Result<Start> {
    let config = Stage1Config::by_name(&settings.configuration)?;
    let (mut network, domain) = match &settings.start {
        Some(path) => {
            let loaded = rogs_stage1::open_stage1(path, device)?;
            let untrained = (!loaded.trained).then_some(TrainingDomain::Procedural);
            (loaded.network, loaded.domain.or(untrained))
        }
        None => (
            from_seed(&config, settings.seed, device)?,
            Some(TrainingDomain::Procedural),
        ),
    };
    extend(&mut network, &config, settings.seed)?;
    if network.config != config {
        return Err(crate::Error::Setting {
            what: "configuration",
            value: settings.configuration.clone(),
            rule: "that of the checkpoint to start from",
        });
    }
    if settings.fresh_fk_branch || network.fk_branch()?.is_none() {
        fresh_fk_branch(&mut network, settings.seed)?;
    }
    if settings.held_gate && network.held_gate()?.is_none() {
        fresh_held_gate(&mut network, settings.seed)?;
    }
    if settings.optimiser.lora_rank > 0 {
        add_low_rank_updates(&mut network, settings)?;
    }
    bring_into_memory(&mut network.parameters, &settings.optimiser)?;
    Ok(Start { network, domain })
}

/// Gives a network of a checkpoint the stem, the sweep and the comparison with other times of its configuration where it has
/// none; they say nothing yet. A sweep takes the range of depths of its configuration.
fn extend(network: &mut Stage1, config: &Stage1Config, seed: u64) -> Result<()> {
    let mut extended = Stage1Config {
        name: config.name.clone(),
        ..network.config.clone()
    };
    if !extended.has_stem() {
        extended.stem_channels = config.stem_channels;
    }
    if extended.sweep_depths == 0 {
        extended.sweep_depths = config.sweep_depths;
    }
    if extended.sweep_other_times == 0 {
        extended.sweep_other_times = config.sweep_other_times;
    }
    extended.sweep_range_mm = config.sweep_range_mm;
    if extended != *config {
        return Ok(());
    }
    for spec in layout::released(config) {
        if network.parameters.shape(&spec.name).is_none() {
            let values = seeded::values(&spec, config, seed);
            network.parameters.insert(&spec.name, &spec.shape, values)?;
        }
    }
    network.config = extended;
    Ok(())
}

/// Reads the trained parameters of a large checkpoint; the others are read from the file whenever they are used.
fn bring_into_memory(parameters: &mut Parameters, settings: &OptimiserSettings) -> Result<()> {
    for name in parameters.names() {
        if rate_of(&name, settings).is_some() && !parameters.memory().contains_key(&name) {
            let shape = parameters.shape(&name).map(<[usize]>::to_vec).unwrap_or_default();
            let values = parameters.host(&name)?;
            parameters.insert(&name, &shape, values)?;
        }
    }
    Ok(())
}

/// Seeded weights that can learn: in the released network the ray embedding starts at zero on both sides of its norm,
/// beside a trained encoder; alone, it would get no gradient at all.
fn from_seed(config: &Stage1Config, seed: u64, device: &Device) -> Result<Stage1> {
    let mut network = seeded::network(config, seed, device)?;
    fresh_fk_branch(&mut network, seed)?;
    let parameters = &mut network.parameters;
    let (width, patch) = (config.width, config.patch);
    let name = "backbone.plucker_embed.net.weight";
    let shape = [width, 6, 1, patch, patch];
    let spec = layout::ParameterSpec {
        name: name.into(),
        shape: shape.to_vec(),
        initial: layout::Initial::Uniform {
            fan_in: 6 * patch * patch,
        },
    };
    parameters.insert(name, &shape, seeded::values(&spec, config, seed))?;
    parameters.insert("backbone.plucker_ln.weight", &[width], vec![1.0; width])?;
    for kind in ["frame_blocks", "global_blocks"] {
        for block in 0..config.pairs {
            for scale in ["ls1", "ls2"] {
                let name = format!("backbone.backbone.{kind}.{block}.{scale}.gamma");
                parameters.insert(&name, &[width], vec![START_LAYER_SCALE; width])?;
            }
        }
    }
    Ok(network)
}

/// An FK branch that gives zero yet and has its input at hand: the first units carry both signs of the FK displacement
/// through to the last convolution, which is zero. A branch of seeded units at a high rate dies before it learns.
fn fresh_fk_branch(network: &mut Stage1, seed: u64) -> Result<()> {
    const CENTRE: usize = 4;
    let config = network.config.clone();
    for spec in layout::fk_branch(&config) {
        let mut values = seeded::values(&spec, &config, seed);
        let taps = |unit: usize, input: usize| (unit * spec.shape[1] + input) * 9;
        let passing = (0..6.min(config.fk_hidden)).map(|unit| match spec.name.as_str() {
            "fk_branch.conv1.weight" => (unit, Some((2 + unit / 2, if unit % 2 == 0 { 1.0 } else { -1.0 }))),
            "fk_branch.conv2.weight" => (unit, Some((unit, 1.0))),
            _ => (unit, None),
        });
        for (unit, pass) in passing {
            if let Some((input, gain)) = pass {
                values[taps(unit, 0)..taps(unit + 1, 0)].fill(0.0);
                values[taps(unit, input) + CENTRE] = gain;
            } else if spec.shape.len() == 1 && !spec.name.contains("conv3") {
                values[unit] = 0.0;
            }
        }
        network.parameters.insert(&spec.name, &spec.shape, values)?;
    }
    Ok(())
}

/// A gate of what is held that starts with what is nearest to the tool: 0.88 at its centre, 0.24 at 5 cm, 0.01 at 10 cm.
/// The last channel of the motion head, which nothing has read before, starts at zero.
fn fresh_held_gate(network: &mut Stage1, seed: u64) -> Result<()> {
    const CENTRE: usize = 4;
    const AT_TOOL: f32 = 8.0;
    const ELSEWHERE: f32 = -6.0;
    let config = network.config.clone();
    for spec in layout::held() {
        let mut values = seeded::values(&spec, &config, seed);
        // The first unit of each layer passes the nearness on.
        let passing = match spec.name.as_str() {
            "held.conv1.weight" => Some((held::NEARNESS, 1.0)),
            "held.conv2.weight" => Some((0, 1.0)),
            "held.conv3.weight" => Some((0, AT_TOOL)),
            "held.conv3.bias" => {
                values.fill(ELSEWHERE);
                None
            }
            _ => {
                values[0] = 0.0;
                None
            }
        };
        if let Some((input, gain)) = passing {
            values[..9 * spec.shape[1]].fill(0.0);
            values[9 * input + CENTRE] = gain;
        }
        network.parameters.insert(&spec.name, &spec.shape, values)?;
    }
    for name in ["weight", "bias"] {
        let name = format!("backbone.{}.scratch.output_conv2.2.{name}", HeadKind::Motion.name());
        let shape = network
            .parameters
            .shape(&name)
            .map(<[usize]>::to_vec)
            .unwrap_or_default();
        let mut values = network.parameters.host(&name)?;
        let last = values.len() - values.len() / HeadKind::Motion.channels();
        values[last..].fill(0.0);
        network.parameters.insert(&name, &shape, values)?;
    }
    Ok(())
}

/// Adds A (seeded) and B (zero) of the QKV and output projections of all aggregator blocks.
fn add_low_rank_updates(network: &mut Stage1, settings: &Stage1Training) -> Result<()> {
    let (config, rank) = (network.config.clone(), settings.optimiser.lora_rank);
    for kind in ["frame_blocks", "global_blocks"] {
        for block in 0..config.pairs {
            for (layer, outputs) in [("qkv", 3 * config.width), ("proj", config.width)] {
                let prefix = format!("backbone.backbone.{kind}.{block}.attn.{layer}");
                let spec = layout::ParameterSpec {
                    name: format!("{prefix}.lora_A.weight"),
                    shape: vec![rank, config.width],
                    initial: layout::Initial::Uniform { fan_in: config.width },
                };
                let values = seeded::values(&spec, &config, settings.seed);
                network.parameters.insert(&spec.name, &spec.shape, values)?;
                let zeros = vec![0.0; outputs * rank];
                network
                    .parameters
                    .insert(&format!("{prefix}.lora_B.weight"), &[outputs, rank], zeros)?;
            }
        }
    }
    Ok(())
}

/// Peak learning rate of a parameter, `None` when it is not trained (`docs/spec/stage1.md` section 15): a rate of 0 is that, so
/// that nothing is differentiated for it.
#[must_use]
pub fn rate_of(name: &str, settings: &OptimiserSettings) -> Option<f64> {
    let head = name.contains("_head.");
    if name.contains("mask_token") {
        return None; // not a part of any output
    }
    let rate = if name.starts_with("held.") {
        settings.held_rate.unwrap_or(settings.fk_rate)
    } else if name.starts_with("fk_branch") {
        settings.fk_rate
    } else if name.contains("splat_head") {
        settings.head_rate
    } else if head || name.contains(".lora_") || (settings.lora_rank == 0 && settings.train_backbone) {
        settings.rate
    } else {
        0.0
    };
    (rate > 0.0).then_some(rate)
}

/// The same network with leaves of its own: trained parameters require gradients, the others do not. Values are shared.
///
/// # Errors
/// When the configuration is not possible.
pub fn tracked(network: &Stage1, settings: &OptimiserSettings) -> Result<Stage1> {
    let parameters = &network.parameters;
    let leaves = parameters.with_leaves(parameters.device(), |name, values| {
        if rate_of(name, settings).is_some() {
            values.require_grad()
        } else {
            values
        }
    });
    Ok(Stage1::new(network.config.clone(), leaves)?)
}
