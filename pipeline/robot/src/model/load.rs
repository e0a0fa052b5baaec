//! From URDF text to a checked [`RobotModel`].

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use glam::DVec3;
use rogs_geometry::{Link, Pose};

use super::guard::{XmlLimits, check_xml};
use super::{Geometry, Joint, JointKind, Mimic, RobotFolder, RobotLink, RobotModel, Shape, read_capped};
use crate::error::{Error, Result};

const MAX_BYTES: u64 = 1 << 20;
const LIMITS: XmlLimits = XmlLimits {
    depth: 24,
    attributes: 24,
    elements: 40_000,
};
/// 255 stands for "no link" in maps.
const MAX_LINKS: usize = 255;

pub(super) fn load(path: &Path) -> Result<RobotModel> {
    let bytes = read_capped(path, MAX_BYTES)?;
    let refuse = |what: String| Error::Urdf {
        path: path.to_owned(),
        what,
    };
    let text = std::str::from_utf8(&bytes).map_err(|_| refuse("the file is not UTF-8 text".into()))?;
    check_xml(text, LIMITS).map_err(refuse)?;
    let robot = urdf_rs::read_from_string(text).map_err(|error| refuse(format!("no URDF: {error}")))?;
    let root_link = check_tree(&robot).map_err(refuse)?;
    let links = robot
        .links
        .iter()
        .map(link)
        .collect::<std::result::Result<Vec<_>, _>>()
        .map_err(refuse)?;
    let joints = joints(&robot, root_link).map_err(refuse)?;
    let folder = RobotFolder::of_urdf(path)?;
    Ok(RobotModel {
        name: robot.name,
        path: path.to_owned(),
        folder,
        links,
        joints,
        root_link,
        base_link: root_link,
    })
}

type Checked<T> = std::result::Result<T, String>;

/// Checks names and tree shape and returns the index of the root link.
fn check_tree(robot: &urdf_rs::Robot) -> Checked<usize> {
    if robot.links.is_empty() {
        return Err("it has no link".into());
    }
    if robot.links.len() > MAX_LINKS {
        return Err(format!(
            "it has {} links, at most {MAX_LINKS} are supported",
            robot.links.len()
        ));
    }
    let mut ids = BTreeMap::new();
    for (id, link) in robot.links.iter().enumerate() {
        if ids.insert(link.name.as_str(), id).is_some() {
            return Err(format!("two links are called `{}`", link.name));
        }
    }
    let mut joint_names = BTreeSet::new();
    let mut parent_of = vec![None; robot.links.len()];
    for joint in &robot.joints {
        if !joint_names.insert(joint.name.as_str()) {
            return Err(format!("two joints are called `{}`", joint.name));
        }
        let end = |role: &str, name: &str| {
            ids.get(name)
                .copied()
                .ok_or_else(|| format!("joint `{}`: its {role} link `{name}` does not exist", joint.name))
        };
        let (parent, child) = (end("parent", &joint.parent.link)?, end("child", &joint.child.link)?);
        if parent_of[child].replace(parent).is_some() {
            return Err(format!("link `{}` is the child of two joints", joint.child.link));
        }
    }
    let roots: Vec<usize> = (0..robot.links.len()).filter(|&id| parent_of[id].is_none()).collect();
    let &[root] = roots.as_slice() else {
        let names: Vec<&str> = roots.iter().take(8).map(|&id| robot.links[id].name.as_str()).collect();
        return Err(match names.as_slice() {
            [] => "the links form a cycle: every link has a parent".into(),
            _ => format!(
                "it has {} root links ({}), one is needed",
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

fn link(link: &urdf_rs::Link) -> Checked<RobotLink> {
    let shape = |origin: &urdf_rs::Pose, geometry: &urdf_rs::Geometry| {
        let place = format!("link `{}`", link.name);
        Ok::<_, String>(Shape {
            link_from_shape: pose(origin, &place)?,
            geometry: checked_geometry(geometry, &place)?,
        })
    };
    Ok(RobotLink {
        name: link.name.clone(),
        visual: link
            .visual
            .iter()
            .map(|item| shape(&item.origin, &item.geometry))
            .collect::<Checked<_>>()?,
        collision: link
            .collision
            .iter()
            .map(|item| shape(&item.origin, &item.geometry))
            .collect::<Checked<_>>()?,
    })
}

fn checked_geometry(geometry: &urdf_rs::Geometry, place: &str) -> Checked<Geometry> {
    let positive = |what: &str, value: f64| {
        let good = value.is_finite() && value > 0.0 && value < 1e6;
        if good {
            Ok(value)
        } else {
            Err(format!("{place}: {what} is {value}, it must be a positive length"))
        }
    };
    Ok(match geometry {
        urdf_rs::Geometry::Box { size } => {
            let sides = size.0;
            Geometry::Box {
                size: [
                    positive("a box side", sides[0])?,
                    positive("a box side", sides[1])?,
                    positive("a box side", sides[2])?,
                ],
            }
        }
        urdf_rs::Geometry::Cylinder { radius, length } => Geometry::Cylinder {
            radius: positive("a radius", *radius)?,
            length: positive("a length", *length)?,
        },
        urdf_rs::Geometry::Sphere { radius } => Geometry::Sphere {
            radius: positive("a radius", *radius)?,
        },
        urdf_rs::Geometry::Capsule { .. } => return Err(format!("{place}: capsules are not supported")),
        urdf_rs::Geometry::Mesh { filename, scale } => {
            let scale = scale.map_or([1.0; 3], |scale| scale.0);
            if !scale.iter().all(|factor| factor.is_finite() && *factor != 0.0) {
                return Err(format!("{place}: mesh scale is {scale:?}"));
            }
            Geometry::Mesh {
                reference: filename.clone(),
                scale,
            }
        }
    })
}

fn pose(origin: &urdf_rs::Pose, place: &str) -> Checked<Pose<Link, Link>> {
    let (xyz, rpy) = (origin.xyz.0, origin.rpy.0);
    if !xyz.iter().chain(&rpy).all(|value| value.is_finite()) {
        return Err(format!("{place}: its origin has a number that is not finite"));
    }
    Ok(Pose::from_xyz_euler(xyz, rpy))
}

/// The joints depth first from the root link, so that parents come before their children; those of one link in the order
/// of the file. In a checked tree these are all joints.
fn depth_first(robot: &urdf_rs::Robot, root_link: usize) -> Vec<&urdf_rs::Joint> {
    let mut joints_of: BTreeMap<&str, Vec<&urdf_rs::Joint>> = BTreeMap::new();
    // The last joint of a list is taken first.
    for joint in robot.joints.iter().rev() {
        joints_of.entry(&joint.parent.link).or_default().push(joint);
    }
    let mut open = joints_of
        .remove(robot.links[root_link].name.as_str())
        .unwrap_or_default();
    let mut order = Vec::with_capacity(robot.joints.len());
    while let Some(joint) = open.pop() {
        order.push(joint);
        open.extend(joints_of.remove(joint.child.link.as_str()).unwrap_or_default());
    }
    order
}

/// The joints of a checked tree, parents first.
fn joints(robot: &urdf_rs::Robot, root_link: usize) -> Checked<Vec<Joint>> {
    let id_of: BTreeMap<&str, usize> = robot
        .links
        .iter()
        .enumerate()
        .map(|(id, link)| (link.name.as_str(), id))
        .collect();
    let by_name: BTreeMap<&str, &urdf_rs::Joint> =
        robot.joints.iter().map(|joint| (joint.name.as_str(), joint)).collect();
    check_mimics(&by_name)?;
    robot.joints.iter().try_for_each(check_limits)?;
    let order = depth_first(robot, root_link);
    let index_of: BTreeMap<&str, usize> = order
        .iter()
        .enumerate()
        .map(|(index, joint)| (joint.name.as_str(), index))
        .collect();
    let convert = |source: &&urdf_rs::Joint| {
        let source = *source;
        let place = format!("joint `{}`", source.name);
        let kind = joint_kind(source)?;
        Ok(Joint {
            name: source.name.clone(),
            kind,
            parent: id_of[source.parent.link.as_str()],
            child: id_of[source.child.link.as_str()],
            parent_from_origin: pose(&source.origin, &place)?,
            axis: joint_axis(source, kind)?,
            limits: joint_limits(source)?,
            mimic: resolve_mimic(source, &by_name).map(|(driver, multiplier, offset)| Mimic {
                driver: index_of[driver],
                multiplier,
                offset,
            }),
        })
    };
    order.iter().map(convert).collect()
}

fn joint_kind(joint: &urdf_rs::Joint) -> Checked<JointKind> {
    match joint.joint_type {
        urdf_rs::JointType::Fixed => Ok(JointKind::Fixed),
        urdf_rs::JointType::Revolute | urdf_rs::JointType::Continuous => Ok(JointKind::Rotational),
        urdf_rs::JointType::Prismatic => Ok(JointKind::Linear),
        ref other => Err(format!("joint `{}`: type {other:?} is not supported", joint.name)),
    }
}

fn joint_axis(joint: &urdf_rs::Joint, kind: JointKind) -> Checked<DVec3> {
    let axis = DVec3::from_array(joint.axis.xyz.0);
    if kind == JointKind::Fixed {
        return Ok(DVec3::X);
    }
    let length = axis.length();
    if !(1e-6..1e6).contains(&length) {
        return Err(format!(
            "joint `{}`: its axis {:?} has no direction",
            joint.name, joint.axis.xyz.0
        ));
    }
    Ok(axis / length)
}

fn check_limits(joint: &urdf_rs::Joint) -> Checked<()> {
    let urdf_rs::JointLimit { lower, upper, .. } = joint.limit;
    if !lower.is_finite() || !upper.is_finite() {
        return Err(format!("joint `{}`: its limits are not finite", joint.name));
    }
    if lower > upper {
        return Err(format!(
            "joint `{}`: its limits are reversed, from {lower} to {upper}",
            joint.name
        ));
    }
    Ok(())
}

/// The limits of a joint that must have some; they were checked before.
fn joint_limits(joint: &urdf_rs::Joint) -> Checked<Option<[f64; 2]>> {
    if !matches!(
        joint.joint_type,
        urdf_rs::JointType::Revolute | urdf_rs::JointType::Prismatic
    ) {
        return Ok(None);
    }
    let urdf_rs::JointLimit { lower, upper, .. } = joint.limit;
    if lower == upper {
        return Err(format!(
            "joint `{}`: it has no limits or an empty range, from {lower} to {upper}",
            joint.name
        ));
    }
    Ok(Some([lower, upper]))
}

fn check_mimics(by_name: &BTreeMap<&str, &urdf_rs::Joint>) -> Checked<()> {
    for joint in by_name.values() {
        let mut at = *joint;
        for step in 0.. {
            let Some(mimic) = &at.mimic else { break };
            if at.joint_type == urdf_rs::JointType::Fixed {
                return Err(format!("joint `{}` is fixed and cannot mimic another", at.name));
            }
            let numbers = [mimic.multiplier.unwrap_or(1.0), mimic.offset.unwrap_or(0.0)];
            if !numbers.iter().all(|value| value.is_finite()) {
                return Err(format!(
                    "joint `{}`: its mimic has a number that is not finite",
                    at.name
                ));
            }
            let missing = || format!("joint `{}` mimics `{}`, which does not exist", at.name, mimic.joint);
            at = by_name.get(mimic.joint.as_str()).ok_or_else(missing)?;
            if at.joint_type == urdf_rs::JointType::Fixed {
                return Err(format!("joint `{}` mimics the fixed joint `{}`", joint.name, at.name));
            }
            if step > by_name.len() {
                return Err(format!("joint `{}` mimics itself through other joints", joint.name));
            }
        }
    }
    Ok(())
}

/// Name of the joint at the end of the mimic chain, factor and summand.
fn resolve_mimic<'a>(
    joint: &'a urdf_rs::Joint,
    by_name: &BTreeMap<&str, &'a urdf_rs::Joint>,
) -> Option<(&'a str, f64, f64)> {
    let mimic = joint.mimic.as_ref()?;
    let (mut multiplier, mut offset) = (mimic.multiplier.unwrap_or(1.0), mimic.offset.unwrap_or(0.0));
    let mut driver = by_name[mimic.joint.as_str()];
    while let Some(next) = &driver.mimic {
        offset += multiplier * next.offset.unwrap_or(0.0);
        multiplier *= next.multiplier.unwrap_or(1.0);
        driver = by_name[next.joint.as_str()];
    }
    Some((driver.name.as_str(), multiplier, offset))
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
        let robot = urdf_rs::read_from_string(&text).unwrap();
        let order: Vec<&str> = depth_first(&robot, 2).iter().map(|joint| joint.name.as_str()).collect();
        assert_eq!(order, ["to_a", "to_c", "to_e", "to_d", "to_b", "to_f"]);
        let peer = k::Chain::<f64>::from(&robot);
        let peer: Vec<String> = peer.iter().skip(1).map(|node| node.joint().name.clone()).collect();
        assert_eq!(order, peer);
    }
}
