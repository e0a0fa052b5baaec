//! Seeded weights: what training starts from when there is no checkpoint, and what the demo runs with.
//!
//! Values depend on the seed, the tensor's name and the position in it, on nothing else. Besides the initial values of
//! `docs/spec/stage1.md` (appendix) the last layers start where an untrained network already gives a plausible picture:
//! about one metre of depth, the pixel's own colour, opaque splats about a pixel wide, no motion.

use super::config::{HeadKind, PREFIX, Stage1Config};
use super::layout::{self, ParameterSpec};
use super::network::Stage1;
use crate::Result;
use burn::tensor::Device;
use rogs_schemas::units::UNITS_PER_METRE;
use rogs_tensors::parameters::Parameters;

/// Depth at which an untrained network places everything, metres.
const START_DEPTH_M: f64 = 1.0;
/// Raw scale of an untrained network: softplus(11) * 0.001 iu is about 3 mm, half a pixel at one metre.
const START_SCALE: f32 = 11.0;
/// Raw opacity of an untrained network: sigmoid(2 * 2.5 - 2) = 0.95.
const START_OPACITY: f32 = 2.5;
/// Share of the usual size with which the last layer of a head starts, so that its features colour the start only a little.
const LAST_LAYER_GAIN: f32 = 0.02;
/// Beyond this distance from the middle the slope of the colour shortcut rises (see [`color_shortcut`]).
const COLOR_KNEE: f32 = 0.35;

/// All parameters of a configuration with the FK branch, from a seed.
///
/// # Errors
/// When the configuration is not possible.
pub fn network(config: &Stage1Config, seed: u64, device: &Device) -> Result<Stage1> {
    config.validate()?;
    let mut parameters = Parameters::new(device);
    for spec in layout::released(config).into_iter().chain(layout::fk_branch(config)) {
        let values = values(&spec, config, seed);
        parameters.insert(&spec.name, &spec.shape, values)?;
    }
    Stage1::new(config.clone(), parameters)
}

/// Initial values of one parameter.
#[must_use]
pub fn values(spec: &ParameterSpec, config: &Stage1Config, seed: u64) -> Vec<f32> {
    let mut values = spec.drawn(seed);
    let local = spec
        .name
        .strip_prefix(PREFIX)
        .and_then(|name| name.strip_prefix('.'))
        .unwrap_or(&spec.name);
    let Some((head, local)) = HeadKind::ALL.iter().find_map(|&kind| {
        local
            .strip_prefix(kind.name())
            .and_then(|rest| rest.strip_prefix('.'))
            .map(|rest| (kind, rest))
    }) else {
        return values;
    };
    match (head, local) {
        (HeadKind::Motion, "scratch.output_conv2.2.weight" | "scratch.output_conv2.2.bias") => values.fill(0.0),
        (_, "scratch.output_conv2.2.weight") => values.iter_mut().for_each(|value| *value *= LAST_LAYER_GAIN),
        (HeadKind::Depth, "scratch.output_conv2.2.bias") => {
            values.copy_from_slice(&[libm::log(START_DEPTH_M * UNITS_PER_METRE) as f32, 0.0]);
        }
        (HeadKind::Splat, "scratch.output_conv2.2.bias") => {
            let start = [
                0.0,
                0.0,
                0.0,
                START_SCALE,
                START_SCALE,
                START_SCALE,
                1.0,
                0.0,
                0.0,
                0.0,
                START_OPACITY,
                0.0,
            ];
            values.copy_from_slice(&start);
        }
        (HeadKind::MotionSplat, "scratch.output_conv2.2.bias") => values.fill(0.0),
        (HeadKind::Splat, _) if local.starts_with("shortcut.") => {
            color_shortcut(local, config.head_hidden, &mut values)
        }
        (HeadKind::MotionSplat, _) if local.starts_with("shortcut.") => {
            pass_shortcut(local, config.head_hidden, &mut values)
        }
        _ => {}
    }
    values
}

/// Shortcut weights with which raw = (2 c - 1), steeper towards black and white, so that sigmoid(2 raw) is close to c.
fn color_shortcut(local: &str, hidden: usize, values: &mut [f32]) {
    // Hidden units 3 k, 3 k + 1, 3 k + 2 of colour k: relu(c), relu(c - 0.5 - knee), relu(0.5 - knee - c).
    const STEEP: f32 = 8.0;
    if hidden < 9 {
        return;
    }
    values.fill(0.0);
    for color in 0..3 {
        let units = [
            (1.0, 0.0, 2.0),
            (1.0, -0.5 - COLOR_KNEE, STEEP),
            (-1.0, 0.5 - COLOR_KNEE, -STEEP),
        ];
        for (unit, (weight, bias, gain)) in units.into_iter().enumerate() {
            let unit = 3 * color + unit;
            match local {
                "shortcut.0.weight" => values[(unit * 3 + color) * 9 + 4] = weight,
                "shortcut.0.bias" => values[unit] = bias,
                "shortcut.2.weight" => values[color * hidden + unit] = gain,
                _ => values[color] = -1.0,
            }
        }
    }
}

/// Shortcut weights that pass the base attributes on: colours with both signs, scales, the real part of the rotation and
/// opacity by their positive part.
fn pass_shortcut(local: &str, hidden: usize, values: &mut [f32]) {
    const UNITS: [(usize, f32); 11] = [
        (0, 1.0),
        (0, -1.0),
        (1, 1.0),
        (1, -1.0),
        (2, 1.0),
        (2, -1.0),
        (3, 1.0),
        (4, 1.0),
        (5, 1.0),
        (6, 1.0),
        (10, 1.0),
    ];
    if hidden < UNITS.len() {
        return;
    }
    values.fill(0.0);
    for (unit, (channel, sign)) in UNITS.into_iter().enumerate() {
        match local {
            "shortcut.0.weight" => values[(unit * 11 + channel) * 9 + 4] = sign,
            "shortcut.2.weight" => values[channel * hidden + unit] = sign,
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn compact_has_laptop_size() {
        let config = Stage1Config::compact();
        config.validate().unwrap();
        let count: usize = layout::released(&config).iter().map(ParameterSpec::len).sum();
        assert!((4_000_000..10_000_000).contains(&count), "{count}");
    }
}
