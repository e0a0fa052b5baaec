//! A run on disk with latents. These are made from the images here: what a tokenizer would say is nothing that this repository
//! can make.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::collections::BTreeMap;
use std::path::Path;

use rogs_lift::latents::LATENTS;
use rogs_r4c::{Record, write_record};
use rogs_schemas::key::{KeyMaterial, Provenance};
use rogs_schemas::records::clip::Clip;
use rogs_train::LatentTraining;
use rogs_train::config::DataSettings;
use rogs_train::latent::LatentLosses;
use rogs_train::plan::ClipPlan;
use rogs_train::records::Records;
use rogs_weights::{ElementType, KIND, TensorSource, write};

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

/// Records of a procedural clip.
pub(crate) fn records(seed: u64) -> Records {
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
    let rgb = clip.cameras[camera].recorded.as_ref().unwrap();
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
pub(crate) fn workspace(root: &Path) -> LatentTraining {
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
