//! Names and shapes of the refiner's parameters, import checks, and seeded parameters for untrained runs.

use std::collections::BTreeMap;

use burn::tensor::Device;

use super::RefinerConfig;
use crate::Result;
use rogs_tensors::parameters::Parameters;

/// Initial logit of every residual gate (gate 0.119).
pub const INITIAL_GATE_LOGIT: f32 = -2.0;

/// Parameters that this project adds to those of the released refiner (`docs/spec/stage2.md` section B.9).
pub const OWN_PARAMETERS: [&str; 3] = [
    "encoder.update_gate.logit",
    "encoder.update_obs_proj.bias",
    "encoder.update_obs_proj.weight",
];

/// Name and shape of every parameter of a configuration, as in the released files (prefix `encoder.`).
/// `num_batches_tracked` counters of the normalisations are not parameters and may be in a file or not.
#[must_use]
pub fn parameter_shapes(config: &RefinerConfig) -> BTreeMap<String, Vec<usize>> {
    let mut shapes = BTreeMap::new();
    let mut add = |name: String, shape: &[usize]| {
        shapes.insert(format!("encoder.{name}"), shape.to_vec());
    };
    let (s, f, p) = (config.state, config.features(), config.attention);
    let [stem, deep] = config.feature_widths;

    let norm = |name: &str, width: usize| -> Vec<(String, Vec<usize>)> {
        ["weight", "bias"]
            .iter()
            .map(|part| (format!("{name}.{part}"), vec![width]))
            .collect()
    };
    let batch_norm = |name: &str, width: usize| -> Vec<(String, Vec<usize>)> {
        ["weight", "bias", "running_mean", "running_var"]
            .iter()
            .map(|part| (format!("{name}.{part}"), vec![width]))
            .collect()
    };
    let linear = |name: &str, outputs: usize, inputs: usize| -> Vec<(String, Vec<usize>)> {
        vec![
            (format!("{name}.weight"), vec![outputs, inputs]),
            (format!("{name}.bias"), vec![outputs]),
        ]
    };
    let transformer = |name: &str, width: usize, projection: usize| -> Vec<(String, Vec<usize>)> {
        let attn = format!("{name}.attn");
        let mut list = norm(&format!("{name}.norm1"), width);
        list.push((format!("{attn}.qkv.weight"), vec![3 * projection, width]));
        list.extend(linear(&format!("{attn}.proj"), width, projection));
        list.extend(norm(&format!("{name}.norm2"), width));
        list.extend(linear(&format!("{name}.mlp.fc1"), 4 * width, width));
        list.extend(linear(&format!("{name}.mlp.fc2"), width, 4 * width));
        list
    };

    let mut all = vec![("update_feature.conv1.weight".to_owned(), vec![stem, 3, 7, 7])];
    all.extend(batch_norm("update_feature.bn1", stem));
    for (layer, block, inputs, outputs) in [
        (1, 0, stem, stem),
        (1, 1, stem, stem),
        (2, 0, stem, deep),
        (2, 1, deep, deep),
    ] {
        let name = format!("update_feature.layer{layer}.{block}");
        all.push((format!("{name}.conv1.weight"), vec![outputs, inputs, 3, 3]));
        all.extend(batch_norm(&format!("{name}.bn1"), outputs));
        all.push((format!("{name}.conv2.weight"), vec![outputs, outputs, 3, 3]));
        all.extend(batch_norm(&format!("{name}.bn2"), outputs));
        if layer == 2 && block == 0 {
            all.push((format!("{name}.downsample.0.weight"), vec![outputs, inputs, 1, 1]));
            all.extend(batch_norm(&format!("{name}.downsample.1"), outputs));
        }
    }
    all.extend(linear("update_rgb_error_proj.0", f, 3));
    all.extend(norm("update_rgb_error_proj.1", f));
    let name = "update_error_attn.0";
    all.extend(linear(&format!("{name}.proj1"), f, 16 * f));
    all.extend(norm(&format!("{name}.norm1"), f));
    all.extend(linear(&format!("{name}.proj2"), 16 * f, f));
    all.extend(norm(&format!("{name}.norm2"), 16 * f));
    all.push((format!("{name}.conv.weight"), vec![f, f, 3, 3]));
    all.push((format!("{name}.conv.bias"), vec![f]));
    all.extend(transformer(&format!("{name}.attn"), f, f));

    all.extend(linear("update_obs_proj", s, f));
    all.extend(linear("update_module.0.linear", s, config.inputs()));
    for block in 0..config.blocks {
        all.extend(transformer(&format!("update_module.1.blocks.{block}"), s, p));
    }
    for layer in [0, 2, 4] {
        all.extend(linear(&format!("update_head.{layer}"), s, s));
    }
    all.extend(linear("update_head.6", config.residuals(), s));
    all.push(("update_gate.logit".to_owned(), vec![5]));
    for (name, shape) in all {
        add(name, &shape);
    }
    shapes
}

/// Whether training changes this parameter; the error encoder and its features are frozen.
#[must_use]
pub fn is_trained(name: &str) -> bool {
    let trained = ["update_obs_proj.", "update_module.", "update_head.", "update_gate."];
    name.strip_prefix("encoder.")
        .is_some_and(|rest| trained.iter().any(|prefix| rest.starts_with(prefix)))
}

/// Checks the names and shapes of imported parameters against the configuration. The parameters that this project adds
/// are filled in (seeded projection, initial gates) when the file, being a released ReSplat refiner, lacks all of
/// them; the names filled in are returned.
///
/// # Errors
/// On the first parameter, in name order, that is missing or has another shape.
pub fn verify_parameters(parameters: &mut Parameters, config: &RefinerConfig, seed: u64) -> Result<Vec<String>> {
    config.validate()?;
    let upstream = OWN_PARAMETERS.iter().all(|name| parameters.shape(name).is_none());
    let mut filled = Vec::new();
    for (name, expected) in parameter_shapes(config) {
        match parameters.shape(&name) {
            Some(found) if found == expected => {}
            Some(found) => {
                let found = found.to_vec();
                return Err(rogs_weights::Error::WrongShape { name, found, expected }.into());
            }
            None if upstream && OWN_PARAMETERS.contains(&name.as_str()) => {
                parameters.insert(&name, &expected, seeded_values(&name, &expected, seed))?;
                filled.push(name);
            }
            None => return Err(rogs_weights::Error::MissingTensor { name }.into()),
        }
    }
    Ok(filled)
}

/// Seeded parameters of an untrained refiner. The values are a function of seed, name and index alone. As upstream, the
/// last layer of the head is zero, so that an untrained refiner changes nothing.
///
/// # Errors
/// When the configuration is not possible.
pub fn seeded_parameters(config: &RefinerConfig, seed: u64, device: &Device) -> Result<Parameters> {
    config.validate()?;
    let mut parameters = Parameters::new(device);
    for (name, shape) in parameter_shapes(config) {
        let values = seeded_values(&name, &shape, seed);
        parameters.insert(&name, &shape, values)?;
    }
    Ok(parameters)
}

/// Initial values of one parameter: uniform in `+-1/sqrt(fan in)` for weights and their biases, identity for
/// normalisations, zero for the last layer of the head, -2 for gates.
fn seeded_values(name: &str, shape: &[usize], seed: u64) -> Vec<f32> {
    let count: usize = shape.iter().product();
    let normalises = name.contains(".norm")
        || name.contains(".bn")
        || name.contains("downsample.1.")
        || name.contains("rgb_error_proj.1.");
    if name.starts_with("encoder.update_head.6.") {
        return vec![0.0; count];
    }
    if name == "encoder.update_gate.logit" {
        return vec![INITIAL_GATE_LOGIT; count];
    }
    if normalises {
        let one = name.ends_with(".weight") || name.ends_with(".running_var");
        return vec![if one { 1.0 } else { 0.0 }; count];
    }
    // ReLU layers of the ResNet keep their signal with He's variance; a bias has the bound of a width-sized fan-in.
    let fan_in = shape[1..]
        .iter()
        .product::<usize>()
        .max(if shape.len() == 1 { shape[0] } else { 1 }) as f32;
    let gain = if name.contains("update_feature.") {
        6.0f32.sqrt()
    } else {
        1.0
    };
    uniform(name, count, seed, gain / fan_in.sqrt())
}

/// `count` values uniform in `[-bound, bound)`: value `i` is a hash of (seed, name, i).
#[must_use]
pub fn uniform(name: &str, count: usize, seed: u64, bound: f32) -> Vec<f32> {
    let stream = name.bytes().fold(0xcbf2_9ce4_8422_2325 ^ mix(seed), |hash: u64, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    });
    let value = |index: u64| {
        let bits = mix(stream.wrapping_add(index.wrapping_mul(0x9e37_79b9_7f4a_7c15)));
        // 24 random bits in the mantissa: exact in f32.
        ((bits >> 40) as f32 / 8_388_608.0 - 1.0) * bound
    };
    (0..count as u64).map(value).collect()
}

/// The finaliser of splitmix64: every input bit reaches every output bit.
fn mix(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uniform_values_fill_their_interval_evenly_and_differ_by_name_and_seed() {
        let values = uniform("a", 40_000, 7, 2.0);
        assert!(values.iter().all(|value| (-2.0..2.0).contains(value)));
        let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / 4e4;
        let square = values.iter().map(|&v| f64::from(v * v)).sum::<f64>() / 4e4;
        // standard errors: 1.155 / 200 and about 1.19 / 200
        assert!(
            mean.abs() < 0.03 && (square - 4.0 / 3.0).abs() < 0.03,
            "{mean} {square}"
        );
        assert_ne!(uniform("a", 4, 7, 2.0), uniform("b", 4, 7, 2.0));
        assert_ne!(uniform("a", 4, 7, 2.0), uniform("a", 4, 8, 2.0));
        assert_eq!(uniform("a", 4, 7, 2.0), values[..4]);
    }

    #[test]
    fn seeded_head_is_zero_and_gates_are_nearly_closed() {
        let config = RefinerConfig::preset("ci").unwrap();
        let parameters = seeded_parameters(&config, 1, &Device::flex()).unwrap();
        assert!(
            parameters
                .host("encoder.update_head.6.weight")
                .unwrap()
                .iter()
                .all(|&value| value == 0.0)
        );
        assert_eq!(parameters.host("encoder.update_gate.logit").unwrap(), [-2.0; 5]);
        assert!(
            parameters
                .host("encoder.update_head.4.weight")
                .unwrap()
                .iter()
                .any(|&value| value != 0.0)
        );
    }

    #[test]
    fn a_released_refiner_lacks_only_what_this_project_adds() {
        let config = RefinerConfig::preset("ci").unwrap();
        let mut parameters = seeded_parameters(&config, 1, &Device::flex()).unwrap();
        assert!(verify_parameters(&mut parameters, &config, 1).unwrap().is_empty());
        for name in OWN_PARAMETERS {
            parameters.memory_mut().remove(name);
        }
        assert_eq!(verify_parameters(&mut parameters, &config, 1).unwrap(), OWN_PARAMETERS);
        parameters.memory_mut().remove("encoder.update_gate.logit");
        let error = verify_parameters(&mut parameters, &config, 1).unwrap_err();
        assert!(
            error.to_string().contains("encoder.update_gate.logit"),
            "one of the three alone is missing: {error}"
        );
        let paper = RefinerConfig::preset("cpu").unwrap();
        assert!(matches!(
            verify_parameters(&mut parameters, &paper, 1),
            Err(rogs_tensors::Error::Weights(rogs_weights::Error::WrongShape { .. }))
        ));
    }
}
