//! Weights files: generation, import of every format and number type, verification, damage, streaming.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod support;

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::{Device, Tensor};
use rogs_geometry::Pose;
use rogs_needs::needs;
use rogs_stage1::{Attention, NetworkCamera, SourceFrames, Stage1, Stage1Config, layout};
use rogs_stage1::{
    ImportRequest, Origin, generate_stage1, import_stage1, merge_lora, open_stage1, stage1_metadata, verify_stage1,
};
use rogs_tensors::parameters::Parameters;
use rogs_weights::ParameterSource;
use rogs_weights::{ElementType, TRAINING_DOMAIN, TensorFile, TensorSource, TrainingDomain, average, open_any, write};
use support::{close, host, tiny_config};

fn source(name: &str, shape: &[usize], values: Vec<f32>) -> TensorSource<'static> {
    TensorSource {
        name: name.to_owned(),
        shape: shape.to_vec(),
        values: Box::new(move || Ok(values)),
    }
}

fn frames(device: &Device) -> SourceFrames {
    let images: Vec<f32> = (0..2 * 3 * 28 * 42).map(|k| ((k * 31) % 97) as f32 / 97.0).collect();
    let camera = NetworkCamera {
        world_from_camera_iu: Pose::IDENTITY,
        focal_centre: [0.7, 1.0, 0.5, 0.5],
    };
    SourceFrames {
        images: rogs_tensors::parameters::from_host(images, [2, 3, 28, 42], device),
        cameras: vec![camera; 2],
        recon_from_base_iu: Pose::IDENTITY,
        times: vec![0.0, 1.0],
        attention: Attention::Joint,
    }
}

fn taps(network: &Stage1) -> Vec<f32> {
    host(Tensor::cat(
        network.encode(&frames(&Device::flex())).unwrap().taps.to_vec(),
        0,
    ))
}

#[test]
fn a_generated_checkpoint_opens_as_the_seeded_network() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tiny.safetensors");
    let config = tiny_config();
    generate_stage1(&path, &config, 5, ElementType::F32, true).unwrap();
    let loaded = open_stage1(&path, &Device::flex()).unwrap();
    assert!(!loaded.trained && loaded.provenance.contains("seed 5"));
    assert_eq!(loaded.network.config, config);
    let seeded = rogs_stage1::seeded::network(&config, 5, &Device::flex()).unwrap();
    assert_eq!(taps(&loaded.network), taps(&seeded));
    assert!(loaded.network.fk_branch().unwrap().is_some());
    // Read tensor by tensor from the mapped file, the numbers are the same.
    let streamed = Parameters::streaming(Box::new(TensorFile::open(&path).unwrap()), &Device::flex());
    assert_eq!(taps(&Stage1::new(config.clone(), streamed).unwrap()), taps(&seeded));
    // What is trained is brought into memory; copies with other leaves still read the rest from the file.
    let mut mixed = Parameters::streaming(Box::new(TensorFile::open(&path).unwrap()), &Device::flex());
    let name = "backbone.backbone.camera_token";
    let shape = mixed.shape(name).unwrap().to_vec();
    mixed.insert(name, &shape, mixed.host(name).unwrap()).unwrap();
    let tracked = mixed.with_leaves(&Device::flex().autodiff(), |_, values| values.autodiff().require_grad());
    assert_eq!((tracked.memory().len(), tracked.names()), (1, mixed.names()));
    let copy = tracked.without_gradients();
    assert_eq!(copy.memory().len(), 1);
    assert_eq!(taps(&Stage1::new(config, copy).unwrap()), taps(&seeded));
}

#[test]
fn import_maps_names_and_number_types() {
    let folder = tempfile::tempdir().unwrap();
    let config = tiny_config();
    let (input, output) = (
        folder.path().join("model.safetensors"),
        folder.path().join("ours.safetensors"),
    );
    let specs = layout::released(&config);
    for element in [ElementType::F32, ElementType::BF16, ElementType::F16] {
        let values = |spec: &layout::ParameterSpec| rogs_stage1::seeded::values(spec, &config, 1);
        let tensors = specs
            .iter()
            .map(|spec| source(&format!("state_dict.module.{}", spec.name), &spec.shape, values(spec)));
        write(&input, &BTreeMap::new(), element, tensors.collect()).unwrap();
        let request = request(&input, &output, &config);
        let report = import_stage1(&request).unwrap();
        assert_eq!(
            (report.origin, report.written, report.verification.is_clean()),
            (Origin::Released, specs.len(), true)
        );
        let loaded = open_stage1(&output, &Device::flex()).unwrap();
        assert!(
            loaded.trained && loaded.provenance.contains("model.safetensors") && loaded.provenance.contains("a test")
        );
        let tolerance = match element {
            ElementType::F32 => 0.0,
            ElementType::F16 => 1e-3,
            ElementType::BF16 => 1e-2,
        };
        for spec in &specs {
            close(
                &spec.name,
                &loaded.network.parameters.host(&spec.name).unwrap(),
                &values(spec),
                tolerance,
            );
        }
    }
}

fn request(input: &Path, output: &Path, config: &Stage1Config) -> ImportRequest {
    ImportRequest {
        input: input.to_owned(),
        output: output.to_owned(),
        config: config.clone(),
        element: ElementType::F32,
        provenance: "a test".into(),
        drop_unexpected: false,
    }
}

#[test]
fn import_names_what_is_missing_unexpected_or_misshapen_and_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let config = tiny_config();
    let (input, output) = (
        folder.path().join("model.safetensors"),
        folder.path().join("ours.safetensors"),
    );
    let mut tensors: Vec<_> = layout::released(&config)
        .iter()
        .map(|spec| source(&spec.name, &spec.shape, vec![0.0; spec.len()]))
        .collect();
    tensors.retain(|tensor| tensor.name != "backbone.encoder.norm.weight");
    tensors.push(source("backbone.extra.weight", &[2], vec![0.0; 2]));
    let norm = tensors
        .iter_mut()
        .find(|tensor| tensor.name == "backbone.encoder.norm.bias")
        .unwrap();
    *norm = source("backbone.encoder.norm.bias", &[3], vec![0.0; 3]);
    write(&input, &BTreeMap::new(), ElementType::F32, tensors).unwrap();
    let error = import_stage1(&request(&input, &output, &config))
        .unwrap_err()
        .to_string();
    for part in [
        "missing: backbone.encoder.norm.weight",
        "unexpected: backbone.extra.weight",
        "backbone.encoder.norm.bias is [3]",
    ] {
        assert!(error.contains(part), "{error}");
    }
    assert!(!output.exists());
    let unopened = open_stage1(&input, &Device::flex())
        .map(|_| ())
        .unwrap_err()
        .to_string();
    assert!(unopened.contains("rogs weights import"), "{unopened}");
}

#[test]
fn a_vggt_file_fills_what_it_has_and_the_rest_starts_fresh() {
    let folder = tempfile::tempdir().unwrap();
    let config = tiny_config();
    let (input, output) = (
        folder.path().join("vggt.safetensors"),
        folder.path().join("ours.safetensors"),
    );
    let theirs = |name: &str| -> Option<String> {
        let rest = name.strip_prefix("backbone.")?;
        if let Some(rest) = rest.strip_prefix("encoder.") {
            return Some(format!("aggregator.patch_embed.{rest}"));
        }
        let fresh = ["backbone.extra_embed", "backbone.time_embed", "motion_head.time_embed"];
        if fresh.iter().any(|part| rest.starts_with(part)) {
            return None;
        }
        let rules = [
            ("backbone.", "aggregator."),
            ("depth_head.", "depth_head."),
            ("motion_head.", "point_head."),
        ];
        rules
            .iter()
            .find_map(|(ours, theirs)| rest.strip_prefix(ours).map(|rest| format!("{theirs}{rest}")))
    };
    let specs = layout::released(&config);
    let mut tensors: Vec<_> = specs
        .iter()
        .filter_map(|spec| Some(source(&theirs(&spec.name)?, &spec.shape, vec![0.25; spec.len()])))
        .collect();
    tensors.push(source("camera_head.token", &[1], vec![0.0]));
    let own = tensors.len() - 1;
    write(&input, &BTreeMap::new(), ElementType::F32, tensors).unwrap();
    assert!(
        import_stage1(&request(&input, &output, &config))
            .unwrap_err()
            .to_string()
            .contains("camera_head.token")
    );
    let report = import_stage1(&ImportRequest {
        drop_unexpected: true,
        ..request(&input, &output, &config)
    })
    .unwrap();
    assert_eq!((report.origin, report.fresh.len()), (Origin::Vggt, specs.len() - own));
    let loaded = open_stage1(&output, &Device::flex()).unwrap();
    assert!(!loaded.trained, "weights with fresh heads are not trained");
    let parameters = &loaded.network.parameters;
    assert!(
        parameters
            .host("backbone.motion_head.norm.weight")
            .unwrap()
            .iter()
            .all(|&value| value == 0.25)
    );
    assert!(
        parameters
            .host("backbone.splat_head.norm.weight")
            .unwrap()
            .iter()
            .all(|&value| value == 1.0)
    );
}

#[test]
fn merging_low_rank_updates_keeps_the_outputs() {
    let folder = tempfile::tempdir().unwrap();
    let (path, merged) = (
        folder.path().join("lora.safetensors"),
        folder.path().join("merged.safetensors"),
    );
    let config = tiny_config();
    let noise = |spec: &layout::ParameterSpec| {
        (0..spec.len())
            .map(|k| ((k * 7919) % 101) as f32 / 101.0 - 0.5)
            .collect()
    };
    let values = |spec: &layout::ParameterSpec| rogs_stage1::seeded::values(spec, &config, 1);
    let mut tensors: Vec<_> = layout::released(&config)
        .iter()
        .map(|spec| source(&spec.name, &spec.shape, values(spec)))
        .collect();
    tensors.extend(
        layout::lora(&config, 8)
            .iter()
            .map(|spec| source(&spec.name, &spec.shape, noise(spec))),
    );
    let mut metadata = stage1_metadata(&config, true, "a test");
    metadata.insert(TRAINING_DOMAIN.to_owned(), TrainingDomain::Procedural.name().to_owned());
    write(&path, &metadata, ElementType::F32, tensors).unwrap();
    merge_lora(&path, &merged, ElementType::F32).unwrap();
    let mut told = TensorFile::open(&merged).unwrap().metadata().clone();
    assert_eq!(told["rogs.provenance"], "a test; low-rank updates merged");
    told.insert("rogs.provenance".to_owned(), "a test".to_owned());
    assert_eq!(told, metadata, "everything else stays as it was");
    let open = |path: &Path| open_stage1(path, &Device::flex()).unwrap().network;
    let plain = rogs_stage1::seeded::network(&config, 1, &Device::flex()).unwrap();
    close("merged", &taps(&open(&merged)), &taps(&open(&path)), 1e-4);
    assert!(
        support::worst(&taps(&plain), &taps(&open(&path))) > 1e-3,
        "the updates do something"
    );
}

#[test]
fn averages_are_weighted_means_of_one_network() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, shape: &[usize], values: Vec<f32>, metadata: &[(&str, &str)]| {
        let path = folder.path().join(name);
        let metadata = metadata.iter().map(|&(key, value)| (key.to_owned(), value.to_owned()));
        let tensors = vec![source("a.weight", shape, values), source("b", &[1], vec![8.0])];
        write(&path, &metadata.collect(), ElementType::F32, tensors).unwrap();
        path
    };
    let kind = ("rogs.kind", "a test");
    let first = file(
        "first",
        &[3],
        vec![1.0, -2.0, 0.5],
        &[kind, ("rogs.provenance", "here")],
    );
    let second = file(
        "second",
        &[3],
        vec![5.0, 2.0, 0.5],
        &[kind, ("rogs.provenance", "there")],
    );
    let out = folder.path().join("mean");
    // Shares of 3 and 1 are three quarters and one quarter.
    let inputs = [(first.clone(), 3.0), (second, 1.0)];
    average(&inputs, &out, ElementType::F32, None).unwrap();
    let mean = TensorFile::open(&out).unwrap();
    assert_eq!(mean.values("a.weight").unwrap(), [2.0, -1.0, 0.5]);
    assert_eq!(mean.values("b").unwrap(), [8.0]);
    assert_eq!(mean.metadata()["rogs.kind"], "a test");
    assert_eq!(
        mean.metadata()["rogs.provenance"],
        "average: 0.750 of (here) + 0.250 of (there)"
    );
    average(&inputs, &out, ElementType::F32, Some("a mean")).unwrap();
    assert_eq!(TensorFile::open(&out).unwrap().metadata()["rogs.provenance"], "a mean");
    std::fs::remove_file(&out).unwrap();

    let other_shape = file("shape", &[1, 3], vec![0.0; 3], &[kind]);
    let other_kind = file("kind", &[3], vec![0.0; 3], &[("rogs.kind", "another")]);
    let other_tensors = folder.path().join("tensors");
    let tensors = vec![source("a.weight", &[3], vec![0.0; 3]), source("c", &[1], vec![0.0])];
    let metadata = BTreeMap::from([(kind.0.to_owned(), kind.1.to_owned())]);
    write(&other_tensors, &metadata, ElementType::F32, tensors).unwrap();
    for (inputs, reason) in [
        (vec![], "nothing to average"),
        (vec![(first.clone(), 0.0)], "positive"),
        (vec![(first.clone(), f64::NAN)], "positive"),
        (
            vec![(first.clone(), 1.0), (other_shape, 1.0)],
            "has shape [1, 3], not [3]",
        ),
        (vec![(first.clone(), 1.0), (other_kind, 1.0)], "`rogs.kind`"),
        (vec![(first.clone(), 1.0), (other_tensors, 1.0)], "lacks the tensor `b`"),
        (vec![(first, 1.0), (folder.path().join("none"), 1.0)], "none"),
    ] {
        let error = average(&inputs, &out, ElementType::F32, None).unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
        assert!(!out.exists());
    }
}

#[test]
fn damaged_files_are_refused_with_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file.safetensors");
    write(
        &path,
        &BTreeMap::new(),
        ElementType::F32,
        vec![source("a", &[4], vec![1.0; 4])],
    )
    .unwrap();
    let good = std::fs::read(&path).unwrap();
    let with_header = |json: &str| [&(json.len() as u64).to_le_bytes()[..], json.as_bytes(), &[0; 16]].concat();
    let mut cases: Vec<Vec<u8>> = (0..good.len()).map(|length| good[..length].to_vec()).collect();
    cases.push([&u64::MAX.to_le_bytes()[..], &good[8..]].concat());
    cases.push(with_header(
        r#"{"a":{"dtype":"F32","shape":[4611686018427387904,4],"data_offsets":[0,16]}}"#,
    ));
    cases.push(with_header(
        r#"{"a":{"dtype":"F32","shape":[4],"data_offsets":[8,24]}}"#,
    ));
    cases.push(with_header(
        r#"{"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]},"b":{"dtype":"F32","shape":[2],"data_offsets":[4,12]}}"#,
    ));
    cases.push(with_header(r#"{"a":7}"#));
    cases.push(with_header("[]"));
    for bytes in cases {
        std::fs::write(&path, &bytes).unwrap();
        assert!(TensorFile::open(&path).is_err(), "{} bytes", bytes.len());
    }
    std::fs::write(&path, &good).unwrap();
    assert_eq!(TensorFile::open(&path).unwrap().values("a").unwrap(), [1.0; 4]);
    // Counters may stand beside the weights; only their values cannot be had.
    let counters = r#"{"a":{"dtype":"I64","shape":[2],"data_offsets":[0,16]},"b":{"dtype":"F64","shape":[0],"data_offsets":[16,16]}}"#;
    std::fs::write(&path, with_header(counters)).unwrap();
    let file = TensorFile::open(&path).unwrap();
    assert_eq!((file.shape("a"), file.values("b").unwrap().len()), (Some(&[2][..]), 0));
    let error = file.values("a").unwrap_err().to_string();
    assert!(error.contains("`a` has numbers of type I64"), "{error}");
    for name in ["file.bin", "none.safetensors", "none.pth"] {
        assert!(open_any(&folder.path().join(name)).is_err());
    }
    std::fs::write(
        folder.path().join("bad.pth"),
        b"not a checkpoint at all, but long enough to look at",
    )
    .unwrap();
    assert!(open_any(&folder.path().join("bad.pth")).is_err());
}

#[needs(long = "writes and imports 4 GB and 2 GB of weights")]
#[test]
fn a_full_size_file_imports_and_verifies() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (
        folder.path().join("full.safetensors"),
        folder.path().join("ours.safetensors"),
    );
    let config = Stage1Config::full();
    generate_stage1(&input, &config, 1, ElementType::BF16, false).unwrap();
    let report = import_stage1(&ImportRequest {
        element: ElementType::BF16,
        ..request(&input, &output, &config)
    })
    .unwrap();
    assert_eq!((report.written, report.verification.matching), (1478, 1478));
    let file = TensorFile::open(&output).unwrap();
    assert_eq!(file.len(), 1_041_147_254);
    assert!(verify_stage1(&file, &config).is_clean());
}
