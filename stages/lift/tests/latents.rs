//! Latents of a tokenizer in place of RGB tokens.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod support;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use rogs_lift::latents::{LATENTS, open_adapter};
use rogs_lift::{ClipInputs, LiftParams, Model, TokenSource, lift_clip, load_model};
use rogs_schemas::records::field::Field;
use rogs_tensors::parameters::Parameters;
use rogs_weights::{ElementType, KIND, TensorSource, Unfiled, write};
use rogs_worker::{StageResult, Unobserved};
use support::small_clip;

/// Two by two tokens.
const SIDE: usize = 28;
const CAMERAS: [&str; 3] = ["wrist", "ext1", "ext2"];

fn noise(count: usize, scale: f32) -> Vec<f32> {
    (0..count)
        .map(|k| (((k * 7919) % 1009) as f32 / 1009.0 - 0.5) * scale)
        .collect()
}

fn tensor(name: &str, shape: &[usize], values: Vec<f32>) -> TensorSource<'static> {
    TensorSource {
        name: name.into(),
        shape: shape.to_vec(),
        values: Box::new(move || Ok(values)),
    }
}

/// An adapter of one block for the compact network.
fn adapter(folder: &Path, width: usize) -> Parameters {
    let path = folder.join("adapter.safetensors");
    let matrix = |name: &str, shape: &[usize]| tensor(name, shape, noise(shape.iter().product(), 0.05));
    let ones = |name: &str| tensor(name, &[width], vec![1.0; width]);
    let zeros = |name: &str, count: usize| tensor(name, &[count], vec![0.0; count]);
    let block = "adapter.blocks.0";
    let tensors = vec![
        matrix("adapter.patch_embed.proj.weight", &[width, 48, 2, 2]),
        zeros("adapter.patch_embed.proj.bias", width),
        ones(&format!("{block}.norm1.weight")),
        zeros(&format!("{block}.norm1.bias"), width),
        matrix(&format!("{block}.attn.qkv.weight"), &[3 * width, width]),
        zeros(&format!("{block}.attn.qkv.bias"), 3 * width),
        matrix(&format!("{block}.attn.proj.weight"), &[width, width]),
        zeros(&format!("{block}.attn.proj.bias"), width),
        ones(&format!("{block}.norm2.weight")),
        zeros(&format!("{block}.norm2.bias"), width),
        matrix(&format!("{block}.mlp.fc1.weight"), &[4 * width, width]),
        zeros(&format!("{block}.mlp.fc1.bias"), 4 * width),
        matrix(&format!("{block}.mlp.fc2.weight"), &[width, 4 * width]),
        zeros(&format!("{block}.mlp.fc2.bias"), width),
        ones("adapter.ln.weight"),
        zeros("adapter.ln.bias", width),
    ];
    write(&path, &BTreeMap::new(), ElementType::F32, tensors).unwrap();
    assert!(open_adapter(&folder.join("none.safetensors"), &Device::flex()).is_err());
    open_adapter(&path, &Device::flex()).unwrap()
}

/// What a test does to metadata and tensors of a latents file before it is written.
type Change<'a> = &'a dyn Fn(&mut BTreeMap<String, String>, &mut Vec<TensorSource<'static>>);

/// A latents file of one region per camera, 2 x 2 latents each unless changed.
fn latents(folder: &Path, change: Change<'_>) -> PathBuf {
    let path = folder.join("latents.safetensors");
    let pairs = [
        (KIND, LATENTS),
        ("episode_id", "episode"),
        ("stride", "16"),
        ("temporal_stride", "4"),
        ("normalised", "true"),
        ("layout", "per_camera"),
    ];
    let mut metadata = pairs.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
    let mut tensors = CAMERAS
        .iter()
        .map(|id| tensor(&format!("latents.{id}"), &[48, 2, 2, 2], noise(48 * 8, 2.0)))
        .collect();
    change(&mut metadata, &mut tensors);
    write(&path, &metadata, ElementType::F32, tensors).unwrap();
    path
}

fn lift(model: &Model, params: &LiftParams, path: Option<&Path>, adapter: Option<&Parameters>) -> StageResult<Field> {
    let inputs = small_clip([SIDE, SIDE], &CAMERAS, &[4], &[]);
    let from = ClipInputs {
        clip: &inputs.clip,
        robot: &inputs.robot,
        conditioning: &inputs.conditioning,
        latents: path,
        adapter,
    };
    lift_clip(model, params, from, &mut Unobserved)
}

#[test]
fn latents_take_the_place_of_rgb_tokens_at_either_stride_and_layout() {
    let folder = tempfile::tempdir().unwrap();
    let params = LiftParams {
        tokens: TokenSource::Latents,
        weights: Some(Unfiled::Seeded),
        ..LiftParams::default()
    };
    let model = load_model(&params, None).unwrap();
    let adapter = adapter(folder.path(), model.network.config.width);
    let path = latents(folder.path(), &|_, _| {});
    let field = lift(&model, &params, Some(&path), Some(&adapter)).unwrap();
    let rgb = lift(&model, &LiftParams::default(), None, None).unwrap();
    assert_ne!(field.position_m, rgb.position_m, "depth comes from other tokens");
    // Stride 8: four latents a token; each latent of stride 16 repeated is the same picture.
    let doubled = |values: &[f32]| -> Vec<f32> {
        let value = |plane: usize, row: usize, column: usize| values[plane * 4 + row / 2 * 2 + column / 2];
        (0..48 * 2)
            .flat_map(|plane| (0..16).map(move |cell| value(plane, cell / 4, cell % 4)))
            .collect()
    };
    let finer = latents(folder.path(), &|metadata, tensors| {
        metadata.insert("stride".into(), "8".into());
        *tensors = CAMERAS
            .iter()
            .map(|id| tensor(&format!("latents.{id}"), &[48, 2, 4, 4], doubled(&noise(48 * 8, 2.0))))
            .collect();
    });
    let same = lift(&model, &params, Some(&finer), Some(&adapter)).unwrap();
    assert_eq!(field.position_m, same.position_m);
    let asked = LiftParams {
        latent_stride: Some(16),
        ..params.clone()
    };
    let error = lift(&model, &asked, Some(&finer), Some(&adapter)).unwrap_err();
    assert!(
        error.message.contains("stride is 8") && error.message.contains("asks for 16"),
        "{}",
        error.message
    );
    // A composite: the first camera on top at full size (64 x 64 pixels), two of half the size below; stride 16.
    let composite = latents(folder.path(), &|metadata, tensors| {
        metadata.insert("layout".into(), "concat_view".into());
        metadata.insert("content".into(), "[96, 64]".into());
        *tensors = vec![tensor("latents", &[48, 2, 7, 5], noise(48 * 2 * 35, 2.0))];
    });
    assert!(lift(&model, &params, Some(&composite), Some(&adapter)).is_ok());
    let cut = latents(folder.path(), &|metadata, tensors| {
        metadata.insert("layout".into(), "concat_view".into());
        metadata.insert("content".into(), "[540, 640]".into());
        *tensors = vec![tensor("latents", &[48, 2, 34, 46], vec![0.0; 48 * 2 * 34 * 46])];
    });
    let error = lift(&model, &params, Some(&cut), Some(&adapter)).unwrap_err();
    assert!(error.message.contains("borders"), "{}", error.message);
}

#[test]
fn latents_that_do_not_fit_are_named() {
    type Change = dyn Fn(&mut BTreeMap<String, String>, &mut Vec<TensorSource<'static>>);
    let folder = tempfile::tempdir().unwrap();
    let params = LiftParams {
        tokens: TokenSource::Latents,
        weights: Some(Unfiled::Seeded),
        ..LiftParams::default()
    };
    let model = load_model(&params, None).unwrap();
    let adapter = adapter(folder.path(), model.network.config.width);
    let set = |key: &'static str, value: &'static str| -> Box<Change> {
        Box::new(move |metadata, _| {
            metadata.insert(key.into(), value.into());
        })
    };
    let shape = |shape: [usize; 4]| -> Box<Change> {
        Box::new(move |_, tensors| tensors[1] = tensor("latents.ext1", &shape, vec![0.0; shape.iter().product()]))
    };
    let cases: [(Box<Change>, &str); 8] = [
        (set("episode_id", "another"), "belongs to episode `another`"),
        (set("stride", "12"), "8 and 16"),
        (set("layout", "mosaic"), "`mosaic`"),
        (set(KIND, "stage1"), "rogs.kind"),
        (shape([16, 2, 2, 2]), "[48, times, rows, columns]"),
        (shape([48, 1, 2, 2]), "source frame 4 has no latent"),
        (shape([48, 2, 3, 2]), "camera `ext1`"),
        (
            Box::new(|_, tensors| drop(tensors.remove(2))),
            "no tensor `latents.ext2`",
        ),
    ];
    for (change, expected) in cases {
        let path = latents(folder.path(), &change);
        let error = lift(&model, &params, Some(&path), Some(&adapter)).unwrap_err();
        assert!(error.message.contains(expected), "{expected}: {}", error.message);
    }
    let path = latents(folder.path(), &|_, _| {});
    assert!(
        lift(&model, &params, None, Some(&adapter))
            .unwrap_err()
            .message
            .contains("`latents`")
    );
    assert!(
        lift(&model, &params, Some(&path), None)
            .unwrap_err()
            .message
            .contains("`adapter`")
    );
}
