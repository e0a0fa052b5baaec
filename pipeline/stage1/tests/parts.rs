//! Parts of the Stage-1 network against reference vectors.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod support;

use burn::tensor::{Device, Tensor};
use rogs_field::attributes;
use rogs_geometry::Pose;
use rogs_kernels::RotaryTable;
use rogs_needs::needs;
use rogs_stage1::adapter::{LatentAdapter, to_token_cells};
use rogs_stage1::geometry::encode_time;
use rogs_stage1::positions::head_positions;
use rogs_stage1::{Attention, HeadKind, Stage1, decode, distillation};
use rogs_tensors::ops::{Linear, Rotary, standardise};
use rogs_tensors::parameters::{Parameters, from_host};
use rogs_vit::{PositionGrid, resampling_matrix};
use support::{Golden, close, host, tiny};

#[test]
fn geometry() {
    let golden = Golden::open("geometry");
    let cameras = golden.cameras("C2W", "fxfycxcy");
    let mut rays = Vec::new();
    for (index, camera) in cameras.iter().enumerate() {
        rays.extend(camera.ray_map(6, 10));
        let found = camera.pose_numbers();
        let expected = &golden.values("pose_encoding")[9 * index..][..9];
        // The quaternion of a half turn is only defined up to its sign.
        let same: f32 = (3..7).map(|k| found[k] * expected[k]).sum();
        let sign = if same < 0.0 && expected[6].abs() < 1e-6 {
            -1.0
        } else {
            1.0
        };
        let expected: Vec<f32> = (0..9)
            .map(|k| {
                if (3..7).contains(&k) {
                    sign * expected[k]
                } else {
                    expected[k]
                }
            })
            .collect();
        close(&format!("pose_encoding {index}"), &found, &expected, 2e-6);
        let points = camera.unproject(&golden.values("depth")[60 * index..][..60], 6, 10);
        let planar: Vec<f32> = (0..180).map(|k| points[(k % 60) * 3 + k / 60]).collect();
        close(
            &format!("unprojected_xyz {index}"),
            &planar,
            &golden.values("unprojected_xyz")[180 * index..][..180],
            2e-6,
        );
    }
    close("plucker_6x10", &rays, golden.values("plucker_6x10"), 2e-6);
    let times: Vec<f32> = golden
        .values("time")
        .iter()
        .flat_map(|&time| encode_time(time, 10))
        .collect();
    close("time_encoding", &times, golden.values("time_encoding"), 1e-6);
}

#[test]
fn dino_pos_interp() {
    let golden = Golden::open("dino_pos_interp");
    let cases = [
        ("a.pos_embed_37x37", "a.out_11x20", 37, [11, 20]),
        ("b.pos_embed_5x5", "b.out_2x3", 5, [2, 3]),
        ("c.pos_embed_5x5", "c.out_8x6", 5, [8, 6]),
    ];
    for (table, expected, side, grid) in cases {
        let width = golden.shape(table)[2];
        let table = golden.values(table);
        let device = Device::flex();
        let matrix: Tensor<2> = from_host(
            resampling_matrix(side, grid, PositionGrid::Antialiased),
            [grid[0] * grid[1], side * side],
            &device,
        );
        let grid_rows: Tensor<2> = from_host(table[width..].to_vec(), [side * side, width], &device);
        close(
            expected,
            &host(matrix.matmul(grid_rows)),
            &golden.values(expected)[width..],
            5e-6,
        );
    }
}

#[test]
fn dpt_pos_embed() {
    let golden = Golden::open("dpt_pos_embed");
    let cases = [
        ("emb_11x20_c16_img154x280", 16, [11, 20], 280.0 / 154.0),
        ("emb_6x10_c8_img154x280", 8, [6, 10], 280.0 / 154.0),
        ("emb_44x80_c4_img154x280", 4, [44, 80], 280.0 / 154.0),
        ("emb_2x3_c8_img28x42", 8, [2, 3], 42.0 / 28.0),
    ];
    for (name, channels, grid, aspect) in cases {
        let map = head_positions(channels, grid, aspect);
        let area = grid[0] * grid[1];
        let interleaved: Vec<f32> = (0..map.len())
            .map(|k| map[(k % channels) * area + k / channels])
            .collect();
        close(name, &interleaved, golden.values(name), 1e-6);
    }
}

#[test]
fn rope_head64() {
    let golden = Golden::open("rope_head64");
    let device = Device::flex();
    let positions: Vec<[usize; 2]> = golden
        .values("pos")
        .chunks_exact(2)
        .map(|p| [p[0] as usize, p[1] as usize])
        .collect();
    let rotary = Rotary::new(RotaryTable::new(&positions, 64), &device);
    let rotated = rotary.apply(golden.tensor("x", [1, 2, 227, 64], &device));
    close("rope y", &host(rotated), golden.values("y"), 2e-6);
}

#[test]
fn block_detail() {
    let device = Device::flex();
    let golden = Golden::open("block_detail");
    let network = tiny(&device);
    let block = network.aggregator().block("frame_blocks", 0).unwrap();
    let rotary = network.aggregator().rotary([2, 3]);
    let input = golden.tensor("x", [2, 13, 64], &device);
    let [query, key, value] = block.queries_keys_values(input.clone(), Some(&rotary));
    close("q_rope", &host(query), golden.values("q_rope"), 5e-6);
    close("k_rope", &host(key), golden.values("k_rope"), 5e-6);
    let packed = golden
        .tensor::<3>("qkv", [2, 13, 192], &device)
        .narrow(2, 128, 64)
        .reshape([2, 13, 4, 16]);
    close("v", &host(value), &host(packed.swap_dims(1, 2)), 5e-6);
    close(
        "after_attn",
        &host(block.attend(input.clone(), Some(&rotary))),
        golden.values("after_attn"),
        5e-6,
    );
    close(
        "y",
        &host(block.forward(input, Some(&rotary))),
        golden.values("y"),
        5e-6,
    );
}

#[test]
fn project_blocked_attention() {
    let device = Device::flex();
    let golden = Golden::open("project_blocked_attention");
    let network = tiny(&device);
    let tokens = golden.tensor::<3>("tokens_in", [4, 13, 64], &device);
    let cameras: Vec<u32> = golden
        .values("camera_of_frame")
        .iter()
        .map(|&camera| camera as u32)
        .collect();
    let joint = network
        .aggregator()
        .forward(tokens.clone(), [2, 3], &Attention::Joint)
        .unwrap();
    close(
        "agg3_unblocked",
        &host(joint[3].clone()),
        golden.values("agg3_unblocked"),
        1e-5,
    );
    let blocked = network
        .aggregator()
        .forward(tokens.clone(), [2, 3], &Attention::WithinCamera(cameras))
        .unwrap();
    close(
        "agg0_blocked",
        &host(blocked[0].clone()),
        golden.values("agg0_blocked"),
        1e-5,
    );
    close(
        "agg3_blocked",
        &host(blocked[3].clone()),
        golden.values("agg3_blocked"),
        1e-5,
    );
    let one = network
        .aggregator()
        .forward(tokens, [2, 3], &Attention::WithinCamera(vec![2; 4]))
        .unwrap();
    assert_eq!(
        host(one[3].clone()),
        host(joint[3].clone()),
        "blocking with one camera changes nothing"
    );
}

#[test]
fn activations() {
    let golden = Golden::open("activations");
    let each =
        |name: &str, function: fn(f32) -> f32| golden.values(name).iter().map(|&raw| function(raw)).collect::<Vec<_>>();
    close("color", &each("raw", attributes::colour), golden.values("color"), 1e-6);
    close(
        "opacity",
        &each("raw", attributes::opacity),
        golden.values("opacity"),
        1e-6,
    );
    for (input, output) in [("raw", "scale"), ("scale_big_in", "scale_big_out")] {
        let ratio: Vec<f32> = each(input, attributes::scale_iu)
            .iter()
            .zip(golden.values(output))
            .map(|(a, b)| a / b)
            .collect();
        close(output, &ratio, &vec![1.0; ratio.len()], 1e-6);
    }
    close(
        "depth",
        &each("depth_in", decode::depth_iu),
        golden.values("depth_out"),
        1e-6,
    );
    let quaternions: Vec<f32> = golden
        .values("quat_in")
        .chunks_exact(4)
        .flat_map(|q| attributes::rotation([q[0], q[1], q[2], q[3]]))
        .collect();
    close("quat", &quaternions, golden.values("quat_out"), 1e-6);
    let raw = golden.values("raw");
    let planes: Vec<f32> = (0..11).flat_map(|_| raw.iter().copied()).collect();
    let tensors = host(decode::activate_attributes(from_host(
        planes,
        [1, 11, 1, raw.len()],
        &Device::flex(),
    )));
    close("color as tensors", &tensors[..raw.len()], golden.values("color"), 1e-6);
    close(
        "scale as tensors",
        &tensors[3 * raw.len()..4 * raw.len()],
        golden.values("scale"),
        1e-8,
    );
    close(
        "opacity as tensors",
        &tensors[10 * raw.len()..],
        golden.values("opacity"),
        1e-6,
    );
}

#[needs(shared)]
#[test]
fn head_motion_head_by_stages() {
    let device = Device::flex();
    let golden = Golden::open("head_motion_head");
    let forward = Golden::open("full_forward");
    let network = tiny(&device);
    let encoded = network.encode(&support_frames(&forward, &device)).unwrap();
    let head = network.head(HeadKind::Motion).unwrap();
    close(
        "time_embed.t1",
        &host(head.modulation(Some(0.3125)).unwrap()),
        golden.values("time_embed.t1"),
        1e-5,
    );
    check_stages(&golden, ".t1", 1e-5, |observe| {
        let projections = head.projections(Some(0.3125));
        let _ = head.forward_observed(&projections, &encoded, observe);
    });
}

#[needs(shared)]
#[test]
fn head_depth_and_splat_by_stages() {
    let device = Device::flex();
    let forward = Golden::open("full_forward");
    let network = tiny(&device);
    let encoded = network.encode(&support_frames(&forward, &device)).unwrap();
    for (kind, name, tolerance) in [
        (HeadKind::Depth, "head_depth_head", 1e-5),
        (HeadKind::Splat, "head_splat_head", 2e-5),
    ] {
        let golden = Golden::open(name);
        let head = network.head(kind).unwrap();
        check_stages(&golden, "", tolerance, |observe| {
            let _ = head.forward_observed(&head.projections(None), &encoded, observe);
        });
        if let Some(shortcut) = head.shortcut(forward.tensor("in.images", [4, 3, 28, 42], &device)) {
            close("shortcut", &host(shortcut), golden.values("shortcut"), tolerance);
        }
    }
}

#[needs(shared)]
#[test]
fn head_motion_splat_by_stages() {
    let device = Device::flex();
    let forward = Golden::open("full_forward");
    let golden = Golden::open("head_motion_splat_head");
    let network = tiny(&device);
    let encoded = network.encode(&support_frames(&forward, &device)).unwrap();
    let head = network.head(HeadKind::MotionSplat).unwrap();
    close(
        "time_embed.t1",
        &host(head.modulation(Some(0.3125)).unwrap()),
        golden.values("time_embed.t1"),
        1e-5,
    );
    check_stages(&golden, ".t1", 2e-5, |observe| {
        let _ = head.forward_observed(&head.projections(Some(0.3125)), &encoded, observe);
    });
    let raw = |name: &str, channels: usize| forward.tensor::<4>(name, [4, channels, 28, 42], &device);
    let base = Tensor::cat(
        vec![
            raw("out.color", 3),
            raw("out.scale", 3),
            raw("out.rotation", 4),
            raw("out.opacity", 1),
        ],
        1,
    );
    close(
        "shortcut.t1",
        &host(head.shortcut(base).unwrap()),
        golden.values("shortcut.t1"),
        2e-5,
    );
}

fn check_stages(golden: &Golden, suffix: &str, tolerance: f32, run: impl FnOnce(&mut dyn FnMut(&str, &Tensor<4>))) {
    let mut seen = 0;
    run(&mut |name, tensor| {
        let name = format!("{name}{suffix}");
        if golden.has(&name) {
            seen += 1;
            close(&name, &host(tensor.clone()), golden.values(&name), tolerance);
        }
    });
    let stages = golden
        .names()
        .filter(|name| !name.starts_with("time_embed") && !name.starts_with("shortcut"))
        .count();
    assert_eq!(seen, stages, "every stage of the reference is compared");
}

fn support_frames(golden: &Golden, device: &Device) -> rogs_stage1::SourceFrames {
    rogs_stage1::SourceFrames {
        images: golden.tensor("in.images", [4, 3, 28, 42], device),
        cameras: golden.cameras("in.C2W", "in.fxfycxcy"),
        recon_from_base_iu: Pose::IDENTITY,
        times: golden.values("in.input_timesteps").to_vec(),
        attention: Attention::Joint,
    }
}

#[needs(shared)]
#[test]
fn project_latent_adapter() {
    let device = Device::flex();
    let golden = Golden::open("project_latent_adapter");
    let parameters = golden.parameters("adapter.", &device);
    let adapter = LatentAdapter::new(parameters.scope("adapter"), 64, 4);
    let latent = golden.tensor::<4>("latent", [4, 48, 4, 6], &device);
    close(
        "patch",
        &host(adapter.patches(latent.clone()).unwrap()),
        golden.values("patch"),
        1e-5,
    );
    close(
        "tokens",
        &host(adapter.forward(latent.clone()).unwrap()),
        golden.values("tokens"),
        1e-5,
    );
    let repeated = host(to_token_cells(latent.clone(), [4, 6]).unwrap());
    assert_eq!(
        (repeated.len(), repeated[0], repeated[13]),
        (4 * 48 * 8 * 12, host(latent.clone())[0], host(latent.clone())[0])
    );
    assert!(to_token_cells(latent, [5, 6]).is_err());
}

/// The losses of the adapter against the same terms computed with PyTorch.
#[test]
fn adapter_distillation() {
    let device = Device::flex();
    let golden = Golden::open("latent_adapter_io");
    let number = |value: Tensor<1>| host(value)[0];
    let item = |name: &str, index: usize| {
        let whole = golden.tensor::<3>(name, [2, 12, 16], &device);
        whole.narrow(0, index, 1)
    };
    for index in 0..2 {
        let terms = distillation::tokens(item("tok.pred", index), item("tok.target", index));
        for (name, value) in [
            ("tok.mse", terms.square),
            ("tok.distmat", terms.pairs),
            ("tok.cos", terms.direction),
        ] {
            close(name, &[number(value)], &golden.values(name)[index..=index], 1e-6);
        }
    }
    let taps = |name: &str| {
        [0, 1].map(|tap| {
            let raw = golden.tensor::<3>(&format!("feat.{name}{tap}"), [2, 12, 32], &device);
            standardise(raw, 1e-5)
        })
    };
    let feature = number(distillation::features(&taps("pred"), &taps("target")));
    close("loss.feature", &[feature], golden.values("loss.feature"), 1e-6);
    let depth = |name: &str| golden.tensor::<3>(name, [2, 10, 12], &device).log();
    let depth = number(distillation::log_depth(depth("depth.pred"), depth("depth.target")));
    close("loss.log_depth", &[depth], golden.values("loss.log_depth"), 1e-6);
    let whole = |name: &str| golden.tensor::<3>(name, [2, 12, 16], &device);
    let token = number(distillation::tokens(whole("tok.pred"), whole("tok.target")).square);
    close(
        "loss.total",
        &[feature + depth + 0.1 * token],
        golden.values("loss.total"),
        2e-6,
    );
}

#[test]
fn project_lora() {
    let device = Device::flex().autodiff();
    let golden = Golden::open("project_lora");
    let network = tiny(&device);
    let name = "backbone.backbone.frame_blocks.0.attn";
    let mut parameters = network.parameters;
    for (layer, part) in [("qkv", "A"), ("qkv", "B"), ("proj", "A"), ("proj", "B")] {
        let source = if layer == "qkv" {
            part.to_owned()
        } else {
            format!("block.proj_{part}")
        };
        let full = format!("{name}.{layer}.lora_{part}.weight");
        parameters
            .insert(&full, golden.shape(&source), golden.values(&source).to_vec())
            .unwrap();
        let leaf = parameters.memory_mut().get_mut(&full).unwrap();
        leaf.values = leaf.values.clone().require_grad();
    }
    let layer = Linear::load(&parameters.scope(&format!("{name}.qkv")), 192, 64).unwrap();
    let y = layer.forward(golden.tensor::<2>("x", [5, 64], &device));
    close("y", &host(y.clone()), golden.values("y"), 1e-5);
    let grads = (y * golden.tensor::<2>("loss_weight", [5, 192], &device))
        .mean()
        .backward();
    for part in ["A", "B"] {
        let leaf = &parameters.memory()[&format!("{name}.qkv.lora_{part}.weight")].values;
        close(
            &format!("grad_{part}"),
            &host(leaf.grad(&grads).unwrap()),
            golden.values(&format!("grad_{part}")),
            1e-5,
        );
    }
    // The block, with the updates trained beside the weights and folded into them.
    let network = Stage1::new(support::tiny_config(), parameters).unwrap();
    let run = |network: &Stage1, device: &Device| {
        let tokens = golden.tensor::<3>("block.tokens_in", [4, 13, 64], device);
        let rotary = network.aggregator().rotary([2, 3]);
        host(
            network
                .aggregator()
                .block("frame_blocks", 0)
                .unwrap()
                .forward(tokens, Some(&rotary)),
        )
    };
    close(
        "block.out beside",
        &run(&network, &device),
        golden.values("block.out"),
        1e-5,
    );
    let folded = tiny_with(&network, &Device::flex());
    close(
        "block.out folded",
        &run(&folded, &Device::flex()),
        golden.values("block.out"),
        1e-5,
    );
}

/// The same parameters on another device.
fn tiny_with(network: &Stage1, device: &Device) -> Stage1 {
    let mut parameters = Parameters::new(device);
    for name in network.parameters.names() {
        let shape = network.parameters.shape(&name).unwrap().to_vec();
        parameters
            .insert(&name, &shape, network.parameters.host(&name).unwrap())
            .unwrap();
    }
    Stage1::new(network.config.clone(), parameters).unwrap()
}
