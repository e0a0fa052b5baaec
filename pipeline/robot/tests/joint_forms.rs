//! Joints as the usual writers of URDF write them: what is read, with which warning, and where the links then are.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use glam::DVec3;
use rogs_robot::RobotModel;
use rogs_robot::model::JointKind;

/// Three links in a row: `base`, 1 m above it `arm`, 1 m above that `tip`; `j` turns about z, `k` is what a case says.
fn robot(k: &str) -> String {
    format!(
        r#"<robot name="r"><link name="base"/><link name="arm"/><link name="tip"/>
        <joint name="j" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 1"/><axis xyz="0 0 1"/>
        <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
        {k}<parent link="arm"/><child link="tip"/><origin xyz="0 0 1"/></joint></robot>"#
    )
}

fn load(text: &str) -> Result<RobotModel, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("robot.urdf");
    std::fs::write(&path, text).unwrap();
    RobotModel::load(&path).map_err(|error| error.chain())
}

/// Where the point (1, 0, 0) of the tip is, with `j` at 0.5 and `k` at a value where it takes one.
fn point(model: &RobotModel, k: Option<f64>) -> DVec3 {
    let values = [("j", 0.5)].into_iter().chain(k.map(|value| ("k", value)));
    let state = model.joint_state(values).unwrap();
    model.fk(&state)[2].point(DVec3::X)
}

fn turned(angle: f64, height: f64) -> DVec3 {
    DVec3::new(angle.cos(), angle.sin(), height)
}

#[test]
fn every_usual_form_has_its_meaning() {
    let joint =
        |kind: &str, inside: &str| robot(&format!(r#"<joint name="k" type="{kind}"><axis xyz="0 0 1"/>{inside}"#));
    let range = r#"<limit lower="-1" upper="1" effort="1" velocity="1"/>"#;
    // Text, value of `k`, where the point is, limits of `k`, and words of the warning.
    type Case<'a> = (String, Option<f64>, DVec3, Option<[f64; 2]>, Option<&'a str>);
    let cases: [Case<'_>; 18] = [
        (
            joint("revolute", range),
            Some(0.25),
            turned(0.75, 2.0),
            Some([-1.0, 1.0]),
            None,
        ),
        (
            joint("revolute", r#"<limit lower="-1" upper="1"/>"#),
            Some(0.25),
            turned(0.75, 2.0),
            Some([-1.0, 1.0]),
            None,
        ),
        (
            joint("revolute", r#"<limit upper="1"/>"#),
            Some(0.25),
            turned(0.75, 2.0),
            Some([0.0, 1.0]),
            None,
        ),
        (
            joint("revolute", r#"<limit lower="0" upper="0"/>"#),
            Some(0.0),
            turned(0.5, 2.0),
            Some([0.0, 0.0]),
            None,
        ),
        (
            joint("revolute", r#"<limit lower="-inf" upper="inf"/>"#),
            Some(9.0),
            turned(9.5, 2.0),
            None,
            None,
        ),
        (
            joint("revolute", r#"<limit effort="1"/>"#),
            Some(0.25),
            turned(0.75, 2.0),
            None,
            Some("no `lower` and `upper`"),
        ),
        (
            joint("revolute", ""),
            Some(0.25),
            turned(0.75, 2.0),
            None,
            Some("no `lower` and `upper`"),
        ),
        (joint("continuous", ""), Some(7.0), turned(7.5, 2.0), None, None),
        (
            joint("continuous", r#"<limit lower="2" upper="1"/>"#),
            Some(7.0),
            turned(7.5, 2.0),
            None,
            None,
        ),
        (
            joint("prismatic", range),
            Some(0.25),
            turned(0.5, 2.25),
            Some([-1.0, 1.0]),
            None,
        ),
        (joint("fixed", range), None, turned(0.5, 2.0), None, None),
        (
            joint("floating", ""),
            None,
            turned(0.5, 2.0),
            None,
            Some("a floating joint is not moved"),
        ),
        (
            joint("planar", ""),
            None,
            turned(0.5, 2.0),
            None,
            Some("a planar joint is not moved"),
        ),
        (
            joint("revolute", r#"<mimic joint="j" multiplier="2" offset="0.1"/>"#),
            None,
            turned(0.5 + 1.1, 2.0),
            None,
            None,
        ),
        (
            joint("fixed", r#"<mimic joint="j"/>"#),
            None,
            turned(0.5, 2.0),
            None,
            Some("its `mimic` is left aside"),
        ),
        (
            joint("revolute", &format!(r#"{range}<mimic joint="gone"/>"#)),
            Some(0.25),
            turned(0.75, 2.0),
            Some([-1.0, 1.0]),
            Some("`gone`, which does not exist"),
        ),
        (
            robot(
                r#"<joint name="k" type="revolute"><axis xyz="0 0 2"/><limit lower="-1" upper="1"/><dynamics damping="1"/>"#,
            ),
            Some(0.25),
            turned(0.75, 2.0),
            Some([-1.0, 1.0]),
            None,
        ),
        // Without an axis it is x, about which (1, 0, 0) does not move.
        (
            robot(r#"<joint name="k" type="continuous">"#),
            Some(0.25),
            turned(0.5, 2.0),
            None,
            None,
        ),
    ];
    for (text, value, expected, limits, warning) in cases {
        let model = load(&text).unwrap_or_else(|error| panic!("{text}: {error}"));
        let found = point(&model, value);
        assert!(
            (found - expected).length() < 1e-12,
            "{text}: {found} instead of {expected}"
        );
        assert_eq!(model.joints[1].limits, limits, "{text}");
        match warning {
            None => assert!(model.notes.is_empty(), "{text}: {:?}", model.notes),
            Some(words) => assert!(
                model.notes.len() == 1 && model.notes[0].contains(words) && model.notes[0].contains("joint `k`"),
                "{text}: {:?}",
                model.notes
            ),
        }
    }
}

#[test]
fn degrees_and_millimetres_are_told() {
    let joint =
        |kind: &str, inside: &str| robot(&format!(r#"<joint name="k" type="{kind}"><axis xyz="0 0 1"/>{inside}"#));
    let with_origin = |origin: &str| {
        joint("continuous", "").replace(
            r#"<parent link="arm"/><child link="tip"/><origin xyz="0 0 1"/>"#,
            &format!(r#"<parent link="arm"/><child link="tip"/>{origin}"#),
        )
    };
    for (text, words) in [
        (
            joint("revolute", r#"<limit lower="-170" upper="170"/>"#),
            Some("are these degrees"),
        ),
        (
            joint("revolute", r#"<limit lower="0" upper="90"/>"#),
            Some("are these degrees"),
        ),
        (
            joint("revolute", r#"<limit lower="-6.2831853" upper="6.2831853"/>"#),
            None,
        ),
        (joint("revolute", r#"<limit lower="-1e16" upper="1e16"/>"#), None),
        (
            joint("prismatic", r#"<limit lower="0" upper="40"/>"#),
            Some("are these millimetres"),
        ),
        (joint("prismatic", r#"<limit lower="0" upper="0.04"/>"#), None),
        (
            with_origin(r#"<origin xyz="0 0 1" rpy="0 0 90"/>"#),
            Some("are these degrees"),
        ),
        (
            with_origin(r#"<origin xyz="0 0 1" rpy="-180 0 0"/>"#),
            Some("are these degrees"),
        ),
        (with_origin(r#"<origin xyz="0 0 1" rpy="0 0 6.28319"/>"#), None),
        (with_origin(r#"<origin xyz="0 0 333"/>"#), Some("are these millimetres")),
    ] {
        let notes = load(&text).unwrap().notes;
        match words {
            None => assert!(notes.is_empty(), "{text}: {notes:?}"),
            Some(words) => assert!(notes.len() == 1 && notes[0].contains(words), "{text}: {notes:?}"),
        }
    }
}

#[test]
fn a_joint_that_mimics_one_that_does_not_move_stands_at_its_offset() {
    let text = robot(
        r#"<joint name="k" type="revolute"><axis xyz="0 0 1"/><mimic joint="lock" multiplier="3" offset="0.25"/>"#,
    )
    .replace(
        "</robot>",
        r#"<link name="side"/><joint name="lock" type="fixed"><parent link="base"/><child link="side"/></joint></robot>"#,
    );
    let model = load(&text).unwrap();
    assert!((point(&model, None) - turned(0.75, 2.0)).length() < 1e-12);
    assert_eq!(model.joints[model.joint_index("k").unwrap()].kind, JointKind::Fixed);
    assert!(model.notes[0].contains("it stands at its offset"), "{:?}", model.notes);
}

#[test]
fn chains_of_mimics_are_multiplied_out_and_circles_refused() {
    let third = |mimic: &str| {
        robot(r#"<joint name="k" type="revolute"><axis xyz="0 0 1"/><mimic joint="l" multiplier="2" offset="0.1"/>"#)
            .replace(
                "</robot>",
                &format!(
                    r#"<link name="side"/><joint name="l" type="revolute"><parent link="base"/><child link="side"/>
                <axis xyz="0 0 1"/><mimic joint="{mimic}" multiplier="-1"/></joint></robot>"#
                ),
            )
    };
    let model = load(&third("j")).unwrap();
    // l = -0.5, k = 2 l + 0.1 = -0.9.
    assert!((point(&model, None) - turned(0.5 - 0.9, 2.0)).length() < 1e-12);
    assert!(
        load(&third("k"))
            .unwrap_err()
            .contains("mimics itself through other joints")
    );
}
