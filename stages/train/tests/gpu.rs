//! Updates on a graphics processor against those on the CPU. Mesa's software Vulkan counts as a device; without any the tests
//! print why they are skipped.
#![cfg(feature = "gpu")]

use burn::tensor::Device;
use rogs_networks::device;
use rogs_train::config::DataSettings;
use rogs_train::{Course, Stage2Trainer, Stage2Training, UpdateReport};

/// Most by which a loss or a norm may differ, as a share of it.
const TOLERANCE: f64 = 1e-3;

fn gpu() -> Option<Device> {
    match device::open("gpu") {
        Ok(device) => Some(device),
        Err(error) => {
            println!("skipped: {error}");
            None
        }
    }
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

fn same(cpu: &UpdateReport, gpu: &UpdateReport) {
    let close = |what: &str, a: f64, b: f64| {
        assert!(
            (a - b).abs() <= TOLERANCE * a.abs().max(1e-3),
            "{what}: {a} on the CPU, {b} on the other"
        );
    };
    close("loss", cpu.loss, gpu.loss);
    close("norm", cpu.gradient_norm, gpu.gradient_norm);
    for (name, value) in &cpu.terms {
        close(name, *value, gpu.terms[name]);
    }
}

fn updates(mut trainer: impl Course, count: usize) -> Vec<UpdateReport> {
    let mut stream = trainer.stream().unwrap();
    (0..count)
        .map(|_| {
            let batch = stream.next_item().unwrap().unwrap();
            trainer.update(&batch).unwrap()
        })
        .collect()
}

#[test]
fn stage2_takes_the_same_course() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let lift = folder.path().join("stage1.safetensors");
    std::fs::write(&lift, rogs_lift::COMPACT_WEIGHTS).unwrap();
    let settings = Stage2Training {
        preset: "ci".into(),
        lift,
        steps: 2,
        data: data(),
        ..Stage2Training::default()
    };
    let run = |device: &Device| updates(Stage2Trainer::new(settings.clone(), device).unwrap(), 1);
    for (cpu, gpu) in run(&Device::flex()).iter().zip(&run(&gpu)) {
        same(cpu, gpu);
    }
}
