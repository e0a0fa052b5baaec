//! Reading golden vectors.
#![allow(dead_code, unreachable_pub)]

pub mod network;
#[path = "../../../../tests/support/tensors.rs"]
mod tensors;

use std::path::PathBuf;

use burn::tensor::{Device, Tensor, TensorData};
use rogs_geometry::Pose;
use rogs_needs::shared;
use rogs_stage1::{NetworkCamera, Stage1, Stage1Config};
use rogs_tensors::parameters::{Parameters, to_host};
use tensors::Tensors;

/// The tensors of one golden file.
pub struct Golden(Tensors);

impl Golden {
    /// Opens a file of the repository, or of the reference data where it is too large for that.
    pub fn open(name: &str) -> Self {
        let own = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/{name}.safetensors"));
        Self(Tensors::read(&match own.exists() {
            true => own,
            false => shared!("golden/stage1").join(format!("{name}.safetensors")),
        }))
    }

    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.names()
    }

    pub fn has(&self, name: &str) -> bool {
        self.0.has(name)
    }

    pub fn shape(&self, name: &str) -> &[usize] {
        self.0.shape(name)
    }

    pub fn values(&self, name: &str) -> &[f32] {
        self.0.values(name)
    }

    pub fn scalar(&self, name: &str) -> f32 {
        self.values(name)[0]
    }

    pub fn matrices(&self, name: &str) -> Vec<[f64; 16]> {
        let matrix = |values: &[f32]| std::array::from_fn(|index| f64::from(values[index]));
        self.values(name).chunks_exact(16).map(matrix).collect()
    }

    /// The tensors whose names begin with `prefix`, as parameters.
    pub fn parameters(&self, prefix: &str, device: &Device) -> Parameters {
        let mut parameters = Parameters::new(device);
        for name in self.names().filter(|name| name.starts_with(prefix)) {
            parameters
                .insert(name, self.shape(name), self.values(name).to_vec())
                .unwrap();
        }
        parameters
    }

    /// A tensor in another shape of the same size.
    pub fn tensor<const D: usize>(&self, name: &str, shape: [usize; D], device: &Device) -> Tensor<D> {
        Tensor::from_data(TensorData::new(self.values(name).to_vec(), shape), device)
    }

    pub fn cameras(&self, matrices: &str, intrinsics: &str) -> Vec<NetworkCamera> {
        let focal = |values: &[f32]| std::array::from_fn(|index| f64::from(values[index]));
        let intrinsics = self.values(intrinsics).chunks_exact(4).map(focal);
        self.matrices(matrices)
            .iter()
            .zip(intrinsics)
            .map(|(matrix, focal_centre)| NetworkCamera {
                world_from_camera_iu: Pose::from_matrix4(matrix).unwrap(),
                focal_centre,
            })
            .collect()
    }
}

pub fn tiny_config() -> Stage1Config {
    Stage1Config {
        name: "tiny".into(),
        width: 64,
        heads: 4,
        patch: 14,
        encoder_blocks: 2,
        position_grid: 5,
        registers: 4,
        pairs: 4,
        taps: [0, 1, 2, 3],
        head_channels: [8, 12, 16, 16],
        head_features: 16,
        head_hidden: 32,
        time_frequencies: 10,
        fk_hidden: 32,
        stem_channels: [0; 4],
        sweep_depths: 0,
        sweep_range_mm: [100, 4000],
        sweep_other_times: 0,
    }
}

/// The tiny network of the goldens.
pub fn tiny(device: &Device) -> Stage1 {
    let weights = Golden::open("weights_tiny");
    let mut parameters = Parameters::new(device);
    for name in weights.names() {
        parameters
            .insert(name, weights.shape(name), weights.values(name).to_vec())
            .unwrap();
    }
    Stage1::new(tiny_config(), parameters).unwrap()
}

/// Largest absolute difference; NaN counts as infinite.
pub fn worst(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len(), "number of values");
    let difference = |(a, b): (&f32, &f32)| if (a - b).is_nan() { f32::INFINITY } else { (a - b).abs() };
    found.iter().zip(expected).map(difference).fold(0.0, f32::max)
}

/// Fails when the largest absolute difference exceeds the tolerance.
#[track_caller]
pub fn close(what: &str, found: &[f32], expected: &[f32], tolerance: f32) {
    let error = worst(found, expected);
    println!("{what}: worst error {error:.2e} (tolerance {tolerance:.0e})");
    assert!(
        error <= tolerance,
        "{what}: worst error {error:e} exceeds {tolerance:e}"
    );
}

/// The tolerance of `full_forward`: 1e-5 + 1e-5 x the largest reference magnitude.
pub fn scaled_tolerance(expected: &[f32]) -> f32 {
    1e-5 + 1e-5 * expected.iter().fold(0.0f32, |largest, value| largest.max(value.abs()))
}

pub fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    to_host(tensor).unwrap()
}
