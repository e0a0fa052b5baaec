//! Updates on a GPU against those on the CPU. Mesa's software Vulkan counts as a GPU; without any the tests fail.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![cfg(feature = "gpu")]

#[path = "support/latents.rs"]
mod latents;
#[path = "support/losses.rs"]
mod losses;
#[path = "support/networks.rs"]
mod networks;
mod support;

use std::path::Path;

use burn::tensor::Device;
use latents::workspace;
use losses::NONE;
use networks::seeded_network;
use rogs_lift::ProductPrecision;
use rogs_tensors::device;
use rogs_tensors::optimiser::Gradients;
use rogs_train::config::{DataSettings, LossWeights};
use rogs_train::run::run;
use rogs_train::{
    LatentTrainer, LatentTraining, Stage1Trainer, Stage1Training, Stage2Trainer, Stage2Training, Trainer, UpdateReport,
};
use support::{difference, first_moments};

/// Most by which a loss or a norm may differ, as a share of it.
const TOLERANCE: f64 = 1e-3;
/// Most by which the gradients of all parameters together may differ, as a share of their norm: a hundred times what rounding
/// brings on software Vulkan, a small part of what a wrong gradient would.
const OF_GRADIENTS: f64 = 3e-3;

fn gpu() -> Device {
    device::open(rogs_schemas::Device::Gpu).unwrap()
}

fn data() -> DataSettings {
    DataSettings {
        size: [28, 42],
        source_times: [2, 2],
        queries: 1,
        images_per_step: 6,
        ..DataSettings::default()
    }
}

/// A network with a plane sweep under every loss that needs no weights of the user.
fn stage1(folder: &Path) -> Stage1Training {
    let mut settings = Stage1Training {
        configuration: "compact-sweep".into(),
        start: Some(seeded_network(folder)),
        steps: 2,
        checkpoint_every: 1,
        evaluate_every: 1,
        evaluation_clips: 1,
        data: data(),
        losses: LossWeights {
            stereo_robot: 1.0,
            metric_robot: 0.01,
            sweep: 1.0,
            sweep_depth: 1.0,
            ..LossWeights::default()
        },
        ..Stage1Training::default()
    };
    settings.optimiser.warmup = 1;
    settings
}

fn same(cpu: &UpdateReport, gpu: &UpdateReport) {
    let close = |what: &str, a: f64, b: f64| {
        assert!(
            (a - b).abs() <= TOLERANCE * a.abs().max(1e-3),
            "{what}: {a} on the CPU, {b} on the other"
        );
    };
    close("loss", cpu.loss, gpu.loss);
    close("norm", cpu.gradient_norm, gpu.gradient_norm);
    assert!(cpu.terms.keys().eq(gpu.terms.keys()));
    for (name, value) in &cpu.terms {
        close(name, *value, gpu.terms[name]);
    }
}

/// The first update of a run, and moments that are a constant times its gradients.
fn first_update(mut trainer: impl Trainer) -> (UpdateReport, Gradients) {
    let batch = trainer.stream().unwrap().next_item().unwrap().unwrap();
    let report = trainer.update(&batch).unwrap();
    (report, first_moments(&trainer))
}

/// Loss, terms and gradients of an update are those of the CPU.
fn takes_the_same_update<T: Trainer>(gpu: &Device, on: impl Fn(&Device) -> T) {
    let ((cpu_report, cpu_moments), (gpu_report, gpu_moments)) =
        (first_update(on(&Device::flex())), first_update(on(gpu)));
    same(&cpu_report, &gpu_report);
    let found = difference(&cpu_moments, &gpu_moments);
    println!("gradients differ by {found:.1e} of their norm");
    assert!(found < OF_GRADIENTS, "{found}");
}

/// As a whole; in segments, without mesh anchors; with low-rank updates alone in segments.
#[test]
fn stage1_takes_the_same_update() {
    let gpu = gpu();
    let folder = tempfile::tempdir().unwrap();
    for (gradient_checkpointing, anchoring_dropout, lora_rank) in [(false, 0.0, 0), (true, 1.0, 0), (true, 0.0, 4)] {
        let mut settings = Stage1Training {
            gradient_checkpointing,
            ..stage1(folder.path())
        };
        settings.data.anchoring_dropout = anchoring_dropout;
        settings.optimiser.lora_rank = lora_rank;
        takes_the_same_update(&gpu, |device| Stage1Trainer::new(settings.clone(), device).unwrap());
    }
}

#[test]
fn a_sweep_alone_takes_the_same_update() {
    let gpu = gpu();
    let folder = tempfile::tempdir().unwrap();
    let settings = Stage1Training {
        losses: LossWeights {
            sweep: 1.0,
            sweep_depth: 1.0,
            ..NONE
        },
        ..stage1(folder.path())
    };
    takes_the_same_update(&gpu, |device| Stage1Trainer::new(settings.clone(), device).unwrap());
}

/// Files of a run are the same on all devices: what one began another ends.
#[test]
fn a_run_of_stage1_goes_on_elsewhere() {
    let gpu = gpu();
    let folder = tempfile::tempdir().unwrap();
    let settings = stage1(folder.path());
    let run_on = |device: &Device, folder: &Path, stop_after: u64| {
        let mut trainer = Stage1Trainer::new(settings.clone(), device).unwrap();
        run(&mut trainer, folder, Some(stop_after), &mut |_| {}).unwrap();
        first_moments(&trainer)
    };
    let (whole, parts) = (folder.path().join("whole"), folder.path().join("parts"));
    let on_cpu = run_on(&Device::flex(), &whole, 2);
    run_on(&gpu, &parts, 1);
    let on_both = run_on(&Device::flex(), &parts, 2);
    let found = difference(&on_cpu, &on_both);
    println!("gradients differ by {found:.1e} of their norm");
    assert!(found < OF_GRADIENTS, "{found}");
}

#[test]
fn the_latent_adapter_takes_the_same_update() {
    let gpu = gpu();
    let root = tempfile::tempdir().unwrap();
    let settings = LatentTraining {
        lift: seeded_network(root.path()),
        ..workspace(root.path())
    };
    for gradient_checkpointing in [false, true] {
        let settings = LatentTraining {
            gradient_checkpointing,
            ..settings.clone()
        };
        takes_the_same_update(&gpu, |device| LatentTrainer::new(settings.clone(), device).unwrap());
    }
    let scores = |device: &Device| {
        let trainer = LatentTrainer::new(settings.clone(), device).unwrap();
        trainer.evaluate().unwrap().scores
    };
    for ((name, cpu), (_, gpu)) in scores(&Device::flex()).iter().zip(&scores(&gpu)) {
        assert!((cpu - gpu).abs() < TOLERANCE * cpu.abs(), "{name}: {cpu} {gpu}");
    }
}

#[test]
fn products_of_bfloat16_are_refused() {
    let gpu = gpu();
    let folder = tempfile::tempdir().unwrap();
    let settings = Stage1Training {
        precision: ProductPrecision::Bf16,
        ..stage1(folder.path())
    };
    let error = Stage1Trainer::new(settings, &gpu).err().unwrap().to_string();
    assert!(error.contains("precision") && error.contains("f32"), "{error}");
}

#[test]
fn stage2_takes_the_same_course() {
    let gpu = gpu();
    let folder = tempfile::tempdir().unwrap();
    let settings = Stage2Training {
        preset: "ci".into(),
        lift: seeded_network(folder.path()),
        steps: 2,
        data: data(),
        ..Stage2Training::default()
    };
    let update = |device: &Device| first_update(Stage2Trainer::new(settings.clone(), device).unwrap()).0;
    same(&update(&Device::flex()), &update(&gpu));
}
