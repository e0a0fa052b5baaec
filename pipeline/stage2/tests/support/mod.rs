//! Golden files of Stage 2 and comparisons with them.

#[path = "../../../../tests/support/tensors.rs"]
mod tensors;
pub(crate) mod updates;

use std::path::PathBuf;

use burn::tensor::Device;
use rogs_needs::shared;
use rogs_stage2::{FeatureMap, RefinerConfig, TokenGrid};
use rogs_tensors::parameters::Parameters;
use tensors::Tensors;

/// Tolerance of features and attributes, and of hidden states: |a - b| <= absolute + 1e-4 |b|.
pub(crate) const FEATURE: f64 = 1e-4;
pub(crate) const STATE: f64 = 2e-4;

/// A golden file in memory.
pub(crate) struct Golden {
    name: String,
    arrays: Tensors,
}

/// Where a golden file lies: with the crate when it is small, else with the reference data.
fn find(file: &str) -> PathBuf {
    let small = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("tests/golden")
        .join(file);
    match small.is_file() {
        true => small,
        false => shared!("golden/stage2").join(file),
    }
}

/// The text of a golden table.
pub(crate) fn text(file: &str) -> String {
    std::fs::read_to_string(find(file)).unwrap()
}

/// A golden file by name.
pub(crate) fn golden(name: &str) -> Golden {
    let path = find(&format!("{name}.safetensors"));
    Golden {
        name: name.to_owned(),
        arrays: Tensors::read(&path),
    }
}

impl Golden {
    /// Whether the file has an array.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.arrays.has(name)
    }

    /// Values of an array.
    pub(crate) fn array(&self, name: &str) -> &[f32] {
        self.arrays.values(name)
    }

    /// Values of an array of indices.
    pub(crate) fn indices(&self, name: &str) -> Vec<u32> {
        self.array(name).iter().map(|&value| value as u32).collect()
    }

    /// Points of an array `[n, 3]`.
    pub(crate) fn points(&self, name: &str) -> Vec<[f32; 3]> {
        self.array(name).chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect()
    }

    /// Views of an array `[views, channels, height, width]`.
    pub(crate) fn images(&self, name: &str) -> Vec<FeatureMap> {
        let (shape, values) = (self.arrays.shape(name), self.arrays.values(name));
        let &[_, channels, height, width] = shape else {
            panic!("not an image: `{name}`")
        };
        let area = height * width;
        let view = |data: &[f32]| FeatureMap {
            height,
            width,
            channels,
            data: (0..area)
                .flat_map(|pixel| (0..channels).map(move |c| (c, pixel)))
                .map(|(c, pixel)| data[c * area + pixel])
                .collect(),
        };
        values.chunks_exact(channels * area).map(view).collect()
    }

    /// Views of an array of tokens `[views * height * width, channels]`.
    pub(crate) fn views(&self, name: &str, height: usize, width: usize) -> Vec<FeatureMap> {
        let (shape, values) = (self.arrays.shape(name), self.arrays.values(name));
        let channels = shape[1];
        let view = |data: &[f32]| FeatureMap {
            height,
            width,
            channels,
            data: data.to_vec(),
        };
        values.chunks_exact(height * width * channels).map(view).collect()
    }

    /// The 59 updater channels of Gaussians stored upstream: opacities become logits, SH stay colour-major.
    pub(crate) fn attributes(&self, names: [&str; 5]) -> Vec<f32> {
        let [means, scales, quats, opacities, sh] = names.map(|name| self.array(name));
        let row = |n: usize| {
            [
                &means[3 * n..3 * n + 3],
                &scales[3 * n..3 * n + 3],
                &quats[4 * n..4 * n + 4],
                &[logit(opacities[n])],
                &sh[48 * n..48 * n + 48],
            ]
            .concat()
        };
        (0..opacities.len()).flat_map(row).collect()
    }

    /// The weights of the file.
    pub(crate) fn parameters(&self, device: &Device) -> Parameters {
        let mut parameters = Parameters::new(device);
        for array in self.arrays.names() {
            if let Some(name) = array.strip_prefix("w.") {
                let (shape, values) = (self.arrays.shape(array), self.arrays.values(array));
                parameters.insert(name, shape, values.to_vec()).unwrap();
            }
        }
        parameters
    }

    /// The same with this project's own parameters, which files of the donor lack (zero, as their values do not enter).
    pub(crate) fn parameters_with_own(&self, device: &Device, width: usize) -> Parameters {
        let mut parameters = self.parameters(device);
        parameters
            .insert(
                "encoder.update_obs_proj.weight",
                &[width, width],
                vec![0.0; width * width],
            )
            .unwrap();
        parameters
            .insert("encoder.update_obs_proj.bias", &[width], vec![0.0; width])
            .unwrap();
        parameters
            .insert("encoder.update_gate.logit", &[5], vec![0.0; 5])
            .unwrap();
        parameters
    }

    /// Mass and pooled feedback of each token from the stored sparse contributions.
    pub(crate) fn pooled(&self, tag: &str, grid: &TokenGrid, channels: usize) -> (Vec<f32>, Vec<f32>) {
        let (pixels, gaussians) = (
            self.indices(&format!("in.coo_pixel_{tag}")),
            self.indices(&format!("in.coo_gaussian_{tag}")),
        );
        let (weights, error) = (
            self.array(&format!("in.coo_weight_{tag}")),
            self.array(&format!("in.E_{tag}")),
        );
        let mut mass = vec![0.0f64; grid.len()];
        let mut sums = vec![0.0f64; grid.len() * channels];
        for ((&pixel, &gaussian), &weight) in pixels.iter().zip(&gaussians).zip(weights) {
            let Some(token) = grid.token_of(gaussian as usize) else {
                continue;
            };
            mass[token] += f64::from(weight);
            for channel in 0..channels {
                sums[token * channels + channel] +=
                    f64::from(weight) * f64::from(error[pixel as usize * channels + channel]);
            }
        }
        let divide = |(index, sum): (usize, &f64)| (sum / mass[index / channels].max(1e-30)) as f32;
        let feedback = sums.iter().enumerate().map(divide).collect();
        (mass.iter().map(|&mass| mass as f32).collect(), feedback)
    }

    /// Asserts closeness to an array of the file.
    pub(crate) fn close_to(&self, name: &str, values: &[f32], absolute: f64) {
        self.close(name, values, self.array(name), absolute);
    }

    /// Asserts |value - expected| <= absolute + 1e-4 |expected| everywhere; prints the worst error.
    pub(crate) fn close(&self, what: &str, values: &[f32], expected: &[f32], absolute: f64) {
        assert_eq!(values.len(), expected.len(), "{}: {what}: number of values", self.name);
        let mut worst = (0.0f64, 0.0f64, 0);
        for (index, (&value, &reference)) in values.iter().zip(expected).enumerate() {
            let error = (f64::from(value) - f64::from(reference)).abs();
            let share = error / (absolute + 1e-4 * f64::from(reference).abs());
            assert!(!share.is_nan(), "{}: {what}[{index}] is not a number", self.name);
            if share > worst.0 {
                worst = (share, error, index);
            }
        }
        assert!(
            worst.0 <= 1.0,
            "{}: {what}[{}]: {} where {} is expected, {:.2} of the tolerance",
            self.name,
            worst.2,
            values[worst.2],
            expected[worst.2],
            worst.0
        );
        if values.len() > 200 {
            println!(
                "{}: {what}: worst error {:.2e}, {:.3} of the tolerance",
                self.name, worst.1, worst.0
            );
        }
    }
}

/// Sizes of the golden loops.
pub(crate) fn small_config() -> RefinerConfig {
    RefinerConfig {
        name: "golden".into(),
        updates: 3,
        ..RefinerConfig::preset("ci").unwrap()
    }
}

/// Maps of all views, one after the other.
pub(crate) fn joined(views: &[FeatureMap]) -> Vec<f32> {
    views.iter().flat_map(|view| &view.data).copied().collect()
}

/// A correction with its position in internal units, as the golden file has it.
pub(crate) fn delta_iu(row: &[f32]) -> Vec<f32> {
    row.iter()
        .enumerate()
        .map(|(channel, &value)| if channel < 3 { value * 3.5 } else { value })
        .collect()
}

/// Logit of an opacity, clamped by 1e-6 as upstream.
fn logit(opacity: f32) -> f32 {
    let clamped = f64::from(opacity.clamp(1e-6, 1.0 - 1e-6));
    (clamped / (1.0 - clamped)).ln() as f32
}
