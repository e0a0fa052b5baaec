//! What URDF files say that moves and shows nothing: known and passed over, or noted, or refused.
//!
//! Elements and attributes in [`KNOWN`] and [`ATTRIBUTES`] are read or matter to neither kinematics nor shape; any other is
//! noted once. Text that another program must process first (xacro) and files of other formats are refused by name.

use std::collections::BTreeMap;

use roxmltree::Node;

use super::xml::{Parsed, line};

/// What was left aside: one note for each kind, with the first place and the number.
#[derive(Debug, Default)]
pub(super) struct Notes(BTreeMap<String, (String, usize)>);

impl Notes {
    /// Notes that something was found at a place.
    pub(super) fn add(&mut self, place: impl Into<String>, what: impl Into<String>) {
        self.0.entry(what.into()).or_insert_with(|| (place.into(), 0)).1 += 1;
    }

    /// One line for each kind.
    pub(super) fn lines(&self) -> Vec<String> {
        let line = |(what, (place, count)): (&String, &(String, usize))| match count {
            1 => format!("{place}: {what}"),
            _ => format!("{place}, and {} more: {what}", count - 1),
        };
        self.0.iter().map(line).collect()
    }
}

/// Elements that are read or say nothing about kinematics and shape, by their parent. Whatever stands below one that is
/// not read is not looked at.
const KNOWN: [(&str, &[&str]); 10] = [
    (
        "robot",
        &[
            "link",
            "joint",
            "material",
            "gazebo",
            "transmission",
            "ros2_control",
            "sensor",
            "mujoco",
            "plugin",
            "dynamics",
            "group",
            "group_state",
            "disable_collisions",
            "end_effector",
            "virtual_joint",
            "preserveFixedJoint",
        ],
    ),
    (
        "link",
        &[
            "visual",
            "collision",
            "inertial",
            "contact",
            "gravity",
            "kinematic",
            "surface",
            "self_filter",
            "collision_checking",
            "self_collision_checking",
            "sensor",
            "material",
            "mu",
            "selfCollide",
        ],
    ),
    (
        "joint",
        &[
            "origin",
            "parent",
            "child",
            "axis",
            "limit",
            "mimic",
            "dynamics",
            "calibration",
            "safety_controller",
            "hardwareInterface",
            "joint_properties",
            "friction",
            "damping",
            "controller",
            "actuator",
            "transmission",
            "sensor",
        ],
    ),
    ("visual", &["origin", "geometry", "material", "meta"]),
    (
        "collision",
        &[
            "origin",
            "geometry",
            "material",
            "verbose",
            "contact_coefficients",
            "surface",
            "max_contacts",
            "proximity_properties",
            "hydroelastic",
        ],
    ),
    ("mesh", &[]),
    ("box", &[]),
    ("cylinder", &[]),
    ("sphere", &[]),
    ("capsule", &[]),
];

/// Attributes that are read or say nothing about kinematics and shape, by element.
const ATTRIBUTES: [(&str, &[&str]); 16] = [
    ("robot", &["name", "version", "schemaLocation"]),
    ("link", &["name", "type", "concave"]),
    ("joint", &["name", "type", "dont_collapse"]),
    ("visual", &["name"]),
    ("collision", &["name", "group", "concave"]),
    ("geometry", &["name"]),
    ("origin", &["xyz", "rpy", "quat_xyzw"]),
    ("axis", &["xyz"]),
    ("parent", &["link"]),
    ("child", &["link"]),
    (
        "limit",
        &[
            "lower",
            "upper",
            "effort",
            "velocity",
            "acceleration",
            "deceleration",
            "jerk",
            "command_effort",
            "current",
            "gear_velocity",
            "K_position",
            "K_velocity",
        ],
    ),
    ("mimic", &["joint", "multiplier", "offset"]),
    ("mesh", &["filename", "scale"]),
    ("box", &["size"]),
    ("sphere", &["radius"]),
    ("cylinder", &["radius", "length"]),
];

/// Files that stand where a URDF is expected: what they are, and how a URDF is made of them.
pub(super) fn refuse_other_formats(root: Node<'_, '_>) -> Parsed<()> {
    let xacro = |at: u32| {
        Err(format!(
            "line {at}: it is a xacro file, a template; expand it first: `xacro robot.urdf.xacro > robot.urdf`"
        ))
    };
    match root.tag_name().name() {
        "robot" => {}
        "mujoco" => {
            return Err(
                "it is a MuJoCo model (MJCF), not a URDF; convert it, or name the URDF it was made from".into(),
            );
        }
        "sdf" | "gazebo" | "world" => {
            return Err(
                "it is an SDF model of Gazebo, not a URDF; convert it, or name the URDF it was made from".into(),
            );
        }
        "COLLADA" => return Err("it is a COLLADA mesh; name the URDF that uses it".into()),
        other => return Err(format!("its root element is `{other}`, a URDF has `robot`")),
    }
    for node in root.descendants().filter(Node::is_element) {
        if node.tag_name().namespace().is_some_and(|space| space.contains("xacro")) {
            return xacro(line(node));
        }
        if node
            .attributes()
            .any(|attribute| attribute.value().contains("${") || attribute.value().contains("$("))
        {
            // Controllers take templates of their own; what is read must be plain.
            let read = node.ancestors().all(|node| {
                !node.is_element() || !matches!(node.tag_name().name(), "gazebo" | "ros2_control" | "transmission")
            });
            if read {
                return xacro(line(node));
            }
        }
    }
    Ok(())
}

/// True for elements with a prefix: those of other programs.
pub(super) fn is_foreign(node: Node<'_, '_>) -> bool {
    let of_root = node.document().root_element().tag_name().namespace();
    node.tag_name().namespace() != of_root
}

/// Notes children and attributes of an element that are neither read nor known to matter to nothing here.
pub(super) fn look_over(node: Node<'_, '_>, owner: &str, notes: &mut Notes) {
    let name = node.tag_name().name();
    let known = |table: &[(&str, &'static [&'static str])]| {
        table
            .iter()
            .find(|(element, _)| *element == name)
            .map(|(_, known)| *known)
    };
    if let Some(known) = known(&KNOWN) {
        for inner in node.children().filter(Node::is_element) {
            let inner_name = inner.tag_name().name();
            if is_foreign(inner) || !known.contains(&inner_name) {
                notes.add(
                    format!("line {}, {owner}", line(inner)),
                    format!("the element `{}` is not read", written_name(inner)),
                );
            }
        }
    }
    if let Some(known) = known(&ATTRIBUTES) {
        for attribute in node.attributes() {
            if attribute.namespace().is_some() || known.contains(&attribute.name()) {
                continue;
            }
            notes.add(
                format!("line {}, {owner}", line(node)),
                format!("the attribute `{}` of `{name}` is not read", attribute.name()),
            );
        }
    }
}

/// The name of an element with its prefix, as the file has it.
pub(super) fn written_name<'a>(node: Node<'a, '_>) -> &'a str {
    let text = &node.document().input_text()[node.range()];
    let end = text.find(|c: char| c.is_ascii_whitespace() || matches!(c, '>' | '/'));
    text.get(1..end.unwrap_or(text.len())).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::super::urdf::parse;
    use super::super::urdf::tests::{joint_with, robot_with};
    use super::*;

    #[test]
    fn whatever_is_not_read_is_known_or_noted() {
        let parents = [
            ("robot", robot_with("<ELEMENT/>")),
            ("link", robot_with("<link name=\"c\"><ELEMENT/></link>")),
            ("joint", joint_with("<ELEMENT/>")),
        ];
        for (parent, text) in parents {
            let (_, known) = KNOWN.iter().find(|(name, _)| *name == parent).unwrap();
            let unused = known.iter().filter(|name| {
                !matches!(
                    **name,
                    "link"
                        | "joint"
                        | "visual"
                        | "collision"
                        | "origin"
                        | "parent"
                        | "child"
                        | "axis"
                        | "limit"
                        | "mimic"
                )
            });
            for name in unused {
                let description = parse(&text.replace("ELEMENT", name)).unwrap();
                assert_eq!(description.notes.lines(), Vec::<String>::new(), "{name} in {parent}");
            }
            for name in ["unheard_of", "drake:joint", "origins"] {
                let notes = parse(&text.replace("ELEMENT", name)).unwrap().notes.lines();
                assert_eq!(notes.len(), 1, "{name} in {parent}: {notes:?}");
                assert!(
                    notes[0].contains(&format!("`{name}`")) && notes[0].starts_with("line 3"),
                    "{notes:?}"
                );
            }
        }
    }

    #[test]
    fn attributes_that_nobody_reads_are_noted() {
        for (text, attribute) in [
            (
                joint_with("<origin xyz=\"0 0 1\" rpyDegrees=\"0 0 90\"/>"),
                "rpyDegrees",
            ),
            (joint_with("<axis xyz=\"0 0 1\" frame=\"a\"/>"), "frame"),
            (joint_with("<limit lower=\"0\" upper=\"1\" unit=\"deg\"/>"), "unit"),
            (joint_with("<mimic joint=\"j\" power=\"2\"/>"), "power"),
            (
                robot_with(
                    "<link name=\"c\"><visual><geometry><mesh filename=\"m.stl\" unit=\"mm\"/></geometry></visual></link>",
                ),
                "unit",
            ),
        ] {
            let notes = parse(&text).unwrap().notes.lines();
            assert!(
                notes.len() == 1 && notes[0].contains(&format!("`{attribute}`")),
                "{notes:?}"
            );
        }
    }

    #[test]
    fn files_of_other_kinds_are_told_apart() {
        let cases = [
            ("<mujoco/>", "MuJoCo"),
            ("<sdf/>", "SDF"),
            ("<COLLADA/>", "COLLADA"),
            ("<launch/>", "`launch`"),
            ("<robot><group name='arm'/></robot>", "SRDF"),
            ("<robot/>", "no link"),
            ("robot: 1", "no XML"),
            ("", "no XML"),
            (
                "<robot xmlns:xacro='http://ros.org/wiki/xacro'>\n<xacro:include filename='a'/></robot>",
                "line 2: it is a xacro",
            ),
            (
                "<robot><xacro:property name='a' value='1'/></robot>",
                "xacro robot.urdf.xacro",
            ),
            (
                "<robot><link name='a'><visual><origin xyz='0 0 ${h}'/></visual></link></robot>",
                "xacro",
            ),
            (
                "<robot><link name='a'><visual><geometry><mesh filename='$(find p)/m.stl'/></geometry></visual></link></robot>",
                "xacro",
            ),
        ];
        for (text, words) in cases {
            let message = parse(text).unwrap_err();
            assert!(message.contains(words), "{text}: {message}");
        }
        // What xacro has made still declares its prefix.
        assert!(parse("<robot xmlns:xacro='http://ros.org/wiki/xacro'><link name='a'/></robot>").is_ok());
        assert!(parse("<robot><link name='a'/><gazebo><p a='${x}'/></gazebo></robot>").is_ok());
    }
}
