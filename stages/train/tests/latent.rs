//! Training of the latent adapter on records as a run has them. Latents are made from the images here: what a tokenizer
//! would say is nothing that this repository can make.

mod support;

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::Device;
use rogs_lift::latents::{LATENTS, open_adapter};
use rogs_lift::{ClipInputs, LiftParams, TokenSource, lift_inputs, load_model};
use rogs_networks::checkpoint::{ElementType, KIND, TensorSource, write};
use rogs_schemas::key::{KeyMaterial, Provenance};
use rogs_schemas::record::{Record, write_record};
use rogs_schemas::records::clip::Clip;
use rogs_train::config::DataSettings;
use rogs_train::latent::LatentLosses;
use rogs_train::plan::ClipPlan;
use rogs_train::records::Records;
use rogs_train::run::{Course, run};
use rogs_train::{LatentTrainer, LatentTraining};
use support::{difference, first_moments};

const SIZE: [usize; 2] = [28, 42];
/// Side of the image cell of a latent: that of a token.
const CELL: usize = 14;
const CHANNELS: usize = 48;
const STRIDE: usize = 4;

fn data() -> DataSettings {
    DataSettings {
        size: SIZE.map(|side| side as u32),
        source_times: [2, 2],
        queries: 1,
        images_per_step: 6,
        ..DataSettings::default()
    }
}

fn records(seed: u64) -> Records {
    ClipPlan::evaluation(seed, &data()).records(&data()).unwrap()
}

fn save<T: Record>(folder: &Path, name: &str, record: &T) {
    let material = KeyMaterial {
        stage: "test".into(),
        stage_version: 1,
        schema: String::new(),
        params: "{}".into(),
        inputs: BTreeMap::new(),
    };
    let provenance = Provenance {
        material,
        input_content: BTreeMap::new(),
    };
    write_record(&folder.join(name), record, &provenance).unwrap();
}

/// Mean colours of image cells, mixed into the channels of a latent. `[48, times, rows, columns]`
fn latent(clip: &Clip, camera: usize) -> (Vec<usize>, Vec<f32>) {
    let [rows, columns] = SIZE.map(|side| side / CELL);
    let times = clip.frame_count().div_ceil(STRIDE);
    let rgb = clip.cameras[camera].rgb.as_ref().unwrap();
    let mut values = vec![0.0; CHANNELS * times * rows * columns];
    for (index, value) in values.iter_mut().enumerate() {
        let (channel, rest) = (index / (times * rows * columns), index % (times * rows * columns));
        let (time, cell) = (rest / (rows * columns), rest % (rows * columns));
        let first = (cell / columns * CELL, cell % columns * CELL);
        let mut sum = 0.0;
        for pixel in 0..CELL * CELL {
            let (y, x) = (first.0 + pixel / CELL, first.1 + pixel % CELL);
            let place = (time * STRIDE * SIZE[0] * SIZE[1] + y * SIZE[1] + x) * 3 + channel % 3;
            sum += f32::from(rgb[place]) / 255.0;
        }
        let mean = sum / (CELL * CELL) as f32;
        *value = (mean - 0.5) * (1.0 + (channel / 3) as f32 * 0.2) * if channel % 2 == 0 { 2.0 } else { -2.0 };
    }
    (vec![CHANNELS, times, rows, columns], values)
}

fn save_latents(path: &Path, clip: &Clip) {
    let pairs = [
        (KIND, LATENTS),
        ("episode_id", clip.episode_id.as_str()),
        ("stride", "16"),
        ("temporal_stride", "4"),
        ("normalised", "true"),
        ("layout", "per_camera"),
    ];
    let metadata = pairs.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
    let tensors = (0..3).map(|camera| {
        let (shape, values) = latent(clip, camera);
        TensorSource {
            name: format!("latents.{}", clip.cameras[camera].id),
            shape,
            values: Box::new(move || Ok(values)),
        }
    });
    write(path, &metadata, ElementType::F32, tensors.collect()).unwrap();
}

/// A run of three clips with latents and one without.
fn workspace(root: &Path) -> LatentTraining {
    let (run, latents, lift) = (root.join("run"), root.join("latents"), root.join("stage1.safetensors"));
    std::fs::create_dir_all(&latents).unwrap();
    std::fs::write(&lift, rogs_lift::COMPACT_WEIGHTS).unwrap();
    for (name, seed) in [("a", 1), ("b", 2), ("c", 3), ("none", 4)] {
        let folder = run.join("clips").join(name);
        std::fs::create_dir_all(&folder).unwrap();
        let records = records(seed);
        save(&folder, "clip.r4c", &records.clip);
        save(&folder, "robot.r4c", &records.robot);
        save(&folder, "conditioning.r4c", &records.conditioning);
        if name != "none" {
            save_latents(&latents.join(format!("{name}.safetensors")), &records.clip);
        }
    }
    LatentTraining {
        lift,
        blocks: 1,
        run,
        latents,
        steps: 12,
        checkpoint_every: 2,
        evaluate_every: 6,
        evaluation_clips: 1,
        rate: 1e-3,
        warmup: 1,
        losses: LatentLosses {
            token: 0.1,
            feature: 1.0,
            log_depth: 1.0,
            ..LatentLosses::default()
        },
        ..LatentTraining::default()
    }
}

/// Terms of the clip that is trained on are lower at the end of a run than at its start.
fn falls(run: &Path, names: &[&str]) {
    let metrics = std::fs::read_to_string(run.join("metrics.jsonl")).unwrap();
    let lines = metrics.lines().map(|line| serde_json::from_str(line).unwrap());
    let updates: Vec<serde_json::Value> = lines
        .filter(|line: &serde_json::Value| line["terms"].is_object())
        .collect();
    let (first, last) = (&updates[0], &updates[updates.len() - 1]);
    for name in names {
        let [first, last] = [first, last].map(|update| update["terms"][name].as_f64().unwrap());
        assert!(last < 0.9 * first, "{name}: {first} to {last}");
    }
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one_and_its_adapter_lifts() {
    let root = tempfile::tempdir().unwrap();
    // One clip to train on, two held out.
    let settings = LatentTraining {
        evaluation_clips: 2,
        ..workspace(root.path())
    };
    let (whole, parts) = (root.path().join("whole"), root.path().join("parts"));
    let mut trainer = LatentTrainer::new(settings.clone()).unwrap();
    run(&mut trainer, &whole, None, &mut |_| {}).unwrap();
    falls(&whole, &["feature", "log_depth"]);
    for stop in [6, 12] {
        let mut trainer = LatentTrainer::new(settings.clone()).unwrap();
        run(&mut trainer, &parts, Some(stop), &mut |_| {}).unwrap();
    }
    let bytes = |folder: &Path, name: &str| std::fs::read(folder.join(name)).unwrap();
    for name in ["state.safetensors", "metrics.jsonl"] {
        assert!(bytes(&whole, name) == bytes(&parts, name), "{name}");
    }

    let model = load_model(&LiftParams::default(), Some(&settings.lift)).unwrap();
    let adapter = open_adapter(&whole.join("model.safetensors"), &Device::flex()).unwrap();
    let params = LiftParams {
        tokens: TokenSource::Latents,
        ..LiftParams::default()
    };
    let records = records(3);
    let latents = settings.latents.join("c.safetensors");
    let inputs = ClipInputs {
        clip: &records.clip,
        robot: &records.robot,
        conditioning: &records.conditioning,
        latents: Some(&latents),
        adapter: Some(&adapter),
    };
    let field = lift_inputs(&model, &params, inputs, &mut |_, _, work| work(), &mut Vec::new()).unwrap();
    assert!(field.position_m.iter().all(|value| value.is_finite()));
}

/// Gradients in segments are those of the whole, to rounding.
#[test]
fn gradient_checkpointing_changes_no_gradient() {
    let root = tempfile::tempdir().unwrap();
    let settings = workspace(root.path());
    let update = |gradient_checkpointing: bool| {
        let settings = LatentTraining {
            gradient_checkpointing,
            ..settings.clone()
        };
        let mut trainer = LatentTrainer::new(settings).unwrap();
        let batch = trainer.stream().unwrap().next_item().unwrap().unwrap();
        let report = trainer.update(&batch).unwrap();
        (report, first_moments(&trainer))
    };
    let ((whole, whole_moments), (parts, parts_moments)) = (update(false), update(true));
    assert_eq!(
        whole.terms.keys().collect::<Vec<_>>(),
        parts.terms.keys().collect::<Vec<_>>()
    );
    assert!((whole.loss - parts.loss).abs() < 1e-5 * whole.loss);
    let found = difference(&whole_moments, &parts_moments);
    assert!(found < 1e-3, "{found}");
}

#[test]
fn tokens_alone_are_aligned_without_the_network_behind_them_and_training_goes_on_from_there() {
    let root = tempfile::tempdir().unwrap();
    let first = LatentTraining {
        losses: LatentLosses::default(),
        evaluation_clips: 2,
        ..workspace(root.path())
    };
    let out = root.path().join("first");
    let mut trainer = LatentTrainer::new(first.clone()).unwrap();
    let scores = trainer.evaluate().unwrap().scores;
    assert_eq!(
        scores.keys().collect::<Vec<_>>(),
        ["direction", "pairs", "token"],
        "nothing else was asked for"
    );
    run(&mut trainer, &out, None, &mut |_| {}).unwrap();
    falls(&out, &["token", "pairs", "direction"]);
    let end = trainer.evaluate().unwrap().scores["token"];
    let second = LatentTraining {
        start: Some(out.join("model.safetensors")),
        ..first
    };
    let trainer = LatentTrainer::new(second).unwrap();
    assert!((trainer.evaluate().unwrap().scores["token"] - end).abs() < 1e-6);
}

#[test]
fn what_is_missing_or_does_not_fit_is_named() {
    let root = tempfile::tempdir().unwrap();
    let settings = workspace(root.path());
    let refused = |settings: LatentTraining| LatentTrainer::new(settings).err().unwrap().to_string();
    let none = refused(LatentTraining {
        evaluation_clips: 3,
        ..settings.clone()
    });
    assert!(none.contains("3 clips have") && none.contains("at least 4"), "{none}");
    let wrong = refused(LatentTraining {
        start: Some(settings.lift.clone()),
        ..settings.clone()
    });
    assert!(wrong.contains("holds no latent adapter"), "{wrong}");

    // Latents of another episode: the file is named when its turn comes.
    std::fs::copy(
        settings.latents.join("a.safetensors"),
        settings.latents.join("b.safetensors"),
    )
    .unwrap();
    let mut trainer = LatentTrainer::new(LatentTraining {
        steps: 16,
        evaluation_clips: 0,
        ..settings
    })
    .unwrap();
    let error = run(&mut trainer, &root.path().join("out"), None, &mut |_| {}).unwrap_err();
    assert!(error.to_string().contains("b.safetensors"), "{error}");

    let path = root.path().join("settings.toml");
    for (text, expected) in [
        ("blocks = 0", "blocks"),
        ("clips_per_step = 0", "clips_per_step"),
        ("[losses]\ntoken = -1.0", "losses"),
        ("rate = 2.0", "rate"),
        ("betas = [1.0, 0.5]", "betas"),
        ("speed = 1", "speed"),
    ] {
        std::fs::write(&path, text).unwrap();
        let error = LatentTraining::read(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{text}: {error}");
    }
}

#[test]
fn the_published_settings_are_understood() {
    let manifests = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../manifests/training");
    let [first, second] =
        [1, 2].map(|phase| LatentTraining::read(&manifests.join(format!("latent-{phase}.toml"))).unwrap());
    assert_eq!(first.losses, LatentLosses::default());
    assert_eq!((second.steps, second.rate, second.losses.token), (300, 5e-5, 0.1));
}
