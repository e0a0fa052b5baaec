//! Gradients of the objective reach the network and make it better.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod support;

use burn::tensor::Device;
use rogs_refine::RefineParams;
use rogs_refine::training::{AdamW, TermValues, TrainingOptions, TrainingStep, training_step};
use rogs_schemas::records::clip::{CameraRole, DepthReference, Tracks};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_stage2::objective::ObjectiveWeights;
use rogs_stage2::weights::uniform;
use rogs_stage2::{Refiner, RefinerConfig, parameter_shapes, seeded_parameters};
use rogs_tensors::parameters::{Parameters, to_host};
use support::{Example, example};

/// Parameters on an autodiff device, with a head that is not zero.
fn parameters(scale: f32) -> (RefinerConfig, Parameters) {
    let config = RefinerConfig::preset("ci").unwrap();
    let mut parameters = seeded_parameters(&config, 21, &Device::flex().autodiff()).unwrap();
    for (name, shape) in parameter_shapes(&config) {
        if name.starts_with("encoder.update_head.6") {
            let values = uniform(&name, shape.iter().product(), 21, scale);
            parameters.insert(&name, &shape, values).unwrap();
        }
    }
    (config, parameters)
}

fn run(example: &Example, config: &RefinerConfig, parameters: &mut Parameters, updates: u32) -> TrainingStep {
    AdamW::track(parameters);
    let refiner = Refiner::load(parameters, config).unwrap();
    let params = RefineParams {
        updates: Some(updates),
        ..RefineParams::default()
    };
    let weights = ObjectiveWeights {
        coverage: 0.3,
        ..ObjectiveWeights::default()
    };
    let options = TrainingOptions {
        weights,
        ..TrainingOptions::default()
    };
    training_step(example.inputs(), &refiner, &params, &options).unwrap()
}

/// The small clip with everything a term of the objective needs: stereo depth, a paired-right camera, mesh-anchored
/// Gaussians, moving ones, and tracks.
fn complete(seed: u64) -> Example {
    let mut example = example(seed);
    let (height, width, frames) = (
        example.clip.height as usize,
        example.clip.width as usize,
        example.clip.frame_count(),
    );
    let depth = |camera: usize| DepthReference {
        depth_m: (0..frames * height * width)
            .map(|k| {
                if k % 7 == 0 {
                    f32::NAN
                } else {
                    0.9 + 0.05 * camera as f32 + 0.003 * (k % 50) as f32
                }
            })
            .collect(),
        range_m: [0.1, 5.0],
        origin: ReferenceOrigin::Exact,
    };
    let mut right = example.clip.cameras[1].clone();
    right.id = "ext1_right".into();
    right.role = CameraRole::Evaluation;
    right.partner = Some(CameraIndex(1));
    right.recorded = right.recorded.map(|rgb| rgb.iter().map(|value| 255 - value).collect());
    example.clip.cameras.push(right);
    for (index, camera) in example.clip.cameras.iter_mut().enumerate() {
        camera.depth = Some(depth(index));
    }
    for frame in 0..frames {
        let mut pose = example.robot.base_from_camera[frames + frame];
        pose.translation[0] += 0.05;
        example.robot.base_from_camera.push(pose);
    }
    for index in (0..example.field.len()).step_by(9) {
        example.field.support[index] = 1;
        example.field.link[index] = 0;
    }
    let moved = uniform("moved", 3 * example.field.len(), seed, 0.05);
    if let Some(last) = example.field.slices.last_mut() {
        last.displacement_m = moved;
    }
    let count = 12;
    let position = |k: usize| ((k * 37) % 11) as f32 / 100.0;
    example.clip.tracks = Some(Tracks {
        anchor_frame: FrameIndex(0),
        camera: (0..count).map(|k| CameraIndex((k % 3) as u32)).collect(),
        pixel: (0..count).flat_map(|k| [(3 + k) as f32, (2 + k % 9) as f32]).collect(),
        position_m: (0..count * frames * 3).map(position).collect(),
        visible: vec![1; count * frames],
        origin: ReferenceOrigin::Exact,
    });
    example
}

/// Every term by itself: the surrogate's gradient is that of the term.
#[test]
fn the_gradient_of_every_term_agrees_with_finite_differences() {
    let example = complete(33);
    let none = ObjectiveWeights {
        rendering: 0.0,
        rendering_squared: 0.0,
        right_views: 1.0,
        perceptual: 0.0,
        depth: 0.0,
        robot: 0.0,
        motion: 0.0,
        preservation: 0.0,
        coverage: 0.0,
        coverage_right: 0.0,
        discount: 1.0,
    };
    type Value = fn(&TermValues) -> f64;
    let cases: [(&str, ObjectiveWeights, Value); 8] = [
        ("rendering", ObjectiveWeights { rendering: 1.0, ..none }, |terms| {
            terms.rendering
        }),
        (
            "rendering_squared",
            ObjectiveWeights {
                rendering_squared: 1.0,
                ..none
            },
            |terms| terms.rendering_squared,
        ),
        ("depth", ObjectiveWeights { depth: 1.0, ..none }, |terms| terms.depth),
        ("robot", ObjectiveWeights { robot: 1.0, ..none }, |terms| terms.robot),
        ("motion", ObjectiveWeights { motion: 1.0, ..none }, |terms| terms.motion),
        (
            "preservation",
            ObjectiveWeights {
                preservation: 1.0,
                ..none
            },
            |terms| terms.preservation,
        ),
        ("coverage", ObjectiveWeights { coverage: 1.0, ..none }, |terms| {
            terms.coverage
        }),
        (
            "coverage_right",
            ObjectiveWeights {
                coverage_right: 1.0,
                ..none
            },
            |terms| terms.coverage_right,
        ),
    ];
    let name = "encoder.update_head.6.bias";
    let mut wrong = Vec::new();
    for (term, weights, value) in cases {
        let step_of = |parameters: &mut Parameters, config: &RefinerConfig| {
            AdamW::track(parameters);
            let refiner = Refiner::load(parameters, config).unwrap();
            let params = RefineParams {
                updates: Some(1),
                ..RefineParams::default()
            };
            let options = TrainingOptions {
                weights,
                right_views: true,
                ..TrainingOptions::default()
            };
            training_step(example.inputs(), &refiner, &params, &options).unwrap()
        };
        let (config, mut trained) = parameters(0.3);
        let step = step_of(&mut trained, &config);
        assert!(step.objective > 0.0, "{term}");
        assert!(
            (value(&step.terms[0]) - step.objective).abs() <= 1e-6 * step.objective,
            "{term}"
        );
        let gradients = step.surrogate.backward();
        let parameter = &trained.memory()[name].values;
        let gradient = to_host(parameter.grad(&gradients).unwrap()).unwrap();
        let values = to_host(parameter.clone()).unwrap();
        let norm = norm_of(&gradient);
        assert!(norm > 0.0, "{term} has no gradient");
        // Robot positions differ by a millimetre, so their absolute values have their kinks close by.
        let length = if term == "robot" { 0.002 } else { 0.03 };
        let objective_at = |sign: f64| {
            let (config, mut changed) = parameters(0.3);
            let moved = values.iter().zip(&gradient);
            let moved = moved
                .map(|(v, g)| v + (sign * length * f64::from(*g) / norm) as f32)
                .collect();
            let shape = changed.shape(name).unwrap().to_vec();
            changed.insert(name, &shape, moved).unwrap();
            step_of(&mut changed, &config).objective
        };
        let slope = (objective_at(1.0) - objective_at(-1.0)) / (2.0 * length);
        // Absolute values and the alpha cut have kinks.
        if (slope - norm).abs() > 0.15 * norm {
            wrong.push(format!("{term}: gradient {norm}, difference {slope}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

fn norm_of(values: &[f32]) -> f64 {
    values.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>().sqrt()
}

#[test]
fn a_query_time_that_the_field_lacks_is_named() {
    let example = example(34);
    let (config, mut parameters) = parameters(0.0);
    AdamW::track(&mut parameters);
    let refiner = Refiner::load(&parameters, &config).unwrap();
    let options = TrainingOptions {
        frames: &[FrameIndex(3)],
        ..TrainingOptions::default()
    };
    let error = training_step(example.inputs(), &refiner, &RefineParams::default(), &options)
        .err()
        .unwrap();
    assert!(error.message.contains("frame 3"), "{}", error.message);
}

/// One update: nothing is cut then, so the surrogate's gradient must be that of the objective itself.
#[test]
fn the_gradient_of_one_update_agrees_with_finite_differences_of_the_objective() {
    let example = example(31);
    let (config, mut trained) = parameters(0.3);
    let gradients = run(&example, &config, &mut trained, 1).surrogate.backward();
    let objective_with = |name: &str, values: Vec<f32>| {
        let (_, mut changed) = parameters(0.3);
        let shape = changed.shape(name).unwrap().to_vec();
        changed.insert(name, &shape, values).unwrap();
        run(&example, &config, &mut changed, 1).objective
    };
    let names = [
        "encoder.update_head.6.bias",
        "encoder.update_gate.logit",
        "encoder.update_head.4.weight",
        "encoder.update_obs_proj.bias",
    ];
    for name in names {
        let parameter = &trained.memory()[name].values;
        let gradient = to_host(parameter.grad(&gradients).unwrap()).unwrap();
        let values = to_host(parameter.clone()).unwrap();
        // Along the gradient: the largest slope there is, so that f32 renders resolve it.
        let norm = norm_of(&gradient);
        let step = 0.02 * (norm_of(&values) + 0.1);
        let moved = |sign: f64| {
            values
                .iter()
                .zip(&gradient)
                .map(|(v, g)| v + (sign * step * f64::from(*g) / norm) as f32)
                .collect()
        };
        let slope = (objective_with(name, moved(1.0)) - objective_with(name, moved(-1.0))) / (2.0 * step);
        // The absolute value, the alpha cut and eligibility have kinks: a tenth is what central differences can show.
        assert!(
            (slope - norm).abs() <= 0.1 * norm,
            "`{name}`: gradient {norm}, difference {slope}"
        );
    }
}

#[test]
fn a_few_steps_make_renders_better_than_those_of_stage_1() {
    let example = example(32);
    let (config, mut parameters) = parameters(0.0);
    let untrained = run(&example, &config, &mut parameters, 1);
    let frozen = parameters.host("encoder.update_feature.conv1.weight").unwrap();
    let mut optimiser = AdamW::default();
    (optimiser.learning_rate, optimiser.gate_learning_rate) = (5e-3, 5e-3);
    for _ in 0..80 {
        let step = run(&example, &config, &mut parameters, 1);
        optimiser.step(&mut parameters, &step.surrogate).unwrap();
    }
    let trained = run(&example, &config, &mut parameters, 1);
    assert!(
        trained.objective < 0.95 * untrained.objective,
        "{} after {}",
        trained.objective,
        untrained.objective
    );
    assert!(
        trained.terms[0].rendering < untrained.terms[0].rendering,
        "{:?}",
        trained.terms
    );
    assert_eq!(
        parameters.host("encoder.update_feature.conv1.weight").unwrap(),
        frozen,
        "the error encoder is frozen"
    );
}
