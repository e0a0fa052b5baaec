//! How something that the gripper holds moves, as far as kinematics and gripper states tell
//! (`docs/spec/conditioning.md` section 9).

use glam::DVec3;
use rogs_geometry::{Base, Error, Link, Pose, Recon, Result};
use rogs_schemas::FrameIndex;
use rogs_schemas::records::robot::RobotMaps;

/// A gripper that is more open than at its tightest by at most this much holds on.
const SLACK: f64 = 0.1;
/// A gripper that never closes further than this holds nothing.
const OPEN: f64 = 0.02;
/// What differs by less stands still: metres, and entries of a rotation.
const STILL: f64 = 1e-6;

/// Where a body is at every frame that moves with the hand while the gripper is closed, and stays where it is while the
/// gripper is open, opens or closes. At the first frame it has the pose of the hand.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldPath {
    /// Metres. `[F]`
    recon_from_held: Vec<Pose<Recon, Link>>,
    /// The tool centre, metres. `[F]`
    tool: Vec<DVec3>,
}

impl HeldPath {
    /// The path beside a hand; `gripper` is 0 open, 1 closed. All `[F]`
    #[must_use]
    pub fn new(recon_from_hand: &[Pose<Recon, Link>], gripper: &[f64], tool: Vec<DVec3>) -> Self {
        let tightest = gripper.iter().copied().fold(0.0, f64::max);
        let closed = |state: f64| tightest > OPEN && state >= tightest - SLACK;
        let mut recon_from_held: Vec<Pose<Recon, Link>> = recon_from_hand.first().copied().into_iter().collect();
        for (hand, state) in recon_from_hand.windows(2).zip(gripper.windows(2)) {
            let Some(&last) = recon_from_held.last() else { break };
            let stays = hand[0] == hand[1] || !(closed(state[0]) && closed(state[1]));
            recon_from_held.push(if stays {
                last
            } else {
                hand[1] * hand[0].inverse() * last
            });
        }
        Self { recon_from_held, tool }
    }

    /// The path in a clip of these robot maps; `None` where no link carries the tool centre.
    ///
    /// # Errors
    /// When the robot maps have fewer frames than there are gripper states, or a stored pose is not rigid.
    pub fn of_clip(robot: &RobotMaps, gripper: &[f64]) -> Result<Option<Self>> {
        let recon_from_base: Pose<Recon, Base> = Pose::from_rigid(&robot.recon_from_base)?;
        let links = robot.link_names.len();
        let at_frame = |frame: FrameIndex| -> Result<Vec<Pose<Recon, Link>>> {
            let stored = robot.base_from_link.get(frame.at() * links..(frame.at() + 1) * links);
            let stored = stored.ok_or(Error::MissingLinkPoses { frame })?;
            let in_recon = |pose| Ok(recon_from_base * Pose::<Base, Link>::from_rigid(pose)?);
            stored.iter().map(in_recon).collect()
        };
        let frames = FrameIndex::first(gripper.len());
        let poses: Vec<Vec<Pose<Recon, Link>>> = frames.map(at_frame).collect::<Result<_>>()?;
        let tool = robot.tool_m.chunks_exact(3).take(poses.len());
        let tool: Vec<DVec3> = tool
            .map(|point| recon_from_base.point(DVec3::from_slice(point)))
            .collect();
        let Some(hand) = hand(&poses, &tool, links) else {
            return Ok(None);
        };
        let recon_from_hand: Vec<Pose<Recon, Link>> = poses.iter().map(|links| links[hand]).collect();
        Ok(Some(Self::new(&recon_from_hand, gripper, tool)))
    }

    /// `T(position) T(source)^-1` of what is held, metres; `position` counts frames and may lie between two. `None` outside
    /// the clip.
    #[must_use]
    pub fn motion(&self, source: FrameIndex, position: f64) -> Option<Pose<Recon, Recon>> {
        let at = |position: f64| self.recon_from_held.get(position as usize).filter(|_| position >= 0.0);
        let (before, after) = (at(position.floor())?, at(position.ceil())?);
        let query = if before == after {
            *before
        } else {
            before.towards(after, position - position.floor())
        };
        let source = self.recon_from_held.get(source.at())?;
        Some(if query == *source {
            Pose::IDENTITY
        } else {
            query * source.inverse()
        })
    }

    /// The tool centre at a frame, reconstruction frame, metres.
    #[must_use]
    pub fn tool(&self, frame: FrameIndex) -> Option<DVec3> {
        self.tool.get(frame.at()).copied()
    }
}

/// The link that carries the tool centre: the one in whose frame it stays. Where it lies on the axis of a joint it stays in
/// the frames of both links; the outer one is then meant, whose origin lies on that axis too, as descriptions of robots have
/// it, while that of the inner one need not. What that leaves open the order of the description decides.
fn hand(poses: &[Vec<Pose<Recon, Link>>], tool: &[DVec3], links: usize) -> Option<usize> {
    let pose = |frame: usize, link: usize| poses.get(frame)?.get(link).copied();
    let seen_from = |frame: usize, link: usize, point: DVec3| Some(pose(frame, link)?.inverse().point(point));
    let stays = |link: usize, point: &dyn Fn(usize) -> Option<DVec3>| -> Option<bool> {
        let first = seen_from(0, link, point(0)?)?;
        let mut frames = 0..poses.len();
        Some(frames.all(|frame| {
            let there = point(frame).and_then(|point| seen_from(frame, link, point));
            there.is_some_and(|there| (there - first).length() < STILL)
        }))
    };
    let origin_stays = |of: usize, link: usize| {
        let origin = |frame: usize| Some(pose(frame, of)?.translation);
        stays(link, &origin) == Some(true)
    };
    let turns = |a: usize, b: usize| {
        let relative = |frame: usize| Some(pose(frame, a)?.rotation.transpose() * pose(frame, b)?.rotation);
        (0..poses.len()).any(|frame| {
            relative(frame)
                .zip(relative(0))
                .is_some_and(|(now, first)| !now.abs_diff_eq(first, STILL))
        })
    };
    let carries = |link: &usize| stays(*link, &|frame| tool.get(frame).copied()) == Some(true);
    (0..links).filter(carries).reduce(|found, next| {
        if !turns(found, next) {
            return found;
        }
        match (origin_stays(next, found), origin_stays(found, next)) {
            (false, true) => found,
            _ => next,
        }
    })
}

#[cfg(test)]
mod tests {
    use rogs_schemas::ClipId;

    use super::*;

    /// Base, forearm, hand on the forearm's turning z axis, a camera on the forearm: the tool centre lies on that axis.
    fn arm(order: [usize; 4], gripper: &[f64]) -> (RobotMaps, Vec<Pose<Base, Link>>) {
        let count = gripper.len();
        let mut hands = Vec::new();
        let (mut base_from_link, mut tool_m) = (Vec::new(), Vec::new());
        for frame in 0..count {
            let t = frame as f64;
            let forearm: Pose<Base, Link> = Pose::from_xyz_euler([0.4 + 0.01 * t, 0.1, 0.5], [3.0, 0.02 * t, 0.0]);
            let on_forearm = |xyz, turn: f64| Pose::<Link, Link>::from_xyz_euler(xyz, [0.0, 0.0, turn]);
            let hand = forearm * on_forearm([0.0, 0.0, 0.1], 0.1 * t);
            // The joint's axis does not meet the forearm's own origin.
            let inner = forearm * on_forearm([0.088, 0.0, 0.0], 0.3);
            let camera = forearm * on_forearm([0.0, 0.05, 0.02], 1.0);
            let links = [Pose::IDENTITY, inner, hand, camera];
            base_from_link.extend(order.map(|link| links[link].to_rigid()));
            tool_m.extend(hand.point(DVec3::Z * 0.12).to_array());
            hands.push(hand);
        }
        let recon_from_base: Pose<Recon, Base> = Pose::from_xyz_euler([0.3, -0.2, 1.0], [0.4, 0.5, 0.6]);
        let robot = RobotMaps {
            clip_id: ClipId::made_of("clip"),
            link_names: (0..4).map(|link| format!("link{link}")).collect(),
            base_from_link,
            base_from_camera: Vec::new(),
            recon_from_base: recon_from_base.to_rigid(),
            tool_m,
            height: 0,
            width: 0,
            maps: Vec::new(),
        };
        (robot, hands)
    }

    fn close(a: DVec3, b: DVec3) -> bool {
        (a - b).length() < 1e-9
    }

    #[test]
    fn points_of_the_hand_stay_in_it_whatever_the_order_of_links() {
        let gripper = [0.6; 5];
        for order in [[0, 1, 2, 3], [2, 3, 1, 0], [3, 2, 0, 1]] {
            let (robot, hands) = arm(order, &gripper);
            let recon_from_base: Pose<Recon, Base> = Pose::from_rigid(&robot.recon_from_base).unwrap();
            let path = HeldPath::of_clip(&robot, &gripper).unwrap().unwrap();
            for corner in [DVec3::new(0.03, -0.02, 0.13), DVec3::new(-0.03, 0.02, 0.18)] {
                let at = |frame: usize| recon_from_base.point(hands[frame].point(corner));
                for (source, query) in [(0, 4), (3, 1), (2, 2)] {
                    let motion = path.motion(FrameIndex(source as u32), query as f64).unwrap();
                    assert!(close(motion.point(at(source)), at(query)), "{order:?} {source} {query}");
                }
            }
            assert!(close(
                path.tool(FrameIndex(2)).unwrap(),
                recon_from_base.point(hands[2].point(DVec3::Z * 0.12))
            ));
        }
    }

    #[test]
    fn nothing_moves_before_it_is_taken_and_after_it_is_let_go() {
        let gripper = [0.0, 0.3, 0.6, 0.58, 0.6, 0.2, 0.1];
        let (robot, hands) = arm([0, 1, 2, 3], &gripper);
        let recon_from_base: Pose<Recon, Base> = Pose::from_rigid(&robot.recon_from_base).unwrap();
        let path = HeldPath::of_clip(&robot, &gripper).unwrap().unwrap();
        let point = DVec3::new(0.5, 0.1, 0.3);
        let motion = |source, query: f64| path.motion(FrameIndex(source), query).unwrap();
        for (source, query) in [(0, 2.0), (1, 0.0), (4, 6.0), (5, 4.0)] {
            assert_eq!(motion(source, query), Pose::IDENTITY, "{source} {query}");
        }
        // It is held from frame 2 to frame 4.
        let carried = recon_from_base * hands[4] * hands[2].inverse() * recon_from_base.inverse();
        assert!(close(motion(0, 6.0).point(point), carried.point(point)));
        assert!(!close(carried.point(point), point));
        // Between frames it is between.
        let half = motion(0, 2.5).point(point);
        let ends = [motion(0, 2.0).point(point), motion(0, 3.0).point(point)];
        assert!((half - (ends[0] + ends[1]) / 2.0).length() < 3e-3 && !close(half, ends[0]));
        assert_eq!(path.motion(FrameIndex(0), 6.5), None);
    }

    #[test]
    fn an_open_gripper_holds_nothing() {
        let gripper = [0.0, 0.01, 0.0];
        let (robot, _) = arm([0, 1, 2, 3], &gripper);
        let path = HeldPath::of_clip(&robot, &gripper).unwrap().unwrap();
        assert_eq!(path.motion(FrameIndex(0), 2.0), Some(Pose::IDENTITY));
    }

    #[test]
    fn without_a_link_that_carries_the_tool_there_is_no_path() {
        let (mut robot, _) = arm([0, 1, 2, 3], &[0.5; 4]);
        robot.tool_m[5] += 0.01;
        assert_eq!(HeldPath::of_clip(&robot, &[0.5; 4]).unwrap(), None);
        assert!(HeldPath::of_clip(&robot, &[0.5; 5]).is_err());
    }
}
