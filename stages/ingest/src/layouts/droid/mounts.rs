//! Poses of the cameras: fixed ones of the external cameras, the hand-eye of the wrist camera, and what gives wrong
//! ones away.

use std::collections::BTreeMap;
use std::path::Path;

use rogs_geometry::{Base, Camera, Link, Pose};
use rogs_schemas::Intrinsics;
use rogs_worker::StageResult;

use super::metadata::Metadata;
use super::published::{Poses, Published};
use super::trajectory::CameraLog;
use crate::checks;
use crate::fault::wrong;
use crate::params::Quality;

/// Poses that are the same differ by no more, metres and radians: files keep seven digits.
const SAME: [f64; 2] = [1e-4, 1e-4];
/// Two ways to the hand-eye agree within this, metres and radians.
const AGREE: [f64; 2] = [0.002, 0.0035];
/// A camera further from the flange than this is not on the wrist, metres.
const REACH: f64 = 0.35;
/// How far the robot's flange is from a camera that sees it, metres.
const SIGHT: std::ops::Range<f64> = 0.05..4.0;
/// Tilt of DROID's wrist cameras towards +x of the flange, degrees; image x is -y of the flange (`docs/spec/data.md`
/// section 0).
const WRIST_TILT_DEG: f64 = 19.3;

/// A pose with where it comes from.
pub(super) struct Mounted<P> {
    pub(super) pose: P,
    pub(super) origin: String,
    pub(super) warnings: Vec<String>,
}

/// A camera for messages.
#[derive(Clone, Copy)]
pub(super) struct Named<'a> {
    pub(super) id: &'a str,
    pub(super) serial: &'a str,
    pub(super) uuid: &'a str,
    /// The trajectory.
    pub(super) path: &'a Path,
}

/// A pose from a 6-vector.
pub(super) fn pose_of<A: rogs_geometry::Frame, B: rogs_geometry::Frame>([x, y, z, a, b, c]: &[f64; 6]) -> Pose<A, B> {
    Pose::from_xyz_euler([*x, *y, *z], [*a, *b, *c])
}

/// The pose of an external camera at step 0: published, else of the metadata, else of the HDF5; `None` without any.
pub(super) fn external(
    named: Named<'_>,
    metadata: Option<[f64; 6]>,
    log: &CameraLog,
    (published, asked): (Option<&Published>, &BTreeMap<String, Quality>),
) -> StageResult<Option<Mounted<Pose<Base, Camera>>>> {
    let Named { id, serial, uuid, path } = named;
    let later = match published {
        Some(published) => published.pose(uuid, serial, asked)?,
        None => Poses::default(),
    };
    let logged = log.left.as_ref().and_then(|rows| rows.first());
    let mut warnings = later.refused;
    if let (Some(rows), Some(first)) = (&log.left, logged) {
        let first: Pose<Base, Camera> = pose_of(first);
        if rows.iter().any(|row| differ(&first, &pose_of(row), SAME)) {
            warnings.push(format!(
                "`{}`: the pose of camera `{id}` ({serial}) changes from step to step: that of step 0 is taken",
                path.display()
            ));
        }
    }
    let what = format!("the pose of camera `{id}` ({serial})");
    let (rigid, origin) = match (later.taken, metadata, logged) {
        (Some((pose, file)), _, _) => (pose, format!("published ({file})")),
        (None, Some(six), _) => (checks::euler_pose(&six, &what, path)?, "metadata".to_owned()),
        (None, None, Some(six)) => (checks::euler_pose(six, &what, path)?, "HDF5".to_owned()),
        (None, None, None) => return Ok(None),
    };
    let pose = Pose::from_rigid(&rigid).map_err(|error| wrong(path, error))?;
    Ok(Some(Mounted { pose, origin, warnings }))
}

/// The hand-eye of the wrist camera: its pose at step 0 seen from the flange, else the logged offset, else that of the
/// robot's other episodes; `None` without any.
pub(super) fn hand_eye(
    named: Named<'_>,
    metadata: &Metadata,
    at_step_0: Option<[f64; 6]>,
    log: &CameraLog,
    base_from_flange: &Pose<Base, Link>,
    published: Option<&Published>,
) -> StageResult<Option<Mounted<Pose<Link, Camera>>>> {
    let Named { id, serial, path, .. } = named;
    let what = format!("the pose of camera `{id}` ({serial})");
    let logged = log.left.as_ref().and_then(|rows| rows.first().copied());
    let first = match (at_step_0, logged) {
        (Some(six), _) => Some((six, "step 0 of the metadata")),
        (None, Some(six)) => Some((six, "step 0 of the HDF5")),
        (None, None) => None,
    };
    let offset: Option<Pose<Link, Camera>> = log
        .gripper_offset
        .filter(|six| six.iter().any(|&v| v != 0.0))
        .map(|six| pose_of(&six));
    let mut warnings = Vec::new();
    let (pose, origin) = match (first, offset) {
        (Some((six, origin)), offset) => {
            checks::euler_pose(&six, &what, path)?;
            let pose = base_from_flange.inverse() * pose_of::<Base, Camera>(&six);
            plausible(named, &pose, &six, base_from_flange, offset.as_ref())?;
            if let Some(offset) = offset.filter(|offset| differ(&pose, offset, AGREE)) {
                let (metres, radians) = difference(&pose, &offset);
                warnings.push(format!(
                    "the hand-eye of `{id}` ({serial}) by step 0 and the logged offset differ by {:.1} mm and {:.2} degrees",
                    1000.0 * metres,
                    radians.to_degrees()
                ));
            }
            (pose, origin.to_owned())
        }
        (None, Some(offset)) => (offset, "offset in the HDF5".to_owned()),
        (None, None) => {
            let found = match published {
                Some(published) => published.hand_eye(metadata.robot_serial.as_deref(), serial)?,
                None => None,
            };
            let Some((pose, by)) = found else { return Ok(None) };
            warnings.push(format!(
                "the hand-eye of `{id}` ({serial}) is the mean of other episodes ({by}): off by some millimetres and up \
                 to 2 degrees"
            ));
            (pose, format!("published mean ({by})"))
        }
    };
    let distance = pose.translation.length();
    if distance > REACH {
        let text = format!("{what} is {distance:.2} m from the flange at step 0: not on the wrist");
        return Err(
            wrong(path, text).with_hint("is this the wrist camera's serial, and are these metres, camera to base?")
        );
    }
    if pose.rotation.z_axis.z < 0.0 {
        warnings.push(format!(
            "camera `{id}` ({serial}) looks away from the gripper: check its pose"
        ));
    }
    Ok(Some(Mounted { pose, origin, warnings }))
}

/// Refuses a hand-eye that is not as those of other robots, nor the logged one, when another reading of the 6-vector is.
fn plausible(
    named: Named<'_>,
    pose: &Pose<Link, Camera>,
    six: &[f64; 6],
    base_from_flange: &Pose<Base, Link>,
    logged: Option<&Pose<Link, Camera>>,
) -> StageResult<()> {
    let tilt: Pose<Link, Link> = Pose::from_xyz_euler([0.0; 3], [0.0, WRIST_TILT_DEG.to_radians(), 0.0]);
    let usual: Pose<Link, Camera> = tilt * Pose::from_xyz_euler([0.0; 3], [0.0, 0.0, -std::f64::consts::FRAC_PI_2]);
    let fits = |pose: &Pose<Link, Camera>, degrees: f64| match logged {
        Some(logged) => !differ(pose, logged, AGREE),
        None => pose.translation.length() < 0.2 && difference(pose, &usual).1 < degrees.to_radians(),
    };
    if fits(pose, 30.0) {
        return Ok(());
    }
    for (other, text) in misread(&pose_of(six), six) {
        if fits(&(base_from_flange.inverse() * other), 15.0) {
            return Err(misread_error(named, text));
        }
    }
    Ok(())
}

/// Looks whether the robot is where an external camera would see it; returns a warning when it never is.
pub(super) fn check_sight(
    named: Named<'_>,
    pose: &Pose<Base, Camera>,
    lens: &Intrinsics,
    size: (u32, u32),
    flanges: &[Pose<Base, Link>],
) -> StageResult<Option<String>> {
    let share = |pose: &Pose<Base, Camera>| sight(pose, lens, size, flanges);
    let seen = share(pose);
    if seen >= 0.2 {
        return Ok(None);
    }
    let [a, b, c] = rogs_geometry::euler_xyz_from_rotation(&pose.rotation);
    let [x, y, z] = pose.translation.to_array();
    for (other, text) in misread(pose, &[x, y, z, a, b, c]) {
        if share(&other) > 0.8 {
            return Err(misread_error(named, text));
        }
    }
    let Named { id, serial, .. } = named;
    Ok((seen == 0.0).then(|| format!("camera `{id}` ({serial}) never sees the robot's flange: check its pose")))
}

/// Share of the flange's places that lie before the camera and not far outside its image.
fn sight(pose: &Pose<Base, Camera>, lens: &Intrinsics, size: (u32, u32), flanges: &[Pose<Base, Link>]) -> f64 {
    let camera_from_base = pose.inverse();
    let seen = flanges.iter().filter(|flange| {
        let [x, y, z] = (camera_from_base * **flange).translation.to_array();
        let (u, v) = (lens.fx * x / z + lens.cx, lens.fy * y / z + lens.cy);
        let inside = |value: f64, side: u32| (-0.5..1.5).contains(&(value / f64::from(side)));
        SIGHT.contains(&z) && inside(u, size.0) && inside(v, size.1)
    });
    seen.count() as f64 / flanges.len().max(1) as f64
}

/// What a 6-vector would be if it had been written in one of the ways that occur, with words for it.
fn misread(pose: &Pose<Base, Camera>, [x, y, z, a, b, c]: &[f64; 6]) -> [(Pose<Base, Camera>, &'static str); 2] {
    let turn = |angles: [f64; 3]| Pose::<Base, Base>::from_xyz_euler([0.0; 3], angles);
    let moved = Pose::<Base, Base>::from_xyz_euler([*x, *y, *z], [0.0; 3]);
    let turned = turn([*a, 0.0, 0.0]) * turn([0.0, *b, 0.0]) * turn([0.0, 0.0, *c]);
    [
        (
            pose.inverse().relabelled(),
            "base to camera; DROID's are camera to base",
        ),
        (
            (moved * turned).relabelled(),
            "Euler angles about moving axes; DROID's are about fixed ones, R = Rz(c) Ry(b) Rx(a)",
        ),
    ]
}

fn misread_error(named: Named<'_>, text: &str) -> rogs_worker::StageError {
    let Named { id, serial, path, .. } = named;
    let what = format!("the pose of camera `{id}` ({serial}) does not fit the robot, but it does when read as {text}");
    wrong(path, what).with_hint("correct the file that it comes from; docs/droid.md shows the convention")
}

/// Distance from the left to the right eye by the logged poses, metres, and a warning where they are no rectified pair.
pub(super) fn measured_baseline(named: Named<'_>, log: &CameraLog) -> StageResult<(Option<f64>, Option<String>)> {
    let first = |rows: &Option<Vec<[f64; 6]>>| rows.as_ref().and_then(|rows| rows.first().copied());
    let (Some(left), Some(right)) = (first(&log.left), first(&log.right)) else {
        return Ok((None, None));
    };
    let (left, right): (Pose<Base, Camera>, Pose<Base, Camera>) = (pose_of(&left), pose_of(&right));
    let step = (left.inverse() * right).translation.to_array();
    let Named { id, serial, path, .. } = named;
    if step[0] < -0.01 {
        let text = format!(
            "the right eye of camera `{id}` ({serial}) stands {:.1} mm to the left of the left one: the eyes are swapped",
            -1000.0 * step[0]
        );
        return Err(wrong(path, text));
    }
    let (_, turned) = difference(&left, &right);
    let aside = step[1].hypot(step[2]);
    let odd = aside > 0.003 || turned > 0.01 || !(0.02..0.3).contains(&step[0]);
    let text = odd.then(|| {
        format!(
            "the logged eyes of camera `{id}` ({serial}) are no rectified pair ({:.1} mm to the right, {:.1} mm aside, \
             {:.2} degrees): not used for the right eye",
            1000.0 * step[0],
            1000.0 * aside,
            turned.to_degrees()
        )
    });
    Ok(((!odd).then_some(step[0]), text))
}

/// Distance in metres and angle in radians.
pub(super) fn difference<A: rogs_geometry::Frame, B: rogs_geometry::Frame>(
    a: &Pose<A, B>,
    b: &Pose<A, B>,
) -> (f64, f64) {
    let between = a.inverse() * *b;
    let r = between.rotation;
    // Half the length of the skew part is the sine: exact for small angles, where the trace is not.
    let sine = [
        r.y_axis.z - r.z_axis.y,
        r.z_axis.x - r.x_axis.z,
        r.x_axis.y - r.y_axis.x,
    ]
    .map(|part| part / 2.0);
    let sine = sine.iter().map(|part| part * part).sum::<f64>().sqrt();
    let cosine = (r.x_axis.x + r.y_axis.y + r.z_axis.z - 1.0) / 2.0;
    (between.translation.length(), sine.atan2(cosine))
}

/// Whether two poses differ by more than this, metres and radians.
pub(super) fn differ<A: rogs_geometry::Frame, B: rogs_geometry::Frame>(
    a: &Pose<A, B>,
    b: &Pose<A, B>,
    [metres, radians]: [f64; 2],
) -> bool {
    let (far, turned) = difference(a, b);
    far > metres || turned > radians
}

/// Refuses metadata whose external cameras are those of the HDF5 the other way round; warns where they are others.
pub(super) fn check_serials(
    path: &Path,
    cameras: &[(Named<'_>, Option<[f64; 6]>, &CameraLog)],
) -> StageResult<Vec<String>> {
    let mut warnings = Vec::new();
    let same = |six: &[f64; 6], log: &CameraLog| {
        let logged = log.left.as_ref().and_then(|rows| rows.first());
        logged.map(|logged| !differ(&pose_of::<Base, Camera>(six), &pose_of(logged), SAME))
    };
    for (index, (named, six, log)) in cameras.iter().enumerate() {
        let Some(six) = six else { continue };
        if same(six, log) != Some(false) {
            continue;
        }
        let Named { id, serial, .. } = named;
        let mut others = cameras.iter().enumerate().filter(|(other, _)| *other != index);
        if let Some((_, (other, _, _))) = others.find(|(_, (_, _, log))| same(six, log) == Some(true)) {
            let text = format!(
                "the metadata gives camera `{id}` ({serial}) the pose that the HDF5 has for `{}` ({}): the serials are swapped",
                other.id, other.serial
            );
            return Err(wrong(path, text).with_hint("correct the serials in the metadata"));
        }
        warnings.push(format!(
            "the pose of camera `{id}` ({serial}) in the metadata is not that of step 0 in the HDF5: the metadata's is taken"
        ));
    }
    Ok(warnings)
}
