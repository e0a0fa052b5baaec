//! URDF text as it stands: every element that is used, with its line, and a note for what is left aside.
//!
//! Read are `robot`, `link`, `joint` and below them what moves or shows the robot; [`super::known`] tells what happens to
//! the rest.

use glam::{DQuat, DVec3};
use roxmltree::Node;

use super::guard::XmlLimits;
use super::known::{Notes, is_foreign, look_over, refuse_other_formats, written_name};
use super::xml::{Parsed, child, line, with_root};
use super::{Geometry, Shape};
use rogs_geometry::{Link, Pose};

pub(super) const LIMITS: XmlLimits = XmlLimits {
    depth: 24,
    attributes: 40,
    elements: 100_000,
};

/// No part of a robot arm lies further from the next, metres.
const FAR_M: f64 = 20.0;
/// Limits of rotation that are probably degrees, radians: joints turn less far, and "without end" is written larger.
const DEGREES: std::ops::RangeInclusive<f64> = 15.0..=720.0;

/// A robot as its file describes it.
#[derive(Debug)]
pub(super) struct Description {
    pub name: String,
    pub links: Vec<LinkElement>,
    pub joints: Vec<JointElement>,
    pub notes: Notes,
}

#[derive(Debug)]
pub(super) struct LinkElement {
    pub name: String,
    pub line: u32,
    pub visual: Vec<Shape>,
    pub collision: Vec<Shape>,
}

#[derive(Debug)]
pub(super) struct JointElement {
    pub name: String,
    pub line: u32,
    pub kind: JointType,
    pub parent: String,
    pub child: String,
    pub parent_from_origin: Pose<Link, Link>,
    pub axis: [f64; 3],
    pub limit: Option<Limit>,
    pub mimic: Option<MimicElement>,
}

impl JointElement {
    /// Where it stands, for messages.
    pub(super) fn place(&self) -> String {
        format!("line {}, joint `{}`", self.line, self.name)
    }
}

/// The joint types of URDF.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum JointType {
    Fixed,
    Revolute,
    Continuous,
    Prismatic,
    Floating,
    Planar,
}

/// Lower and upper limit as written.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limit {
    pub lower: Option<f64>,
    pub upper: Option<f64>,
}

#[derive(Debug)]
pub(super) struct MimicElement {
    pub joint: String,
    pub multiplier: f64,
    pub offset: f64,
}

/// Reads a URDF.
///
/// # Errors
/// When it is no URDF, or an element that is used is incomplete or has numbers that are none; with the line.
pub(super) fn parse(text: &str) -> Parsed<Description> {
    if !text.trim_start().starts_with('<') {
        return Err("it is no XML: a URDF begins with `<?xml` or `<robot`".into());
    }
    with_root(text, LIMITS, robot)
}

fn robot(root: Node<'_, '_>) -> Parsed<Description> {
    refuse_other_formats(root)?;
    let mut description = Description {
        name: root.attribute("name").unwrap_or_default().trim().to_owned(),
        links: Vec::new(),
        joints: Vec::new(),
        notes: Notes::default(),
    };
    let notes = &mut description.notes;
    look_over(root, "the robot", notes);
    for node in root.children().filter(Node::is_element) {
        if is_foreign(node) {
            continue;
        }
        match node.tag_name().name() {
            "link" => description.links.push(link(node, notes)?),
            "joint" => description.joints.push(joint(node, notes)?),
            _ => {}
        }
    }
    if description.links.is_empty() {
        return Err(match child(root, "group").or_else(|| child(root, "group_state")) {
            Some(_) => "it is an SRDF (groups of joints), which has no links; name the URDF that belongs to it".into(),
            None => "it has no link".into(),
        });
    }
    Ok(description)
}

fn name_of(node: Node<'_, '_>, what: &str) -> Parsed<String> {
    match node.attribute("name").map(str::trim) {
        Some(name) if !name.is_empty() => Ok(name.to_owned()),
        _ => Err(format!("line {}: a {what} without a name", line(node))),
    }
}

fn link(node: Node<'_, '_>, notes: &mut Notes) -> Parsed<LinkElement> {
    let name = name_of(node, "link")?;
    let owner = format!("link `{name}`");
    look_over(node, &owner, notes);
    let mut link = LinkElement {
        name,
        line: line(node),
        visual: Vec::new(),
        collision: Vec::new(),
    };
    for part in node.children().filter(|part| part.is_element() && !is_foreign(*part)) {
        let shapes = match part.tag_name().name() {
            "visual" => &mut link.visual,
            "collision" => &mut link.collision,
            _ => continue,
        };
        look_over(part, &owner, notes);
        shapes.extend(shape(part, &owner, notes)?);
    }
    Ok(link)
}

/// The shape of a `visual` or `collision`; `None` where there is nothing to show.
fn shape(node: Node<'_, '_>, owner: &str, notes: &mut Notes) -> Parsed<Option<Shape>> {
    let place = format!("line {}, {owner}", line(node));
    let geometry = child(node, "geometry");
    if let Some(geometry) = geometry {
        look_over(geometry, owner, notes);
    }
    let element = geometry.and_then(|geometry| geometry.children().find(Node::is_element));
    let Some(element) = element else {
        notes.add(place, format!("a `{}` has no geometry", node.tag_name().name()));
        return Ok(None);
    };
    look_over(element, owner, notes);
    let Some(geometry) = geometry_of(element, owner, notes)? else {
        return Ok(None);
    };
    let link_from_shape = origin(node, owner, notes)?;
    Ok(Some(Shape {
        link_from_shape,
        geometry,
    }))
}

fn geometry_of(node: Node<'_, '_>, owner: &str, notes: &mut Notes) -> Parsed<Option<Geometry>> {
    let place = format!("line {}, {owner}", line(node));
    let name = node.tag_name().name();
    let required = |attribute: &str| -> Parsed<[f64; 1]> {
        numbers(node, attribute, &place)?.ok_or_else(|| format!("{place}: a `{name}` needs `{attribute}`"))
    };
    let geometry = match name {
        "box" => {
            let size = numbers(node, "size", &place)?.ok_or_else(|| format!("{place}: a `box` needs `size`"))?;
            Geometry::Box { size }
        }
        "cylinder" => Geometry::Cylinder {
            radius: required("radius")?[0],
            length: required("length")?[0],
        },
        "capsule" => Geometry::Capsule {
            radius: required("radius")?[0],
            length: required("length")?[0],
        },
        "sphere" => Geometry::Sphere {
            radius: required("radius")?[0],
        },
        "mesh" => return mesh(node, &place, notes).map(Some),
        _ => {
            return Err(format!(
                "{place}: the geometry `{}` is not known; URDF has box, cylinder, sphere, capsule, mesh",
                written_name(node)
            ));
        }
    };
    let lengths: &[f64] = match &geometry {
        Geometry::Box { size } => size,
        Geometry::Cylinder { radius, length } => &[*radius, *length],
        Geometry::Capsule { radius, .. } | Geometry::Sphere { radius } => &[*radius],
        Geometry::Mesh { .. } => &[],
    };
    if let Some(length) = lengths.iter().find(|length| !(0.0..1e6).contains(*length)) {
        return Err(format!(
            "{place}: a `{name}` has the length {length}, it must be positive"
        ));
    }
    if lengths.contains(&0.0) {
        notes.add(place, format!("a `{name}` of size 0 shows nothing"));
        return Ok(None);
    }
    Ok(Some(geometry))
}

fn mesh(node: Node<'_, '_>, place: &str, notes: &mut Notes) -> Parsed<Geometry> {
    let reference = node.attribute("filename").unwrap_or_default().trim();
    if reference.is_empty() {
        return Err(format!("{place}: a `mesh` names no file (`filename`)"));
    }
    let one_number = node
        .attribute("scale")
        .is_some_and(|text| text.split_ascii_whitespace().count() == 1);
    let scale = if one_number {
        notes.add(
            place,
            "the scale of a mesh has one number, which is taken for all three axes",
        );
        numbers::<1>(node, "scale", place)?.map_or([1.0; 3], |[factor]| [factor; 3])
    } else {
        numbers(node, "scale", place)?.unwrap_or([1.0; 3])
    };
    if scale.contains(&0.0) {
        return Err(format!("{place}: the scale of a mesh is {scale:?}, it must not be 0"));
    }
    Ok(Geometry::Mesh {
        reference: reference.to_owned(),
        scale,
    })
}

/// The pose in the `origin` below a node; the identity without one.
fn origin(node: Node<'_, '_>, owner: &str, notes: &mut Notes) -> Parsed<Pose<Link, Link>> {
    let Some(origin) = child(node, "origin") else {
        return Ok(Pose::IDENTITY);
    };
    look_over(origin, owner, notes);
    let place = format!("line {}, {owner}", line(origin));
    let xyz = numbers(origin, "xyz", &place)?.unwrap_or([0.0; 3]);
    let rpy = numbers(origin, "rpy", &place)?;
    let beyond = |angle: &f64| angle.abs() > 2.0 * std::f64::consts::PI + 0.01;
    if rpy.is_some_and(|angles: [f64; 3]| angles.iter().any(beyond)) {
        notes.add(
            &place,
            "an angle of an `rpy` is beyond a full turn: are these degrees? URDF takes radians",
        );
    }
    if xyz.iter().any(|length: &f64| length.abs() > FAR_M) {
        notes.add(
            &place,
            "an `xyz` is more than 20 m: are these millimetres? URDF takes metres",
        );
    }
    let Some(quaternion) = numbers::<4>(origin, "quat_xyzw", &place)? else {
        return Ok(Pose::from_xyz_euler(xyz, rpy.unwrap_or([0.0; 3])));
    };
    if rpy.is_some() {
        return Err(format!("{place}: its origin has both `rpy` and `quat_xyzw`; leave one"));
    }
    let quaternion = DQuat::from_array(quaternion);
    if (quaternion.length() - 1.0).abs() > 1e-3 {
        return Err(format!(
            "{place}: the quaternion of its origin has length {}",
            quaternion.length()
        ));
    }
    Ok(Pose::new(
        glam::DMat3::from_quat(quaternion.normalize()),
        DVec3::from_array(xyz),
    ))
}

fn joint(node: Node<'_, '_>, notes: &mut Notes) -> Parsed<JointElement> {
    let name = name_of(node, "joint")?;
    let owner = format!("joint `{name}`");
    let place = format!("line {}, {owner}", line(node));
    look_over(node, &owner, notes);
    let kind = match node.attribute("type").map(str::trim) {
        Some("fixed") => JointType::Fixed,
        Some("revolute") => JointType::Revolute,
        Some("continuous") => JointType::Continuous,
        Some("prismatic") => JointType::Prismatic,
        Some("floating") => JointType::Floating,
        Some("planar") => JointType::Planar,
        Some(other) => {
            return Err(format!(
                "{place}: the type `{other}` is not known; URDF has revolute, continuous, prismatic, fixed, floating, planar"
            ));
        }
        None => return Err(format!("{place}: it has no `type`")),
    };
    let end = |role: &str| {
        let named = child(node, role).and_then(|end| end.attribute("link")).map(str::trim);
        named
            .map(str::to_owned)
            .ok_or_else(|| format!("{place}: it names no {role} link"))
    };
    let part = |name: &str, notes: &mut Notes| {
        let part = child(node, name);
        if let Some(part) = part {
            look_over(part, &owner, notes);
        }
        part
    };
    for role in ["parent", "child"] {
        part(role, notes);
    }
    let axis = match part("axis", notes) {
        Some(axis) => numbers(axis, "xyz", &place)?.unwrap_or([1.0, 0.0, 0.0]),
        None => [1.0, 0.0, 0.0],
    };
    Ok(JointElement {
        kind,
        parent: end("parent")?,
        child: end("child")?,
        parent_from_origin: origin(node, &owner, notes)?,
        axis,
        limit: part("limit", notes)
            .map(|limit| read_limit(limit, kind, &place, notes))
            .transpose()?,
        mimic: part("mimic", notes)
            .map(|mimic| read_mimic(mimic, &place))
            .transpose()?,
        line: line(node),
        name,
    })
}

/// The limits of a joint that has a use for them; an infinite one is none.
fn read_limit(node: Node<'_, '_>, kind: JointType, place: &str, notes: &mut Notes) -> Parsed<Limit> {
    let mut limit = Limit {
        lower: None,
        upper: None,
    };
    if !matches!(kind, JointType::Revolute | JointType::Prismatic) {
        return Ok(limit);
    }
    for (attribute, value) in [("lower", &mut limit.lower), ("upper", &mut limit.upper)] {
        let Some(text) = node.attribute(attribute) else {
            continue;
        };
        *value = match text.trim().parse::<f64>() {
            Ok(number) if number.is_infinite() => Some(number),
            _ => numbers::<1>(node, attribute, place)?.map(|[number]| number),
        };
    }
    let farthest = [limit.lower, limit.upper].into_iter().flatten().map(f64::abs);
    let farthest = farthest.filter(|limit| limit.is_finite()).fold(0.0, f64::max);
    if kind == JointType::Revolute && DEGREES.contains(&farthest) {
        notes.add(
            place,
            "its limits are several turns: are these degrees? URDF takes radians",
        );
    }
    if kind == JointType::Prismatic && farthest > FAR_M {
        notes.add(
            place,
            "its limits are more than 20 m: are these millimetres? URDF takes metres",
        );
    }
    Ok(limit)
}

fn read_mimic(node: Node<'_, '_>, place: &str) -> Parsed<MimicElement> {
    let joint = node.attribute("joint").unwrap_or_default().trim();
    if joint.is_empty() {
        return Err(format!("{place}: its mimic names no joint"));
    }
    let number = |attribute: &str, default: f64| -> Parsed<f64> {
        Ok(numbers::<1>(node, attribute, place)?.map_or(default, |[value]| value))
    };
    Ok(MimicElement {
        joint: joint.to_owned(),
        multiplier: number("multiplier", 1.0)?,
        offset: number("offset", 0.0)?,
    })
}

/// The `N` finite numbers of an attribute; `None` where it is not there or empty.
fn numbers<const N: usize>(node: Node<'_, '_>, attribute: &str, place: &str) -> Parsed<Option<[f64; N]>> {
    let Some(text) = node.attribute(attribute).map(str::trim).filter(|text| !text.is_empty()) else {
        return Ok(None);
    };
    let shown: String = text.chars().take(60).collect();
    let wrong = |what: &str| {
        let element = node.tag_name().name();
        Err(format!(
            "{place}: invalid `{attribute}` of `{element}`, `{shown}`: {what}"
        ))
    };
    if text.contains(',') {
        return wrong("separate numbers by blanks, with a point for decimals");
    }
    let mut values = [0.0; N];
    let mut words = text.split_ascii_whitespace();
    for value in &mut values {
        *value = match words.next().map(str::parse::<f64>) {
            Some(Ok(number)) if number.is_finite() => number,
            Some(Ok(_)) => return wrong("a number is not finite"),
            Some(Err(_)) => return wrong("expected a number, e.g. `0.25`"),
            None => return wrong(&format!("expected {N} numbers")),
        };
    }
    if words.next().is_some() {
        return wrong(&format!("expected {N} numbers"));
    }
    Ok(Some(values))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in super::super) fn robot_with(inside: &str) -> String {
        format!("<robot name=\"r\">\n<link name=\"a\"/><link name=\"b\"/>\n{inside}</robot>")
    }

    pub(in super::super) fn joint_with(inside: &str) -> String {
        robot_with(&format!(
            "<joint name=\"j\" type=\"revolute\"><parent link=\"a\"/><child link=\"b\"/>{inside}</joint>"
        ))
    }

    #[test]
    fn origins_take_angles_or_a_quaternion() {
        let pose = |origin: &str| parse(&joint_with(origin)).map(|robot| robot.joints[0].parent_from_origin);
        let turned = pose("<origin xyz='1 2 3' rpy='0 0 1.5707963267948966'/>").unwrap();
        let same = pose("<origin xyz=' 1  2 3 ' quat_xyzw='0 0 0.7071067811865476 0.7071067811865476'/>").unwrap();
        assert!(turned.rotation.abs_diff_eq(same.rotation, 1e-12) && turned.translation == same.translation);
        assert_eq!(pose("<origin/>").unwrap(), Pose::IDENTITY);
        assert_eq!(pose("").unwrap(), Pose::IDENTITY);
        for (wrong, words) in [
            ("<origin rpy='0 0 0' quat_xyzw='0 0 0 1'/>", "leave one"),
            ("<origin quat_xyzw='0 0 0 2'/>", "length 2"),
            ("<origin xyz='0, 0, 1'/>", "by blanks"),
            ("<origin xyz='0 0'/>", "expected 3 numbers"),
            ("<origin xyz='0 0 0 0'/>", "expected 3 numbers"),
            ("<origin xyz='0 0 nan'/>", "not finite"),
            ("<origin xyz='0 0 x'/>", "expected a number"),
        ] {
            let message = pose(wrong).unwrap_err();
            assert!(
                message.contains(words) && message.starts_with("line 3, joint `j`"),
                "{message}"
            );
        }
    }

    #[test]
    fn shapes_of_every_kind() {
        let shapes = |geometry: &str| {
            let text = robot_with(&format!(
                "<link name='c'><visual><geometry>{geometry}</geometry></visual></link>"
            ));
            parse(&text).map(|robot| (robot.links[2].visual.clone(), robot.notes.lines()))
        };
        let one = |geometry: &str| shapes(geometry).unwrap().0.remove(0).geometry;
        assert_eq!(one("<box size='1 2 3'/>"), Geometry::Box { size: [1.0, 2.0, 3.0] });
        assert_eq!(
            one("<capsule radius='1' length='2'/>"),
            Geometry::Capsule {
                radius: 1.0,
                length: 2.0
            }
        );
        let scale = |text: &str| match one(&format!("<mesh filename='m.stl' {text}/>")) {
            Geometry::Mesh { scale, .. } => scale,
            other => panic!("{other:?}"),
        };
        assert_eq!(scale(""), [1.0; 3]);
        assert_eq!(scale("scale='0.001'"), [0.001; 3]);
        assert_eq!(scale("scale='1 -1 1'"), [1.0, -1.0, 1.0]);
        for nothing in ["", "<box size='0 0 0'/>", "<sphere radius='0'/>"] {
            let (shapes, notes) = shapes(nothing).unwrap();
            assert!(shapes.is_empty() && notes.len() == 1, "{notes:?}");
        }
        for (wrong, words) in [
            ("<plane/>", "`plane`"),
            ("<mesh/>", "names no file"),
            ("<mesh filename='a' scale='1 1'/>", "expected 3"),
            ("<mesh filename='a' scale='1 0 1'/>", "not be 0"),
            ("<sphere/>", "needs `radius`"),
            ("<box size='1 -1 1'/>", "positive"),
        ] {
            let message = shapes(wrong).unwrap_err();
            assert!(
                message.contains(words) && message.starts_with("line 3, link `c`"),
                "{message}"
            );
        }
    }
}
