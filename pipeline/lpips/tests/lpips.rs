//! LPIPS against the values of the `lpips` package for two trunks of generated weights with the real heads.
//! `cargo test -p rogs-lpips --features tensors,pytorch --test lpips -- --nocapture` prints the worst errors;
//! `ROGS_LONG_TESTS=1` adds the full trunk.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use burn::tensor::{Device, Tensor};
use rogs_lpips::{Lpips, LpipsTensors, LpipsWeights};
use rogs_needs::{needs, shared};
use rogs_tensors::parameters::{from_host, to_host};
use rogs_weights::ParameterSource;
use rogs_weights::TensorFile;
use serde_json::Value;

const PAIRS: [&str; 4] = ["time_gap", "blur", "noise", "other_view"];

/// The folder with the golden values.
fn data() -> PathBuf {
    shared!("data/lpips")
}

fn golden(folder: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("golden.json")).unwrap()).unwrap()
}

/// An 8-bit RGB image: values, height, width.
fn image(folder: &Path, name: &str) -> (Vec<u8>, usize, usize) {
    let image = image::open(folder.join("pairs").join(format!("{name}.png")))
        .unwrap()
        .to_rgb8();
    (image.to_vec(), image.height() as usize, image.width() as usize)
}

fn check(network: &Lpips, folder: &Path, golden: &Value, tolerance: f64) {
    let mut worst = 0.0f64;
    for pair in PAIRS {
        let [a, b] = ["a", "b"].map(|side| {
            let (rgb, height, width) = image(folder, &format!("{pair}_{side}"));
            network.features_of_bytes(&rgb, height, width).unwrap()
        });
        let layers = network.layer_distances(&a, &b).unwrap();
        for (found, expected) in layers.iter().zip(golden[pair]["per_layer"].as_array().unwrap()) {
            let expected = expected.as_f64().unwrap();
            worst = worst.max((found - expected).abs() / expected);
        }
        let (found, expected) = (
            network.distance(&a, &b).unwrap(),
            golden[pair]["lpips"].as_f64().unwrap(),
        );
        worst = worst.max((found - expected).abs() / expected);
        assert_eq!(network.distance(&b, &a).unwrap(), found, "{pair}: symmetric");
        let (rgb, height, width) = image(folder, &format!("{pair}_a"));
        let unit: Vec<f32> = rgb.iter().map(|&value| f32::from(value) / 255.0).collect();
        let own = network.features(&unit, height, width).unwrap();
        let sooner = network.distance_from(&unit, height, width, &b).unwrap();
        assert_eq!(
            sooner,
            network.distance(&own, &b).unwrap(),
            "{pair}: with and without keeping"
        );
        assert_eq!(network.distance(&a, &a).unwrap(), golden["self_zero"].as_f64().unwrap());
    }
    println!("worst relative error of distances and layer terms: {worst:.2e}");
    assert!(worst < tolerance, "{worst}");
}

#[needs(shared)]
#[test]
fn the_narrow_trunk_agrees_with_the_package() {
    let folder = data();
    let network = Lpips::open(&folder.join("lpips_hash_div8.safetensors")).unwrap();
    assert_eq!(network.description(), "lpips_hash_div8.safetensors");
    check(&network, &folder, &golden(&folder)["models"]["hash_div8"], 2e-6);
}

#[needs(shared)]
#[test]
fn tensors_agree_with_the_kernels_and_give_gradients() {
    let folder = data();
    let weights = LpipsWeights::open(&folder.join("lpips_hash_div8.safetensors")).unwrap();
    let device = Device::flex().autodiff();
    let network = LpipsTensors::new(&weights, &device);
    let golden = &golden(&folder)["models"]["hash_div8"];
    let tensor = |name: &str| -> Tensor<4> {
        let (rgb, height, width) = image(&folder, name);
        let values = rgb.iter().map(|&value| f32::from(value) / 255.0).collect();
        from_host::<3>(values, [height, width, 3], &device)
            .permute([2, 0, 1])
            .unsqueeze::<4>()
    };
    let a = tensor("noise_a").require_grad();
    let distance = network.distance(a.clone(), tensor("noise_b"));
    let found = f64::from(to_host(distance.clone()).unwrap()[0]);
    let expected = golden["noise"]["lpips"].as_f64().unwrap();
    assert!((found - expected).abs() < 2e-5 * expected, "{found} {expected}");
    let gradients = distance.backward();
    let gradient = to_host(a.grad(&gradients).unwrap()).unwrap();
    assert!(gradient.iter().all(|value| value.is_finite()) && gradient.iter().any(|value| value.abs() > 1e-9));
}

/// The full widths with generated weights (the real trunk is the user's to bring).
#[needs(shared, long = "16 passes of the full VGG16")]
#[test]
fn the_full_trunk_agrees_with_the_package() {
    let folder = data();
    let golden = golden(&folder);
    let network = Lpips::new(full_trunk(&folder, &golden));
    check(&network, &folder, &golden["models"]["hash_full"], 2e-6);
}

/// VGG16 shapes filled by the formula of `docs/spec/data.md` section 10, with the real heads.
fn full_trunk(folder: &Path, golden: &Value) -> LpipsWeights {
    let widths = [64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512];
    let mut tensors = BTreeMap::new();
    let mut inputs = 3;
    for (layer, &outputs) in widths.iter().enumerate() {
        let bound = (6.0 / (9.0 * inputs as f64)).sqrt();
        let weight = generated(layer as u64, outputs * inputs * 9, bound);
        let bias = generated(layer as u64 + 100, outputs, 0.05);
        if layer == 0 {
            for (values, key) in [(&weight, "first_weights_hash_full"), (&bias, "first_bias_hash_full")] {
                for (found, expected) in values.iter().zip(golden[key].as_array().unwrap()) {
                    assert_eq!(f64::from(*found), expected.as_f64().unwrap());
                }
            }
        }
        tensors.insert(format!("conv{layer}.weight"), (vec![outputs, inputs, 3, 3], weight));
        tensors.insert(format!("conv{layer}.bias"), (vec![outputs], bias));
        inputs = outputs;
    }
    let heads = TensorFile::open(&folder.join("lpips_v0.1_vgg_heads.safetensors")).unwrap();
    for name in heads.names() {
        tensors.insert(
            name.to_owned(),
            (heads.shape(name).unwrap().to_vec(), heads.values(name).unwrap()),
        );
    }
    LpipsWeights::from_map("generated trunk, real heads", &tensors).unwrap()
}

fn generated(stream: u64, count: usize, factor: f64) -> Vec<f32> {
    let value = |index: u64| {
        let mut z = (stream << 32)
            .wrapping_add(index)
            .wrapping_add(1)
            .wrapping_mul(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
        let unit = (z >> 40) as f64 / f64::from(1 << 24);
        ((2.0 * unit - 1.0) * factor) as f32
    };
    (0..count as u64).map(value).collect()
}

#[needs(shared)]
#[test]
fn what_cannot_be_compared_is_refused() {
    let folder = data();
    let network = Lpips::open(&folder.join("lpips_hash_div8.safetensors")).unwrap();
    assert!(network.features(&[0.0; 30], 2, 5).is_err());
    let small = network.features(&[0.5; 16 * 16 * 3], 16, 16).unwrap();
    let wrong = network.distance_from(&[0.5; 16 * 17 * 3], 16, 17, &small).unwrap_err();
    assert!(wrong.to_string().contains("16x17"), "{wrong}");
    let other = network.features(&[0.5; 16 * 17 * 3], 16, 17).unwrap();
    assert!(
        network
            .distance(&small, &other)
            .unwrap_err()
            .to_string()
            .contains("16x17")
    );
    assert!(Lpips::open(&folder.join("golden.json")).is_err());
    assert!(Lpips::open(&folder.join("lpips_v0.1_vgg_heads.safetensors")).is_err());
}
