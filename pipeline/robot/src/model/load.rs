//! From URDF text to a checked [`RobotModel`].

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use glam::DVec3;
use rogs_geometry::{Link, Pose, rotation_about_axis};

use super::known::Notes;
use super::urdf::{Description, JointElement, JointType, parse};
use super::xml::{self, Parsed};
use super::{Joint, JointKind, Mimic, RobotFolder, RobotLink, RobotModel, read_capped};
use crate::error::{Error, Result};

const MAX_BYTES: u64 = 4 << 20;
/// 255 stands for "no link" in maps.
const MAX_LINKS: usize = 255;

pub(super) fn load(path: &Path) -> Result<RobotModel> {
    let bytes = read_capped(path, MAX_BYTES)?;
    let model = xml::text_of(&bytes).and_then(|text| model(&text));
    let (description, root_link, joints) = model.map_err(|what| Error::Urdf {
        path: path.to_owned(),
        what,
    })?;
    let folder = RobotFolder::of_urdf(path).map_err(|source| Error::Io {
        action: "opening",
        path: path.to_owned(),
        source,
    })?;
    let link = |link: super::urdf::LinkElement| RobotLink {
        name: link.name,
        visual: link.visual,
        collision: link.collision,
    };
    Ok(RobotModel {
        name: description.name,
        path: path.to_owned(),
        folder,
        notes: description.notes.lines(),
        links: description.links.into_iter().map(link).collect(),
        joints,
        root_link,
        base_link: root_link,
    })
}

fn model(text: &str) -> Parsed<(Description, usize, Vec<Joint>)> {
    let mut description = parse(text)?;
    let mut notes = std::mem::take(&mut description.notes);
    let root_link = check_tree(&description)?;
    let joints = joints(&description, root_link, &mut notes)?;
    description.notes = notes;
    Ok((description, root_link, joints))
}

/// Checks names and tree shape and returns the index of the root link.
fn check_tree(robot: &Description) -> Parsed<usize> {
    if robot.links.len() > MAX_LINKS {
        return Err(format!(
            "it has {} links, at most {MAX_LINKS} are supported",
            robot.links.len()
        ));
    }
    let mut ids = BTreeMap::new();
    for (id, link) in robot.links.iter().enumerate() {
        if ids.insert(link.name.as_str(), id).is_some() {
            return Err(format!("line {}: two links are called `{}`", link.line, link.name));
        }
    }
    let mut joint_names = BTreeSet::new();
    let mut parent_of = vec![None; robot.links.len()];
    for joint in &robot.joints {
        if !joint_names.insert(joint.name.as_str()) {
            return Err(format!("line {}: two joints are called `{}`", joint.line, joint.name));
        }
        let end = |role: &str, name: &str| {
            ids.get(name)
                .copied()
                .ok_or_else(|| format!("{}: its {role} link `{name}` does not exist", joint.place()))
        };
        let (parent, child) = (end("parent", &joint.parent)?, end("child", &joint.child)?);
        if parent_of[child].replace(parent).is_some() {
            return Err(format!(
                "line {}: link `{}` is the child of two joints",
                joint.line, joint.child
            ));
        }
    }
    let roots: Vec<usize> = (0..robot.links.len()).filter(|&id| parent_of[id].is_none()).collect();
    let &[root] = roots.as_slice() else {
        let names: Vec<&str> = roots.iter().take(8).map(|&id| robot.links[id].name.as_str()).collect();
        return Err(match names.as_slice() {
            [] => "the links form a cycle: every link has a parent".into(),
            _ => format!(
                "it has {} root links ({}), one is needed: connect them by joints, for example fixed ones",
                roots.len(),
                names.join(", ")
            ),
        });
    };
    for (id, link) in robot.links.iter().enumerate() {
        let mut at = id;
        for _ in 0..robot.links.len() {
            at = parent_of[at].unwrap_or(root);
        }
        if at != root {
            return Err(format!("link `{}` is part of a cycle", link.name));
        }
    }
    Ok(root)
}

/// The joints depth first from the root link, so that parents come before their children; those of one link in the order
/// of the file. In a checked tree these are all joints.
fn depth_first(robot: &Description, root_link: usize) -> Vec<&JointElement> {
    let mut joints_of: BTreeMap<&str, Vec<&JointElement>> = BTreeMap::new();
    // The last joint of a list is taken first.
    for joint in robot.joints.iter().rev() {
        joints_of.entry(&joint.parent).or_default().push(joint);
    }
    let mut open = joints_of
        .remove(robot.links[root_link].name.as_str())
        .unwrap_or_default();
    let mut order = Vec::with_capacity(robot.joints.len());
    while let Some(joint) = open.pop() {
        order.push(joint);
        open.extend(joints_of.remove(joint.child.as_str()).unwrap_or_default());
    }
    order
}

/// The joints of a checked tree, parents first.
fn joints(robot: &Description, root_link: usize, notes: &mut Notes) -> Parsed<Vec<Joint>> {
    let id_of: BTreeMap<&str, usize> = robot
        .links
        .iter()
        .enumerate()
        .map(|(id, link)| (link.name.as_str(), id))
        .collect();
    let by_name: BTreeMap<&str, &JointElement> =
        robot.joints.iter().map(|joint| (joint.name.as_str(), joint)).collect();
    let order = depth_first(robot, root_link);
    let index_of: BTreeMap<&str, usize> = order
        .iter()
        .enumerate()
        .map(|(index, joint)| (joint.name.as_str(), index))
        .collect();
    let mut convert = |source: &&JointElement| {
        let source = *source;
        let kind = joint_kind(source, notes);
        let axis = joint_axis(source, kind)?;
        let mut joint = Joint {
            name: source.name.clone(),
            kind,
            parent: id_of[source.parent.as_str()],
            child: id_of[source.child.as_str()],
            parent_from_origin: source.parent_from_origin,
            axis,
            limits: joint_limits(source, kind, notes)?,
            mimic: None,
        };
        match follow(source, kind, &by_name, notes)? {
            Follows::Nothing => {}
            Follows::Joint(driver, multiplier, offset) => {
                joint.mimic = Some(Mimic {
                    driver: index_of[driver],
                    multiplier,
                    offset,
                });
            }
            Follows::Constant(value) => {
                joint.parent_from_origin = joint.parent_from_origin * motion(kind, axis, value);
                (joint.kind, joint.limits) = (JointKind::Fixed, None);
            }
        }
        Ok(joint)
    };
    order.iter().map(&mut convert).collect()
}

/// The motion of a joint at a value.
pub(super) fn motion(kind: JointKind, axis: DVec3, value: f64) -> Pose<Link, Link> {
    match kind {
        JointKind::Fixed => Pose::IDENTITY,
        JointKind::Rotational => Pose::new(rotation_about_axis(axis, value), DVec3::ZERO),
        JointKind::Linear => Pose::new(glam::DMat3::IDENTITY, axis * value),
    }
}

fn joint_kind(joint: &JointElement, notes: &mut Notes) -> JointKind {
    let held = |notes: &mut Notes, kind: &str| {
        notes.add(
            joint.place(),
            format!("a {kind} joint is not moved: its link stays at the joint's origin"),
        );
        JointKind::Fixed
    };
    match joint.kind {
        JointType::Fixed => JointKind::Fixed,
        JointType::Revolute | JointType::Continuous => JointKind::Rotational,
        JointType::Prismatic => JointKind::Linear,
        JointType::Floating => held(notes, "floating"),
        JointType::Planar => held(notes, "planar"),
    }
}

fn joint_axis(joint: &JointElement, kind: JointKind) -> Parsed<DVec3> {
    if kind == JointKind::Fixed {
        return Ok(DVec3::X);
    }
    let axis = DVec3::from_array(joint.axis);
    let length = axis.length();
    if !(1e-6..1e6).contains(&length) {
        return Err(format!("{}: its axis {:?} has no direction", joint.place(), joint.axis));
    }
    Ok(axis / length)
}

/// The limits of a joint. Of two limits one that is not written is 0, as the standard says; where neither is, none are
/// known: only a mimic joint and one that turns without end may do so unnoted.
fn joint_limits(joint: &JointElement, kind: JointKind, notes: &mut Notes) -> Parsed<Option<[f64; 2]>> {
    if kind == JointKind::Fixed || joint.kind == JointType::Continuous {
        return Ok(None);
    }
    let (lower, upper) = match joint.limit {
        Some(limit) if limit.lower.is_some() || limit.upper.is_some() => {
            (limit.lower.unwrap_or(0.0), limit.upper.unwrap_or(0.0))
        }
        _ => {
            if joint.mimic.is_none() {
                notes.add(
                    joint.place(),
                    "no `lower` and `upper` limit is given: its values are not compared with any",
                );
            }
            return Ok(None);
        }
    };
    if lower > upper {
        return Err(format!(
            "{}: its limits are reversed, from {lower} to {upper}; exchange `lower` and `upper`",
            joint.place()
        ));
    }
    Ok((lower.is_finite() || upper.is_finite()).then_some([lower, upper]))
}

/// What a joint follows.
enum Follows<'a> {
    /// It is driven by its own value.
    Nothing,
    /// The joint at the end of the mimic chain, factor and summand.
    Joint(&'a str, f64, f64),
    /// A joint that does not move: it stands at this value.
    Constant(f64),
}

/// Multiplies a chain of mimic joints out.
fn follow<'a>(
    joint: &'a JointElement,
    kind: JointKind,
    by_name: &BTreeMap<&str, &'a JointElement>,
    notes: &mut Notes,
) -> Parsed<Follows<'a>> {
    let Some(first) = &joint.mimic else {
        return Ok(Follows::Nothing);
    };
    if kind == JointKind::Fixed {
        notes.add(
            joint.place(),
            "a joint that does not move mimics another: its `mimic` is left aside",
        );
        return Ok(Follows::Nothing);
    }
    let (mut multiplier, mut offset) = (first.multiplier, first.offset);
    let Some(mut driver) = by_name.get(first.joint.as_str()).copied() else {
        let what = format!(
            "it mimics `{}`, which does not exist: its own value moves it",
            first.joint
        );
        notes.add(joint.place(), what);
        return Ok(Follows::Nothing);
    };
    for _ in 0..by_name.len() {
        if !moves(driver) {
            notes.add(
                joint.place(),
                format!(
                    "it mimics `{}`, which does not move: it stands at its offset",
                    driver.name
                ),
            );
            return Ok(Follows::Constant(offset));
        }
        let next = driver
            .mimic
            .as_ref()
            .and_then(|next| Some((next, by_name.get(next.joint.as_str())?)));
        let Some((next, &target)) = next else {
            if !multiplier.is_finite() || !offset.is_finite() {
                return Err(format!(
                    "{}: the factors of what it mimics are too large",
                    joint.place()
                ));
            }
            return Ok(Follows::Joint(&driver.name, multiplier, offset));
        };
        offset += multiplier * next.offset;
        multiplier *= next.multiplier;
        driver = target;
    }
    let itself = if first.joint == joint.name {
        "itself"
    } else {
        "itself through other joints"
    };
    Err(format!("{}: it mimics {itself}", joint.place()))
}

fn moves(joint: &JointElement) -> bool {
    matches!(
        joint.kind,
        JointType::Revolute | JointType::Continuous | JointType::Prismatic
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_come_parents_first_in_the_order_of_the_file_as_in_the_k_crate() {
        let link = |name: &str| format!(r#"<link name="{name}"/>"#);
        let joint = |name: &str, parent: &str, child: &str| {
            format!(r#"<joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/></joint>"#)
        };
        let links: String = ["d", "b", "root", "a", "c", "e", "f"].map(link).concat();
        let joints = [
            joint("to_c", "a", "c"),
            joint("to_a", "root", "a"),
            joint("to_f", "b", "f"),
            joint("to_b", "root", "b"),
            joint("to_d", "a", "d"),
            joint("to_e", "c", "e"),
        ];
        let text = format!(r#"<robot name="r">{links}{}</robot>"#, joints.concat());
        let robot = parse(&text).unwrap();
        let order: Vec<&str> = depth_first(&robot, 2).iter().map(|joint| joint.name.as_str()).collect();
        assert_eq!(order, ["to_a", "to_c", "to_e", "to_d", "to_b", "to_f"]);
        let peer = k::Chain::<f64>::from(&urdf_rs::read_from_string(&text).unwrap());
        let peer: Vec<String> = peer.iter().skip(1).map(|node| node.joint().name.clone()).collect();
        assert_eq!(order, peer);
    }
}
