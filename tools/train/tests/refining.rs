//! Training of Stage 2 on fields of a real Stage 1.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::path::Path;

use burn::tensor::Device;
use rogs_train::config::DataSettings;
use rogs_train::run::{Trainer, run};
use rogs_train::{Stage2Trainer, Stage2Training};

fn tiny(folder: &Path) -> Stage2Training {
    let lift = folder.join("stage1.safetensors");
    std::fs::write(&lift, rogs_lift::COMPACT_WEIGHTS).unwrap();
    Stage2Training {
        preset: "ci".into(),
        lift,
        steps: 4,
        checkpoint_every: 2,
        evaluate_every: 4,
        evaluation_clips: 1,
        recurrence: [1, 2],
        data: DataSettings {
            size: [28, 42],
            source_times: [2, 2],
            queries: 1,
            images_per_step: 6,
            ..DataSettings::default()
        },
        rate: 2e-3,
        gate_rate: 2e-3,
        warmup: 1,
        ..Stage2Training::default()
    }
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one_and_changes_only_what_is_trained() {
    let folder = tempfile::tempdir().unwrap();
    let settings = tiny(folder.path());
    let (whole, parts) = (folder.path().join("whole"), folder.path().join("parts"));
    let mut trainer = Stage2Trainer::new(settings.clone(), &Device::flex()).unwrap();
    let encoder = "encoder.update_obs_proj.weight";
    let frozen: Vec<String> = (trainer.parameters().names().into_iter())
        .filter(|name| !rogs_stage2::weights::is_trained(name))
        .collect();
    assert!(!frozen.is_empty());
    let before: Vec<_> = frozen
        .iter()
        .map(|name| trainer.parameters().host(name).unwrap())
        .collect();
    let projection = trainer.parameters().host(encoder).unwrap();
    run(&mut trainer, &whole, None, &mut |_| {}).unwrap();
    for (name, before) in frozen.iter().zip(before) {
        assert!(
            trainer.parameters().host(name).unwrap() == before,
            "{name} is frozen and moved"
        );
    }
    assert!(trainer.parameters().host(encoder).unwrap() != projection);
    for stop in [2, 4] {
        let mut trainer = Stage2Trainer::new(settings.clone(), &Device::flex()).unwrap();
        run(&mut trainer, &parts, Some(stop), &mut |_| {}).unwrap();
    }
    let bytes = |folder: &Path, name: &str| std::fs::read(folder.join(name)).unwrap();
    assert!(bytes(&whole, "state.safetensors") == bytes(&parts, "state.safetensors"));
    // The refined clip is scored after every recurrent update, and the weights load as those of the preset.
    let metrics = String::from_utf8(bytes(&whole, "metrics.jsonl")).unwrap();
    assert!(metrics.contains("novel PSNR after 2 updates"), "{metrics}");
    let params = rogs_refine::RefineParams {
        preset: "ci".into(),
        ..rogs_refine::RefineParams::default()
    };
    let loaded = rogs_refine::load_refiner(&params, Some(&whole.join("model.safetensors"))).unwrap();
    assert!(loaded.info.trained && loaded.warnings.is_empty());
}

#[test]
fn bad_settings_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("settings.toml");
    for (text, expected) in [
        ("preset = \"huge\"", "huge"),
        ("recurrence = [0, 2]", "recurrence"),
        ("[losses]\ndepth = -1.0", "losses"),
        ("rate = 99.0", "rate"),
        ("[data]\nsize = [29, 41]", "data.size"),
    ] {
        std::fs::write(&path, text).unwrap();
        let error = Stage2Training::read(&path).err().unwrap().to_string();
        assert!(error.contains(expected), "{text}: {error}");
    }
}
