//! Lifting of small clips made here: what a field contains, the interventions, queries, determinism.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod support;

use rogs_geometry::{LinkPoses, Pose};
use rogs_lift::{
    CrossCamera, FieldQuery, LiftParams, Model, MotionOptions, ProductPrecision, RobotAtTime, RobotMotion, lift_clip,
    load_model,
};
use rogs_schemas::FrameIndex;
use rogs_schemas::records::clip::DepthReference;
use rogs_schemas::records::field::{Field, GATE_ATTRIBUTES, RAW_CHANNELS};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::records::robot::NO_LINK;
use rogs_stage1::held::HeldPath;
use rogs_weights::Unfiled;
use rogs_worker::Unobserved;
use support::{FRAMES, Inputs, MESH_DEPTH_M, small_clip};

const HEIGHT: usize = 28;
const WIDTH: usize = 42;
const AREA: usize = HEIGHT * WIDTH;

/// Two cameras that see the robot, asked for frames 1 and 4 as well.
fn inputs() -> Inputs {
    small_clip([HEIGHT, WIDTH], &["wrist", "ext1"], &[1, 4], &robot_pixels())
}

fn robot_pixels() -> Vec<u32> {
    (0..AREA as u32)
        .filter(|pixel| (10..18).contains(&(pixel / WIDTH as u32)) && (15..25).contains(&(pixel % WIDTH as u32)))
        .collect()
}

/// The same parameters for a network of random weights.
fn seeded(params: &LiftParams) -> LiftParams {
    LiftParams {
        weights: Some(Unfiled::Seeded),
        ..params.clone()
    }
}

fn model(params: &LiftParams) -> Model {
    load_model(&seeded(params), None).unwrap()
}

/// A model whose motion and FK branch are not zero, as after some training.
fn moving_model() -> Model {
    let model = model(&LiftParams::default());
    let names = [
        "backbone.motion_head.time_embed.weight",
        "backbone.motion_head.scratch.output_conv2.2.weight",
        "fk_branch.conv3.weight",
    ];
    let mut network = model.network;
    for name in names {
        let shape = network.parameters.shape(name).unwrap().to_vec();
        let count: usize = shape.iter().product();
        let values = (0..count)
            .map(|k| (((k * 7919) % 113) as f32 / 113.0 - 0.5) * 0.02)
            .collect();
        network.parameters.insert(name, &shape, values).unwrap();
    }
    Model {
        network,
        info: model.info,
        domain: None,
        made_for: None,
    }
}

/// The same model where all that the gripper can reach is held.
fn holding_model() -> Model {
    let mut model = moving_model();
    for spec in rogs_stage1::layout::held() {
        let value = if spec.name == "held.conv3.bias" { 30.0 } else { 0.0 };
        let values = vec![value; spec.len()];
        model
            .network
            .parameters
            .insert(&spec.name, &spec.shape, values)
            .unwrap();
    }
    model
}

fn lift_with(model: &Model, params: &LiftParams, inputs: &Inputs) -> Field {
    lift_clip(model, params, inputs.all(), &mut Unobserved).unwrap()
}

#[test]
fn a_seeded_field_is_a_plausible_still_picture() {
    let inputs = inputs();
    let params = LiftParams::default();
    let field = lift_with(&model(&params), &params, &inputs);
    assert_eq!(field.len(), 4 * AREA);
    assert!(!field.weights.trained && field.weights.description.contains("seed 73"));
    assert_eq!(
        field.slices.iter().map(|slice| slice.time).collect::<Vec<_>>(),
        [0.0, 0.25, 1.0]
    );
    assert!(
        field
            .slices
            .iter()
            .all(|slice| slice.displacement_m.iter().all(|&d| d == 0.0) && slice.moving_raw.is_empty())
    );
    let rgb = inputs.clip.cameras[0].recorded.as_ref().unwrap();
    for pixel in 0..AREA {
        let (z, raw) = (
            field.position_m[3 * pixel + 2],
            &field.base_raw[RAW_CHANNELS * pixel..][..RAW_CHANNELS],
        );
        if field.support[pixel] != 0 {
            assert!((z - MESH_DEPTH_M).abs() < 1e-6, "anchored pixels lie on the mesh");
            assert!((field.scale_cap_iu[pixel] - 1.5 * 3.5 * MESH_DEPTH_M / 30.0).abs() < 1e-6);
        } else {
            assert!((0.5..2.0).contains(&z) && field.link[pixel] == NO_LINK && field.scale_cap_iu[pixel].is_infinite());
        }
        for channel in 0..3 {
            let color = rogs_field::attributes::colour(raw[channel]);
            assert!(
                (color - f32::from(rgb[3 * pixel + channel]) / 255.0).abs() < 0.12,
                "pixel {pixel} channel {channel}"
            );
        }
    }
    assert_eq!(
        field.support.iter().filter(|&&support| support != 0).count(),
        4 * robot_pixels().len()
    );
}

#[test]
fn bf16_products_are_a_parameter_and_change_little() {
    let inputs = inputs();
    let plain = LiftParams::default();
    let rounded = LiftParams {
        precision: ProductPrecision::Bf16,
        ..LiftParams::default()
    };
    let exact = lift_with(&model(&plain), &plain, &inputs);
    let rounded = lift_with(&model(&rounded), &rounded, &inputs);
    assert_ne!(rounded.position_m, exact.position_m);
    for (a, b) in rounded.position_m.iter().zip(&exact.position_m) {
        assert!((a - b).abs() < 0.02, "{a} {b}");
    }
}

#[test]
fn interventions_change_what_they_say_and_nothing_else() {
    let inputs = inputs();
    let model = moving_model();
    let base = lift_with(&model, &LiftParams::default(), &inputs);
    let with = |change: &dyn Fn(&mut LiftParams)| {
        let mut params = LiftParams::default();
        change(&mut params);
        lift_with(&model, &params, &inputs)
    };
    let free = with(&|params| params.anchoring = false);
    assert!(free.support.iter().all(|&support| support == 0) && free.scale_cap_iu.iter().all(|cap| cap.is_infinite()));
    assert_eq!(free.base_raw, base.base_raw);
    assert_ne!(free.position_m, base.position_m);
    assert_ne!(
        free.slices, base.slices,
        "the FK displacement is taken at the learned depth"
    );

    let uncapped = with(&|params| params.footprint_px = None);
    assert!(uncapped.scale_cap_iu.iter().all(|cap| cap.is_infinite()));
    assert_eq!(
        (&uncapped.position_m, &uncapped.slices),
        (&base.position_m, &base.slices)
    );

    let unconditioned = with(&|params| params.fk_conditioning = false);
    assert_eq!(
        (&unconditioned.position_m, &unconditioned.base_raw),
        (&base.position_m, &base.base_raw)
    );
    assert_ne!(unconditioned.slices, base.slices);

    let blocked = with(&|params| params.attention = CrossCamera::WithinCamera);
    assert_ne!(blocked.base_raw, base.base_raw);

    let coarse = with(&|params| params.rgb_downsample = 8);
    assert_ne!(coarse.base_raw, base.base_raw);

    let fewer = with(&|params| params.source_frames = Some(vec![FrameIndex(4)]));
    assert_eq!((fewer.views.len(), fewer.len()), (2, 2 * AREA));

    let gated = with(&|params| params.motion_gate_iu = 1e9);
    let open = |field: &Field| {
        field.slices[1]
            .gate
            .iter()
            .filter(|&&gate| gate & GATE_ATTRIBUTES != 0)
            .count()
    };
    assert!(open(&base) > 0 && open(&gated) == 0);
    assert_eq!(
        gated.slices[1].displacement_m, base.slices[1].displacement_m,
        "the displacement is never gated"
    );
}

#[test]
fn kinematic_transport_moves_robot_pixels_with_their_link() {
    let inputs = inputs();
    let params = LiftParams {
        robot_motion: RobotMotion::Kinematics,
        ..LiftParams::default()
    };
    let field = lift_with(&model(&params), &params, &inputs);
    let slice = field.slice_at(1.0).unwrap();
    let raw = rogs_field::raw_at(&field, slice);
    for pixel in 0..AREA {
        let d = &slice.displacement_m[3 * pixel..][..3];
        if field.support[pixel] == 0 {
            assert_eq!(d, [0.0; 3]);
            continue;
        }
        // The conditioning of the test says 0.07 iu per frame from frame 0 to 4.
        assert!(
            (d[0] - 0.28 / 3.5).abs() < 1e-6 && (d[1] - 0.01 / 3.5).abs() < 1e-6,
            "{d:?}"
        );
        let (turned, base) = (
            &raw[RAW_CHANNELS * pixel..][..RAW_CHANNELS],
            &field.base_raw[RAW_CHANNELS * pixel..][..RAW_CHANNELS],
        );
        assert_eq!((&turned[..6], turned[10]), (&base[..6], base[10]));
        // 0.4 rad about z: (cos 0.2, 0, 0, sin 0.2) * q.
        let expected = 0.2f32.cos() * base[6] - 0.2f32.sin() * base[9];
        assert!((turned[6] - expected).abs() < 1e-5);
    }
}

#[test]
fn queries_answer_stored_times_exactly_and_others_in_between() {
    let inputs = inputs();
    let model = moving_model();
    let params = LiftParams {
        fk_conditioning: false,
        ..LiftParams::default()
    };
    let field = lift_with(&model, &params, &inputs);
    let query = FieldQuery::new(
        &field,
        &model.network,
        MotionOptions {
            gates: params.gates(),
            robot_motion: params.robot_motion,
        },
    )
    .unwrap();
    for stored in &field.slices {
        assert_eq!(&query.at(stored.time, &[]).unwrap(), stored);
    }
    let between = query.at(0.37, &[]).unwrap();
    assert!(between.displacement_m != field.slices[1].displacement_m);
    assert!(query.at(1.5, &[]).unwrap_err().to_string().contains("outside"));
    let dropped = Field {
        query_state: Vec::new(),
        ..field
    };
    assert!(
        FieldQuery::new(
            &dropped,
            &model.network,
            MotionOptions {
                gates: params.gates(),
                robot_motion: params.robot_motion
            }
        )
        .is_err()
    );
}

/// Points of a body that is rigid to link 1 stay in its frame, as far as the gripper reaches; by the formula of the clip.
#[test]
fn what_the_gripper_holds_follows_it() {
    let turned = |frame: f64, [x, y, z]: [f64; 3]| {
        let (s, c) = (0.1 * frame).sin_cos();
        [c * x - s * y + 0.02 * frame, s * x + c * y, z]
    };
    let back = |frame: f64, [x, y, z]: [f64; 3]| {
        let ((s, c), x) = ((0.1 * frame).sin_cos(), x - 0.02 * frame);
        [c * x + s * y, c * y - s * x, z]
    };
    let tool = [-0.35, 0.0, 1.0];
    let mut inputs = inputs();
    inputs.robot.tool_m = (0..FRAMES).flat_map(|frame| turned(frame as f64, tool)).collect();
    inputs.clip.robot.gripper = vec![0.5; FRAMES];
    let params = LiftParams::default();
    let (plain, held) = (moving_model(), holding_model());
    let (still, field) = (lift_with(&plain, &params, &inputs), lift_with(&held, &params, &inputs));
    assert!(field.position_m == still.position_m && field.base_raw == still.base_raw);
    let distance = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
    let (mut followed, mut beyond) = (0, 0);
    for (slice, without) in field.slices.iter().zip(&still.slices) {
        let query = slice.time * (FRAMES - 1) as f64;
        for gaussian in 0..field.len() {
            let of = |values: &[f32]| [0, 1, 2].map(|axis| f64::from(values[3 * gaussian + axis]));
            let source = field.views[gaussian / AREA].frame.at() as f64;
            let place = of(&field.position_m);
            let moved = turned(query, back(source, place));
            let left = ((0.3 - distance(place, turned(source, tool))) / 0.15).clamp(0.0, 1.0);
            let supported = field.support[gaussian] != 0;
            let share = if supported {
                0.0
            } else {
                left * left * (3.0 - 2.0 * left)
            };
            let (with, without) = (of(&slice.displacement_m), of(&without.displacement_m));
            for axis in 0..3 {
                let expected = share * (moved[axis] - place[axis]);
                let found = with[axis] - without[axis];
                assert!(
                    (found - expected).abs() < 1e-5,
                    "{gaussian} {axis}: {found}, not {expected}"
                );
                assert!(share > 0.0 || with[axis] == without[axis]);
            }
            followed += usize::from(share == 1.0 && distance(moved, place) > 0.01);
            beyond += usize::from(share == 0.0 && !supported);
        }
    }
    assert!(followed > 20 && beyond > 500, "{followed} {beyond}");

    // At a stored time a query is told the same and gives the same.
    let options = MotionOptions {
        gates: params.gates(),
        robot_motion: params.robot_motion,
    };
    let path = HeldPath::of_clip(&inputs.robot, &inputs.clip.robot.gripper)
        .unwrap()
        .unwrap();
    let query = FieldQuery::new(&field, &held.network, options).unwrap();
    let at = |frame: FrameIndex| LinkPoses::at_frame(&inputs.robot, frame).unwrap();
    for (index, slice) in field.slices.iter().enumerate() {
        let frame = inputs.conditioning.query_frames[index];
        let robot = field.views.iter().enumerate().map(|(view, seen)| {
            let motions = at(frame).motion_from(&at(seen.frame));
            let robot = RobotAtTime::new(&inputs.conditioning, view, index, &motions, None);
            Some(robot.with_held(&path, seen.frame, frame.at() as f64, &Pose::IDENTITY))
        });
        assert_eq!(&query.at(slice.time, &robot.collect::<Vec<_>>()).unwrap(), slice);
    }
}

#[test]
fn nothing_follows_without_a_grip_or_without_kinematics() {
    let mut inputs = inputs();
    let (plain, held) = (moving_model(), holding_model());
    let same = |params: &LiftParams, inputs: &Inputs| {
        let (plain, held) = (lift_with(&plain, params, inputs), lift_with(&held, params, inputs));
        plain.slices == held.slices
    };
    // The tool centre lies on no moving link, and the gripper is open.
    assert!(same(&LiftParams::default(), &inputs));
    inputs.robot.tool_m = (0..FRAMES).flat_map(|frame| [0.02 * frame as f64, 0.0, 1.0]).collect();
    assert!(same(&LiftParams::default(), &inputs));
    inputs.clip.robot.gripper = vec![0.5; FRAMES];
    assert!(!same(&LiftParams::default(), &inputs));
    let unconditioned = LiftParams {
        fk_conditioning: false,
        ..LiftParams::default()
    };
    assert!(same(&unconditioned, &inputs));
}

#[test]
fn one_and_two_threads_give_the_same_bytes() {
    let inputs = inputs();
    let model = moving_model();
    let fields = [1, 2].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| lift_with(&model, &LiftParams::default(), &inputs))
    });
    assert!(fields[0] == fields[1]);
}

#[test]
fn inputs_that_do_not_belong_together_are_named() {
    let model = model(&LiftParams::default());
    let fail = |params: &LiftParams, change: &dyn Fn(&mut Inputs)| {
        let mut inputs = inputs();
        change(&mut inputs);
        lift_clip(&model, params, inputs.all(), &mut Unobserved)
            .unwrap_err()
            .message
    };
    let params = LiftParams::default();
    assert!(fail(&params, &|inputs| inputs.robot.clip_id = "other".parse().unwrap()).contains("`other`"));
    assert!(fail(&params, &|inputs| inputs.clip.cameras[1].recorded = None).contains("ext1"));
    assert!(fail(&params, &|inputs| inputs.robot.maps.clear()).contains("robot map"));
    assert!(fail(&params, &|inputs| inputs.conditioning.query_frames[1] = FrameIndex(3)).contains("frame 1"));
    assert!(
        fail(
            &LiftParams {
                source_frames: Some(vec![FrameIndex(2)]),
                ..params.clone()
            },
            &|_| {}
        )
        .contains("frame 2")
    );
    assert!(
        fail(
            &LiftParams {
                rgb_downsample: 0,
                ..params.clone()
            },
            &|_| {}
        )
        .contains("rgb_downsample")
    );
    let unknown = load_model(
        &LiftParams {
            configuration: "huge".into(),
            ..seeded(&params)
        },
        None,
    );
    assert!(unknown.is_err_and(|error| error.message.contains("huge")));
    let weights = std::path::Path::new("/nonexistent/weights.safetensors");
    assert!(load_model(&params, Some(weights)).is_err_and(|error| error.message.contains("nonexistent")));
}

/// Stereo depth of both cameras, and how much larger than usual the scene is.
fn with_depth(larger: f64) -> Inputs {
    let mut inputs = inputs();
    for (index, camera) in inputs.clip.cameras.iter_mut().enumerate() {
        let depth_m = (0..FRAMES * AREA)
            .map(|k| {
                if k % 5 == 0 {
                    f32::NAN
                } else {
                    (larger * (0.6 + 0.1 * index as f64 + 0.001 * (k % 40) as f64)) as f32
                }
            })
            .collect();
        camera.depth = Some(DepthReference {
            depth_m,
            range_m: [0.1, 5.0],
            origin: ReferenceOrigin::Exact,
        });
    }
    for pose in &mut inputs.robot.base_from_camera {
        pose.translation = pose.translation.map(|value| value * larger);
    }
    inputs
}

fn camera_wise() -> LiftParams {
    LiftParams {
        attention: CrossCamera::CameraWise,
        anchoring: false,
        fk_conditioning: false,
        ..LiftParams::default()
    }
}

#[test]
fn camera_wise_fields_take_their_size_from_stereo_and_do_not_see_each_other() {
    let (model, params) = (moving_model(), camera_wise());
    let field = lift_with(&model, &params, &with_depth(1.0));
    assert_eq!((field.len(), field.query_state.len()), (4 * AREA, 0));
    assert!(field.support.iter().all(|&support| support == 0));
    // Each camera's unit and what it was taken from; the second camera is 0.3 m off, but its unit is of its own frame.
    let label = &field.weights.description;
    assert!(
        label.contains("unit of each camera: wrist 0.") && label.contains(" m (exact), ext1 0."),
        "{label}"
    );
    assert!(field.slices[2].displacement_m.iter().any(|&d| d != 0.0));
    // Everything twice as large: the network sees the same, the field is twice as large.
    let twice = lift_with(&model, &params, &with_depth(2.0));
    let doubled = |a: &[f32], b: &[f32]| {
        a.iter()
            .zip(b)
            .all(|(a, b)| (2.0 * a - b).abs() <= 1e-4 * (1.0 + b.abs()))
    };
    assert!(doubled(&field.position_m, &twice.position_m));
    assert!(doubled(
        &field.slices[2].displacement_m,
        &twice.slices[2].displacement_m
    ));
    let activated = |raw: &f32| 0.001 * (1.0 + f64::from(*raw).exp()).ln();
    for (a, b) in field
        .base_raw
        .chunks_exact(RAW_CHANNELS)
        .zip(twice.base_raw.chunks_exact(RAW_CHANNELS))
    {
        assert_eq!(a[..3], b[..3], "colours stay");
        for axis in 3..6 {
            assert!((2.0 * activated(&a[axis]) / activated(&b[axis]) - 1.0).abs() < 1e-3);
        }
    }
    // The largest scale is 0.3 of the camera's unit, and not 0.3 internal units.
    let caps = field.scale_cap_iu.iter().zip(&twice.scale_cap_iu);
    assert!(
        caps.clone()
            .all(|(a, b)| a.is_finite() && (2.0 * a / b - 1.0).abs() < 1e-5)
    );
    assert!(
        label.contains(&format!("wrist {:.4} m", field.scale_cap_iu[0] / (0.3 * 3.5))),
        "{label}"
    );
    // Another picture of the second camera changes nothing of the first.
    let mut other = with_depth(1.0);
    other.clip.cameras[1]
        .recorded
        .as_mut()
        .unwrap()
        .iter_mut()
        .for_each(|value| *value = 255 - *value);
    let changed = lift_with(&model, &params, &other);
    let first = 2 * AREA * 3;
    assert_eq!(field.position_m[..first], changed.position_m[..first]);
    assert_ne!(field.position_m[first..], changed.position_m[first..]);
}

/// The audit of camera-wise fields: in the world a camera sees what it saw in its own frame and unit.
#[test]
fn camera_wise_fields_look_the_same_in_the_world() {
    #[derive(Default)]
    struct Warnings(Vec<String>);
    impl rogs_worker::Observer for Warnings {
        fn warn(&mut self, warning: String) {
            self.0.push(warning);
        }
    }
    let mut heard = Warnings::default();
    for size in [0.4, 1.0, 3.0] {
        let inputs = with_depth(size);
        lift_clip(&moving_model(), &camera_wise(), inputs.all(), &mut heard).unwrap();
    }
    assert_eq!(heard.0, Vec::<String>::new());
}

#[test]
fn camera_wise_lifting_says_what_it_lacks() {
    let model = model(&LiftParams::default());
    let run =
        |params: &LiftParams, inputs: &Inputs| lift_clip(&model, params, inputs.all(), &mut Unobserved).unwrap_err();
    let error = run(&camera_wise(), &inputs());
    assert!(
        error.message.contains("stereo depth of camera `wrist`"),
        "{}",
        error.message
    );
    let mut blind = with_depth(1.0);
    blind.clip.cameras[1].depth.as_mut().unwrap().depth_m.fill(f32::NAN);
    assert!(run(&camera_wise(), &blind).message.contains("`ext1`"));
    let anchored = LiftParams {
        anchoring: true,
        ..camera_wise()
    };
    assert!(run(&anchored, &with_depth(1.0)).message.contains("anchoring = false"));
}
