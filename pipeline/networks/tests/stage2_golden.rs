//! The Stage-2 refiner against golden vectors of the released modules and of the specified adaptation.

mod stage2_support;

use burn::tensor::Device;
use rogs_networks::parameters::{from_host, to_host};
use rogs_networks::stage2::error_encoder::ColourLayout;
use rogs_networks::stage2::mv_attention::MultiViewAttention;
use rogs_networks::stage2::observation::{ObservationTrunkTail, TrunkTailConfig};
use rogs_networks::stage2::updater::{NeighbourBlock, Neighbours};
use rogs_networks::stage2::{
    Correction, ErrorEncoder, Plane, RefinerConfig, ResNetFront, TokenGrid, Updater, nearest_neighbours,
    parameter_shapes,
};
use rogs_schemas::records::refinement::ScaleResidual;
use stage2_support::{Golden, golden};

/// Tolerance of features and attributes, and of hidden states: |a - b| <= absolute + 1e-4 |b|.
const FEATURE: f64 = 1e-4;
const STATE: f64 = 2e-4;

#[test]
fn resnet_front_gives_the_three_maps() {
    let Some(golden) = golden("resnet18_front") else { return };
    let front = ResNetFront::load(&golden.parameters(), "encoder.update_feature", [64, 128]).unwrap();
    let images = golden.images("in.image");
    for (view, image) in images.iter().enumerate() {
        let maps = front.forward(image).unwrap().maps;
        for (level, map) in maps.iter().enumerate() {
            let expected = &golden.images(&format!("out.feat{level}"))[view];
            assert_eq!(
                (map.height, map.width, map.channels),
                (expected.height, expected.width, expected.channels)
            );
            golden.close(&format!("feat{level}"), &map.data, &expected.data, FEATURE);
        }
    }
    assert!(front.forward(&Plane::zeros(4, 4, 1)).is_err());
}

#[test]
fn neighbour_attention_follows_the_released_blocks() {
    let Some(golden) = golden("point_transformer") else {
        return;
    };
    let parameters = golden.parameters();
    let points = golden.points("in.points");
    let block = |index: usize| {
        NeighbourBlock::load(
            &parameters.scope(&format!("encoder.update_module.1.blocks.{index}")),
            32,
            16,
        )
        .unwrap()
    };
    let blocks = [block(0), block(1)];
    let (device, x) = (Device::flex(), golden.array("in.x"));

    let indices = nearest_neighbours(&points, 8);
    assert_eq!(indices, golden.indices("out.knn_idx"), "neighbours are exact");
    let near = Neighbours::new(&indices, 8, &device);
    let input = || from_host::<2>(x.to_vec(), [300, 32], &device);
    golden.close_to(
        "out.block0_attn_on_x",
        &to_host(blocks[0].attention_of(input(), &near)).unwrap(),
        FEATURE,
    );
    let first = blocks[0].forward(input(), &near);
    golden.close_to("out.block0", &to_host(first.clone()).unwrap(), FEATURE);
    golden.close_to("out.stack", &to_host(blocks[1].forward(first, &near)).unwrap(), FEATURE);

    // Two sets of 180 and 115 tokens do not see each other. The third set of the file, 5 tokens with padding, is
    // something the project does on purpose in another way: K = n.
    for (start, end) in [(0, 180), (180, 295)] {
        let indices = nearest_neighbours(&points[start..end], 8);
        let global: Vec<u32> = indices.iter().map(|index| index + start as u32).collect();
        assert_eq!(global, golden.indices("out.knn_idx_offset3")[start * 8..end * 8]);
        let near = Neighbours::new(&indices, 8, &device);
        let input = from_host::<2>(x[start * 32..end * 32].to_vec(), [end - start, 32], &device);
        let stack = to_host(blocks[1].forward(blocks[0].forward(input, &near), &near)).unwrap();
        golden.close(
            "stack of a set",
            &stack,
            &golden.array("out.stack_offset3")[start * 32..end * 32],
            FEATURE,
        );
    }
}

#[test]
fn multi_view_attention_follows_the_released_block() {
    for (name, channels) in [("mv_lowres_attn_c32", 32), ("mv_lowres_attn_c48", 48)] {
        let Some(golden) = golden(name) else { return };
        let block = MultiViewAttention::load(&golden.parameters(), "encoder.update_error_attn.0", channels).unwrap();
        let mut views = golden.views("in.x", 8, 12);
        let trace = block.trace(&views).unwrap();
        golden.close_to("out.after_norm1", &trace.folded, FEATURE);
        golden.close_to("out.after_attn_block", &trace.attended, FEATURE);
        for (smoothed, expected) in trace.smoothed.iter().zip(golden.images("out.after_conv")) {
            golden.close("after_conv", &smoothed.data, &expected.data, FEATURE);
        }
        block.forward(&mut views).unwrap();
        golden.close_to("out.y", &stage2_support::joined(&views), FEATURE);
        let odd = vec![Plane::zeros(6, 8, channels)];
        assert!(block.trace(&odd).is_err(), "sides must be multiples of four");
    }
}

#[test]
fn observation_trunk_tail_follows_the_released_modules() {
    let Some(golden) = golden("observation_trunk_tail") else {
        return;
    };
    let parameters = golden.parameters();
    let config = TrunkTailConfig {
        inputs: 20,
        repeated: 19,
        width: 32,
        attention: 16,
        blocks: 2,
        neighbours: 16,
        state: 32,
    };
    let tail = ObservationTrunkTail::load(&parameters, config).unwrap();
    let output = tail
        .forward(&golden.images("in.cat"), &golden.points("in.points"), &parameters)
        .unwrap();
    for (view, expected) in output.regressed.iter().zip(golden.images("out.regressor")) {
        golden.close("regressor", &view.data, &expected.data, FEATURE);
    }
    golden.close_to("out.proj", &output.projected, FEATURE);
    golden.close_to("out.pt", &output.attended, FEATURE);
    golden.close(
        "cond",
        &output.features,
        &stage2_support::joined(&golden.images("out.cond_features")),
        FEATURE,
    );
    golden.close(
        "state0",
        &output.state,
        &stage2_support::joined(&golden.images("out.state0")),
        STATE,
    );
}

#[test]
fn three_updates_with_colour_blocks_follow_the_released_loop() {
    let Some(golden) = golden("update_loop_quarter") else {
        return;
    };
    released_loop(&golden, ColourLayout::Blocks, (8, 12));
}

#[test]
fn three_updates_with_pixel_tokens_follow_the_released_loop() {
    let Some(golden) = golden("update_loop_full") else {
        return;
    };
    released_loop(&golden, ColourLayout::Pixels, (16, 24));
}

/// The donor's loop: error features of the same grid cell, linear scales, no gates, no bound.
fn released_loop(golden: &Golden, layout: ColourLayout, (rows, columns): (usize, usize)) {
    let device = Device::flex();
    let parameters = golden.parameters_with_own(&device, 32);
    let config = stage2_support::small_config();
    let encoder = ErrorEncoder::load_layout(&parameters, config.feature_widths, layout).unwrap();
    let updater = Updater::load(&parameters, &config).unwrap();
    let observed = golden.images("in.image");
    let maps: Vec<_> = observed
        .iter()
        .map(|image| encoder.feature_maps(image).unwrap())
        .collect();
    let features: Vec<Plane> = maps.iter().map(|maps| maps.concatenated(rows, columns)).collect();
    golden.close(
        "obs_features",
        &stage2_support::joined(&features),
        &stage2_support::joined(&golden.images("out.obs_features")),
        FEATURE,
    );

    // The state: update_proj of cond_features, resized to the token grid.
    let weight = golden.array("w.encoder.update_proj.weight");
    let bias = golden.array("w.encoder.update_proj.bias");
    let project = |view: &Plane| {
        let inputs = view.channels;
        let pixel = |pixel: &[f32]| -> Vec<f32> {
            (0..32)
                .map(|o| bias[o] + (0..inputs).map(|i| weight[o * inputs + i] * pixel[i]).sum::<f32>())
                .collect()
        };
        let data = view.data.chunks_exact(inputs).flat_map(pixel).collect();
        Plane {
            height: view.height,
            width: view.width,
            channels: 32,
            data,
        }
        .resized(rows, columns)
    };
    let states: Vec<Plane> = golden.images("in.cond_features").iter().map(project).collect();
    let mut state = stage2_support::joined(&states);
    golden.close(
        "state0",
        &state,
        &stage2_support::joined(&golden.images("out.state0")),
        STATE,
    );

    let tokens = 3 * rows * columns;
    let mut attributes = golden.attributes([
        "in.means",
        "in.scales",
        "in.rotations_unnorm_xyzw",
        "in.opacities",
        "in.sh",
    ]);
    for update in 0..3 {
        let renders = golden.images(&format!("in.render{update}"));
        if update == 0 {
            let error: Vec<f32> = renders
                .iter()
                .zip(&observed)
                .flat_map(|(a, b)| encoder.colour_error(a, b))
                .collect();
            golden.close("rgb_error_in", &error, golden.array("out.rgb_error_in0"), FEATURE);
        }
        let before = encoder.before_attention(&renders, &observed, &maps).unwrap();
        if golden.has(&format!("out.err_pre_attn{update}")) {
            golden.close_to(
                &format!("out.err_pre_attn{update}"),
                &stage2_support::joined(&before),
                FEATURE,
            );
        }
        let error = stage2_support::joined(&encoder.forward(&renders, &observed, &maps).unwrap());
        if golden.has(&format!("out.err{update}")) {
            golden.close_to(&format!("out.err{update}"), &error, FEATURE);
        }

        let points: Vec<[f32; 3]> = attributes
            .chunks_exact(59)
            .map(|row| [row[0], row[1], row[2]])
            .collect();
        let indices = nearest_neighbours(&points, 8);
        // Stored as the upstream kernel's input: the inverse activation of opacity, everything else as it is.
        let seen: Vec<f32> = attributes.clone();
        if update == 0 {
            assert_eq!(indices, golden.indices("out.knn_idx0"));
            let input = (0..tokens).flat_map(|t| {
                [
                    &seen[t * 59..t * 59 + 59],
                    &state[t * 32..t * 32 + 32],
                    &error[t * 32..t * 32 + 32],
                ]
                .concat()
            });
            golden.close_to("out.updater_in0", &input.collect::<Vec<_>>(), FEATURE);
        }
        let tensor = |values: &[f32], width: usize| from_host::<2>(values.to_vec(), [tokens, width], &device);
        let near = Neighbours::new(&indices, 8, &device);
        if update == 0 {
            let mut x = updater.embed(tensor(&seen, 59), tensor(&state, 32), tensor(&error, 32));
            golden.close_to("out.updater_lin0", &to_host(x.clone()).unwrap(), STATE);
            for block in updater.blocks() {
                x = block.forward(x, &near);
            }
            golden.close_to("out.updater_pt0", &to_host(x).unwrap(), STATE);
        }
        let output = updater.forward(tensor(&seen, 59), tensor(&state, 32), tensor(&error, 32), &near);
        state = to_host(output.state).unwrap();
        golden.close_to(&format!("out.state{}", update + 1), &state, STATE);
        let head = to_host(output.residual).unwrap();
        golden.close_to(&format!("out.head{update}"), &head, FEATURE);
        for (row, residual) in attributes.chunks_exact_mut(59).zip(head.chunks_exact(59)) {
            for (channel, (value, residual)) in row.iter_mut().zip(residual).enumerate() {
                *value += residual;
                if (3..6).contains(&channel) {
                    *value = value.max(1e-6);
                }
            }
        }
        let names =
            ["means", "scales", "rotations_unnorm", "opacities", "sh"].map(|part| format!("out.{part}{}", update + 1));
        let expected = golden.attributes([&names[0], &names[1], &names[2], &names[3], &names[4]]);
        golden.close("attributes", &attributes, &expected, FEATURE);
    }
}

#[test]
fn two_adapted_updates_follow_the_specification() {
    let Some(golden) = golden("adapted_two_updates") else {
        return;
    };
    let device = Device::flex();
    let parameters = golden.parameters();
    let config = stage2_support::small_config();
    let updater = Updater::load(&parameters, &config).unwrap();
    let gates = updater.gates_on_host().unwrap();
    let tensor = |values: Vec<f32>, width: usize| {
        let rows = values.len() / width;
        from_host::<2>(values, [rows, width], &device)
    };
    let mut state = to_host(updater.initial_state(tensor(golden.array("in.obs_features").to_vec(), 32))).unwrap();
    golden.close_to("out.state0", &state, STATE);

    let part = |name: &str, time: usize, gaussian: usize, width: usize| {
        golden.array(name)[(time * 192 + gaussian) * width..][..width].to_vec()
    };
    let raw = |time: usize, n: usize| {
        [
            part("in.color_raw", time, n, 3),
            part("in.scale_raw", time, n, 3),
            part("in.quat_raw_wxyz", time, n, 4),
            part("in.opacity_raw", time, n, 1),
        ]
        .concat()
    };
    let mut correction = Correction::zero(192);
    for update in 0..2 {
        let (before, state_before) = (correction.clone(), state.clone());
        for time in 0..2 {
            let tag = format!("r{update}_s{time}");
            let grid = TokenGrid::new(vec![2 * time, 2 * time + 1], 6, 8, &config).unwrap();
            let (mass, feedback) = golden.pooled(&tag, &grid, 32);
            for token in 0..grid.len() {
                let gaussian = grid.gaussians(token).next().unwrap();
                let expected = golden.array(&format!("out.mass_{tag}"))[gaussian];
                assert!((mass[token] - expected).abs() <= 1e-4 + 1e-4 * expected.abs());
            }
            let eligible: Vec<usize> = (0..grid.len()).filter(|&token| mass[token] > 1e-3).collect();
            let gaussians: Vec<u32> = eligible
                .iter()
                .map(|&token| grid.gaussians(token).next().unwrap() as u32)
                .collect();
            assert_eq!(gaussians, golden.indices(&format!("out.eligible_{tag}")));

            let mut attributes = vec![0.0; eligible.len() * 59];
            for (out, &n) in attributes.chunks_exact_mut(59).zip(&gaussians) {
                let n = n as usize;
                let centre: [f32; 3] = part("in.mu0", time, n, 3).try_into().unwrap();
                before.attributes(n, centre, &raw(time, n), ScaleResidual::PreActivation, out);
            }
            let state_rows: Vec<f32> = gaussians
                .iter()
                .flat_map(|&n| &state_before[n as usize * 32..][..32])
                .copied()
                .collect();
            let pooled: Vec<f32> = eligible
                .iter()
                .flat_map(|&token| &feedback[token * 32..][..32])
                .copied()
                .collect();
            golden.close_to(&format!("out.feedback_{tag}"), &pooled, FEATURE);
            if update == 0 {
                let rows = attributes
                    .chunks_exact(59)
                    .zip(state_rows.chunks_exact(32))
                    .zip(pooled.chunks_exact(32));
                let input: Vec<f32> = rows.flat_map(|((a, s), f)| [a, s, f].concat()).collect();
                golden.close_to(&format!("out.updater_in_{tag}"), &input, FEATURE);
            }
            let points: Vec<[f32; 3]> = attributes
                .chunks_exact(59)
                .map(|row| [row[0], row[1], row[2]])
                .collect();
            let near = Neighbours::new(&nearest_neighbours(&points, 8), 8, &device);
            let output = updater.forward(
                tensor(attributes, 59),
                tensor(state_rows, 32),
                tensor(pooled, 32),
                &near,
            );
            let head = to_host(output.residual).unwrap();
            golden.close_to(&format!("out.head_{tag}"), &head, FEATURE);
            let new_state = to_host(output.state).unwrap();
            for (row, &n) in gaussians.iter().enumerate() {
                correction.add(n as usize, &head[row * 59..][..59], gates);
                state[n as usize * 32..][..32].copy_from_slice(&new_state[row * 32..][..32]);
            }
        }
        let delta: Vec<f32> = (0..192)
            .flat_map(|n| stage2_support::delta_iu(correction.row(n)))
            .collect();
        golden.close_to(&format!("out.delta_{}", update + 1), &delta, FEATURE);
        golden.close_to(&format!("out.state{}", update + 1), &state, STATE);
    }
    // The corrected field at every query time, whether it is a source time or not.
    for time in 0..3 {
        for n in 0..192 {
            let centre: [f32; 3] = part("in.mu0", time, n, 3).try_into().unwrap();
            let mut seen = [0.0; 59];
            correction.attributes(n, centre, &raw(time, n), ScaleResidual::PreActivation, &mut seen);
            let expected = |name: &str, width: usize| {
                golden.array(&format!("out.field_t{time}.{name}"))[n * width..][..width].to_vec()
            };
            golden.close("means", &seen[..3], &expected("means", 3), FEATURE);
            let scales: Vec<f32> = seen[3..6]
                .iter()
                .map(|&raw| rogs_networks::stage2::correction::activated_scale(raw))
                .collect();
            golden.close("scales", &scales, &expected("scales", 3), FEATURE);
            let norm = seen[6..10].iter().map(|v| v * v).sum::<f32>().sqrt();
            let quat: Vec<f32> = seen[6..10].iter().map(|v| v / norm).collect();
            golden.close("quats", &quat, &expected("quats_wxyz", 4), FEATURE);
            golden.close(
                "opacity",
                &[1.0 / (1.0 + (-seen[10]).exp())],
                &expected("opacities", 1),
                FEATURE,
            );
            golden.close("sh", &seen[11..], &expected("sh", 48), FEATURE);
        }
    }
}

#[test]
fn parameter_names_and_shapes_are_those_of_the_released_refiner() {
    let Some(table) = stage2_support::text("state_dict_full.tsv") else {
        return;
    };
    let shapes = parameter_shapes(&RefinerConfig::preset("paper").unwrap());
    let mut listed = 0;
    for line in table.lines().skip(1) {
        let fields: Vec<&str> = line.split('\t').collect();
        let (name, shape) = (fields[0], fields[2]);
        if name.ends_with("num_batches_tracked") || name.starts_with("encoder.update_proj.") {
            assert!(!shapes.contains_key(name));
            continue;
        }
        let expected = shapes.get(name).unwrap_or_else(|| panic!("`{name}` is missing"));
        assert_eq!(
            format!(
                "[{}]",
                expected.iter().map(ToString::to_string).collect::<Vec<_>>().join(",")
            ),
            shape,
            "{name}"
        );
        listed += 1;
    }
    // 141 tensors, 12 of them counters or the donor's state projection; three are this project's.
    assert_eq!((listed, shapes.len()), (129, 132), "names beside the released ones");
}
