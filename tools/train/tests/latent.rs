//! Training of the latent adapter on records as a run has them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

#[path = "support/latents.rs"]
mod latents;
mod support;

use std::path::Path;

use burn::tensor::Device;
use latents::{records, workspace};
use rogs_lift::latents::open_adapter;
use rogs_lift::{ClipInputs, LiftParams, TokenSource, lift_clip, load_model};
use rogs_train::latent::LatentLosses;
use rogs_train::run::{Trainer, run};
use rogs_train::{LatentTrainer, LatentTraining, Stage1Training, Stage2Training};
use rogs_worker::Unobserved;
use support::{difference, first_moments};

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
    let mut trainer = LatentTrainer::new(settings.clone(), &Device::flex()).unwrap();
    run(&mut trainer, &whole, None, &mut |_| {}).unwrap();
    falls(&whole, &["feature", "log_depth"]);
    for stop in [6, 12] {
        let mut trainer = LatentTrainer::new(settings.clone(), &Device::flex()).unwrap();
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
    let field = lift_clip(&model, &params, inputs, &mut Unobserved).unwrap();
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
        let mut trainer = LatentTrainer::new(settings, &Device::flex()).unwrap();
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
    let mut trainer = LatentTrainer::new(first.clone(), &Device::flex()).unwrap();
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
    let trainer = LatentTrainer::new(second, &Device::flex()).unwrap();
    assert!((trainer.evaluate().unwrap().scores["token"] - end).abs() < 1e-6);
}

#[test]
fn what_is_missing_or_does_not_fit_is_named() {
    let root = tempfile::tempdir().unwrap();
    let settings = workspace(root.path());
    let refused = |settings: LatentTraining| LatentTrainer::new(settings, &Device::flex()).err().unwrap().to_string();
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
    let long = LatentTraining {
        steps: 16,
        evaluation_clips: 0,
        ..settings
    };
    let mut trainer = LatentTrainer::new(long, &Device::flex()).unwrap();
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
    for name in [
        "stage1",
        "stage1-continue",
        "stage1-held",
        "stage1-cells",
        "stage1-scenes",
        "stage1-wide-1",
    ] {
        let settings = Stage1Training::read(&manifests.join(format!("{name}.toml"))).unwrap();
        assert!(settings.start.is_none_or(|file| file.exists()), "{name}");
    }
    let refiner = Stage2Training::read(&manifests.join("stage2.toml")).unwrap();
    assert!(refiner.lift.exists() && refiner.start.is_some_and(|file| file.exists()));
}
