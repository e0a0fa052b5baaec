//! Weight files, and the stage as a program.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod support;

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use rogs_r4c::{Record, read_record, write_record};
use rogs_refine::{RefineParams, load_refiner};
use rogs_schemas::key::{KeyMaterial, Provenance};
use rogs_schemas::records::refinement::Refinement;
use rogs_stage2::weights::OWN_PARAMETERS;
use rogs_stage2::{Device, RefinerConfig, seeded_parameters};
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use support::example;

/// Writes the seeded parameters of the `ci` preset with a head that is not zero, without the tensors named in `skip`.
fn write_weights(path: &Path, skip: &[&str]) {
    let config = RefinerConfig::preset("ci").unwrap();
    let parameters = seeded_parameters(&config, 9, &Device::flex()).unwrap();
    let mut bytes: BTreeMap<String, (Vec<usize>, Vec<u8>)> = BTreeMap::new();
    for name in parameters
        .names()
        .into_iter()
        .filter(|name| !skip.contains(&name.as_str()))
    {
        let mut values = parameters.host(&name).unwrap();
        if name == "encoder.update_head.6.bias" {
            values.fill(0.25);
        }
        let shape = parameters.shape(&name).unwrap().to_vec();
        bytes.insert(
            name,
            (shape, values.iter().flat_map(|value| value.to_le_bytes()).collect()),
        );
    }
    let views = bytes
        .iter()
        .map(|(name, (shape, bytes))| (name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()));
    safetensors::serialize_to_file(views, None, path).unwrap();
}

#[test]
fn a_weights_file_is_trained_and_named_unless_it_lacks_what_this_project_adds() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("refiner.safetensors");
    write_weights(&path, &[]);
    let network = load_refiner(&RefineParams::default(), Some(&path)).unwrap();
    assert!(network.info.trained && network.warnings.is_empty());
    assert_eq!(
        (network.info.description.as_str(), network.info.hash.len()),
        ("refiner.safetensors", 64)
    );

    write_weights(&path, &OWN_PARAMETERS);
    let network = load_refiner(&RefineParams::default(), Some(&path)).unwrap();
    assert!(!network.info.trained && network.info.description.contains("UNTRAINED in part"));
    assert!(network.warnings[0].contains("encoder.update_gate.logit"));
}

#[test]
fn a_weights_file_that_does_not_fit_is_refused_with_the_tensor_and_the_preset() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("refiner.safetensors");
    write_weights(&path, &[]);
    let refused = |preset: &str, path: &Path| {
        let params = RefineParams {
            preset: preset.into(),
            ..RefineParams::default()
        };
        load_refiner(&params, Some(path)).err().unwrap()
    };
    let error = refused("cpu", &path);
    assert!(error.message.contains("has shape") && error.hint.unwrap().contains("`cpu`"));
    write_weights(&path, &["encoder.update_error_attn.0.conv.bias"]);
    assert!(
        refused("ci", &path)
            .message
            .contains("lack the tensor `encoder.update_error_attn.0.conv.bias`")
    );
    std::fs::write(&path, b"not tensors").unwrap();
    assert!(refused("ci", &path).message.contains("refiner.safetensors"));
    assert!(
        refused("ci", &folder.path().join("none.safetensors"))
            .message
            .contains("none.safetensors")
    );
    assert!(
        refused("ci", &folder.path().join("weights.bin"))
            .message
            .contains(".safetensors, .pth")
    );
}

#[test]
fn the_program_refines_files_the_same_for_any_thread_count() {
    let folder = tempfile::tempdir().unwrap();
    let example = example(12);
    write(folder.path().join("clip.r4c"), &example.clip);
    write(folder.path().join("robot.r4c"), &example.robot);
    write(folder.path().join("field-1.r4c"), &example.field);
    write_weights(&folder.path().join("refiner.safetensors"), &[]);
    let run = |out: &str, arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rogs-refine"));
        command.current_dir(folder.path()).args([
            "one",
            "--clip",
            "clip.r4c",
            "--robot",
            "robot.r4c",
            "--field",
            "field-1.r4c",
            "--out",
            out,
        ]);
        let output = command.args(arguments).output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{text}");
        (std::fs::read(folder.path().join(out)).unwrap(), text)
    };
    let weights = ["--weights", "refiner.safetensors", "--params", "keep_state=true"];
    let (one, _) = run("one.r4c", &[&weights[..], &["--threads", "1"]].concat());
    let (two, _) = run("two.r4c", &[&weights[..], &["--threads", "2"]].concat());
    assert!(one == two, "the files differ in some byte");

    let (record, info) = read_record::<Refinement>(&folder.path().join("one.r4c")).unwrap();
    let field_key = rogs_r4c::Reader::open(&folder.path().join("field-1.r4c"))
        .unwrap()
        .provenance()
        .key();
    assert_eq!((record.field_key, record.updates), (field_key, 2));
    assert!(!record.steps[0].values.is_empty());

    // A run of one update, resumed: the same record under another provenance.
    run("part.r4c", &[&weights[..], &["--params", "updates=1"]].concat());
    run("rest.r4c", &[&weights[..], &["--resume", "part.r4c"]].concat());
    let (resumed, resumed_info) = read_record::<Refinement>(&folder.path().join("rest.r4c")).unwrap();
    assert!(resumed == record && resumed_info.content == info.content);

    let (_, text) = run("untrained.r4c", &["--params", "weights=\"seeded\""]);
    assert!(text.contains("warning") && text.contains("UNTRAINED"), "{text}");
}

fn write<T: Record>(path: std::path::PathBuf, record: &T) {
    let material = KeyMaterial {
        stage: "test".into(),
        stage_version: 1,
        schema: T::SCHEMA.to_string(),
        params: "{}".into(),
        inputs: BTreeMap::new(),
    };
    write_record(
        &path,
        record,
        &Provenance {
            material,
            input_content: BTreeMap::new(),
        },
    )
    .unwrap();
}
