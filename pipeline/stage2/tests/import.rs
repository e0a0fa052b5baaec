//! Released files are read by name.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::path::PathBuf;

use burn::tensor::Device;
use rogs_needs::needs;
use rogs_stage2::weights::OWN_PARAMETERS;
use rogs_stage2::{Refiner, RefinerConfig, parameter_shapes, read_weights, verify_parameters};

/// Written by `torch.save` (PyTorch 2.15) in the form of a released file: tensors under `state_dict`, here in bfloat16,
/// with counters, the donor's state projection and tensors of its initial network, without what this project adds.
/// Entry `i` of tensor `name` is `((37 i + length of name) mod 64) / 64 - 0.5`.
fn released() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden/refiner_ci.pth")
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

/// A file with exactly the names and shapes of the released base model is imported by name; one that lacks a tensor, or has
/// one of another shape, is refused and nothing is written.
#[test]
fn the_released_model_is_imported_whole_with_every_shape_checked() {
    use rogs_stage2::{ReleasedImport, ReleasedModel, import_released, verify_released};
    use rogs_weights::ParameterSource;
    use rogs_weights::{ElementType, TensorFile, TensorSource, write};

    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (
        folder.path().join("resplat.safetensors"),
        folder.path().join("ours.safetensors"),
    );
    let model = ReleasedModel::Re10k;
    type Shapes = std::collections::BTreeMap<String, Vec<usize>>;
    let write_with = |change: &dyn Fn(&mut Shapes)| {
        let mut tensors = model.tensors();
        // Wide tensors of the backbone are the bulk of half a gigabyte; names and shapes are what is tested here.
        tensors.retain(|_, shape| shape.iter().product::<usize>() < 300_000);
        let small: Vec<String> = tensors.keys().cloned().collect();
        change(&mut tensors);
        let sources = tensors.into_iter().map(|(name, shape)| {
            let (count, number) = (shape.iter().product::<usize>(), name.len() as f32);
            TensorSource {
                name: format!("state_dict.{name}"),
                shape,
                values: Box::new(move || Ok(vec![number; count])),
            }
        });
        write(
            &input,
            &std::collections::BTreeMap::new(),
            ElementType::BF16,
            sources.collect(),
        )
        .unwrap();
        small
    };
    let request = ReleasedImport {
        input: input.clone(),
        output: output.clone(),
        model,
        element: ElementType::BF16,
        provenance: "a test".into(),
        drop_unexpected: false,
    };
    write_with(&|tensors| {
        tensors.insert("encoder.gaussian_head.2.bias".into(), vec![58]);
    });
    let error = import_released(&request).unwrap_err().to_string();
    assert!(error.contains("missing: encoder.depth_predictor."), "{error}");
    assert!(
        error.contains("encoder.gaussian_head.2.bias is [58], expected [232]"),
        "{error}"
    );
    assert!(!output.exists());
    let file = TensorFile::open(&input).unwrap();
    assert!(
        file.names()
            .iter()
            .any(|name| name.starts_with("state_dict.encoder.update_"))
    );
    drop(file);
    // What is there matches, once the missing bulk is left aside.
    let small = write_with(&|_| {});
    let source = rogs_weights::Renamed::without_folders(rogs_weights::open_any(&input).unwrap());
    let report = verify_released(&source, model);
    assert_eq!(
        (report.matching, report.misshapen.len(), report.unexpected.len()),
        (small.len(), 0, 0)
    );
    assert_eq!(report.missing.len(), model.tensors().len() - small.len());
}

/// The whole base model, 224 million parameters in bf16, through the import and into the refiner.
#[needs(long = "writes and reads 900 MB")]
#[test]
fn a_full_size_released_file_imports_and_gives_the_paper_refiner() {
    use rogs_stage2::{ReleasedImport, ReleasedModel, import_released};
    use rogs_weights::{ElementType, TensorSource, write};

    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (
        folder.path().join("resplat.safetensors"),
        folder.path().join("ours.safetensors"),
    );
    let model = ReleasedModel::Re10k;
    let sources = model.tensors().into_iter().map(|(name, shape)| {
        let (count, number) = (shape.iter().product::<usize>(), (name.len() % 7) as f32 / 64.0);
        TensorSource {
            name,
            shape,
            values: Box::new(move || Ok(vec![number; count])),
        }
    });
    write(
        &input,
        &std::collections::BTreeMap::new(),
        ElementType::BF16,
        sources.collect(),
    )
    .unwrap();
    let request = ReleasedImport {
        input,
        output: output.clone(),
        model,
        element: ElementType::BF16,
        provenance: "a test".into(),
        drop_unexpected: false,
    };
    assert_eq!(import_released(&request).unwrap(), model.tensors().len());
    let config = RefinerConfig::preset("paper").unwrap();
    let mut parameters = read_weights(&output, &config, &Device::flex()).unwrap();
    assert_eq!(verify_parameters(&mut parameters, &config, 3).unwrap(), OWN_PARAMETERS);
    let weight = parameters.host("encoder.update_module.0.linear.weight").unwrap();
    assert_eq!(
        weight[12_345],
        ("encoder.update_module.0.linear.weight".len() % 7) as f32 / 64.0
    );
    Refiner::load(&parameters, &config).unwrap();
}
