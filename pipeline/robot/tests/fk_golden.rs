//! Forward kinematics against recorded robot states and against the `k` crate.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common;

use std::collections::BTreeMap;

use rogs_needs::{needs, shared};
use rogs_robot::fk_json::FkTable;
use rogs_robot::{JointState, RobotModel};
use rogs_schemas::records::robot::RobotSpec;
use serde_json::Value;

fn numbers(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|entry| entry.as_f64().unwrap())
        .collect()
}

fn recorded_states(model: &RobotModel) -> Vec<(JointState, Value)> {
    let golden = std::fs::read_to_string(shared!("data/robots/fk_golden.json")).unwrap();
    let golden: Value = serde_json::from_str(&golden).unwrap();
    let names: Vec<String> = (1..=7).map(|index| format!("panda_joint{index}")).collect();
    let state = |case: &Value| {
        let gripper = case["gripper_position"].as_f64().unwrap();
        model
            .robot_state(&RobotSpec::default(), &names, &numbers(&case["joints"]), gripper)
            .unwrap()
    };
    let cases = golden["cases"].as_array().unwrap();
    cases.iter().map(|case| (state(case), case.clone())).collect()
}

#[needs(shared)]
#[test]
fn recorded_states_agree_for_every_link() {
    let model = common::panda();
    let cases = recorded_states(&model);
    assert_eq!(cases.len(), 12);
    let (mut worst_translation, mut worst_rotation) = (0.0f64, 0.0f64);
    for (state, case) in &cases {
        let poses = model.fk(state);
        let links = case["links"].as_object().unwrap();
        assert!(links.contains_key("left_inner_finger") && links.contains_key("right_outer_finger"));
        for (name, matrix) in links {
            let ours = poses[model.link_id(name).unwrap()].to_matrix4();
            for (index, (ours, golden)) in ours.iter().zip(numbers(matrix)).enumerate() {
                let worst = if index % 4 == 3 {
                    &mut worst_translation
                } else {
                    &mut worst_rotation
                };
                *worst = worst.max((ours - golden).abs());
            }
        }
    }
    println!("largest difference: {worst_translation:.1e} m, {worst_rotation:.1e} in rotation entries");
    // The golden file has nine decimals.
    assert!(worst_translation < 1e-8 && worst_rotation < 1e-8);
}

#[needs(shared)]
#[test]
fn the_flange_pose_is_the_recorded_cartesian_position() {
    let model = common::panda();
    let cases = recorded_states(&model);
    for (state, case) in &cases {
        let recorded = numbers(&case["cartesian_position"]);
        let flange = model.fk(state)[model.link_id("panda_link8").unwrap()];
        let distance = (flange.translation - glam::DVec3::from_slice(&recorded[..3])).length();
        assert!(distance < 1e-6, "{distance}");
        let euler = rogs_geometry::euler_xyz_from_rotation(&flange.rotation);
        let turn = |a: f64, b: f64| {
            ((a - b + 3.0 * std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI).abs()
        };
        assert!(
            euler.iter().zip(&recorded[3..]).all(|(&a, &b)| turn(a, b) < 1e-5),
            "{euler:?} {recorded:?}"
        );
    }
}

#[needs(shared)]
#[test]
fn own_transforms_agree_with_the_k_crate() {
    let model = common::panda();
    let cases = recorded_states(&model);
    let text = std::fs::read_to_string(&model.path).unwrap();
    let chain = k::Chain::<f64>::from(urdf_rs::read_from_string(&text).unwrap());
    for (state, _) in &cases {
        let value_of: BTreeMap<&str, f64> = model
            .joints
            .iter()
            .map(|joint| joint.name.as_str())
            .zip(state.values.iter().copied())
            .collect();
        for node in chain.iter() {
            let name = node.joint().name.clone();
            if let Some(value) = value_of.get(name.as_str()) {
                node.set_joint_position_unchecked(*value);
            }
        }
        chain.update_transforms();
        let ours = model.fk(state);
        for node in chain.iter() {
            let Some(name) = node.link().as_ref().map(|link| link.name.clone()) else {
                continue;
            };
            let theirs = node.world_transform().unwrap().to_homogeneous();
            let ours = ours[model.link_id(&name).unwrap()].to_matrix4();
            let worst = (0..16)
                .map(|i| (theirs[(i / 4, i % 4)] - ours[i]).abs())
                .fold(0.0, f64::max);
            assert!(worst < 1e-12, "{name}: {worst}");
        }
    }
}

#[needs(shared)]
#[test]
fn the_table_form_follows_mimic_joints_and_names_its_errors() {
    let model = common::panda();
    let header: Vec<String> = ["panda_joint1", " finger_joint "].map(String::from).to_vec();
    let table = FkTable::new(&model, &header).unwrap();
    let row = table.row(0, &["0.5", " 0.3"]).unwrap();
    assert_eq!(table.row(1, &["0", "0"]).unwrap().row, 1);
    let state = model
        .joint_state([("panda_joint1", 0.5), ("finger_joint", 0.3)])
        .unwrap();
    let expected = model.fk(&state)[model.link_id("right_inner_finger").unwrap()].to_matrix4();
    assert_eq!(row.links["right_inner_finger"], expected);
    let error = |header: &[&str], row: &[&str]| {
        let table = FkTable::new(&model, header);
        table
            .and_then(|table| table.check(0, row).map(drop))
            .unwrap_err()
            .to_string()
    };
    assert!(error(&["panda_joint9"], &["0"]).contains("header, column 1"));
    // As near to one joint as to another: all are named.
    assert!(error(&["panda_joint9"], &["0"]).contains("it has panda_joint1, "));
    assert!(error(&["panda_joint_4"], &["0"]).contains("did you mean `panda_joint4`?"));
    assert!(error(&["panda_joint8"], &["0"]).contains("fixed"));
    assert!(error(&["panda_joint1", "panda_joint1"], &["0", "0"]).contains("twice"));
    assert!(error(&["panda_joint1"], &["nan"]).contains("row 1, column `panda_joint1`"));
    assert!(error(&["panda_joint1"], &["0", "1"]).contains("2 fields"));
    assert!(error(&["finger_joint", "left_inner_finger_joint"], &["0.3", "0.3"]).contains("contradicts"));
}

#[needs(shared)]
#[test]
fn limits_are_reported_for_driven_joints_only() {
    let model = common::panda();
    let state = model
        .joint_state([("panda_joint4", 0.5), ("finger_joint", 0.3)])
        .unwrap();
    let excesses = model.limit_excesses(&state);
    assert_eq!(excesses.len(), 1);
    assert_eq!(model.joints[excesses[0].joint].name, "panda_joint4");
}

#[needs(shared)]
#[test]
fn another_base_link_moves_all_poses() {
    let model = common::panda();
    let state = model
        .joint_state([("panda_joint1", 0.5), ("panda_joint2", 0.3)])
        .unwrap();
    let link = model.link_id("panda_link8").unwrap();
    let usual = model.fk(&state);
    let from_link2 = model.clone().with_base_link("panda_link2").unwrap().fk(&state);
    let expected = usual[model.link_id("panda_link2").unwrap()]
        .inverse()
        .point(usual[link].translation);
    assert!((from_link2[link].translation - expected).length() < 1e-15);
}
