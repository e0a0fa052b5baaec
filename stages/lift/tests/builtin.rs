//! The networks inside the program: which of them a clip has.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod support;

use rogs_lift::{BUILTIN, BUILTIN_SCENES, LiftParams, Models, builtin_of, lift_clip};
use rogs_weights::Unfiled;
use rogs_worker::Unobserved;
use support::{Inputs, small_clip};

fn clip(robot: &[u32]) -> Inputs {
    small_clip([28, 42], &["wrist", "ext1"], &[], robot)
}

/// Hash of the weights that a clip is lifted with.
fn lifted_with(models: &mut Models, params: &LiftParams, inputs: &Inputs) -> String {
    let model = models.of_clip(params, &inputs.robot).unwrap();
    let field = lift_clip(model, params, inputs.all(), &mut Unobserved).unwrap();
    assert_eq!(field.weights.hash, model.info.hash);
    field.weights.hash
}

#[test]
fn a_clip_without_a_robot_in_view_has_the_network_for_scenes() {
    let params = LiftParams::default();
    let mut models = Models::load(&params, None, false).unwrap();
    let (robot, scene) = (clip(&[200, 201, 202]), clip(&[]));
    for _ in 0..2 {
        assert_eq!(lifted_with(&mut models, &params, &robot), BUILTIN.hash());
        assert_eq!(lifted_with(&mut models, &params, &scene), BUILTIN_SCENES.hash());
    }
    for file in [&BUILTIN, &BUILTIN_SCENES] {
        assert_eq!(builtin_of(file.hash()).unwrap().name, file.name);
    }
    assert!(builtin_of("00ff").is_none());
}

#[test]
fn a_network_that_is_named_is_that_of_every_clip() {
    let scene = clip(&[]);
    let hash = |params: &LiftParams, adapted: bool| {
        let mut models = Models::load(params, None, adapted).unwrap();
        models.of_clip(params, &scene.robot).unwrap().info.hash.clone()
    };
    let of = |configuration: &str| LiftParams {
        configuration: configuration.into(),
        ..LiftParams::default()
    };
    assert_eq!(hash(&of("compact-sweep"), false), BUILTIN.hash());
    assert_eq!(hash(&of("compact-wide"), false), BUILTIN_SCENES.hash());
    assert_eq!(hash(&LiftParams::default(), true), BUILTIN.hash());
    let seeded = LiftParams {
        weights: Some(Unfiled::Seeded),
        ..of("compact")
    };
    assert_eq!(hash(&seeded, false), "");
    let error = Models::load(&of("full"), None, false).err().unwrap();
    assert!(error.message.contains("`compact-sweep`, for robots"), "{error}");
}
