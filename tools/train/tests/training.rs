//! Training changes the network as its settings say, and a killed run resumes as if nothing had happened.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

#[path = "support/losses.rs"]
mod losses;
mod support;

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::Device;
use glam::DVec3;
use losses::NONE;
use rogs_geometry::{Link, Pose, Recon};
use rogs_lift::ProductPrecision;
use rogs_lpips::{LpipsTensors, LpipsWeights};
use rogs_random::Pcg64;
use rogs_schemas::FrameIndex;
use rogs_stage1::held::{HeldMotion, HeldPath};
use rogs_stage1::stage1_metadata;
use rogs_stage1::{Stage1, Stage1Config, seeded};
use rogs_tensors::optimiser;
use rogs_tensors::parameters::{from_host, to_host};
use rogs_train::config::{DataSettings, LossWeights, OptimiserSettings};
use rogs_train::plan::ClipPlan;
use rogs_train::run::run;
use rogs_train::sample::Sample;
use rogs_train::stage1::forward::{Heads, lift};
use rogs_train::stage1::objective::{objective, of_copies};
use rogs_train::stage1::start;
use rogs_train::stage1::terms::Losses;
use rogs_train::stream::batches;
use rogs_train::{Stage1Trainer, Stage1Training, Trainer};
use rogs_weights::{ElementType, TensorSource, write};
use support::{difference, first_moments};

/// A run small enough for a test: the compact network on very small images.
fn tiny(steps: u64) -> Stage1Training {
    Stage1Training {
        steps,
        checkpoint_every: 2,
        evaluate_every: 2,
        evaluation_clips: 1,
        data: DataSettings {
            size: [28, 42],
            source_times: [1, 2],
            queries: 1,
            images_per_step: 6,
            ..DataSettings::default()
        },
        optimiser: OptimiserSettings {
            rate: 1e-3,
            head_rate: 1e-3,
            warmup: 2,
            ..OptimiserSettings::default()
        },
        ..Stage1Training::default()
    }
}

fn train(
    settings: &Stage1Training,
    folder: &Path,
    stop_after: Option<u64>,
    say: &mut dyn FnMut(&str),
) -> rogs_train::Result<()> {
    run(
        &mut Stage1Trainer::new(settings.clone(), &Device::flex())?,
        folder,
        stop_after,
        say,
    )
}

fn sample(settings: &Stage1Training, seed: u64) -> Sample {
    let mut random = Pcg64::from_seed(seed);
    ClipPlan::draw(seed, 2, &settings.data, &mut random)
        .sample(&settings.data, true)
        .unwrap()
}

fn bytes(folder: &Path, name: &str) -> Vec<u8> {
    std::fs::read(folder.join(name)).unwrap()
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, parts) = (folder.path().join("whole"), folder.path().join("parts"));
    let settings = tiny(4);
    train(&settings, &whole, None, &mut |_| {}).unwrap();
    let mut said = Vec::new();
    for stop in [2, 4] {
        train(&settings, &parts, Some(stop), &mut |line| said.push(line.to_owned())).unwrap();
        // What a kill between two checkpoints leaves behind: lines about updates that are made again.
        if stop == 2 {
            let path = parts.join("metrics.jsonl");
            let mut text = std::fs::read_to_string(&path).unwrap();
            text.push_str("{\"step\":2,\"loss\":1.0}\n{\"step\":3,\"lo");
            std::fs::write(&path, text).unwrap();
        }
    }
    assert!(
        said.iter().any(|line| line.starts_with("resumed after 2 of 4")),
        "{said:?}"
    );
    for name in ["state.safetensors", "metrics.jsonl"] {
        assert!(bytes(&whole, name) == bytes(&parts, name), "{name} differs");
    }
    let page = String::from_utf8(bytes(&parts, "report.html")).unwrap();
    assert!(
        page.contains("<svg")
            && page.contains("data:image/png;base64,")
            && !page.contains("http:")
            && !page.contains("https:")
    );
}

#[test]
fn a_folder_belongs_to_one_run() {
    let folder = tempfile::tempdir().unwrap();
    train(&tiny(1), folder.path(), None, &mut |_| {}).unwrap();
    let other = Stage1Training { seed: 74, ..tiny(1) };
    let error = train(&other, folder.path(), None, &mut |_| {})
        .err()
        .unwrap()
        .to_string();
    assert!(
        error.contains("settings.toml") && error.contains("other settings"),
        "{error}"
    );
}

#[test]
fn updates_are_the_same_for_any_number_of_threads() {
    let settings = tiny(1);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let batch = batches(&settings, 0).next_item().unwrap().unwrap();
            let mut trainer = Stage1Trainer::new(settings.clone(), &Device::flex()).unwrap();
            let report = trainer.update(&batch).unwrap();
            let name = "backbone.depth_head.scratch.output_conv2.2.weight";
            (report, trainer.network.parameters.host(name).unwrap())
        })
    };
    let (one, three) = (run(1), run(3));
    assert!(one == three);
}

/// A narrow network of generated weights in the shape of LPIPS-VGG.
fn perceptual(device: &Device) -> LpipsTensors {
    const CONVOLUTIONS: [(usize, usize, usize); 13] = [
        (0, 3, 4),
        (2, 4, 4),
        (5, 4, 6),
        (7, 6, 6),
        (10, 6, 8),
        (12, 8, 8),
        (14, 8, 8),
        (17, 8, 8),
        (19, 8, 8),
        (21, 8, 8),
        (24, 8, 8),
        (26, 8, 8),
        (28, 8, 8),
    ];
    let mut random = Pcg64::from_seed(6);
    let mut draw = |count: usize, from: f64, to: f64| -> Vec<f32> {
        (0..count)
            .map(|_| (from + (to - from) * random.next_double()) as f32)
            .collect()
    };
    let mut tensors = BTreeMap::new();
    for (place, inputs, outputs) in CONVOLUTIONS {
        let weight = draw(outputs * inputs * 9, -0.3, 0.3);
        tensors.insert(
            format!("features.{place}.weight"),
            (vec![outputs, inputs, 3, 3], weight),
        );
        tensors.insert(
            format!("features.{place}.bias"),
            (vec![outputs], draw(outputs, 0.0, 0.2)),
        );
    }
    for (layer, channels) in [4, 6, 8, 8, 8].into_iter().enumerate() {
        let head = (vec![1, channels, 1, 1], draw(channels, 0.0, 1.0));
        tensors.insert(format!("lin{layer}.model.1.weight"), head);
    }
    LpipsTensors::new(&LpipsWeights::from_map("generated", &tensors).unwrap(), device)
}

/// The loss has the gradient of the value that is reported.
#[test]
fn gradients_are_those_of_the_reported_loss() {
    let settings = tiny(1);
    let clip = sample(&settings, 4711);
    let cases = [
        (
            "heads",
            LossWeights {
                stereo: 1.0,
                depth_head: 1.0,
                ..NONE
            },
        ),
        (
            "sweep",
            LossWeights {
                sweep: 1.0,
                sweep_depth: 1.0,
                ..NONE
            },
        ),
        (
            "metric",
            LossWeights {
                metric_final: 0.001,
                metric_right: 0.001,
                metric_robot: 0.001,
                ..NONE
            },
        ),
        (
            "colour",
            LossWeights {
                movies_mse: 1.0,
                ..NONE
            },
        ),
        ("held", LossWeights { held: 1.0, ..NONE }),
        (
            "perceptual",
            LossWeights {
                movies_lpips: 1.0,
                ..NONE
            },
        ),
        (
            "composited motion",
            LossWeights {
                track_final: 1.0,
                fk_final: 1.0,
                ..NONE
            },
        ),
        (
            "coverage",
            LossWeights {
                coverage: 1.0,
                coverage_right: 1.0,
                ..NONE
            },
        ),
    ];
    let device = Device::flex();
    let perceptual = perceptual(&device.clone().autodiff());
    for (what, weights) in cases {
        let name = match what {
            "sweep" => "stem.sweep.features.0.weight",
            "held" => "held.conv3.bias",
            "composited motion" => "backbone.motion_head.scratch.output_conv2.2.bias",
            "coverage" | "perceptual" => "backbone.splat_head.scratch.output_conv2.2.bias",
            _ => "backbone.depth_head.scratch.output_conv2.2.bias",
        };
        let entry = match what {
            "coverage" => 10, // opacity
            _ => 0,
        };
        let mut settings = settings.clone();
        if what == "sweep" {
            settings.configuration = "compact-sweep".into();
        }
        settings.held_gate = what == "held";
        let value_with = |shift: f32| {
            let mut trainer = Stage1Trainer::new(settings.clone(), &Device::flex()).unwrap();
            let shape = trainer.network.parameters.shape(name).unwrap().to_vec();
            let mut values = trainer.network.parameters.host(name).unwrap();
            // Away from zero: static pixels are at the kink of |x| before training.
            values[entry] += shift + if what == "composited motion" { 0.3 } else { 0.0 };
            trainer.network.parameters.insert(name, &shape, values).unwrap();
            let network = start::tracked(&trainer.network, &settings.optimiser).unwrap();
            let lifted = lift(&network, &clip, true, Heads::All).unwrap();
            let losses = Losses {
                weights: &weights,
                perceptual: Some(&perceptual),
            };
            let result = objective(&clip, &lifted, losses, &mut Pcg64::from_seed(1)).unwrap();
            let gradients = result.loss.backward();
            let gradient = network.parameters.memory()[name].values.grad(&gradients).unwrap();
            (result.value, f64::from(to_host(gradient).unwrap()[entry]))
        };
        let step = 2e-3;
        let (below, above) = (value_with(-step).0, value_with(step).0);
        let numeric = (above - below) / (2.0 * f64::from(step));
        let (_, analytic) = value_with(0.0);
        // Gaussians that come and go at the edge of their footprint make rendered losses jump a little.
        let tolerance = if matches!(what, "heads" | "sweep" | "held") {
            0.01
        } else {
            0.12
        };
        assert!(
            (numeric - analytic).abs() < tolerance * numeric.abs().max(1e-4),
            "{what}: {analytic} by the backward pass, {numeric} by differences"
        );
    }
}

/// The rendered robot is judged at robot pixels of source cameras, of clips that are anchored to the mesh.
#[test]
fn the_rendered_robot_counts_where_it_is_anchored() {
    let settings = tiny(1);
    let trainer = Stage1Trainer::new(settings.clone(), &Device::flex()).unwrap();
    let weights = LossWeights {
        metric_final: 1.0,
        metric_robot: 1.0,
        ..NONE
    };
    let terms = |clip: &Sample| {
        let lifted = lift(&trainer.network, clip, true, Heads::All).unwrap();
        let losses = Losses {
            weights: &weights,
            perceptual: None,
        };
        objective(clip, &lifted, losses, &mut Pcg64::from_seed(1))
            .unwrap()
            .terms
    };
    let clip = sample(&settings, 4711);
    let whole = terms(&clip);
    // References of nothing but the robot make of the term of all pixels that of the robot.
    let mut robot_alone = clip.clone();
    for target in robot_alone.queries.iter_mut().flat_map(|query| &mut query.targets) {
        target.valid = target.valid.iter().zip(&target.support).map(|(a, b)| a * b).collect();
    }
    let alone = terms(&robot_alone);
    assert!(whole["metric_robot"] > 0.0);
    assert_eq!(whole["metric_robot"], alone["metric_robot"]);
    assert_eq!(alone["metric_final"], alone["metric_robot"]);
    assert_ne!(whole["metric_final"], whole["metric_robot"]);
    assert!(!terms(&clip.without_anchors()).contains_key("metric_robot"));
}

/// Depth errors as shares do not depend on how large the scene is; those in millimetres do.
#[test]
fn errors_as_shares_of_depth_know_no_scale() {
    let settings = tiny(1);
    let trainer = Stage1Trainer::new(settings.clone(), &Device::flex()).unwrap();
    let weights = LossWeights {
        metric_final: 1.0,
        metric_share: 1.0,
        ..NONE
    };
    let clip = sample(&settings, 4711);
    let lifted = lift(&trainer.network, &clip, true, Heads::All).unwrap();
    let terms = |factor: f32| {
        let mut clip = clip.clone();
        for target in clip.queries.iter_mut().flat_map(|query| &mut query.targets) {
            target.depth_iu.iter_mut().for_each(|depth| *depth *= factor);
        }
        let losses = Losses {
            weights: &weights,
            perceptual: None,
        };
        objective(&clip, &lifted, losses, &mut Pcg64::from_seed(1))
            .unwrap()
            .terms
    };
    // Rendered depth is next to nothing beside references that are a thousand times too far: the share is 1.
    let far = terms(1000.0);
    assert!((far["metric_share"] - 1.0).abs() < 0.01, "{}", far["metric_share"]);
    assert!(far["metric_final"] > 100.0 * terms(1.0)["metric_final"]);
}

/// With losses of the sweep alone nothing else runs or changes, and they are what they are in the whole network.
#[test]
fn a_sweep_is_trained_alone() {
    let mut settings = tiny(1);
    settings.configuration = "compact-sweep".into();
    settings.losses = LossWeights {
        sweep: 1.0,
        sweep_depth: 1.0,
        ..NONE
    };
    let batch = batches(&settings, 0).next_item().unwrap().unwrap();
    let mut trainer = Stage1Trainer::new(settings.clone(), &Device::flex()).unwrap();
    let values = |trainer: &Stage1Trainer| -> BTreeMap<String, Vec<f32>> {
        let parameters = &trainer.network.parameters;
        let names = parameters.names().into_iter();
        names
            .map(|name| (name.clone(), parameters.host(&name).unwrap()))
            .collect()
    };
    let losses = Losses {
        weights: &settings.losses,
        perceptual: None,
    };
    let in_whole = |clip: &Sample| {
        let lifted = lift(&trainer.network, clip, true, Heads::Depth).unwrap();
        objective(clip, &lifted, losses, &mut Pcg64::from_seed(1))
            .unwrap()
            .value
    };
    let expected = batch.clips.iter().map(in_whole).sum::<f64>() / batch.clips.len() as f64;
    let before = values(&trainer);
    let report = trainer.update(&batch).unwrap();
    assert!(
        (report.loss - expected).abs() < 1e-5 * expected,
        "{} {expected}",
        report.loss
    );
    for (name, after) in values(&trainer) {
        // The last layer speaks to the stem, which is not asked.
        let trained = name.starts_with("stem.sweep.") && !name.starts_with("stem.sweep.join");
        assert_eq!(after != before[&name], trained, "{name}");
    }
}

/// Gradients in segments are those of the whole, to rounding, with and without a trained encoder.
#[test]
fn gradient_checkpointing_changes_no_gradient() {
    for lora_rank in [0, 4] {
        let update = |gradient_checkpointing: bool| {
            let mut settings = Stage1Training {
                gradient_checkpointing,
                ..tiny(1)
            };
            settings.optimiser.lora_rank = lora_rank;
            let batch = batches(&settings, 0).next_item().unwrap().unwrap();
            let mut trainer = Stage1Trainer::new(settings, &Device::flex()).unwrap();
            let report = trainer.update(&batch).unwrap();
            (report, first_moments(&trainer))
        };
        let ((whole, whole_moments), (parts, parts_moments)) = (update(false), update(true));
        assert!((whole.loss - parts.loss).abs() < 1e-5 * whole.loss);
        assert!((whole.gradient_norm - parts.gradient_norm).abs() < 1e-3 * whole.gradient_norm);
        let found = difference(&whole_moments, &parts_moments);
        assert!(found < 1e-3, "{found}");
    }
}

/// Losses on copies of the outputs, as for a network on a GPU, give the gradients of losses on the outputs.
#[test]
fn losses_on_copies_of_the_outputs_change_no_gradient() {
    let mut settings = tiny(1);
    settings.configuration = "compact-sweep".into();
    (settings.losses.sweep, settings.losses.sweep_depth) = (1.0, 1.0);
    let clip = sample(&settings, 7);
    let losses = Losses {
        weights: &settings.losses,
        perceptual: None,
    };
    let gradients = |copied: bool| {
        let network = start::start(&settings, &Device::flex().autodiff()).unwrap().network;
        let network = start::tracked(&network, &settings.optimiser).unwrap();
        let lifted = lift(&network, &clip, true, Heads::All).unwrap();
        let judge = if copied { of_copies } else { objective };
        let objective = judge(&clip, &lifted, losses, &mut Pcg64::from_seed(3)).unwrap();
        let gradients = optimiser::gradients(&network.parameters, &objective.loss).unwrap();
        (objective.terms, gradients)
    };
    let ((terms, whole), (same_terms, copied)) = (gradients(false), gradients(true));
    assert!(terms.contains_key("sweep_depth") && terms.contains_key("metric_right"));
    assert_eq!(terms, same_terms);
    let found = difference(&whole, &copied);
    assert!(found < 1e-5, "{found}");
}

/// Products of bfloat16 are another rounding, not another trainer.
#[test]
fn products_of_bfloat16_hardly_change_an_update() {
    let update = |precision| {
        let settings = Stage1Training { precision, ..tiny(1) };
        let batch = batches(&settings, 0).next_item().unwrap().unwrap();
        let mut trainer = Stage1Trainer::new(settings, &Device::flex()).unwrap();
        let report = trainer.update(&batch).unwrap();
        (report, first_moments(&trainer))
    };
    let ((single, singles), (rounded, roundeds)) = (update(ProductPrecision::F32), update(ProductPrecision::Bf16));
    assert!(single.loss != rounded.loss);
    assert!(
        (single.loss - rounded.loss).abs() < 0.02 * single.loss,
        "{} {}",
        single.loss,
        rounded.loss
    );
    let found = difference(&singles, &roundeds);
    assert!(found > 1e-4 && found < 0.15, "{found}");
}

#[test]
fn a_network_learns_one_clip() {
    let mut settings = tiny(12);
    (settings.optimiser.rate, settings.optimiser.head_rate) = (4e-3, 4e-3);
    let clip = sample(&settings, 99);
    let mut trainer = Stage1Trainer::new(settings, &Device::flex()).unwrap();
    let mut losses = Vec::new();
    for step in 0..12 {
        let batch = rogs_train::stream::Batch {
            step,
            clips: vec![clip.clone()],
        };
        losses.push(trainer.update(&batch).unwrap().loss);
    }
    assert!(losses[11] < 0.8 * losses[0], "{losses:?}");
}

/// Checkpoints of a configuration without a stem or a sweep continue in one that has it.
#[test]
fn a_checkpoint_without_a_stem_or_sweep_gets_one_that_says_nothing_yet() {
    let without_stem = Stage1Config {
        stem_channels: [0; 4],
        ..Stage1Config::compact()
    };
    let of_stem = ["stem.tokens.weight", "backbone.depth_head.stem.project.3.weight"];
    goes_on_with_what_it_lacks(&without_stem, Stage1Config::compact(), &of_stem);
    let of_sweep = ["stem.sweep.join.weight"];
    goes_on_with_what_it_lacks(&Stage1Config::compact(), Stage1Config::compact_sweep(), &of_sweep);
}

/// The parameters named are zero at first and learn.
fn goes_on_with_what_it_lacks(config: &Stage1Config, wanted: Stage1Config, learning: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("old.safetensors");
    let mut old = seeded::network(config, 5, &Device::flex()).unwrap();
    // A trained stem counts; a seeded one does not, nor would a sweep that feeds it.
    let heard = "backbone.depth_head.stem.project.1.weight";
    if let Some(shape) = old.parameters.shape(heard).map(<[usize]>::to_vec) {
        let count = shape.iter().product();
        old.parameters.insert(heard, &shape, vec![0.01; count]).unwrap();
    }
    let tensor = |name: String| TensorSource {
        shape: old.parameters.shape(&name).unwrap().to_vec(),
        values: Box::new({
            let values = old.parameters.host(&name).unwrap();
            move || Ok(values)
        }),
        name,
    };
    let tensors = old.parameters.names().into_iter().map(tensor).collect();
    write(
        &path,
        &stage1_metadata(config, true, "a test"),
        ElementType::F32,
        tensors,
    )
    .unwrap();

    let settings = Stage1Training {
        start: Some(path),
        configuration: wanted.name.clone(),
        ..tiny(1)
    };
    let mut trainer = Stage1Trainer::new(settings.clone(), &Device::flex()).unwrap();
    assert_eq!(trainer.network.config, wanted);
    let clip = sample(&settings, 99);
    let depth = |network: &Stage1| to_host(lift(network, &clip, true, Heads::Depth).unwrap().depth).unwrap();
    let plain = Stage1::new(
        trainer.network.config.clone(),
        trainer.network.parameters.without_gradients(),
    )
    .unwrap();
    assert_eq!(depth(&old), depth(&plain));

    // What they say comes through their last layers first.
    for &name in learning {
        let values = trainer.network.parameters.host(name).unwrap();
        assert!(values.iter().all(|&value| value == 0.0), "{name} says something");
    }
    let batch = batches(&settings, 0).next_item().unwrap().unwrap();
    trainer.update(&batch).unwrap();
    for &name in learning {
        let values = trainer.network.parameters.host(name).unwrap();
        assert!(values.iter().any(|&value| value != 0.0), "{name} does not learn");
    }
}

/// It starts with what is nearest to the tool, learns, and is part of the weights; a network that has one keeps it.
#[test]
fn a_gate_of_what_is_held_starts_at_the_tool_and_learns() {
    let folder = tempfile::tempdir().unwrap();
    let mut settings = tiny(1);
    settings.held_gate = true;
    settings.losses = LossWeights { held: 1.0, ..NONE };
    let mut trainer = Stage1Trainer::new(settings.clone(), &Device::flex()).unwrap();
    let tool = DVec3::new(0.1, 0.2, 0.9);
    let carry = DVec3::X * 0.1;
    let hands = [Pose::<Recon, Link>::IDENTITY, Pose::from_translation(carry)];
    let path = HeldPath::new(&hands, &[0.5; 2], vec![tool, tool + carry]);
    let motion = [HeldMotion::new(&path, FrameIndex(0), 1.0, &Pose::IDENTITY)];
    let offsets = [0.0, 0.03, 0.05, 0.1, 0.2, 0.31];
    let places = |axis: usize| offsets.map(|offset| ((tool[axis] + if axis == 1 { offset } else { 0.0 }) * 3.5) as f32);
    let width = offsets.len();
    let position = from_host((0..3).flat_map(places).collect(), [1, 3, 1, width], &Device::flex());
    let zeros = |channels: usize| from_host(vec![0.0; channels * width], [1, channels, 1, width], &Device::flex());
    let plain = Stage1::new(
        trainer.network.config.clone(),
        trainer.network.parameters.without_gradients(),
    )
    .unwrap();
    let gate = plain.held_gate().unwrap().unwrap();
    let holding = gate.look(&motion, position, zeros(12), zeros(1));
    let moved = to_host(holding.displacement(&motion, zeros(1))).unwrap();
    for (pixel, offset) in offsets.into_iter().enumerate() {
        let left = ((0.3 - offset) / 0.15f64).clamp(0.0, 1.0);
        let logit = 8.0 * (-0.5 * (offset / 0.05f64).powi(2)).exp() - 6.0;
        let expected = 0.35 * left * left * (3.0 - 2.0 * left) / (1.0 + (-logit).exp());
        assert!(
            (f64::from(moved[pixel]) - expected).abs() < 1e-5,
            "{offset}: {}",
            moved[pixel]
        );
        assert!(moved[width + pixel].abs() < 1e-6 && moved[2 * width + pixel].abs() < 1e-6);
    }

    let head = "backbone.motion_head.scratch.output_conv2.2.weight";
    for name in ["held.conv3.weight", head] {
        let values = trainer.network.parameters.host(name).unwrap();
        assert!(
            values[values.len() / 4 * 3..].iter().all(|&value| value == 0.0),
            "{name}"
        );
    }
    let batch = batches(&settings, 0).next_item().unwrap().unwrap();
    let report = trainer.update(&batch).unwrap();
    assert!(report.terms["held"] > 0.0 && report.terms.len() == 1);
    for name in ["held.conv3.weight", head] {
        let values = trainer.network.parameters.host(name).unwrap();
        assert!(
            values[values.len() / 4 * 3..].iter().any(|&value| value != 0.0),
            "{name}"
        );
    }

    let path = folder.path().join("model.safetensors");
    let metadata = trainer.metadata("");
    rogs_train::checkpoint::export(&trainer.network.parameters, &metadata, &path, ElementType::F32).unwrap();
    let learned = trainer.network.parameters.host("held.conv3.weight").unwrap();
    settings.start = Some(path);
    let next = Stage1Trainer::new(settings, &Device::flex()).unwrap();
    assert_eq!(next.network.parameters.host("held.conv3.weight").unwrap(), learned);
}

#[test]
fn losses_of_the_depth_head_alone_train_no_other_head() {
    let mut settings = tiny(1);
    settings.losses = LossWeights {
        stereo: 1.0,
        depth_head: 0.01,
        ..NONE
    };
    let batch = batches(&settings, 0).next_item().unwrap().unwrap();
    let mut trainer = Stage1Trainer::new(settings, &Device::flex()).unwrap();
    let report = trainer.update(&batch).unwrap();
    assert_eq!(report.terms.keys().collect::<Vec<_>>(), ["depth_head", "stereo"]);
    let trained: Vec<&String> = trainer.moments.by_name.keys().collect();
    let of = |part: &str| trained.iter().filter(|name| name.contains(part)).count();
    assert!(of("depth_head") > 50 && of("frame_blocks") > 50 && of("stem.levels") == 16);
    assert_eq!(of("splat_head") + of("motion_head") + of("fk_branch"), 0);
}

#[test]
fn only_the_chosen_parameters_are_trained() {
    let mut settings = tiny(1);
    settings.optimiser.lora_rank = 4;
    let batch = batches(&settings, 0).next_item().unwrap().unwrap();
    let mut trainer = Stage1Trainer::new(settings.clone(), &Device::flex()).unwrap();
    let before: Vec<_> = trainer.network.parameters.names();
    let values = |trainer: &Stage1Trainer, name: &str| trainer.network.parameters.host(name).unwrap();
    let old: Vec<Vec<f32>> = before.iter().map(|name| values(&trainer, name)).collect();
    trainer.update(&batch).unwrap();
    let (mut changed, mut kept) = (0, 0);
    for (name, old) in before.iter().zip(old) {
        let same = values(&trainer, name) == old;
        // A starts to move once B is no longer zero.
        let trained = name.contains("_head.") || name.contains("fk_branch") || name.contains("lora_B");
        if trained {
            changed += usize::from(!same);
        } else if !name.contains("lora_A") {
            assert!(same, "{name} is frozen and moved");
            kept += 1;
        }
    }
    assert!(changed > 50 && kept > 50, "{changed} {kept}");
}

#[test]
fn bad_settings_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("settings.toml");
    for (text, expected) in [
        ("stepz = 3", "stepz"),
        ("steps = 0", "steps"),
        ("[data]\nsize = [100, 154]", "data.size"),
        ("[data]\nimages_per_step = 3", "images_per_step"),
        ("[losses]\nmovies_mse = -1.0", "losses"),
        ("configuration = \"huge\"", "huge"),
        ("[optimiser]\nbetas = [0.9, 1.0]", "betas"),
    ] {
        std::fs::write(&path, text).unwrap();
        let error = Stage1Training::read(&path).err().unwrap().to_string();
        assert!(error.contains(expected), "{text}: {error}");
    }
}
