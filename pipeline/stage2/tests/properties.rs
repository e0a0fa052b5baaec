//! Properties of the Stage-2 network: what it must do for any weights, and that gradients reach what is trained.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use burn::tensor::{Device, Tensor};
use rogs_stage2::updater::Neighbours;
use rogs_stage2::weights::{is_trained, uniform};
use rogs_stage2::{
    ErrorEncoder, FeatureMap, Refiner, RefinerConfig, TokenGrid, TokenSet, Updater, nearest_neighbours,
    parameter_shapes, seeded_parameters,
};
use rogs_tensors::parameters::{Parameters, from_host, to_host};

/// A network of the smallest useful sizes whose head is not zero.
fn tiny(seed: u64, device: &Device) -> (RefinerConfig, Parameters) {
    let preset = RefinerConfig::preset("ci").unwrap();
    let config = RefinerConfig {
        name: "tiny".into(),
        state: 8,
        blocks: 2,
        attention: 4,
        neighbours: 4,
        ..preset
    };
    let mut parameters = seeded_parameters(&config, seed, device).unwrap();
    for (name, shape) in parameter_shapes(&config) {
        if name.starts_with("encoder.update_head.6") {
            let values = uniform(&name, shape.iter().product(), seed, 0.5);
            parameters.insert(&name, &shape, values).unwrap();
        }
    }
    (config, parameters)
}

fn image(name: &str, height: usize, width: usize) -> FeatureMap {
    let data = uniform(name, height * width * 3, 1, 0.5)
        .into_iter()
        .map(|value| value + 0.5)
        .collect();
    FeatureMap {
        height,
        width,
        channels: 3,
        data,
    }
}

#[test]
fn equal_render_and_observation_give_the_same_features_at_every_pixel_before_attention() {
    let (config, parameters) = tiny(1, &Device::flex());
    let encoder = ErrorEncoder::load(&parameters, &config).unwrap();
    let images = [image("a", 10, 13), image("b", 10, 13)];
    let maps: Vec<_> = images
        .iter()
        .map(|image| encoder.feature_maps(image).unwrap())
        .collect();
    let before = encoder.before_attention(&images, &images, &maps).unwrap();
    let features = encoder.features();
    for view in &before {
        assert_eq!((view.height, view.width, view.channels), (10, 13, features));
        assert!(
            view.data
                .chunks_exact(features)
                .all(|pixel| pixel == &view.data[..features])
        );
    }
    let after = encoder.forward(&images, &images, &maps).unwrap();
    assert_eq!(
        (after.len(), after[0].height, after[0].width),
        (2, 10, 13),
        "padding is cut off again"
    );
    let wrong = [image("c", 10, 12), image("d", 10, 12)];
    assert!(encoder.forward(&wrong, &images, &maps).is_err());
    assert!(encoder.forward(&images[..1], &images, &maps).is_err());
}

#[test]
fn cameras_see_each_other_in_the_attention_and_nowhere_else() {
    let (config, parameters) = tiny(2, &Device::flex());
    let encoder = ErrorEncoder::load(&parameters, &config).unwrap();
    let observed = [image("a", 8, 8), image("b", 8, 8)];
    let maps: Vec<_> = observed
        .iter()
        .map(|image| encoder.feature_maps(image).unwrap())
        .collect();
    let renders = [image("c", 8, 8), image("d", 8, 8)];
    let changed = [renders[0].clone(), image("e", 8, 8)];
    let before = |renders: &[FeatureMap]| encoder.before_attention(renders, &observed, &maps).unwrap();
    assert_eq!(before(&renders)[0], before(&changed)[0]);
    let after = |renders: &[FeatureMap]| encoder.forward(renders, &observed, &maps).unwrap();
    assert_ne!(after(&renders)[0], after(&changed)[0]);
}

#[test]
fn the_order_of_gaussians_does_not_matter() {
    let (config, parameters) = tiny(3, &Device::flex());
    let refiner = Refiner::load(&parameters, &config).unwrap();
    let grid = TokenGrid::new(vec![0], 6, 7, &config).unwrap();
    let (n, f) = (grid.len(), config.features());
    // Coarse coordinates could tie, and ties are broken by index: use the full random ones.
    let attributes = uniform("attributes", n * 59, 3, 1.0);
    let feedback = uniform("feedback", n * f, 3, 1.0);
    let state = uniform("state", n * config.state, 3, 1.0);
    let order: Vec<usize> = (0..n).map(|i| (i * 5 + 3) % n).collect();
    let run = |order: &[usize]| {
        let pick = |values: &[f32], width: usize| -> Vec<f32> {
            order
                .iter()
                .flat_map(|&i| &values[i * width..(i + 1) * width])
                .copied()
                .collect()
        };
        let attributes = pick(&attributes, 59);
        let set = TokenSet {
            tokens: (0..n as u32).collect(),
            positions: attributes
                .chunks_exact(59)
                .map(|row| [row[0], row[1], row[2]])
                .collect(),
            attributes,
            feedback: pick(&feedback, f),
        };
        let mut state = pick(&state, config.state);
        let residual = refiner.update(&grid, set, &mut state).unwrap();
        (residual, state)
    };
    let plain = run(&(0..n).collect::<Vec<_>>());
    let permuted = run(&order);
    for (row, &source) in order.iter().enumerate() {
        for (a, b, width) in [(&permuted.0, &plain.0, 59), (&permuted.1, &plain.1, config.state)] {
            let pairs = a[row * width..(row + 1) * width]
                .iter()
                .zip(&b[source * width..(source + 1) * width]);
            assert!(
                pairs.clone().all(|(a, b)| (a - b).abs() <= 1e-5 + 1e-5 * b.abs()),
                "Gaussian {source}"
            );
        }
    }
}

#[test]
fn arrays_of_wrong_sizes_and_empty_sets_are_handled() {
    let (config, parameters) = tiny(4, &Device::flex());
    let refiner = Refiner::load(&parameters, &config).unwrap();
    let grid = TokenGrid::new(vec![0], 4, 4, &config).unwrap();
    let mut state = vec![0.5; 16 * config.state];
    assert!(
        refiner
            .update(&grid, TokenSet::default(), &mut state)
            .unwrap()
            .is_empty()
    );
    let short = TokenSet {
        tokens: vec![1],
        ..TokenSet::default()
    };
    assert!(refiner.update(&grid, short, &mut state).is_err());
    let one = |token: u32| TokenSet {
        tokens: vec![token],
        attributes: vec![0.1; 59],
        positions: vec![[0.0; 3]],
        feedback: vec![0.2; config.features()],
    };
    assert!(
        refiner.update(&grid, one(16), &mut state).is_err(),
        "there is no token 16"
    );
    assert_eq!(
        refiner.update(&grid, one(3), &mut state).unwrap().len(),
        59,
        "a set smaller than K"
    );
    assert!(
        state[..3 * config.state].iter().all(|&value| value == 0.5),
        "other tokens keep their state"
    );
}

/// What two updates with a shared hidden state give for fixed inputs, as one number. `[1]`
fn two_updates(parameters: &Parameters, config: &RefinerConfig) -> Tensor<1> {
    let device = parameters.device();
    let (n, f) = (9, config.features());
    let input = |name: &str, width: usize| from_host::<2>(uniform(name, n * width, 5, 1.0), [n, width], device);
    let positions: Vec<[f32; 3]> = uniform("positions", 3 * n, 5, 1.0)
        .chunks_exact(3)
        .map(|p| [p[0], p[1], p[2]])
        .collect();
    let neighbours = Neighbours::new(&nearest_neighbours(&positions, 4), 4, device);
    let updater = Updater::load(parameters, config).unwrap();
    let state = updater.initial_state(input("observation", f));
    let first = updater.forward(input("attributes", 59), state, input("feedback", f), &neighbours);
    let second = updater.forward(
        input("attributes 2", 59),
        first.state,
        input("feedback 2", f),
        &neighbours,
    );
    let residual = first.residual + second.residual;
    // Gate 0 scales three channels, gate 4 forty-eight.
    let gates = updater.gates();
    let part = |from: usize, to: usize, gate: usize| {
        let gate = gates.clone().narrow(0, gate, 1).unsqueeze::<2>();
        (residual.clone().narrow(1, from, to - from) * gate)
            .powi_scalar(2)
            .sum()
    };
    part(0, 3, 0) + part(3, 6, 1) + part(6, 10, 2) + part(10, 11, 3) + part(11, 59, 4)
}

#[test]
fn gradients_of_two_updates_agree_with_finite_differences_for_every_trained_parameter() {
    let device = Device::flex().autodiff();
    let (config, mut parameters) = tiny(6, &device);
    for parameter in parameters.memory_mut().values_mut() {
        parameter.values = parameter.values.clone().require_grad();
    }
    let gradients = two_updates(&parameters, &config).backward();
    let (_, plain) = tiny(6, &Device::flex());
    let value_with = |name: &str, values: Vec<f32>| {
        let (_, mut changed) = tiny(6, &Device::flex());
        changed.insert(name, plain.shape(name).unwrap(), values).unwrap();
        f64::from(to_host(two_updates(&changed, &config)).unwrap()[0])
    };
    let mut checked = 0;
    for name in plain.names() {
        let gradient = parameters.memory()[&name]
            .values
            .grad(&gradients)
            .map(|gradient| to_host(gradient).unwrap());
        if !is_trained(&name) {
            assert!(
                gradient.is_none_or(|gradient| gradient.iter().all(|&value| value == 0.0)),
                "`{name}` is frozen"
            );
            continue;
        }
        let gradient = gradient.unwrap_or_else(|| panic!("no gradient reaches `{name}`"));
        // Along one random direction: f32 sums leave no more than three digits for single entries.
        let direction = uniform(&format!("direction {name}"), gradient.len(), 8, 1.0);
        let slope: f64 = gradient
            .iter()
            .zip(&direction)
            .map(|(g, d)| f64::from(*g) * f64::from(*d))
            .sum();
        let values = plain.host(&name).unwrap();
        let step = 2e-3 / (values.len() as f32).sqrt();
        let moved = |sign: f32| {
            values
                .iter()
                .zip(&direction)
                .map(|(v, d)| v + sign * step * d)
                .collect()
        };
        let difference = (value_with(&name, moved(1.0)) - value_with(&name, moved(-1.0))) / f64::from(2.0 * step);
        let scale = slope.abs().max(difference.abs()).max(0.3);
        assert!(
            (slope - difference).abs() <= 0.02 * scale,
            "`{name}`: gradient {slope}, difference {difference}"
        );
        checked += 1;
    }
    assert_eq!(
        checked,
        2 + 2 + 2 * 11 + 8 + 1,
        "projection, input layer, two blocks, head, gates"
    );
}
