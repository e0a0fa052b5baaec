//! What happens in an episode: reaching, grasping, carrying, pushing, as tool paths that the arm can follow.

use glam::{DMat3, DVec3};
use rogs_geometry::{Base, Pose};

use crate::frame::BodyFrame;
use crate::math::{Draw, minimum_jerk, rot_x, rot_y, rot_z};
use crate::robot::{ARM_JOINTS, HOME, Robot, RobotState, TOOL_Z, gripper_for_gap, solve_tool};
use crate::scene::Object;

/// Kind of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// The tool goes to an object without touching it.
    Reach,
    /// An object is taken and lifted.
    Grasp,
    /// An object in the gripper is moved, and perhaps put down.
    Carry,
    /// An object is pushed over the table with closed fingers.
    Push,
}

impl Action {
    /// The action for a number in [0, 1): grasping and carrying are the most frequent.
    pub(crate) fn of(share: f64) -> Self {
        match share {
            u if u < 0.18 => Self::Reach,
            u if u < 0.50 => Self::Grasp,
            u if u < 0.80 => Self::Carry,
            _ => Self::Push,
        }
    }
}

/// The motion of robot and objects.
#[derive(Debug, Clone)]
pub(crate) struct Motion {
    pub action: Action,
    /// One a frame.
    pub states: Vec<RobotState>,
    /// Object-to-base of the first object, one a frame. The others stay where they are.
    pub target: Vec<Pose<Base, BodyFrame>>,
    /// Frames `[from, to)` in which the first object is rigid to the flange.
    pub held: Option<[usize; 2]>,
}

const ATTEMPTS: usize = 60;
/// Fastest joint movement, radians a second.
const FASTEST: f64 = 2.6;
/// Reach of the closed fingers around the tool centre, half extents along flange x and y, metres.
const FIST: [f64; 2] = [0.0112, 0.0155];

/// Where the tool is at a time; times are shares of the episode.
#[derive(Debug, Clone, Copy)]
struct Waypoint {
    time: f64,
    tool: DVec3,
    yaw: f64,
    tilt: [f64; 2],
}

struct Plan {
    action: Action,
    path: Vec<Waypoint>,
    /// (time, state), ascending.
    gripper: Vec<(f64, f64)>,
    /// Times between which the object is held.
    held: Option<[f64; 2]>,
    /// Object-to-flange while held.
    flange_from_object: Pose<BodyFrame, BodyFrame>,
    /// Direction of a push, and how far the object may be taken.
    push: Option<DVec3>,
    /// Amplitude of the sway of the hand between waypoints.
    sway: [DVec3; 2],
}

/// Draws a motion for the objects until one can be followed. `None` when all attempts fail.
pub(crate) fn draw_motion(
    draw: &mut Draw,
    robot: &Robot,
    objects: &[Object],
    table_z: f64,
    frames: usize,
    fps: f64,
    action: Action,
) -> Option<Motion> {
    (0..ATTEMPTS).find_map(|_| {
        let plan = draw_plan(draw, action, objects, table_z);
        follow(robot, &plan, objects, table_z, frames, fps)
    })
}

fn draw_plan(draw: &mut Draw, action: Action, objects: &[Object], table_z: f64) -> Plan {
    let object = &objects[0];
    let place = object.start.translation;
    let yaw = draw.range(-0.7, 0.7);
    let tilt = [0.10 * draw.normal(), 0.10 * draw.normal()];
    let grip = DVec3::new(place.x, place.y, table_z + object.grip_height);
    let hover = |draw: &mut Draw, from: DVec3, low: f64, high: f64, spread: f64| {
        let aside = DVec3::new(draw.range(-spread, spread), draw.range(-spread, spread), 0.0);
        let mut point = from + aside;
        point.z = table_z + draw.range(low, high);
        point
    };
    let closed_on_it = gripper_for_gap(object.grip_width);
    let at = |time: f64, tool: DVec3, yaw: f64, tilt: [f64; 2]| Waypoint { time, tool, yaw, tilt };
    let no_tilt = [0.0; 2];
    let sway = [draw.normal3(0.006), draw.normal3(0.003)];
    // The object as the gripper holds it: its x axis across the pads, at the height of the grip.
    let held_object = Pose::new(
        rot_z(yaw + std::f64::consts::FRAC_PI_2),
        DVec3::new(place.x, place.y, table_z + object.half.z),
    );
    let flange_at_grip = flange_target(grip, yaw, no_tilt);
    let mut plan = Plan {
        action,
        path: Vec::new(),
        gripper: vec![(0.0, 0.0)],
        held: None,
        flange_from_object: flange_at_grip.inverse() * held_object,
        push: None,
        sway,
    };
    match action {
        Action::Reach => {
            let start = hover(draw, place, 0.22, 0.38, 0.22);
            let above = grip + DVec3::Z * draw.range(0.03, 0.10);
            let turn = draw.range(-0.6, 0.6);
            plan.path = vec![
                at(0.0, start, yaw + turn, tilt),
                at(draw.range(0.75, 0.98), above, yaw, no_tilt),
            ];
            plan.gripper = vec![(0.1, draw.range(0.0, 0.8)), (0.7, draw.range(0.0, 0.3))];
        }
        Action::Grasp => {
            let start = hover(draw, place, 0.14, 0.26, 0.12);
            let (arrive, closed, leave) = (draw.range(0.30, 0.40), draw.range(0.46, 0.54), draw.range(0.55, 0.60));
            let lifted = hover(draw, grip, 0.14, 0.28, 0.14);
            plan.path = vec![
                at(0.0, start, yaw + draw.range(-0.4, 0.4), tilt),
                at(arrive, grip, yaw, no_tilt),
                at(leave, grip, yaw, no_tilt),
                at(1.0, lifted, yaw + draw.range(-0.4, 0.4), tilt),
            ];
            plan.gripper = vec![(arrive, draw.range(0.0, 0.5) * closed_on_it), (closed, closed_on_it)];
            plan.held = Some([closed, 2.0]);
        }
        Action::Carry => {
            let from = hover(draw, place, 0.16, 0.28, 0.18);
            let put = DVec3::new(place.x, place.y, grip.z);
            let down = draw.chance(0.6);
            let arrive = draw.range(0.62, 0.72);
            let last = if down { put } else { hover(draw, place, 0.14, 0.26, 0.1) };
            plan.path = vec![
                at(0.0, from, yaw + draw.range(-0.5, 0.5), tilt),
                at(draw.range(0.05, 0.15), from, yaw + draw.range(-0.3, 0.3), tilt),
                at(arrive, last, yaw, if down { no_tilt } else { tilt }),
            ];
            plan.gripper = vec![(0.0, closed_on_it)];
            plan.held = Some([0.0, 2.0]);
            if down {
                let (release, rise) = (arrive + 0.05, arrive + 0.14);
                plan.path.push(at(rise, put, yaw, no_tilt));
                plan.path
                    .push(at(1.0, put + DVec3::Z * draw.range(0.06, 0.14), yaw, no_tilt));
                plan.gripper = vec![(release, closed_on_it), (rise, closed_on_it * draw.range(0.0, 0.4))];
                plan.held = Some([0.0, release]);
            }
        }
        Action::Push => {
            let angle = draw.range(-std::f64::consts::PI, std::f64::consts::PI);
            let along = DVec3::new(libm::cos(angle), libm::sin(angle), 0.0);
            let height = table_z + object.grip_height.min(0.045);
            let ground = DVec3::new(place.x, place.y, height);
            let begin = ground - along * (object.radius + draw.range(0.04, 0.09));
            let end = ground + along * draw.range(0.02, 0.10);
            let above = begin + DVec3::Z * draw.range(0.03, 0.10);
            let (low, go) = (draw.range(0.12, 0.22), draw.range(0.26, 0.34));
            plan.path = vec![
                at(0.0, above, yaw, no_tilt),
                at(low, begin, yaw, no_tilt),
                at(go, begin, yaw, no_tilt),
                at(draw.range(0.85, 1.0), end, yaw, no_tilt),
            ];
            plan.gripper = vec![(0.0, 1.0)];
            plan.push = Some(along);
        }
    }
    plan
}

/// Flange pose that brings the tool centre to a point: pointing down, turned by yaw, then tilted.
fn flange_target(tool: DVec3, yaw: f64, tilt: [f64; 2]) -> Pose<Base, BodyFrame> {
    let rotation: DMat3 = rot_z(yaw) * rot_x(std::f64::consts::PI + tilt[0]) * rot_y(tilt[1]);
    Pose::new(rotation, tool - rotation * DVec3::Z * TOOL_Z)
}

impl Plan {
    fn target(&self, time: f64) -> Pose<Base, BodyFrame> {
        let (first, last) = (self.path[0], self.path[self.path.len() - 1]);
        if time <= first.time {
            return flange_target(first.tool, first.yaw, first.tilt);
        }
        let Some(pair) = self.path.windows(2).find(|pair| time < pair[1].time) else {
            return flange_target(last.tool, last.yaw, last.tilt);
        };
        let (a, b) = (pair[0], pair[1]);
        let share = (time - a.time) / (b.time - a.time);
        let s = minimum_jerk(share);
        let moving = (b.tool - a.tool).length() > 1e-6;
        let window = if moving {
            16.0 * share * share * (1.0 - share) * (1.0 - share)
        } else {
            0.0
        };
        let swing = libm::sin(std::f64::consts::TAU * share);
        let sway = if self.push.is_some() {
            DVec3::ZERO
        } else {
            (self.sway[0] + self.sway[1] * swing) * window
        };
        let blend = |p: f64, q: f64| p + (q - p) * s;
        flange_target(
            a.tool.lerp(b.tool, s) + sway,
            blend(a.yaw, b.yaw),
            [blend(a.tilt[0], b.tilt[0]), blend(a.tilt[1], b.tilt[1])],
        )
    }

    fn gripper(&self, time: f64) -> f64 {
        let (first, last) = (self.gripper[0], self.gripper[self.gripper.len() - 1]);
        if time <= first.0 {
            return first.1;
        }
        let Some(pair) = self.gripper.windows(2).find(|pair| time < pair[1].0) else {
            return last.1;
        };
        let s = minimum_jerk((time - pair[0].0) / (pair[1].0 - pair[0].0));
        pair[0].1 + (pair[1].1 - pair[0].1) * s
    }
}

fn follow(robot: &Robot, plan: &Plan, objects: &[Object], table_z: f64, frames: usize, fps: f64) -> Option<Motion> {
    let time = |frame: usize| frame as f64 / (frames.max(2) - 1) as f64;
    let mut joints = solve_tool(robot, &plan.target(0.0), HOME)?;
    let mut states = Vec::with_capacity(frames);
    let mut flanges = Vec::with_capacity(frames);
    for frame in 0..frames {
        let next = solve_tool(robot, &plan.target(time(frame)), joints)?;
        let fastest = (0..ARM_JOINTS).map(|k| (next[k] - joints[k]).abs()).fold(0.0, f64::max);
        if fastest > FASTEST / fps {
            return None;
        }
        joints = next;
        states.push(RobotState {
            joints,
            gripper: plan.gripper(time(frame)),
        });
        flanges.push(robot.flange(&joints));
    }
    let held = plan.held.map(|[from, to]| {
        let first = (0..frames).find(|&f| time(f) >= from).unwrap_or(frames);
        let end = (0..frames).find(|&f| time(f) > to).unwrap_or(frames);
        [first, end]
    });
    let target = target_path(plan, objects, &flanges, held);
    // A hand that pushes a tall thing at its foot would run into its top.
    if plan.push.is_some() && objects[0].height > 0.10 {
        return None;
    }
    let free = is_free(objects, &flanges, &target, held, table_z);
    free.then_some(Motion {
        action: plan.action,
        states,
        target,
        held,
    })
}

/// Poses of the first object.
fn target_path(
    plan: &Plan,
    objects: &[Object],
    flanges: &[Pose<Base, BodyFrame>],
    held: Option<[usize; 2]>,
) -> Vec<Pose<Base, BodyFrame>> {
    let object = &objects[0];
    if let Some(along) = plan.push {
        let mut shift: f64 = 0.0;
        let advance = |flange: &Pose<Base, BodyFrame>| {
            let tool = flange.point(DVec3::Z * TOOL_Z);
            let reach =
                FIST[0] * along.dot(flange.rotation.x_axis).abs() + FIST[1] * along.dot(flange.rotation.y_axis).abs();
            let near = object.start.translation.dot(along) - extent(object, along);
            tool.dot(along) + reach - near
        };
        let pose = |flange| {
            shift = shift.max(advance(flange));
            Pose::new(object.start.rotation, object.start.translation + along * shift)
        };
        return flanges.iter().map(pose).collect();
    }
    let Some([first, end]) = held else {
        return vec![object.start; flanges.len()];
    };
    // Before it is taken the object rests as it is held then; afterwards as it was let go.
    let in_hand = |frame: usize| flanges[frame] * plan.flange_from_object;
    let last = flanges.len() - 1;
    let pose = |frame: usize| in_hand(frame.clamp(first.min(last), end.saturating_sub(1).max(first.min(last))));
    (0..flanges.len()).map(pose).collect()
}

/// Largest extent of the object's outline along a direction.
fn extent(object: &Object, along: DVec3) -> f64 {
    let local = object.start.rotation.transpose() * along;
    let reach = |p: &glam::Vec3| p.as_dvec3().dot(-local);
    object.body.mesh.mesh().positions.iter().map(reach).fold(0.0, f64::max)
}

/// Whether fingers and held object keep clear of the table and the other objects.
fn is_free(
    objects: &[Object],
    flanges: &[Pose<Base, BodyFrame>],
    target: &[Pose<Base, BodyFrame>],
    held: Option<[usize; 2]>,
    table_z: f64,
) -> bool {
    let first = &objects[0];
    flanges.iter().enumerate().all(|(frame, flange)| {
        let tool = flange.point(DVec3::Z * TOOL_Z);
        let tip = tool.z - 0.020;
        let carried = held.is_some_and(|[from, to]| (from..to).contains(&frame));
        let bottom = if carried {
            target[frame].translation.z - first.half.z
        } else {
            f64::INFINITY
        };
        let clear_of = |other: &Object, radius: f64, low: f64, at: DVec3| {
            let apart = (other.start.translation - at).truncate().length();
            low > table_z + other.height + 0.012 || apart > other.radius + radius
        };
        tip > table_z
            && objects[1..].iter().all(|other| {
                clear_of(other, 0.055, tip, tool)
                    && clear_of(
                        other,
                        first.radius + 0.004,
                        bottom.min(target[frame].translation.z - first.half.z),
                        target[frame].translation,
                    )
            })
    })
}
