//! Suppositions about joint and gripper states.

use rogs_geometry::{Base, Link, Pose};

use super::footage::Footage;
use super::mistake::Mistake;
use crate::Result;

/// Link poses under each supposition about the states. `[T][F][L]`
pub(super) type Tables = Vec<Vec<Vec<Pose<Base, Link>>>>;

/// Other readings of the joint values, each with the link poses that it gives; the first entry is the values as given.
pub(super) fn readings(footage: &Footage<'_>) -> Result<(Vec<Mistake>, Tables)> {
    let names = footage.joint_names;
    let count = names.len();
    let mut mistakes = Vec::new();
    let mut tables = vec![footage.kinematics(footage.positions, footage.gripper)?];
    let mut add = |mistake: Mistake, value: &dyn Fn(&[f64], usize) -> f64| -> Result<()> {
        let changed: Vec<f64> = footage
            .positions
            .chunks_exact(count.max(1))
            .flat_map(|row| (0..count).map(|joint| value(row, joint)).collect::<Vec<f64>>())
            .collect();
        tables.push(footage.kinematics(&changed, footage.gripper)?);
        mistakes.push(mistake);
        Ok(())
    };
    if count > 1 {
        let order = "the reverse one".to_owned();
        add(Mistake::JointOrder { order }, &|row, joint| row[count - 1 - joint])?;
        let order = "the last one first".to_owned();
        add(Mistake::JointOrder { order }, &|row, joint| row[(joint + 1) % count])?;
        let order = "the first one last".to_owned();
        add(Mistake::JointOrder { order }, &|row, joint| {
            row[(joint + count - 1) % count]
        })?;
    }
    for first in 0..count.saturating_sub(1) {
        let order = format!("`{}` and `{}` are swapped", names[first], names[first + 1]);
        add(Mistake::JointOrder { order }, &|row, joint| {
            let other = if joint == first { first + 1 } else { first };
            row[if joint == first || joint == first + 1 {
                other
            } else {
                joint
            }]
        })?;
    }
    let unit = "they are degrees, radians are expected";
    add(Mistake::JointUnit { unit }, &|row, joint| row[joint].to_radians())?;
    let unit = "they were turned from degrees into radians, though they were radians";
    add(Mistake::JointUnit { unit }, &|row, joint| row[joint].to_degrees())?;
    for flipped in 0..count {
        let joint = names[flipped].clone();
        add(Mistake::JointSign { joint }, &|row, joint| {
            if joint == flipped { -row[joint] } else { row[joint] }
        })?;
    }
    Ok((mistakes, tables))
}

/// Other readings of the gripper states; the first entry of the tables is the states as given.
pub(super) fn grips(footage: &Footage<'_>) -> Result<(Vec<Mistake>, Tables)> {
    let changed = |value: &dyn Fn(f64) -> f64| -> Vec<f64> {
        footage
            .gripper
            .iter()
            .map(|&state| value(state).clamp(0.0, 1.0))
            .collect()
    };
    let mut mistakes = vec![Mistake::GripperSense];
    let mut states = vec![footage.gripper.to_vec(), changed(&|state| 1.0 - state)];
    for factor in [0.25, 0.5, 2.0, 4.0] {
        mistakes.push(Mistake::GripperRange { factor });
        states.push(changed(&|state| factor * state));
    }
    let tables = states
        .iter()
        .map(|states| footage.kinematics(footage.positions, states))
        .collect::<Result<_>>()?;
    Ok((mistakes, tables))
}

/// Which links move against the others when the gripper does.
pub(super) fn fingers(footage: &Footage<'_>) -> Result<Vec<bool>> {
    let first = footage.positions.get(..footage.joint_names.len()).unwrap_or_default();
    let open = footage.kinematics(first, &[0.0])?;
    let closed = footage.kinematics(first, &[1.0])?;
    let apart = |(open, closed): (&Pose<Base, Link>, &Pose<Base, Link>)| {
        (open.translation - closed.translation).length() > 1e-4 || !open.rotation.abs_diff_eq(closed.rotation, 1e-3)
    };
    Ok(open[0].iter().zip(&closed[0]).map(apart).collect())
}
