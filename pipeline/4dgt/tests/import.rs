//! Importing released files: names, shapes, training checkpoints, what is refused.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::path::Path;

use burn::tensor::Device;
use rogs_4dgt::import::ImportRequest;
use rogs_4dgt::{FourDgt, FourDgtConfig, import_encoder, import_network, layout, open_encoder, open_network};
use rogs_needs::needs;
use rogs_vit::{EncoderSizes, PositionGrid};
use rogs_weights::{CONFIGURATION, ElementType, KIND, ParameterSpec, TensorSource, write};

/// Whether the storage of a tensor is in the file, by its name.
type Stored<'a> = &'a dyn Fn(&str) -> bool;

/// A PyTorch file (zip, protocol 2) of nested dictionaries: `folders`, then tensors of f32 by name.
fn write_pytorch(path: &Path, folders: &[(&str, &[ParameterSpec])], stored: Stored<'_>) {
    let text = |out: &mut Vec<u8>, text: &str| {
        out.push(b'X');
        out.extend(u32::try_from(text.len()).unwrap().to_le_bytes());
        out.extend(text.as_bytes());
    };
    let number = |out: &mut Vec<u8>, number: usize| {
        out.push(b'J');
        out.extend(i32::try_from(number).unwrap().to_le_bytes());
    };
    let (mut pickle, mut entries) = (vec![0x80, 2], Vec::new());
    pickle.extend(b"}(");
    for (folder, specs) in folders {
        text(&mut pickle, folder);
        pickle.extend(b"}(");
        for spec in *specs {
            let key = entries.len().to_string();
            text(&mut pickle, &spec.name);
            pickle.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
            text(&mut pickle, "storage");
            pickle.extend(b"ctorch\nFloatStorage\n");
            text(&mut pickle, &key);
            text(&mut pickle, "cpu");
            number(&mut pickle, spec.len());
            pickle.extend(b"tQ");
            number(&mut pickle, 0);
            pickle.push(b'(');
            spec.shape.iter().for_each(|&side| number(&mut pickle, side));
            pickle.extend(b"t(");
            for axis in 0..spec.shape.len() {
                number(&mut pickle, spec.shape[axis + 1..].iter().product());
            }
            pickle.extend(b"t\x89ccollections\nOrderedDict\n)RtR");
            let bytes = spec.drawn(5).iter().flat_map(|value| value.to_le_bytes()).collect();
            entries.push((format!("archive/data/{key}"), stored(&spec.name).then_some(bytes)));
        }
        pickle.push(b'u');
    }
    pickle.extend(b"u.");
    entries.push(("archive/data.pkl".to_owned(), Some(pickle)));
    entries.push(("archive/version".to_owned(), Some(b"3\n".to_vec())));
    let (mut file, mut directory, mut count) = (Vec::<u8>::new(), Vec::<u8>::new(), 0u16);
    for (name, bytes) in entries {
        let Some(bytes) = bytes else { continue };
        let start = u32::try_from(file.len()).unwrap();
        let size = u32::try_from(bytes.len()).unwrap().to_le_bytes();
        let mut common = vec![10, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        common.extend(crc32fast::hash(&bytes).to_le_bytes());
        common.extend(size);
        common.extend(size);
        common.extend(u16::try_from(name.len()).unwrap().to_le_bytes());
        common.extend([0, 0]);
        file.extend(b"PK\x03\x04");
        file.extend(&common);
        file.extend(name.as_bytes());
        file.extend(&bytes);
        directory.extend(b"PK\x01\x02\x0a\x00");
        directory.extend(&common);
        directory.extend([0; 10]);
        directory.extend(start.to_le_bytes());
        directory.extend(name.as_bytes());
        count += 1;
    }
    let start = u32::try_from(file.len()).unwrap();
    let length = u32::try_from(directory.len()).unwrap();
    file.extend(directory);
    file.extend(b"PK\x05\x06\x00\x00\x00\x00");
    file.extend(count.to_le_bytes());
    file.extend(count.to_le_bytes());
    file.extend(length.to_le_bytes());
    file.extend(start.to_le_bytes());
    file.extend([0, 0]);
    std::fs::write(path, file).unwrap();
}

fn config() -> FourDgtConfig {
    FourDgtConfig {
        name: "small".into(),
        width: 24,
        blocks: 1,
        heads: 2,
        head_hidden: 2,
        encoder_width: 768,
    }
}

/// Names as the released file has them, with the index buffer that nobody reads.
fn released(prefix: &str) -> Vec<ParameterSpec> {
    let renamed = |spec: ParameterSpec| ParameterSpec {
        name: format!("{prefix}{}", spec.name),
        ..spec
    };
    layout::network(&config()).into_iter().map(renamed).collect()
}

fn request<'a>(input: &'a Path, output: &'a Path) -> ImportRequest<'a> {
    ImportRequest {
        input,
        output,
        element: ElementType::F32,
        provenance: "a test",
        drop_unexpected: false,
    }
}

#[test]
fn a_training_checkpoint_is_read_without_the_state_of_its_optimiser() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("4dgt.pth"), folder.path().join("4dgt.safetensors"));
    let model = released("module.image_coder.");
    let moments: Vec<ParameterSpec> = released("exp_avg.");
    // The storages of the moments are not even in the file: reading one would fail.
    let stored = |name: &str| !name.starts_with("exp_avg.");
    write_pytorch(&input, &[("model", &model), ("optimizer", &moments)], &stored);
    let written = import_network(&request(&input, &output), &config()).unwrap();
    assert_eq!(written, model.len());
    let loaded = open_network(&output, &Device::flex()).unwrap();
    assert_eq!((loaded.sizes, loaded.trained), (config(), true));
    assert!(
        loaded.provenance.contains("imported from 4dgt.pth; a test"),
        "{}",
        loaded.provenance
    );
    for spec in &model {
        let own = spec.name.strip_prefix("module.image_coder.").unwrap();
        assert_eq!(loaded.parameters.host(own).unwrap(), spec.drawn(5), "{own}");
    }
}

#[test]
fn files_of_other_networks_are_refused_and_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("other.pth"), folder.path().join("out.safetensors"));
    let mut model = released("image_coder.");
    model.pop();
    model.push(ParameterSpec {
        name: "image_coder.levels.0.weight".into(),
        shape: vec![2],
        initial: rogs_weights::Initial::Constant(0.0),
    });
    write_pytorch(&input, &[("model", &model)], &|_| true);
    let error = import_network(&request(&input, &output), &config())
        .unwrap_err()
        .to_string();
    assert!(error.contains("missing: linear_heads.rgb.4.weight"), "{error}");
    assert!(error.contains("unexpected: levels.0.weight"), "{error}");
    assert!(!output.exists());
    let error = open_network(&input, &Device::flex()).err().unwrap().to_string();
    assert!(error.contains("not a safetensors file"), "{error}");
}

#[needs(long = "86 million parameters, twice")]
#[test]
fn an_encoder_says_by_its_tensors_whether_it_has_registers() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("encoder.safetensors");
    for (registers, positions) in [(0, PositionGrid::Offset), (4, PositionGrid::Antialiased)] {
        let input = folder.path().join(format!("dinov2_{registers}.safetensors"));
        let constant = |spec: ParameterSpec| TensorSource {
            name: spec.name,
            values: Box::new({
                let count = spec.shape.iter().product();
                move || Ok(vec![0.5; count])
            }),
            shape: spec.shape,
        };
        let mut tensors: Vec<TensorSource<'_>> = layout::encoder(&EncoderSizes::vit_b(registers))
            .into_iter()
            .map(constant)
            .collect();
        tensors.push(constant(ParameterSpec {
            name: "mask_token".into(),
            shape: vec![1, 768],
            initial: rogs_weights::Initial::Constant(0.0),
        }));
        write(&input, &Default::default(), ElementType::F16, tensors).unwrap();
        let request = ImportRequest {
            element: ElementType::F16,
            ..request(&input, &output)
        };
        import_encoder(&request).unwrap();
        let loaded = open_encoder(&output, &Device::flex()).unwrap();
        assert_eq!((loaded.sizes.registers, loaded.sizes.positions), (registers, positions));
        let error = open_network(&output, &Device::flex()).err().unwrap().to_string();
        assert!(
            error.contains("a checkpoint of `dinov2`, not a checkpoint of `4dgt`"),
            "{error}"
        );
        let network = rogs_4dgt::seeded_network(config(), 1, &Device::flex());
        FourDgt::new(network.sizes, network.parameters, loaded.sizes, loaded.parameters).unwrap();
    }
}

#[test]
fn sizes_that_cannot_be_are_refused_before_anything_is_made_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("encoder.safetensors");
    let vit_b = EncoderSizes::vit_b(0);
    for sizes in [
        EncoderSizes { heads: 0, ..vit_b },
        EncoderSizes { heads: 7, ..vit_b },
        EncoderSizes {
            blocks: usize::MAX,
            ..vit_b
        },
        EncoderSizes {
            registers: usize::MAX,
            ..vit_b
        },
    ] {
        let pairs = [
            (KIND, "dinov2".to_owned()),
            (CONFIGURATION, serde_json::to_string(&sizes).unwrap()),
        ];
        let metadata = pairs.map(|(key, value)| (key.to_owned(), value)).into();
        write(&path, &metadata, ElementType::F32, Vec::new()).unwrap();
        let error = open_encoder(&path, &Device::flex()).err().unwrap().to_string();
        assert!(
            error.contains("an image encoder needs sizes from 1 to 65536"),
            "{error}"
        );
    }
}
