//! The Stage-2 refiner against golden vectors of the released modules and of the specified adaptation.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod support;

use burn::tensor::Device;
use rogs_needs::needs;
use rogs_stage2::error_encoder::ColourLayout;
use rogs_stage2::mv_attention::MultiViewAttention;
use rogs_stage2::observation::{ObservationTrunkTail, TrunkTailConfig};
use rogs_stage2::{FeatureMap, RefinerConfig, ResNetFront, parameter_shapes};
use support::{FEATURE, STATE, golden, updates};

#[needs(shared)]
#[test]
fn resnet_front_gives_the_three_maps() {
    let golden = golden("resnet18_front");
    let front = ResNetFront::load(&golden.parameters(&Device::flex()), "encoder.update_feature", [64, 128]).unwrap();
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
    assert!(front.forward(&FeatureMap::zeros(4, 4, 1)).is_err());
}

#[test]
fn neighbour_attention_follows_the_released_blocks() {
    let golden = golden("point_transformer");
    updates::neighbour_blocks(&golden, &Device::flex());
}

#[needs(shared)]
#[test]
fn multi_view_attention_follows_the_released_block() {
    for (name, channels) in [("mv_lowres_attn_c32", 32), ("mv_lowres_attn_c48", 48)] {
        let golden = golden(name);
        let block = MultiViewAttention::load(
            &golden.parameters(&Device::flex()),
            "encoder.update_error_attn.0",
            channels,
        )
        .unwrap();
        let mut views = golden.views("in.x", 8, 12);
        let trace = block.trace(&views).unwrap();
        golden.close_to("out.after_norm1", &trace.folded, FEATURE);
        golden.close_to("out.after_attn_block", &trace.attended, FEATURE);
        for (smoothed, expected) in trace.smoothed.iter().zip(golden.images("out.after_conv")) {
            golden.close("after_conv", &smoothed.data, &expected.data, FEATURE);
        }
        block.forward(&mut views).unwrap();
        golden.close_to("out.y", &support::joined(&views), FEATURE);
        let odd = vec![FeatureMap::zeros(6, 8, channels)];
        assert!(block.trace(&odd).is_err(), "sides must be multiples of four");
    }
}

#[needs(shared)]
#[test]
fn observation_trunk_tail_follows_the_released_modules() {
    let golden = golden("observation_trunk_tail");
    let parameters = golden.parameters(&Device::flex());
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
        &support::joined(&golden.images("out.cond_features")),
        FEATURE,
    );
    golden.close(
        "state0",
        &output.state,
        &support::joined(&golden.images("out.state0")),
        STATE,
    );
}

#[needs(shared)]
#[test]
fn three_updates_with_colour_blocks_follow_the_released_loop() {
    let golden = golden("update_loop_quarter");
    updates::released_loop(&golden, ColourLayout::Blocks, (8, 12), &Device::flex());
}

#[needs(shared)]
#[test]
fn three_updates_with_pixel_tokens_follow_the_released_loop() {
    let golden = golden("update_loop_full");
    updates::released_loop(&golden, ColourLayout::Pixels, (16, 24), &Device::flex());
}

#[test]
fn two_adapted_updates_follow_the_specification() {
    let golden = golden("adapted_two_updates");
    updates::adapted_updates(&golden, &Device::flex());
}

#[test]
fn parameter_names_and_shapes_are_those_of_the_released_refiner() {
    let table = support::text("state_dict_full.tsv");
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
