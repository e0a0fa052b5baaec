//! A network on disk whose every part contributes.

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use rogs_stage1::stage1_metadata;
use rogs_stage1::{Stage1Config, seeded};
use rogs_weights::{ElementType, TensorSource, write};

/// Size of the values that stand where a seeded network has zeros.
const HEARD: f32 = 0.01;

/// A seeded network with a plane sweep, in a folder. Its last layers are not zero: gradients reach what lies before them.
pub(crate) fn seeded_network(folder: &Path) -> PathBuf {
    let config = Stage1Config::compact_sweep();
    let network = seeded::network(&config, 5, &Device::flex()).unwrap();
    let noise = |k: usize| HEARD * (((k * 7919 + 13) % 1009) as f32 / 504.5 - 1.0);
    let tensor = |name: String| {
        let mut values = network.parameters.host(&name).unwrap();
        if values.iter().all(|&value| value == 0.0) {
            values = (0..values.len()).map(noise).collect();
        }
        TensorSource {
            shape: network.parameters.shape(&name).unwrap().to_vec(),
            values: Box::new(move || Ok(values)),
            name,
        }
    };
    let tensors = network.parameters.names().into_iter().map(tensor).collect();
    let path = folder.join("seeded.safetensors");
    write(
        &path,
        &stage1_metadata(&config, true, "a test"),
        ElementType::F32,
        tensors,
    )
    .unwrap();
    path
}
