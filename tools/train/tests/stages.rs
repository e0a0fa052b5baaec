//! The training code and the pipeline's lifting stage are two programs of the same formulas: they must agree.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use burn::tensor::Device;
use glam::Vec3;
use rogs_lift::{ClipInputs, LiftParams, Model, lift_clip};
use rogs_random::Pcg64;
use rogs_schemas::FrameIndex;
use rogs_schemas::records::clip::time_of_frame;
use rogs_schemas::records::field::{Field, WeightsInfo};
use rogs_schemas::units::{UNITS_PER_METRE, iu_from_m, m_from_iu};
use rogs_stage1::held::HeldPath;
use rogs_stage1::{Stage1Config, seeded};
use rogs_tensors::parameters::to_host;
use rogs_train::config::DataSettings;
use rogs_train::plan::ClipPlan;
use rogs_train::records::Records;
use rogs_train::run::run;
use rogs_train::sample::Sample;
use rogs_train::stage1::forward::{Heads, Lifted, lift};
use rogs_train::{Stage1Trainer, Stage1Training};
use rogs_worker::Unobserved;

/// The first clip in which the gripper carries something on by 5 cm, and in which much of what an untrained network believes
/// to see, a metre away, is within its reach.
fn carried_clip(data: &DataSettings) -> (Sample, Records) {
    let carried = |seed: u64| {
        let plan = ClipPlan::draw(seed, 2, data, &mut Pcg64::from_seed(seed));
        let records = plan.records(data).ok()?;
        let path = HeldPath::of_clip(&records.robot, &records.clip.robot.gripper).unwrap()?;
        let (source, tool) = (plan.sources[0], path.tool(plan.sources[0])?);
        let motion = path.motion(source, plan.queries[1].at() as f64)?;
        if motion.point(tool).distance(tool) < 0.05 {
            return None;
        }
        let sample = plan.sample(data, false).ok()?;
        let [height, width] = sample.size;
        let depth = vec![iu_from_m(1.0); height * width];
        let tool_iu = (tool * UNITS_PER_METRE).as_vec3();
        let of_source = sample.cameras.iter().step_by(plan.sources.len());
        let points = of_source.flat_map(|camera| camera.unproject(&depth, height, width));
        let points: Vec<f32> = points.collect();
        let near = points
            .chunks_exact(3)
            .filter(|&point| Vec3::from_slice(point).distance(tool_iu) < 0.7);
        (near.count() > 200).then_some((sample, records))
    };
    (3..100).find_map(carried).unwrap()
}

#[test]
fn lifting_in_training_equals_the_lift_stage() {
    let data = DataSettings {
        size: [56, 98],
        queries: 2,
        ..DataSettings::default()
    };
    let (sample, records) = carried_clip(&data);
    let mut network = seeded::network(&Stage1Config::compact(), 5, &Device::flex()).unwrap();
    // Motion and the FK branch start at zero: give them something to say.
    for name in [
        "backbone.motion_head.scratch.output_conv2.2.weight",
        "fk_branch.conv3.weight",
    ] {
        let shape = network.parameters.shape(name).unwrap().to_vec();
        let count = shape.iter().product::<usize>();
        let values = (0..count)
            .map(|k| ((k * 7919 % 97) as f32 / 97.0 - 0.5) * 0.2)
            .collect();
        network.parameters.insert(name, &shape, values).unwrap();
    }
    let bare = lift(&network, &sample, true, Heads::All).unwrap();
    for spec in rogs_stage1::layout::held() {
        let mut values = seeded::values(&spec, &Stage1Config::compact(), 8);
        if spec.name.starts_with("held.conv3") {
            values = (0..spec.len()).map(|k| (k % 5) as f32 * 0.2).collect();
        }
        network.parameters.insert(&spec.name, &spec.shape, values).unwrap();
    }
    let lifted = lift(&network, &sample, true, Heads::All).unwrap();
    let unconditioned = lift(&network, &sample, false, Heads::All).unwrap();
    let info = WeightsInfo {
        trained: false,
        configuration: "compact".into(),
        description: String::new(),
        hash: String::new(),
    };
    let model = Model {
        network,
        info,
        domain: None,
        made_for: None,
    };
    let lift_field = |params: &LiftParams| {
        let (clip, robot, conditioning) = (&records.clip, &records.robot, &records.conditioning);
        let inputs = ClipInputs::new(clip, robot, conditioning);
        lift_clip(&model, params, inputs, &mut Unobserved).unwrap()
    };
    let field = lift_field(&LiftParams::default());
    let area = sample.size[0] * sample.size[1];
    let close = |a: f32, b: f32, what: &str| assert!((a - b).abs() < 2e-4 * (1.0 + b.abs()), "{what}: {a} {b}");
    let supported = sample.support.iter().filter(|&&value| value > 0.0).count();
    assert_eq!(supported, field.support.iter().filter(|&&value| value != 0).count());
    assert!(supported > 50);
    let positions_agree = |lifted: &Lifted, field: &Field| {
        let position = to_host(lifted.position.clone()).unwrap();
        for (gaussian, stored) in field.position_m.chunks_exact(3).enumerate() {
            let (view, pixel) = (gaussian / area, gaussian % area);
            for axis in 0..3 {
                let own = m_from_iu(position[(3 * view + axis) * area + pixel]);
                close(stored[axis], own, "position");
            }
        }
    };
    positions_agree(&lifted, &field);
    let unanchored = LiftParams {
        anchoring: false,
        ..LiftParams::default()
    };
    let free = lift(&model.network, &sample.without_anchors(), true, Heads::All).unwrap();
    let free_field = lift_field(&unanchored);
    positions_agree(&free, &free_field);
    assert!(free_field.position_m != field.position_m);
    let displacements_agree = |lifted: &Lifted, field: &Field| {
        let mut all = Vec::new();
        for (query, outputs) in sample.queries.iter().zip(&lifted.queries) {
            let frame = FrameIndex::first(17)
                .find(|&frame| time_of_frame(frame, 17) as f32 == query.time)
                .unwrap();
            let slice = field.slice_at(time_of_frame(frame, 17)).unwrap();
            let displacement = to_host(outputs.displacement.clone()).unwrap();
            for (gaussian, stored) in slice.displacement_m.chunks_exact(3).enumerate() {
                let (view, pixel) = (gaussian / area, gaussian % area);
                for axis in 0..3 {
                    let own = m_from_iu(displacement[(3 * view + axis) * area + pixel]);
                    close(stored[axis], own, "displacement");
                    all.push(own);
                }
            }
        }
        all
    };
    let moved = displacements_agree(&lifted, &field);
    assert!(moved.iter().any(|moved| moved.abs() > 1e-3));
    // What the gripper may hold moves with it, beside the robot and nowhere else; without conditioning nothing does.
    let displacement = |lifted: &Lifted| to_host(lifted.queries[1].displacement.clone()).unwrap();
    let (with, without) = (displacement(&lifted), displacement(&bare));
    let mut following = 0;
    for (index, (with, without)) in with.iter().zip(&without).enumerate() {
        let pixel = index / (3 * area) * area + index % area;
        assert!(sample.support[pixel] == 0.0 || with == without);
        following += usize::from((with - without).abs() > 1e-3);
    }
    assert!(
        following > 50 && following < with.len() / 2,
        "{following} of {}",
        with.len()
    );
    let unconditioned_field = lift_field(&LiftParams {
        fk_conditioning: false,
        ..LiftParams::default()
    });
    displacements_agree(&unconditioned, &unconditioned_field);
    // Kinematics move another point otherwise.
    let moved_freely = displacements_agree(&free, &free_field);
    let differences = moved.iter().zip(&moved_freely).map(|(a, b)| (a - b).abs());
    assert!(differences.fold(0.0f32, f32::max) > 1e-3);
}

#[test]
fn weights_say_what_they_were_trained_on() {
    let folder = tempfile::tempdir().unwrap();
    let settings = Stage1Training {
        steps: 1,
        evaluation_clips: 0,
        data: DataSettings {
            size: [28, 42],
            source_times: [1, 1],
            queries: 1,
            images_per_step: 3,
            ..DataSettings::default()
        },
        ..Stage1Training::default()
    };
    let mut trainer = Stage1Trainer::new(settings.clone(), &Device::flex()).unwrap();
    run(&mut trainer, folder.path(), None, &mut |_| {}).unwrap();
    let built_in = folder.path().join("built-in.safetensors");
    std::fs::write(&built_in, rogs_lift::COMPACT_WEIGHTS).unwrap();
    let plan = ClipPlan::draw(3, 1, &settings.data, &mut Pcg64::from_seed(3));
    for weights in [folder.path().join("model.safetensors"), built_in] {
        let model = rogs_lift::load_model(&LiftParams::default(), Some(&weights)).unwrap();
        let mut clip = plan.records(&settings.data).unwrap().clip;
        assert_eq!(model.out_of_distribution(&clip), None);
        clip.calibration_note = "measured".into();
        let warning = model.out_of_distribution(&clip).unwrap();
        assert!(
            warning.starts_with("OUT OF DISTRIBUTION") && warning.contains(clip.clip_id.as_str()),
            "{warning}"
        );
    }
}
