//! Gradients of the objective reach the network and make it better.

mod support;

use burn::tensor::Device;
use rogs_networks::parameters::{Parameters, to_host};
use rogs_networks::stage2::objective::ObjectiveWeights;
use rogs_networks::stage2::weights::uniform;
use rogs_networks::stage2::{Refiner, RefinerConfig, parameter_shapes, seeded_parameters};
use rogs_refine::RefineParams;
use rogs_refine::training::{AdamW, TrainingStep, training_step};
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
    training_step(example.inputs(), &refiner, &params, &weights).unwrap()
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
        let norm = gradient
            .iter()
            .map(|&g| f64::from(g) * f64::from(g))
            .sum::<f64>()
            .sqrt();
        let step = 0.02 * (values.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>().sqrt() + 0.1);
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
    assert!(trained.rendering[0] < untrained.rendering[0], "{:?}", trained.rendering);
    assert_eq!(
        parameters.host("encoder.update_feature.conv1.weight").unwrap(),
        frozen,
        "the error encoder is frozen"
    );
}
