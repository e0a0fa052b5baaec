//! Released files are read by name.

use std::path::PathBuf;

use burn::tensor::Device;
use rogs_networks::stage2::weights::OWN_PARAMETERS;
use rogs_networks::stage2::{Refiner, RefinerConfig, parameter_shapes, read_weights, verify_parameters};

/// Written by `torch.save` (PyTorch 2.15) in the form of a released file: tensors under `state_dict`, here in bfloat16,
/// with counters, the donor's state projection and tensors of its initial network, without what this project adds.
/// Entry `i` of tensor `name` is `((37 i + length of name) mod 64) / 64 - 0.5`.
fn released() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden/stage2/refiner_ci.pth")
}

#[test]
fn a_pytorch_file_gives_every_tensor_of_the_refiner_by_name() {
    let config = RefinerConfig::preset("ci").unwrap();
    let mut parameters = read_weights(&released(), &config, &Device::flex()).unwrap();
    let shapes = parameter_shapes(&config);
    assert_eq!(
        parameters.names().len(),
        shapes.len() - OWN_PARAMETERS.len(),
        "nothing else is read"
    );
    for name in parameters.names() {
        assert_eq!(parameters.shape(&name).unwrap(), shapes[&name]);
        let expected = |i: usize| ((37 * i + name.len()) % 64) as f32 / 64.0 - 0.5;
        let values = parameters.host(&name).unwrap();
        assert!(
            values.iter().enumerate().all(|(i, &value)| value == expected(i)),
            "`{name}`"
        );
    }
    assert_eq!(verify_parameters(&mut parameters, &config, 3).unwrap(), OWN_PARAMETERS);
    Refiner::load(&parameters, &config).unwrap();
}

#[test]
fn a_pytorch_file_of_other_widths_or_a_damaged_one_is_refused() {
    let wider = RefinerConfig {
        state: 64,
        ..RefinerConfig::preset("ci").unwrap()
    };
    let error = read_weights(&released(), &wider, &Device::flex())
        .err()
        .unwrap()
        .to_string();
    assert!(
        error.contains("encoder.update_head.0.") && error.contains("shape"),
        "{error}"
    );
    let folder = std::env::temp_dir().join(format!("rogs-stage2-import-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let damaged = folder.join("damaged.pth");
    let bytes = std::fs::read(released()).unwrap();
    let config = RefinerConfig::preset("ci").unwrap();
    for kept in [0, 10, bytes.len() / 2, bytes.len() - 7] {
        std::fs::write(&damaged, &bytes[..kept]).unwrap();
        assert!(
            read_weights(&damaged, &config, &Device::flex()).is_err(),
            "{kept} bytes"
        );
    }
    std::fs::remove_dir_all(&folder).unwrap();
}
